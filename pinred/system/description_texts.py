"""URDF and MJCF texts of described robots (see robot_description)."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from .described_body import DescribedBody

_URDF_TYPES = {"slide": "prismatic", "fixed": "fixed"}


def urdf_of(name: str, bodies: Sequence[DescribedBody]) -> str:
    """Return a described robot as a URDF text, with three hinges for each ball."""
    robot = Element("robot", name=name)
    for body in bodies:
        parent = body.parent
        at, rpy = _numbers(body.at), _numbers(pin.rpy.matrixToRpy(_rotation(body.attitude)))
        if body.joint == "ball":
            for axis in "yx":
                carrier = f"{body.name}_{axis}_carrier"
                SubElement(robot, "link", name=carrier)
                _joint(robot, f"{body.name}_{axis}", "continuous", parent, carrier, at, rpy, axis)
                parent, at, rpy = carrier, "0 0 0", "0 0 0"
            _joint(robot, f"{body.name}_z", "continuous", parent, body.name, at, rpy, "z")
        elif body.joint:
            kind = _URDF_TYPES.get(body.joint, "revolute" if body.limits else "continuous")
            joint = _joint(robot, body.name, kind, parent, body.name, at, rpy, body.axis)
            if kind in ("revolute", "prismatic"):
                low, high = (-np.inf, np.inf) if body.limits is None else body.limits
                most = float(np.finfo(float).max)
                SubElement(
                    joint, "limit", lower=repr(max(low, -most)), upper=repr(min(high, most)),
                    effort="0", velocity="0",
                )  # fmt: skip
        _link(robot, body)
    indent(robot)
    return tostring(robot, encoding="unicode") + "\n"


def _joint(
    robot: Element, name: str, kind: str, parent: str, child: str, at: str, rpy: str,
    axis: str | Array,
) -> Element:  # fmt: skip
    """Add a joint to a URDF robot."""
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=at, rpy=rpy)
    if kind != "fixed":
        vector = np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else axis
        SubElement(joint, "axis", xyz=_numbers(vector))
    return joint


def _link(robot: Element, body: DescribedBody) -> None:
    """Add a link with its inertia, if it has mass, to a URDF robot."""
    link = SubElement(robot, "link", name=body.name)
    if not body.mass:
        return
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(body.com))
    SubElement(inertial, "mass", value=repr(body.mass))
    entries = {
        f"i{'xyz'[i]}{'xyz'[j]}": repr(float(body.inertia[i, j]))
        for i in range(3)
        for j in range(i, 3)
    }
    SubElement(inertial, "inertia", entries)


def mjcf_of(name: str, bodies: Sequence[DescribedBody]) -> str:
    """Return a described robot as an MJCF text, with a free joint at the base."""
    root = Element("mujoco", model=name)
    # Every inertia is written; shapes, of which there are none, would not change it.
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    elements = {"": SubElement(root, "worldbody")}
    for body in bodies:
        x, y, z, w = body.attitude
        element = SubElement(
            elements[body.parent], "body", name=body.name, pos=_numbers(body.at),
            quat=_numbers(np.array([w, x, y, z])),
        )  # fmt: skip
        elements[body.name] = element
        if not body.joint:
            SubElement(element, "freejoint")
        elif body.joint != "fixed":
            joint = SubElement(element, "joint", name=body.name, type=body.joint)
            if body.joint != "ball":
                joint.set("axis", _numbers(body.axis))
            if body.limits is not None:
                joint.set("range", _numbers(np.array(body.limits)))
        if not body.mass:
            continue
        SubElement(
            element, "inertial", _moments(body.inertia), pos=_numbers(body.com),
            mass=repr(body.mass),
        )  # fmt: skip
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _moments(inertia: Array) -> dict[str, str]:
    """Return the MJCF attribute of an inertia.  MuJoCo accepts zeros in principal moments only."""
    products = inertia[np.triu_indices(3, 1)]
    if not products.any():
        return {"diaginertia": _numbers(np.diag(inertia))}
    return {"fullinertia": _numbers(np.append(np.diag(inertia), products))}


def _numbers(values: Array) -> str:
    """Return numbers as text, separated by blanks, which reads back as the same numbers."""
    return " ".join(repr(float(value)) for value in values)


def _rotation(attitude: Array) -> Array:
    """Return the rotation matrix of a quaternion (x, y, z, w)."""
    return np.asarray(pin.Quaternion(np.array(attitude)).matrix())
