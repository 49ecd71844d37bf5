"""Robot description files: URDF and MJCF, read through Pinocchio without their meshes.

Pinocchio passes over some things that change the dynamics (mimic joints, equality
constraints, the axis of a planar joint, gravity in MJCF).  They are looked up in the
file itself here, so that they are honoured or refused, never dropped.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from .errors import LoadError, ModelError


def read_description(path: Path, lock: Collection[str]) -> pin.Model:
    """Return the model in a URDF or MJCF file, on its own root, with its gravity.

    lock: joints that will be locked, which may therefore be mimic joints.
    Raises LoadError if the file cannot be read, ModelError if it holds what cannot be reduced.
    """
    if not path.is_file():
        raise LoadError(f"no such file: {path}")
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, UnicodeDecodeError, ValueError) as error:
        raise LoadError(f"{path} is not XML: {error}") from None
    except OSError as error:
        raise LoadError(f"{path} cannot be read: {error.strerror}") from None
    if root.tag == "robot":
        _check_urdf(root, lock)
        build = pin.buildModelFromUrdf
    elif root.tag == "mujoco":
        _check_mjcf(root)
        build = pin.buildModelFromMJCF
    else:
        raise LoadError(f"{path} is neither URDF (<robot>) nor MJCF (<mujoco>), but <{root.tag}>")
    try:
        model = build(str(path))
    except (ValueError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-1]
        raise LoadError(f"Pinocchio cannot read {path}: {reason}") from None
    option = root.find("option")
    if root.tag == "mujoco" and option is not None and "gravity" in option.attrib:
        model.gravity.linear = _floats(option, "gravity", "the MJCF option gravity", 3)
    return model


def mimic_joints(urdf: Path) -> list[str]:
    """Return the moving joints of a URDF that follow another joint."""
    return _mimics(ElementTree.parse(urdf).getroot())


def refuse_mimics(mimics: Collection[str], lock: Collection[str]) -> None:
    """Raise ModelError if a mimic joint is not locked."""
    if free := [name for name in mimics if name not in lock]:
        raise ModelError(
            f"mimic joints are not supported; lock the joints that follow others: lock={free}"
        )


def _moving(robot: ElementTree.Element) -> list[ElementTree.Element]:
    return [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]


def _mimics(robot: ElementTree.Element) -> list[str]:
    return [j.get("name", "?") for j in _moving(robot) if j.find("mimic") is not None]


def _check_urdf(robot: ElementTree.Element, lock: Collection[str]) -> None:
    refuse_mimics(_mimics(robot), lock)
    for joint in _moving(robot):
        axis = joint.find("axis")
        if joint.get("type") == "planar" and axis is not None:
            x, y, z = _floats(axis, "xyz", f"axis of joint '{joint.get('name')}'", 3)
            if x or y or z <= 0:
                raise ModelError(
                    f"planar joint '{joint.get('name')}' has the plane's normal ({x:g}, {y:g}, "
                    f"{z:g}); Pinocchio takes it along z: turn the joint's origin instead"
                )
    for link in robot.findall("link"):
        mass = link.find("inertial/mass")
        if mass is not None:
            (value,) = _floats(mass, "value", f"mass of link '{link.get('name')}'", 1)
            if value < 0:
                raise ModelError(f"link '{link.get('name')}' has negative mass {value:g}")


def _check_mjcf(root: ElementTree.Element) -> None:
    for equality in root.iterfind("equality/*"):
        if equality.get("active", "true") == "true":
            ends = ", ".join(
                f"{key}={equality.get(key)}"
                for key in ("name", "body1", "body2", "joint1", "joint2", "site1", "site2")
                if equality.get(key)
            )
            raise ModelError(
                f"closed loops are not supported: equality <{equality.tag}> ({ends}); "
                'remove it or set active="false"'
            )


def _floats(element: ElementTree.Element, key: str, what: str, size: int) -> list[float]:
    text = element.get(key, "")
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != size or not all(map(math.isfinite, values)):
        raise ModelError(f"{what} must be {size} finite number(s), got '{text}'")
    return values
