"""What an MJCF file says that Pinocchio's reader drops or fills in."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from .attributes import axis, floats
from .errors import ModelError

_NUMBERS = {
    "pos": (3,), "quat": (4,), "euler": (3,), "axisangle": (4,), "mass": (1,),
    "diaginertia": (3,), "fullinertia": (6,), "armature": (1,), "ref": (1,),
}  # fmt: skip


def check_mjcf(root: Element) -> None:
    """Refuse what cannot be reduced.  Raises ModelError that names the joint or body."""
    for include in root.iter("include"):
        raise ModelError(
            f"<include file='{include.get('file')}'> is not read; put the parts into one file"
        )
    for equality in root.iterfind("equality/*"):
        if equality.get("active", "true") == "true":
            keys = ("name", "body1", "body2", "joint1", "joint2", "site1", "site2")
            ends = ", ".join(f"{key}={equality.get(key)}" for key in keys if equality.get(key))
            raise ModelError(
                f"closed loops are not supported: equality <{equality.tag}> ({ends}); "
                'remove it or set active="false"'
            )
    top = root.findall("worldbody/body")
    if len(top) > 1:
        raise ModelError(
            f"body '{top[1].get('name')}' stands beside body '{top[0].get('name')}' in the world; "
            "one body carries all others"
        )
    for body in root.iter("body"):
        _check_body(body)


def _check_body(body: Element) -> None:
    who = f"body '{body.get('name')}'"
    _check_numbers(body, who)
    inertial = body.find("inertial")
    if inertial is None:
        for geom in body.findall("geom"):
            if geom.get("type") == "mesh" or "mesh" in geom.attrib:
                raise ModelError(f"{who} takes its mass from a mesh; give it an <inertial>")
    else:
        _check_numbers(inertial, who)
        (mass,) = floats(inertial, "mass", f"the mass of {who}", 1)
        if mass < 0:
            raise ModelError(f"{who} has negative mass {mass:g}")
        if not {"diaginertia", "fullinertia"} & set(inertial.attrib):
            raise ModelError(f"{who} has an inertial element without diaginertia or fullinertia")
    for joint in body.findall("joint"):
        name = f"joint '{joint.get('name')}'"
        _check_numbers(joint, name)
        if "axis" in joint.attrib:
            axis(joint, "axis", name)


def _check_numbers(element: Element, who: str) -> None:
    for key, sizes in _NUMBERS.items():
        if key in element.attrib:
            floats(element, key, who, *sizes)
