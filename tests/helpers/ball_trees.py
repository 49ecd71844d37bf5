"""Random trees with ball joints, hinges and slides, and robots of balls with closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinred.common.arrays import Array
from pinred.system.system import System

ROOTS = {
    "SE3": pin.JointModelFreeFlyer,
    "SO3": pin.JointModelSpherical,
    "SE2": pin.JointModelPlanar,
    "SO2": pin.JointModelRZ,
    "R": pin.JointModelPX,
}


def random_body(rng: np.random.Generator) -> tuple[pin.Inertia, pin.SE3]:
    """Return a physical inertia and its placement on a joint."""
    moments = rng.uniform(0.5, 1.0, 3) * 0.2
    inertia = pin.Inertia(rng.uniform(0.5, 2.0), np.zeros(3), np.diag(moments))
    return inertia, pin.SE3(pin.exp3(rng.normal(size=3)), 0.2 * rng.normal(size=3))


def ball_tree(
    seed: int, count: int = 5, group: str = "SE3", *, armature: bool = True, balls: float = 0.6
) -> System:
    """Return a random tree of `count` joints behind a root, the first of which is a ball.

    Args:
        seed: Seed of the random numbers.
        count: Number of joints except the root.
        group: Symmetry group of the root.
        armature: Whether some joints have armature.
        balls: Share of balls among the other joints.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"ball tree {seed}"
    model.gravity.setZero()
    root = model.addJoint(0, ROOTS[group](), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, *random_body(rng))
    for k in range(count):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        hinge = pin.JointModelRevoluteUnaligned(axis)
        slide = pin.JointModelPrismaticUnaligned(axis)
        single = hinge if rng.random() < 0.5 else slide
        joint = pin.JointModelSpherical() if k == 0 or rng.random() < balls else single
        place = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3))
        i = model.addJoint(int(rng.integers(1, model.njoints)), joint, place, f"j{k}")
        model.appendBodyToJoint(i, *random_body(rng))
        if armature and rng.random() < 0.5:
            rotors = np.array(model.armature)
            first = model.joints[i].idx_v
            rotors[first : first + model.joints[i].nv] = rng.uniform(0.05, 0.3)
            model.armature = rotors
    return System(model, name=model.name)


def joined_bodies(moments: Array | None = None, offset: Array | None = None) -> System:
    """Return two free bodies, joined by a ball called "joint".

    Args:
        moments: Moments of inertia of both bodies, (2, 3) [kg m²].
        offset: Centres of mass relative to the ball, (2, 3) [m].
    """
    moments = np.array([[0.4, 0.5, 0.7], [0.2, 0.3, 0.4]]) if moments is None else moments
    offset = np.array([[0.0, 0.0, -0.4], [0.1, 0.0, 0.3]]) if offset is None else offset
    model = pin.Model()
    model.name = "joined bodies"
    model.gravity.setZero()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(
        root, pin.Inertia(2.0, np.zeros(3), np.diag(moments[0])), pin.SE3.Identity()
    )
    place = pin.SE3(np.eye(3), -offset[0])
    ball = model.addJoint(root, pin.JointModelSpherical(), place, "joint")
    body = pin.Inertia(1.0, offset[1], np.diag(moments[1]))
    model.appendBodyToJoint(ball, body, pin.SE3.Identity())
    return System(model, name=model.name)
