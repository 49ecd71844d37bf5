"""The robots of example-robot-data."""

from __future__ import annotations

import difflib

import pinocchio as pin

from ..common.errors import LoadError
from ..common.names import quoted
from . import catalogue
from .read_urdf import UrdfRobot, read_urdf
from .rebuild import without_mimics
from .robot_files import read_xml
from .urdf_elements import mimic_couplings
from .urdf_words import left_out_words


def example_model(name: str) -> UrdfRobot:
    """Return a robot of example-robot-data, with rotor armature.

    Raises:
        LoadError: The name is unknown; the message has similar names.
    """
    names = catalogue.example_robots()
    if name not in names:
        near = difflib.get_close_matches(name[:200], [*catalogue.bundled_robots(), *names], n=3)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        more = "" if names else f"; for solo12, talos, ur5 and others: {catalogue.INSTALL_ROBOTS}"
        raise LoadError(
            f"unknown robot {quoted(name)}; {hint}`pinred robots` lists what can be loaded{more}"
        )
    robot = catalogue.example_robot(name)
    if robot.build is None:
        urdf = read_urdf(robot.urdf)
    else:
        root = read_xml(robot.urdf)
        model, couplings = without_mimics(robot.build().robot.model)
        if not couplings:
            candidates = mimic_couplings(root)
            couplings = tuple(c for c in candidates if model.existJointName(c.follower))
        urdf = UrdfRobot(model, couplings, left_out=left_out_words(root))
    if robot.rotors is not None:
        model = urdf.model
        pin.loadRotorParameters(model, str(robot.rotors), False)
        model.armature = model.rotorInertia * model.rotorGearRatio**2
    return urdf
