"""Copies of a model built joint by joint: other joints, another root, or another order.

pin.buildReducedModel crashes on models without joint frames, and fails if a link and a joint
share a name.  pin.appendModel drops gravity, armature and limits.  This module therefore uses
neither function.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array
from ..common.errors import ModelError
from ..common.names import quoted
from .joints import RootChain, places_on_root
from .robot_file_contents import Coupling

# Prismatic joints along x, y and z, which are faster than the last one, for an arbitrary axis.
PRISMATIC = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPrismaticUnaligned)
REVOLUTE = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRevoluteUnaligned)
_RATE_LIMITS = ("lowerVelocityLimit", "upperVelocityLimit", "lowerEffortLimit", "upperEffortLimit")
_ALIGNED = 1e-9  # largest deviation of a unit axis from x, y or z that counts as round-off


class ModelBuilder:
    """A model under construction, with the armature and limits of its joints."""

    def __init__(self) -> None:
        """Create a model that contains only the world."""
        self.model = pin.Model()
        self._armature: list[ArrayLike] = [np.empty(0)]
        self._limits: list[ArrayLike] = [np.empty((2, 0))]

    def add_joint(
        self,
        parent: int,
        joint: pin.JointModel,
        placement: pin.SE3,
        name: str,
        *,
        armature: ArrayLike | None = None,
        limits: ArrayLike | None = None,
    ) -> int:
        """Add a joint.

        Args:
            parent: Index of the parent joint.
            joint: Joint model.
            placement: Placement on the parent joint.
            name: Name of the joint.
            armature: Armature, (nv,) [kg m² | kg]; zero if None.
            limits: Lower and upper position limits, (2, nq) [rad | m]; infinite if None.
        Returns:
            Index of the joint.
        """
        index = int(self.model.addJoint(parent, joint, placement, name))
        nq, nv = self.model.joints[index].nq, self.model.joints[index].nv
        self._armature.append(np.zeros(nv) if armature is None else armature)
        free = np.outer([-np.inf, np.inf], np.ones(nq))
        self._limits.append(free if limits is None else np.asarray(limits, dtype=float))
        return index

    def finish(self) -> pin.Model:
        """Return the model with its armature and limits."""
        model, limits = self.model, np.concatenate(self._limits, axis=1)
        model.armature = np.concatenate(self._armature)
        model.lowerPositionLimit, model.upperPositionLimit = limits
        return model


@dataclass(frozen=True, eq=False)
class NewJoint:
    """A joint to add to a model.

    Attributes:
        name: Name.
        joint: Joint model.
        placement: Placement on the joint before, or on the placement of the first joint.
        armature: Armature, (nv,) [kg m² | kg]; zero if None.
        limits: Lower and upper position limits, (2, nq) [rad | m]; infinite if None.
        body: Placement of the body on the last joint of a chain; the identity if None.
    """

    name: str
    joint: pin.JointModel
    placement: pin.SE3
    armature: ArrayLike | None = None
    limits: ArrayLike | None = None
    body: pin.SE3 | None = None


@dataclass(frozen=True)
class _Carrier:
    """The joint of the new model that moves a body of the old model, and the body's placement."""

    joint: int
    placement: pin.SE3


def rebuild(
    raw: pin.Model,
    *,
    frozen: Mapping[int, Array] | None = None,
    replaced: Mapping[int, Sequence[NewJoint]] | None = None,
    root: pin.JointModel | None = None,
    chain: RootChain | None = None,
    order: Sequence[int] = (),
    without_frames: Collection[int] = (),
) -> pin.Model:
    """Return a copy of a model with some of its joints changed.

    Args:
        raw: Model to copy.
        frozen: Configurations of joints to fix, {joint index: (nq,)}.  The body of a fixed joint
            becomes part of its parent body.
        replaced: Chains of joints that replace joints, {joint index: chain}.  The last joint of a
            chain carries the body.
        root: Joint to insert between the world and the model.
        chain: Joints that `root` replaces; if None, `root` is an additional joint.
        order: Indices of all joints in the new order, parents before children; if empty, the
            order of the model.
        without_frames: Indices of frames to leave out.
    """
    frozen, replaced = frozen or {}, replaced or {}
    builder = ModelBuilder()
    model = builder.model
    model.name, model.gravity = raw.name, raw.gravity
    q = pin.neutral(raw)
    base = 0
    if root is not None:
        at = pin.SE3.Identity() if chain is None else chain.at
        armature = None if chain is None else chain.armature
        base = builder.add_joint(0, root, at, _unused_name(raw, chain), armature=armature)
        model.addJointFrame(base)
    copied: dict[int, int] = {}  # {joint of the old model: joint of the new model}
    carriers = {0: _Carrier(base if chain is None else 0, pin.SE3.Identity())}
    model.inertias[base] += raw.inertias[0]
    on_root = {} if chain is None else places_on_root(raw, chain)
    for i in order or range(1, raw.njoints):
        under, joint = carriers[raw.parents[i]], raw.joints[i]
        at = under.placement * raw.jointPlacements[i]
        qs = slice(joint.idx_q, joint.idx_q + joint.nq)
        if chain is not None and i <= chain.last:
            carrier = _Carrier(base, on_root[str(raw.names[i])])
        elif i in frozen:
            q[qs] = frozen[i]
            motion = joint.createData()
            joint.calc(motion, q)
            carrier = _Carrier(under.joint, at * motion.M)
        elif i in replaced:
            body = replaced[i][-1].body
            carrier = _Carrier(
                _add_chain(builder, under.joint, at, replaced[i]),
                pin.SE3.Identity() if body is None else body,
            )
        else:
            k = builder.add_joint(
                under.joint,
                joint,
                at,
                raw.names[i],
                armature=raw.armature[joint.idx_v : joint.idx_v + joint.nv],
                limits=[raw.lowerPositionLimit[qs], raw.upperPositionLimit[qs]],
            )
            carrier, copied[i] = _Carrier(k, pin.SE3.Identity()), k
        model.appendBodyToJoint(carrier.joint, raw.inertias[i], carrier.placement)
        carriers[i] = carrier
    numbers = {0: 0}  # {frame of the old model: frame of the new model}
    for number, frame in enumerate(raw.frames):
        above = numbers.get(int(frame.parentFrame), 0)
        if number == 0 or number in without_frames:
            numbers[number] = above
            continue
        on = carriers[frame.parentJoint]
        at = on.placement * frame.placement
        numbers[number] = model.addFrame(
            pin.Frame(frame.name, on.joint, above, at, frame.type), False
        )
    model = builder.finish()
    for i, k in copied.items():
        old, new = raw.joints[i], model.joints[k]
        for kind in _RATE_LIMITS:
            limits = getattr(raw, kind)[old.idx_v : old.idx_v + old.nv]
            getattr(model, kind)[new.idx_v : new.idx_v + new.nv] = limits
    return model


def _add_chain(builder: ModelBuilder, on: int, at: pin.SE3, chain: Sequence[NewJoint]) -> int:
    """Add a chain of joints at a placement on a joint; return the index of its last joint."""
    for new in chain:
        on = builder.add_joint(
            on, new.joint, at * new.placement, new.name, armature=new.armature, limits=new.limits
        )
        at = pin.SE3.Identity()
    return on


def _unused_name(raw: pin.Model, chain: RootChain | None) -> str:
    """Return a name for a new root joint that the model does not use yet."""
    name = "root_joint" if chain is None else "+".join(list(raw.names)[1 : chain.last + 1])
    while raw.existJointName(name) or raw.existFrame(name):
        name = f"{name}_"
    return name


def without_mimics(model: pin.Model) -> tuple[pin.Model, tuple[Coupling, ...]]:
    """Return a copy of a model with mimic joints replaced by plain joints, and their couplings.

    Pinocchio's ABA does not support mimic joints.  Pinocchio discards the armature and limits of
    a joint when it creates a mimic joint, so the plain joints have none.

    Raises:
        ModelError: A mimic joint has scaling zero, so that its axis cannot be recovered.
    """
    mimics = list(model.mimicking_joints)
    if not mimics:
        return model.copy(), ()
    plain = rebuild(model, replaced={i: [_joint_of_mimic(model, i)] for i in mimics})
    leaders = {
        model.joints[k].idx_v: model.names[k] for k in range(1, model.njoints) if k not in mimics
    }
    couplings = []
    for i in mimics:
        mimic = model.joints[i].extract()
        ratio, offset = float(mimic.scaling), float(mimic.offset)
        couplings.append(Coupling(model.names[i], {leaders[mimic.idx_v]: ratio}, offset))
    return plain, tuple(couplings)


def _joint_of_mimic(model: pin.Model, i: int) -> NewJoint:
    """Reconstruct the plain joint from which a mimic joint was created, from its axis."""
    joint, scaling = model.joints[i], float(model.joints[i].extract().scaling)
    motion = joint.createData()
    joint.calc(motion, pin.neutral(model))
    twist = np.array(motion.S).ravel()
    if scaling == 0.0 or not np.isfinite(twist).all() or not twist.any():
        raise ModelError(
            f"mimic joint {quoted(model.names[i])} has scaling {scaling:g}, from which its "
            "axis cannot be recovered; build the model without this joint, or with a fixed joint"
        )
    slides = not twist[3:].any()
    axis = (twist[:3] if slides else twist[3:]) / scaling
    plain = joint_along(PRISMATIC if slides else REVOLUTE, axis, _ALIGNED)
    return NewJoint(str(model.names[i]), plain, pin.SE3.Identity())


def joint_along(kinds: Sequence[type], axis: Array, tolerance: float = 0.0) -> pin.JointModel:
    """Return a prismatic joint along, or a revolute joint about, an axis.

    Args:
        kinds: Joint classes, PRISMATIC or REVOLUTE.
        axis: Axis, (3,), of unit length up to the tolerance.
        tolerance: Largest deviation from x, y or z at which the aligned joint class is used.
    """
    k = int(np.argmax(np.abs(axis)))
    if np.abs(axis - np.eye(3)[k]).max() <= tolerance:
        return kinds[k]()
    return kinds[3](axis if tolerance == 0.0 else axis / np.linalg.norm(axis))


def depth_first(parents: Sequence[int]) -> list[int]:
    """Return joints 1, 2, … in depth-first order: each joint is followed by its descendants.

    Pinocchio requires this order; otherwise its crba returns wrong results without an error.

    Args:
        parents: Parent of every joint.  The entry of the world, at index 0, is not read.
    """
    children: list[list[int]] = [[] for _ in parents]
    for i in range(len(parents) - 1, 0, -1):
        children[parents[i]].append(i)
    order, stack = [], children[0]
    while stack:
        i = stack.pop()
        order.append(i)
        stack += children[i]
    return order
