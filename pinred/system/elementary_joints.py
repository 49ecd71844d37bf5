"""The joints that a System keeps as they are: hinge, slide and ball.

Each is one value that states its sizes, labels, units and motion.  Rates σ are components in a
left-invariant frame e_α of the joint's manifold, which is Pinocchio's velocity v: for a ball, the
angular velocity of the child relative to the parent, in the child's axes.  The frame's brackets are
[e_α, e_β] = c^γ_αβ e_γ.  The structure constants c are zero for hinges and slides, and those of
so(3) for balls.  All other joints are split into these at load (see split_joints).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.groups import SO2, SO3, R
from ..lie.rotations import (
    conjugate,
    hat,
    quaternion_exp,
    quaternion_log,
    quaternion_product,
    unit,
)


@dataclass(frozen=True, eq=False)
class ElementaryJoint:
    """A kind of joint whose motion subspace is constant in the child's frame.

    Attributes:
        name: Name of the kind.
        motion: Name of the motion in tables: "revolute", "prismatic" or "ball".
        kinds: Pinocchio's names of the joints, without "JointModel".
        coordinates: Suffix of each coordinate's label, (nx,).
        rates: Suffix of each rate's label, (m,).
        coordinate_units: Unit of each coordinate, (nx,).
        units: Unit of each displacement along the frame, (m,).
        structure: Structure constants c^γ_αβ of the frame, (m, m, m), indices γ, α, β.
        neutral: Coordinates of the joint at rest, (nx,).
        integrate: Function (x, σ) → x exp(σ), for a displacement σ along the frame, (..., m).
        difference: Function (x, y) → σ with y = x exp(σ).
        rate_map: Function x → E, (..., nx, m), with ẋ = E σ.
    """

    name: str
    motion: str
    kinds: tuple[str, ...]
    coordinates: tuple[str, ...]
    rates: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    units: tuple[str, ...]
    structure: Array
    neutral: Array
    integrate: Callable[[Array, Array], Array]
    difference: Callable[[Array, Array], Array]
    rate_map: Callable[[Array], Array]

    def __reduce__(self) -> tuple[Any, ...]:
        return _named, (self.name,)

    @property
    def nx(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def m(self) -> int:
        """Number of rates."""
        return len(self.rates)

    @property
    def is_ball(self) -> bool:
        """Whether the coordinates are a unit quaternion (x, y, z, w)."""
        return self.nx == 4


def _ball_rate_map(x: Array) -> Array:
    """Return E, (..., 4, 3), with q̇ = ½ q ∘ (σ, 0) = E σ."""
    E = np.empty((*x.shape[:-1], 4, 3))
    E[..., :3, :] = 0.5 * (hat(x[..., :3]) + x[..., 3, None, None] * np.eye(3))
    E[..., 3, :] = -0.5 * x[..., :3]
    return E


def _scalar(name: str, motion: str, kinds: tuple[str, ...], unit_name: str) -> ElementaryJoint:
    """Return a kind of joint with one coordinate, whose rate is its derivative."""
    return ElementaryJoint(
        name=name,
        motion=motion,
        kinds=kinds,
        coordinates=("",),
        rates=("",),
        coordinate_units=(unit_name,),
        units=(unit_name,),
        structure=np.zeros((1, 1, 1)),
        neutral=np.zeros(1),
        integrate=lambda x, sigma: np.asarray(x + sigma),
        difference=lambda x, y: np.asarray(y - x),
        rate_map=lambda x: np.ones((*x.shape[:-1], 1, 1)),
    )


HINGE = _scalar("hinge", "revolute", SO2.joints, "rad")
SLIDE = _scalar("slide", "prismatic", R.joints, "m")
BALL = ElementaryJoint(
    name="ball",
    motion="ball",
    kinds=SO3.joints,
    coordinates=(".qx", ".qy", ".qz", ".qw"),
    rates=(".x", ".y", ".z"),
    coordinate_units=("1", "1", "1", "1"),
    units=("rad", "rad", "rad"),
    structure=np.cross(np.eye(3)[:, None, :], np.eye(3)[None, :, :]).transpose(2, 0, 1),
    neutral=np.array([0.0, 0.0, 0.0, 1.0]),
    integrate=lambda x, sigma: unit(quaternion_product(x, quaternion_exp(sigma))),
    difference=lambda x, y: quaternion_log(quaternion_product(conjugate(x), y)),
    rate_map=_ball_rate_map,
)
ELEMENTARY_JOINTS = (HINGE, SLIDE, BALL)


def _named(name: str) -> ElementaryJoint:
    """Return a kind of joint by its name."""
    return next(entry for entry in ELEMENTARY_JOINTS if entry.name == name)


def elementary_joint(joint: pin.JointModel) -> ElementaryJoint | None:
    """Return the kind of a joint, or None if it must be split or rejected."""
    kind = str(joint.shortname()).removeprefix("JointModel")
    return next((entry for entry in ELEMENTARY_JOINTS if kind in entry.kinds), None)
