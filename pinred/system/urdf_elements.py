"""URDF elements that Pinocchio's reader drops or replaces by defaults: checks and conversion.

Pinocchio's parser rejects files for reasons that do not change a motion, such as limits without
effort or velocity.  `reduced_text` keeps only the elements that affect the motion, so errors in
meshes, paths and materials do not matter.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import ModelError
from ..common.names import quoted
from .robot_file_contents import Coupling

UNLIMITED = 1.7e308  # position limit that represents infinity, because the parser cannot read "inf"
_DIGITS = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"
_NUMBER = re.compile(_DIGITS, re.ASCII)
_WITH_COMMAS = re.compile(rf"\s*{_DIGITS}(\s*,\s*{_DIGITS})+\s*", re.ASCII)
_LISTS = ("xyz", "rpy", "size", "scale", "rgba")  # attributes that contain several numbers
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_NEEDS_LIMITS = ("revolute", "prismatic")
_INERTIAL = ("origin", "mass", "inertia")
_JOINT = ("origin", "parent", "child", "axis", "mimic", "dynamics")


def replace_commas(robot: Element) -> str:
    """Replace commas between the numbers of lists by blanks, in place.

    A list that mixes commas and blanks stays as it is, because its commas may be decimal ones.

    Returns:
        A warning, or "" if there are no such lists.
    """
    lists = [
        (element.attrib, key)
        for element in robot.iter()
        for key in _LISTS
        if _WITH_COMMAS.fullmatch(element.get(key, ""))
    ]
    if not lists:
        return ""
    attributes, key = lists[0]
    first = f"{key}={quoted(attributes[key])}"
    for attributes, key in lists:
        attributes[key] = attributes[key].replace(",", " ")
    return (
        f"{len(lists)} lists of numbers have commas, such as {first}; they are read as blanks, "
        "which URDF requires"
    )


def check_urdf(robot: Element) -> None:
    """Reject invalid axes and inertias.  Raises ModelError that names the joint or link."""
    for joint in moving_joints(robot):
        _check_axis(joint)
    for link in robot.findall("link"):
        owner, inertials = f"link {quoted(link.get('name', '?'))}", link.findall("inertial")
        if len(inertials) > 1:
            raise ModelError(
                f"{owner} has {len(inertials)} inertial elements; keep only one of them"
            )
        for inertial in inertials:
            _check_inertial(inertial, owner)


def total_mass(robot: Element) -> float:
    """Return the mass of all links [kg]; call `check_urdf` first."""
    return sum(float(mass.get("value", "0")) for mass in robot.iterfind("link/inertial/mass"))


def tree_depth(robot: Element) -> int:
    """Return the largest number of joints from a root link to a link.

    Raises:
        ModelError: A link is the child of two joints, or joints form a cycle.
    """
    depth: dict[str, int] = {}
    parent_of = _parents(robot)
    for link in parent_of:
        path, end = {link: None}, link
        while end in parent_of and end not in depth:
            end = parent_of[end]
            if end in path:
                raise ModelError(
                    f"link {quoted(link)} is attached to itself through a cycle of joints"
                )
            path[end] = None
        first = depth.setdefault(end, 0)
        depth |= {name: first + k for k, name in enumerate(reversed(path))}
    return max(depth.values(), default=0)


def _parents(robot: Element) -> dict[str, str]:
    """Return the parent of each link.  Raises ModelError for a child of two joints."""
    parent_of: dict[str, str] = {}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            continue  # Pinocchio's reader rejects the joint.
        name = child.get("link", "?")
        if name in parent_of:
            raise ModelError(
                f"closed loops are not supported: link {quoted(name)} is the child of two joints, "
                f"the second {quoted(joint.get('name', '?'))}"
            )
        parent_of[name] = parent.get("link", "?")
    return parent_of


def moving_joints(robot: Element) -> list[Element]:
    """Return the joints that are not fixed."""
    return [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]


def mimic_couplings(robot: Element) -> tuple[Coupling, ...]:
    """Return the couplings that <mimic> elements define between moving joints.

    The <mimic> element of a fixed joint has no effect and is ignored.

    Raises:
        ModelError: A <mimic> names no joint, or has invalid numbers.
    """
    couplings = []
    for joint in moving_joints(robot):
        mimic, name = joint.find("mimic"), joint.get("name", "?")
        if mimic is None:
            continue
        leader = mimic.get("joint")
        if leader is None:
            raise ModelError(
                f"the <mimic> of joint '{name}' names no joint; add the attribute joint="
            )
        ratio, offset = (
            float(_floats(mimic, key, f"the <mimic> of joint '{name}'", 1)[0])
            if key in mimic.attrib
            else default
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        couplings.append(Coupling(name, {leader: ratio}, offset))
    return tuple(couplings)


def keep_numbers(robot: Element, model: pin.Model) -> None:
    """Copy the numbers of planar and floating joints that Pinocchio drops to the model.

    They are damping, dry friction, and the limits of velocity and effort.
    """
    for joint in moving_joints(robot):
        if joint.get("type") not in ("planar", "floating"):
            continue
        name = joint.get("name", "?")
        entry = model.joints[model.getJointId(name)]
        entries = slice(entry.idx_v, entry.idx_v + entry.nv)
        for tag, key, array, sign in (
            ("dynamics", "damping", model.damping, 1.0),
            ("dynamics", "friction", model.upperDryFrictionLimit, 1.0),
            ("dynamics", "friction", model.lowerDryFrictionLimit, -1.0),
            ("limit", "velocity", model.upperVelocityLimit, 1.0),
            ("limit", "effort", model.upperEffortLimit, 1.0),
        ):
            element = joint.find(tag)
            if element is not None and key in element.attrib:
                (value,) = _floats(element, key, f"the {tag} of joint '{name}'", 1)
                array[entries] = sign * value


def reduced_text(robot: Element) -> str:
    """Return a URDF text with only the elements that affect the motion, after `check_urdf`."""
    copied = Element("robot", {"name": robot.get("name", "robot")})
    for link in robot.findall("link"):
        target = SubElement(copied, "link", link.attrib)
        if (inertial := link.find("inertial")) is not None:
            _copy(inertial, SubElement(target, "inertial"), _INERTIAL)
    for joint in robot.findall("joint"):
        target = SubElement(copied, "joint", joint.attrib)
        _copy(joint, target, _JOINT)
        limit, limits = joint.find("limit"), {"effort": "0", "velocity": "0"}
        if limit is not None:
            SubElement(target, "limit", limits | _trimmed(limit))
        elif joint.get("type") in _NEEDS_LIMITS:
            limits |= {"lower": f"-{UNLIMITED}", "upper": f"{UNLIMITED}"}
            SubElement(target, "limit", limits)
    return ElementTree.tostring(copied, encoding="unicode")


def _copy(source: Element, target: Element, tags: tuple[str, ...]) -> None:
    for tag in tags:
        if (child := source.find(tag)) is not None:
            SubElement(target, tag, _trimmed(child))


def _trimmed(element: Element) -> dict[str, str]:
    """Return the attributes with whitespace stripped from their values."""
    names = ("link", "joint")
    return {k: v if k in names else v.strip() for k, v in element.attrib.items()}


def _check_axis(joint: Element) -> None:
    name, axis = f"joint {quoted(joint.get('name', '?'))}", joint.find("axis")
    planar = joint.get("type") == "planar"
    if joint.get("type") == "floating":
        return
    if axis is None:
        if planar:
            raise ModelError(f"planar {name} has no <axis>; add <axis xyz='0 0 1'/>")
        return
    x, y, z = _floats(axis, "xyz", f"the axis of {name}", 3)
    if not (x or y or z):
        raise ModelError(f"the axis of {name} is zero")
    if planar and (x or y or z <= 0):
        raise ModelError(
            f"planar {name} has the plane's normal ({x:g}, {y:g}, {z:g}); "
            "Pinocchio assumes z. Rotate the joint's origin instead"
        )


def _check_inertial(inertial: Element, owner: str) -> None:
    mass, inertia, origin = (inertial.find(tag) for tag in ("mass", "inertia", "origin"))
    if mass is None or inertia is None:
        missing = "mass" if mass is None else "inertia"
        raise ModelError(f"{owner} has an inertial element without <{missing}>")
    (value,) = _floats(mass, "value", f"the mass of {owner}", 1)
    if value < 0:
        raise ModelError(f"{owner} has negative mass {value:g}")
    for key in _MOMENTS:
        _floats(inertia, key, f"the inertia of {owner}", 1)
    for key in ("xyz", "rpy"):
        if origin is not None and key in origin.attrib:
            _floats(origin, key, f"the inertial origin of {owner}", 3)


def _floats(element: Element, key: str, owner: str, size: int) -> Array:
    """Return the numbers in an attribute, read as strictly as Pinocchio's parsers do.

    Args:
        element: Element.
        key: Name of the attribute.
        owner: Owner of the attribute, for the message.
        size: Expected number of numbers.
    Raises:
        ModelError: The attribute does not consist of `size` finite numbers.
    """
    text = element.get(key, "")
    words = text.split()
    values = np.array([float(w) for w in words if _NUMBER.fullmatch(w)])
    if len(values) != len(words) or len(values) != size or not np.isfinite(values).all():
        raise ModelError(f"{owner}: '{key}' must be {size} finite number(s), got {quoted(text)}")
    return values
