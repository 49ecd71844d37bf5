"""The parts of an MJCF file that Pinocchio's reader drops or fills in."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from ..common.arrays import Array
from ..common.errors import ModelError
from .xml_numbers import axis, floats

_NUMBERS = {
    "pos": (3,), "quat": (4,), "euler": (3,), "axisangle": (4,), "mass": (1,), "density": (1,),
    "diaginertia": (3,), "fullinertia": (6,), "armature": (1,), "ref": (1,), "fromto": (6,),
}  # fmt: skip
_NOT_NEGATIVE = ("mass", "density")
_BLANK = " \t\n\r"
_ONCE = ("compiler", "option")  # Pinocchio reads the first only
_UNREAD = ("include", "frame", "replicate", "attach", "composite", "flexcomp")
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


def check_mjcf(root: Element) -> None:
    """Refuse what cannot be reduced.  Raises ModelError that names the joint or body."""
    for tag in _UNREAD:
        for element in root.iter(tag):
            said = " ".join(f"{key}='{value}'" for key, value in element.attrib.items())
            raise ModelError(f"<{tag} {said}> is not read; write its parts out in the file itself")
    for tag in _ONCE:
        if len(root.findall(tag)) > 1:
            raise ModelError(f"<{tag}> stands in the file more than once; merge the elements")
    for equality in root.iterfind("equality/*"):
        if equality.get("active", "true") == "true":
            keys = ("name", "body1", "body2", "joint1", "joint2", "site1", "site2")
            ends = ", ".join(f"{key}={equality.get(key)}" for key in keys if equality.get(key))
            raise ModelError(
                f"closed loops are not supported: equality <{equality.tag}> ({ends}); "
                'remove it or set active="false"'
            )
    for element in root.iterfind("default//*"):
        _check_numbers(element, f"<{element.tag}> in <default>")
    top = root.findall("worldbody/body")
    if len(top) > 1:
        raise ModelError(
            f"body '{top[1].get('name')}' stands beside body '{top[0].get('name')}' in the world; "
            "one body carries all others"
        )
    defaults = [geom for geom in root.iterfind("default//geom") if _shape_keys(geom)]
    for body in root.iterfind("worldbody//body"):
        _check_body(body, shapes_by_default=bool(defaults))


def gravity_of(root: Element) -> Array | None:
    """Return the gravity of an MJCF file, (3,) [m/s²], or None if it does not say."""
    option = root.find("option")
    if option is None:
        return None
    flag = option.find("flag")
    if flag is not None and flag.get("gravity") == "disable":
        return np.zeros(3)
    if "gravity" not in option.attrib:
        return None
    return floats(option, "gravity", "the MJCF option", 3, blank=_BLANK)


def _check_body(body: Element, *, shapes_by_default: bool) -> None:
    who = f"body '{body.get('name')}'"
    _check_numbers(body, who)
    inertial = body.find("inertial")
    if inertial is None:
        for geom in body.findall("geom"):
            _check_geom(geom, who, shapes_by_default=shapes_by_default)
    else:
        _check_numbers(inertial, who)
        floats(inertial, "mass", f"the mass of {who}", 1)
        if not {"diaginertia", "fullinertia"} & set(inertial.attrib):
            raise ModelError(f"{who} has an inertial element without diaginertia or fullinertia")
    for joint in body.findall("joint"):
        name = f"joint '{joint.get('name')}'"
        _check_numbers(joint, name)
        if "axis" in joint.attrib:
            axis(joint, "axis", name, blank=_BLANK)


def _check_geom(geom: Element, who: str, *, shapes_by_default: bool) -> None:
    """Refuse a shape from which Pinocchio would guess the inertia of a body."""
    _check_numbers(geom, f"a geom of {who}")
    kind = geom.get("type", "sphere")
    if shapes_by_default or "mesh" in geom.attrib or kind not in _SIZES:
        shape = "shapes given in <default>" if shapes_by_default else f"a {kind}"
        raise ModelError(f"{who} takes its mass from {shape}; give it an <inertial>")
    if "fromto" in geom.attrib:
        floats(geom, "size", f"a {kind} of {who}", 1, 2, 3, blank=_BLANK)
    else:
        size = floats(geom, "size", f"a {kind} of {who}", 1, 2, 3, blank=_BLANK)
        if len(size) < _SIZES[kind]:
            raise ModelError(f"a {kind} of {who} has {len(size)} sizes, not {_SIZES[kind]}")


def _shape_keys(geom: Element) -> set[str]:
    return {"type", "mesh", "size", "fromto"} & set(geom.attrib)


def _check_numbers(element: Element, who: str) -> None:
    for key, sizes in _NUMBERS.items():
        if key in element.attrib:
            values = floats(element, key, who, *sizes, blank=_BLANK)
            if key in _NOT_NEGATIVE and values[0] < 0:
                raise ModelError(f"{who} has negative {key} {values[0]:g}")
