"""Robots generated in memory: chains of bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...system.load import load
from ...system.system import System

Link = tuple[pin.JointModel, ArrayLike, pin.Inertia]


def serial(name: str, links: Sequence[Link]) -> System:
    """Build a serial chain without gravity.

    Args:
        name: Name of the robot.
        links: For each link, its joint, the position of the joint on the previous link [m], and the
            body. The first joint is the root.
    Returns:
        The chain.
    """
    model = pin.Model()
    model.name = name
    model.gravity = pin.Motion.Zero()
    parent = 0
    for k, (joint, position, body) in enumerate(links):
        placement = pin.SE3(np.eye(3), np.asarray(position, dtype=float))
        parent = model.addJoint(parent, joint, placement, f"joint{k}")
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return load(model)


def body(mass: float, com: ArrayLike, moments: ArrayLike) -> pin.Inertia:
    """Return a body with centre of mass `com` (3,) and principal moments (3,) along its axes."""
    return pin.Inertia(mass, np.asarray(com, dtype=float), np.diag(np.asarray(moments, float)))


def tumbling_arm(name: str, bodies: Sequence[pin.Inertia]) -> System:
    """Build a free base with an arm of three joints about different axes, from four bodies."""
    joints = (pin.JointModelFreeFlyer(), pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    position = [0.3, 0.1, -0.2]
    return serial(name, [(j, position, link) for j, link in zip(joints, bodies, strict=True)])


TUMBLING = {  # initial state of `tumbling_arm`
    "x0": [0.3, -0.5, 0.4],
    "xdot0": [0.6, -0.4, 0.8],
    "xi0": [0.1, 0.2, -0.1, 0.3, -0.2, 0.4],
}


def disc_stack(moments: Sequence[float]) -> System:
    """Build discs on one axis; the first is the base."""
    z = np.zeros(3)
    return serial(
        "discs", [(pin.JointModelRZ(), z, body(1.0, z, [0.6 * i, 0.6 * i, i])) for i in moments]
    )


def single(moments: ArrayLike) -> System:
    """Build a rigid body that rotates about its centre of mass."""
    z = np.zeros(3)
    return serial("body", [(pin.JointModelSpherical(), z, body(1.0, z, moments))])
