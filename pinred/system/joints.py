"""Joints: hinges, slides and balls, which a System keeps, and groups of joints at the root.

An elementary joint is one value that states its sizes, labels, units and motion.  Rates σ are
components in a left-invariant frame e_α of the joint's manifold, which is Pinocchio's velocity v:
for a ball, the angular velocity of the child relative to the parent, in the child's axes.  The
frame's brackets are [e_α, e_β] = c^γ_αβ e_γ.  The structure constants c are zero for hinges and
slides, and those of so(3) for balls.  All other joints are split into these at load (see rebuild).

Consecutive joints at the root can form one joint of a group.  Examples are a planar joint and a
slide along its normal, two slides and a hinge normal to them, or three slides and three hinges.
The links between them are massless, so only the motion of the last link matters.

Users write attitudes of balls as rotation vectors or quaternions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, as_floats, read_only
from ..common.errors import InputError
from ..common.names import brief
from ..lie.group import Group
from ..lie.groups import GROUPS, SE3, SO2, SO3, R
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


_ALONG = 1e-9  # largest round-off in the direction of a unit twist along a group axis
_INDEPENDENT = 1e-6  # smallest singular value of six linearly independent unit twists


def joint_kind(joint: pin.JointModel) -> str:
    """Return Pinocchio's name of a joint type; join the components of a composite with "+"."""
    type_name = str(joint.shortname()).removeprefix("JointModel")
    if type_name != "Composite":
        return type_name
    composite = joint.extract()
    shifted = any(not place.isIdentity() for place in composite.jointPlacements)
    return type_name if shifted else "+".join(map(joint_kind, composite.joints))


def motion_group(joint: pin.JointModel) -> Group | None:
    """Return the symmetry group of a joint's motion, or None if the motion does not form one."""
    type_name = joint_kind(joint)
    return next((group for group in GROUPS.values() if type_name in group.joints), None)


def is_shape_joint(joint: pin.JointModel) -> bool:
    """Return whether a joint is a hinge, a slide or a ball, and so can be part of the shape."""
    return elementary_joint(joint) is not None


def is_ball(joint: pin.JointModel) -> bool:
    """Return whether the coordinates of a joint are a unit quaternion (x, y, z, w)."""
    kind = elementary_joint(joint)
    return kind is not None and kind.is_ball


def is_prismatic(joint: pin.JointModel) -> bool:
    """Return whether a joint is prismatic (metres), not revolute (radians)."""
    group = motion_group(joint)
    return group is not None and group.dim == group.linear == 1


def axes_of(joint: pin.JointModel) -> Array:
    """Return the unit twists of a joint's degrees of freedom, (6, nv), in the body's frame."""
    if joint.shortname() == "JointModelComposite":  # Pinocchio computes its axes with its motion.
        model = pin.Model()
        model.addJoint(0, joint, pin.SE3.Identity(), "joint")
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        return np.array(data.joints[1].S).reshape(6, joint.nv)
    return np.array(joint.createData().S).reshape(6, joint.nv)


def joint_configuration(joint: pin.JointModel, value: float) -> list[float]:
    """Convert the value of a joint with one degree of freedom to Pinocchio's coordinates."""
    return [value] if joint.nq == 1 else [float(np.cos(value)), float(np.sin(value))]


def largest_step(model: pin.Model) -> float:
    """Return the largest distance from a joint to the next joint or its mass [m]; 1 if zero."""
    count = range(1, model.njoints)
    steps = [model.jointPlacements[i].translation for i in count if i > 1]
    levers = [model.inertias[i].lever for i in count if model.inertias[i].mass > 0.0]
    return max((float(np.linalg.norm(p)) for p in (*steps, *levers)), default=0.0) or 1.0


def root_joint(group: Group) -> pin.JointModel:
    """Return the joint that makes a body float in `group`.

    In the axes of the root link, ℝ slides along x and SO(2) rotates about z.  SE(2) moves in the
    xy plane, and ℝ × SE(2) also moves along z.
    """
    kinds = [getattr(pin, f"JointModel{joint}")() for joint in group.joints[0].split("+")]
    if len(kinds) == 1:
        return kinds[0]
    composite = pin.JointModelComposite()
    for joint in kinds:
        composite.addJoint(joint)
    return composite


@dataclass(frozen=True)
class RootChain:
    """Consecutive joints at the root that together move in a group.

    Attributes:
        group: Group of the motion.
        last: Index of the chain's last joint; the chain starts at joint 1.
        at: Placement of the equivalent root joint in the world.
        armature: Armature along the axes of the group, (r,) [kg m² | kg].
    """

    group: Group
    last: int
    at: pin.SE3
    armature: Array


def root_chain(raw: pin.Model) -> RootChain | None:
    """Return the chain at the root of a model, or None if its joints do not form a group."""
    last = _end_of_chain(raw)
    if last < 2 or any(motion_group(raw.joints[i]) is None for i in range(1, last + 1)):
        return None
    chain = pin.Model()
    for i in range(1, last + 1):
        chain.addJoint(i - 1, raw.joints[i], raw.jointPlacements[i], raw.names[i])
    data, nv = chain.createData(), chain.nv
    pin.computeJointJacobians(chain, data, pin.neutral(chain))
    if nv == 6 and np.linalg.matrix_rank(data.J, tol=_INDEPENDENT) == 6:
        return RootChain(SE3, last, data.oMi[last].copy(), raw.armature[:6].copy())
    for joint in range(last, 0, -1):
        at = data.oMi[joint].copy()
        twists = at.toActionMatrixInverse() @ data.J[:, :nv]
        for group in GROUPS.values():
            in_group = np.abs(twists[list(group.axes)])
            if group.dim == nv and _is_permutation(in_group) and _is_permutation(np.abs(twists)):
                return RootChain(group, last, at, np.rint(in_group) @ raw.armature[:nv])
    return None


def places_on_root(raw: pin.Model, chain: RootChain) -> dict[str, pin.SE3]:
    """Return {joint: placement of its body on the equivalent root joint} of a chain."""
    places, at = {}, pin.SE3.Identity()
    for i in range(1, chain.last + 1):
        at = at * raw.jointPlacements[i]
        places[str(raw.names[i])] = chain.at.actInv(at)
    return places


def _end_of_chain(raw: pin.Model) -> int:
    """Return the last joint before which every link is massless and carries only one joint."""
    last, parents = 0, list(raw.parents)[1:]
    children: dict[int, list[int]] = {}
    for i, parent in enumerate(parents, start=1):
        children.setdefault(parent, []).append(i)
    while raw.inertias[last].mass == 0.0 and len(children.get(last, ())) == 1:
        (last,) = children[last]
    return last


def _is_permutation(matrix: Array) -> bool:
    """Return whether each column is a coordinate axis and no axis occurs twice."""
    rounded = np.rint(matrix)
    once = (rounded.sum(axis=0) == 1.0).all() and (rounded.sum(axis=1) <= 1.0).all()
    return bool(once and np.abs(matrix - rounded).max() <= _ALONG)


def attitude_of(value: Any, what: str) -> Array:
    """Return the unit quaternion (x, y, z, w) of an attitude.

    Args:
        value: Rotation vector, (3,) [rad], or quaternion (x, y, z, w) of any length.
        what: Name of the value in messages.
    Returns:
        The quaternion, (4,).
    Raises:
        InputError: The value is neither, is not finite, or is zero.
    """
    numbers = as_floats(value, what)
    if numbers.shape not in ((3,), (4,)) or not np.isfinite(numbers).all():
        raise InputError(
            f"{what}: expected a rotation vector of 3 finite numbers or a quaternion "
            f"(x, y, z, w), got {brief(value)}"
        )
    if numbers.shape == (3,):
        return read_only(quaternion_exp(numbers))
    length = float(np.linalg.norm(numbers))
    if not length > 0.0:
        raise InputError(f"{what}: expected a quaternion other than zero, got {brief(value)}")
    return read_only(numbers / length)
