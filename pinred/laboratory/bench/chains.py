"""Chains of any number of equal links, built in memory."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...common.errors import InputError
from ...system.load import load
from ...system.system import System

FAMILIES = ("planar", "spatial")
_LENGTH, _WIDTH, _MASS = 0.2, 0.05, 1.0  # length [m], width [m] and mass [kg] of a link


def chain(family: str, joints: int) -> System:
    """Build a chain of `joints` + 1 equal links without gravity.

    Args:
        family: "planar": SE(2) base with joints about the plane's normal. "spatial": SE(3) base
            with joints alternating about two axes normal to the link.
        joints: Number of joints.
    Returns:
        The chain.
    Raises:
        InputError: Unknown family, or no joint.
    """
    if family not in FAMILIES or joints < 1:
        raise InputError(
            f"a chain is {' or '.join(FAMILIES)} and has at least one joint, "
            f"got {family!r} with {joints}"
        )
    planar = family == "planar"
    model = pin.Model()
    model.name = f"{family}-chain-{joints}"
    model.gravity = pin.Motion.Zero()
    offset = np.array([_LENGTH, 0.0, 0.0])
    link = pin.Inertia.FromBox(_MASS, _LENGTH, _WIDTH, _WIDTH)
    link.lever = 0.5 * offset
    parent = 0
    for k in range(joints + 1):
        if k == 0:
            joint = pin.JointModelPlanar() if planar else pin.JointModelFreeFlyer()
        else:
            joint = pin.JointModelRY() if not planar and k % 2 else pin.JointModelRZ()
        place = pin.SE3(np.eye(3), offset if k else np.zeros(3))
        parent = model.addJoint(parent, joint, place, f"joint{k}")
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
    return load(model)
