"""Robots with known steady spins: gyrostats, planar chains, tops."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

import pinred

WHEEL = (0.03, 0.02)  # moments of inertia of the rotor about its axis and across it [kg m²]


def gyrostat(moments: tuple[float, float, float], *, group: str = "SO3") -> pinred.System:
    """Return a body with a symmetric rotor on its second axis, all centred.

    moments: I1, I2, I3 of body and rotor together, with the rotor locked [kg m²].
    """
    spin, across = WHEEL
    I1, I2, I3 = moments[0] - across, moments[1] - spin, moments[2] - across
    text = f"""<robot name="gyrostat"><link name="body"><inertial><mass value="2"/>
      <inertia ixx="{I1!r}" iyy="{I2!r}" izz="{I3!r}" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <link name="rotor"><inertial><mass value="0.5"/>
      <inertia ixx="{across}" iyy="{spin}" izz="{across}" ixy="0" ixz="0" iyz="0"/></inertial>
      </link><joint name="wheel" type="continuous"><parent link="body"/><child link="rotor"/>
      <axis xyz="0 1 0"/></joint></robot>"""
    return pinred.load(text_file(text), group=group, gravity=(0.0, 0.0, 0.0))


@cache
def equilibria_of_cat() -> pinred.Equilibria:
    """Return the relative equilibria of the falling cat at momentum 1."""
    return pinred.relative_equilibria(pinred.load("falling_cat"), momentum=1.0, starts=60)


def heavy_gyrostat(*, tilt: float = 0.0, skew: float = 0.0) -> pinred.System:
    """Return a top on a pivot in gravity, with a rotor on its axis.

    tilt: angle between rotor axis and top axis [rad].  skew: difference of the top's two transverse
    moments of inertia [kg m²].
    """
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    body = pin.Inertia(1.0, np.array([0.0, 0.0, 0.5]), np.diag([0.1, 0.1 + skew, 0.05]))
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    place = pin.SE3(pin.exp3(np.array([tilt, 0.0, 0.0])), np.array([0.0, 0.0, 0.7]))
    wheel = model.addJoint(root, pin.JointModelRZ(), place, "wheel")
    rotor = pin.Inertia(0.4, np.zeros(3), np.diag([0.01, 0.01, 0.02]))
    model.appendBodyToJoint(wheel, rotor, pin.SE3.Identity())
    return pinred.load(model)


def text_file(text: str) -> Path:
    """Write a robot file into a temporary folder that is not removed; return its path."""
    folder = Path(tempfile.mkdtemp(prefix="pinred-spin-"))
    path = folder / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def rods(count: int = 3) -> pinred.System:
    """Return a planar chain of rods of 1 m and 1 kg, connected by hinges."""
    model = pin.Model()
    model.name = "rods"
    model.gravity.setZero()
    parent, joint, place = 0, pin.JointModelPlanar(), pin.SE3.Identity()
    rod = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([1e-3, 1.0 / 12.0, 1.0 / 12.0]))
    for k in range(count):
        parent = model.addJoint(parent, joint, place, f"joint{k}")
        model.appendBodyToJoint(parent, rod, pin.SE3.Identity())
        joint, place = pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    return pinred.load(model)
