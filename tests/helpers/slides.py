"""Slides on a line, whose motions between stops have closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinred


def bouncing_slide() -> pinred.System:
    """Return two masses, 3 kg and 1 kg, on one line: the reduced mass is 0.75 kg."""
    model = pin.Model()
    model.name = "slide"
    model.gravity.setZero()
    for k, mass in enumerate((3.0, 1.0)):
        i = model.addJoint(k, pin.JointModelPX(), pin.SE3.Identity(), ("base", "slide")[k])
        inertia = pin.Inertia(mass, np.zeros(3), 0.1 * np.eye(3))
        model.appendBodyToJoint(i, inertia, pin.SE3.Identity())
    return pinred.load(model)


def pair_of_slides() -> pinred.System:
    """Return two equal slides on a free base of 2 kg, which move along one line."""
    model = pin.Model()
    model.name = "pair"
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    for name in ("left", "right"):
        k = model.addJoint(base, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(k, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return pinred.load(model)


def slide_beside(second: str) -> pinred.System:
    """Return a slide along x on a base of 2 kg, and beside it a slide or an arm.

    The base moves along x. The second joint is a slide along y, or an arm along x that turns about
    z. Impulses along x do not act on it: on the arm, only as long as it is along x.
    """
    model = pin.Model()
    model.name = second
    model.gravity.setZero()
    joints = {"slide": pin.JointModelPY(), "arm": pin.JointModelRZ()}
    base = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    for name, joint in (("left", pin.JointModelPX()), ("beside", joints[second])):
        k = model.addJoint(base, joint, pin.SE3.Identity(), name)
        place = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]))
        model.appendBodyToJoint(k, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), place)
    return pinred.load(model)
