"""Cassie from the SDF of example-robot-data, with its loops closed by connect constraints.

The masses, axes and springs are those of Agility Robotics' file cassie_v2.sdf.  As in MuJoCo's
menagerie, the achilles rod hangs on a ball at the hip and meets the heel spring at a point, and
the plantar rod meets the foot at a point: 12 equations of rank 10.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin

from pinred.system.loops.loop import Loop

_POINTS = ("achilles-spring-joint", "plantar-foot-joint")


def cassie_path() -> Path | None:
    """Return the path of cassie_v2.sdf; None if example-robot-data is not installed."""
    spec = find_spec("example_robot_data")
    if spec is None or spec.origin is None:
        return None
    for folder in Path(spec.origin).parents:
        path = folder / "share/example-robot-data/robots/cassie_description/robots/cassie_v2.sdf"
        if path.is_file():
            return path
    return None


def cassie(path: Path) -> tuple[pin.Model, list[Loop], dict[str, tuple[float, float]]]:
    """Return the model on a free flyer, its loops, and its springs {joint: (stiffness, rest)}."""
    source = ET.parse(path).getroot().find("model")
    assert source is not None
    links = {str(link.get("name")): link for link in source.findall("link")}
    at = {name: _pose(link) for name, link in links.items()}
    model, springs = pin.Model(), dict[str, tuple[float, float]]()
    model.name = "cassie"
    model.gravity.setZero()
    carried = {"pelvis": model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")}
    _append(model, carried["pelvis"], links["pelvis"])
    joints = source.findall("joint")
    waiting = [joint for joint in joints if not str(joint.get("name")).endswith(_POINTS)]
    while waiting:
        joint = waiting.pop(0)
        name, (first, second) = str(joint.get("name")), _ends(joint)
        if joint.get("type") == "ball":  # the rod is the parent in the file; its child carries it
            parent, child = second, first
            position = pin.SE3(at[child].rotation, (at[second] * _pose(joint)).translation)
            kind = pin.JointModelSpherical()
        else:
            parent, child = first, second
            position = at[child]
            axis = np.array([float(c) for c in str(joint.findtext("axis/xyz")).split()])
            kind = pin.JointModelRevoluteUnaligned(*(axis / np.linalg.norm(axis)))
        if parent not in carried:
            waiting.append(joint)
            continue
        frame = at[parent].actInv(position)
        carried[child] = model.addJoint(carried[parent], kind, frame, name)
        _append(model, carried[child], links[child])
        for stiffness in joint.iter("spring_stiffness"):
            springs[name] = (float(str(stiffness.text)), 0.0)
    loops = []
    for joint in joints:
        name, (first, second) = str(joint.get("name")), _ends(joint)
        if not name.endswith(_POINTS):
            continue
        point = (at[second] * _pose(joint)).translation
        for link, suffix in ((first, "a"), (second, "b")):
            here = pin.SE3(np.eye(3), at[link].actInv(pin.SE3(np.eye(3), point)).translation)
            frame_type = pin.FrameType.OP_FRAME
            model.addFrame(pin.Frame(f"{name} {suffix}", carried[link], 0, here, frame_type))
        loops.append(Loop(f"{name} a", f"{name} b", "3d", name))
    return model, loops, springs


def _pose(element: ET.Element) -> pin.SE3:
    numbers = np.array([float(c) for c in (element.findtext("pose") or "0 0 0 0 0 0").split()])
    # The file rounds right angles to four digits; without rounding, redundant rows are exact.
    quarters = np.round(numbers[3:] / (np.pi / 4)) * (np.pi / 4)
    angles = np.where(np.abs(numbers[3:] - quarters) < 1e-4, quarters, numbers[3:])
    return pin.SE3(pin.rpy.rpyToMatrix(*angles), numbers[:3])


def _ends(joint: ET.Element) -> tuple[str, str]:
    return str(joint.findtext("parent")).strip(), str(joint.findtext("child")).strip()


def _append(model: pin.Model, joint: int, link: ET.Element) -> None:
    inertial = link.find("inertial")
    assert inertial is not None
    c = {key: float(str(inertial.findtext(f"inertia/{key}"))) for key in
         ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")}  # fmt: skip
    moments = np.array(
        [[c["ixx"], c["ixy"], c["ixz"]], [c["ixy"], c["iyy"], c["iyz"]],
         [c["ixz"], c["iyz"], c["izz"]]]
    )  # fmt: skip
    body = pin.Inertia(float(str(inertial.findtext("mass"))), np.zeros(3), moments)
    model.appendBodyToJoint(joint, body, _pose(inertial))
