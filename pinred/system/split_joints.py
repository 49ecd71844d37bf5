"""Joints with several degrees of freedom as products of simple joints (see joint_types).

Simple joints are hinges, slides and balls.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import pinocchio as pin

from ..common.errors import InputError, ModelError
from ..common.names import listed, quoted
from .joint_types import JOINT_TYPES, Part
from .joints import is_shape_joint, motion_group, root_chain
from .locked_joints import LockValue
from .rebuild import NewJoint, rebuild
from .robot_file_contents import Coupling

# Joint types by Pinocchio's names of their joints.
TYPES = {kind: joint_type for joint_type in JOINT_TYPES for kind in joint_type.kinds}


@dataclass(frozen=True, eq=False)
class SplitModel:
    """A model whose joints are hinges, slides and balls, except the root.

    Attributes:
        model: The model.
        parts: Names of the parts of each joint that was split, {joint: names}.
        couplings: Couplings of parts that follow other parts.
        sliding: Joints whose dry friction acts along a direction of the plane in which they slide.
    """

    model: pin.Model
    parts: Mapping[str, tuple[str, ...]]
    couplings: tuple[Coupling, ...]
    sliding: tuple[str, ...]

    def locked(self, lock: Mapping[str, LockValue]) -> dict[str, LockValue]:
        """Replace each joint that was split by its independent parts.

        Args:
            lock: Values of joints to lock.
        Returns:
            Values of joints of `model` to lock.
        Raises:
            InputError: A joint with several independent parts has a value other than zero.
        """
        followers = {coupling.follower for coupling in self.couplings}
        values: dict[str, LockValue] = {}
        for name, value in lock.items():
            parts = [part for part in self.parts.get(name, (name,)) if part not in followers]
            if len(parts) > 1 and value != 0.0:
                raise InputError(
                    f"lock: joint {quoted(name)} has {len(parts)} degrees of freedom and can only "
                    f"be locked at zero; lock its parts instead: {listed(parts)}"
                )
            values |= dict.fromkeys(parts, value)
        return values

    def whole(self, parts: Collection[str]) -> set[str]:
        """Return the joints, as named before the split, all of whose parts are among `parts`."""
        return {n for n, own in self.parts.items() if {*own} <= {*parts}} | {*parts}


def split_joints(raw: pin.Model) -> SplitModel:
    """Split the joints behind the root into hinges, slides and balls.

    Joints that move the root, and joints of unknown types, stay as they are.

    Args:
        raw: Model.
    Returns:
        The model with split joints; `raw` itself if there is nothing to split.
    Raises:
        ModelError: The armature or damping of a joint is not constant along its parts.
    """
    chain = root_chain(raw)
    first = 1 if chain is None else chain.last + 1
    joints: dict[int, list[_SplitPart]] = {}
    for i in range(first, raw.njoints):
        joint = raw.joints[i]
        if not is_shape_joint(joint) and (i > 1 or motion_group(joint) is None):
            parts = _parts_of(joint)
            if parts is not None:
                joints[i] = _placed(raw, i, parts)
    if not joints:
        return SplitModel(raw, {}, (), ())
    for i, split in joints.items():
        _check_rotated(raw, i, split)
    model = rebuild(raw, replaced={i: _chain(raw, split) for i, split in joints.items()})
    couplings = [
        Coupling(part.name, {before.name: part.ratio}, 0.0)
        for split in joints.values()
        for before, part in pairwise(split)
        if part.ratio is not None
    ]
    sliding = copy_losses(raw, model, joints)
    names = {str(raw.names[i]): tuple(p.name for p in split) for i, split in joints.items()}
    return SplitModel(model, names, tuple(couplings), sliding)


@dataclass(frozen=True, eq=False)
class _SplitPart(Part):
    """A part of a joint of a model.

    Attributes:
        name: Name of the new joint.
        q: Index of its first coordinate in q of the model; that of the next part if it follows.
        v: Index of its rate in v of the model; that of the next part if it follows.
    """

    name: str = ""
    q: int = 0
    v: int = 0

    @property
    def rates(self) -> slice:
        """Indices of its rates in v of the model."""
        return slice(self.v, self.v + self.joint.nv)


def _placed(raw: pin.Model, i: int, parts: Sequence[Part]) -> list[_SplitPart]:
    """Return the parts of joint i of a model with their names and indices."""
    name, q, v = str(raw.names[i]), raw.joints[i].idx_q, raw.joints[i].idx_v
    placed = []
    for part in parts:
        full = f"{name}.{part.suffix}" if part.suffix else name
        placed.append(_SplitPart(**vars(part), name=full, q=q, v=v))
        if part.ratio is None:
            q, v = q + part.joint.nq, v + part.joint.nv
    return placed


def _parts_of(joint: pin.JointModel) -> tuple[Part, ...] | None:
    """Return the simple joints of a joint; None if its motion is not a product of them."""
    name = str(joint.shortname()).removeprefix("JointModel")
    if name in TYPES:
        return TYPES[name].parts(joint)
    if is_shape_joint(joint):
        return (Part("", joint, pin.SE3.Identity()),)
    if name != "Composite":
        return None
    composite, parts = joint.extract(), list[Part]()
    places = composite.jointPlacements
    for k, (component, place) in enumerate(zip(composite.joints, places, strict=True), start=1):
        inner = _parts_of(component)
        if inner is None:
            return None
        for j, part in enumerate(inner):
            suffix = f"{k}.{part.suffix}" if part.suffix else str(k)
            placement = place * part.placement if j == 0 else part.placement
            parts.append(replace(part, suffix=suffix, placement=placement))
    return tuple(parts)


def _check_rotated(raw: pin.Model, i: int, parts: Sequence[_SplitPart]) -> None:
    """Reject armature and damping that differ along axes that turn with the child."""
    rotated = [part.v for part in parts if part.rotated]
    for what, values in (("armature", raw.armature), ("damping", raw.damping)):
        if rotated and not (values[rotated] == values[rotated[0]]).all():
            raise ModelError(
                f"joint {quoted(raw.names[i])} has {what} {values[rotated]} along axes that turn "
                f"with its body, which is not constant along {listed([p.name for p in parts])}; "
                "make these values equal"
            )


def _chain(raw: pin.Model, parts: Sequence[_SplitPart]) -> list[NewJoint]:
    """Return the joints that replace a joint of a model, with their armature and limits."""
    chain = []
    for part in parts:
        new = NewJoint(part.name, part.joint, part.placement)
        if part.ratio is None:
            limits = [raw.lowerPositionLimit[[part.q]], raw.upperPositionLimit[[part.q]]]
            is_limited = part.joint.nq == 1
            armature = raw.armature[part.rates]
            new = replace(new, armature=armature, limits=limits if is_limited else None)
        chain.append(new)
    return chain


def copy_losses(
    raw: pin.Model, model: pin.Model, joints: Mapping[int, Sequence[_SplitPart]]
) -> tuple[str, ...]:
    """Copy damping and dry friction to the model whose joints are split.

    Args:
        raw: Original model.
        model: Model with split joints.
        joints: Parts of the joints that were split, by their index in `raw`.
    Returns:
        Names of the joints whose dry friction is not copied, because it does not act along parts.
    """
    arrays = ("damping", "upperDryFrictionLimit", "lowerDryFrictionLimit")
    sliding: list[str] = []
    for i in range(1, raw.njoints):
        old, name = raw.joints[i], str(raw.names[i])
        if i not in joints:
            new = model.joints[model.getJointId(name)]
            for array in arrays:
                values = getattr(raw, array)[old.idx_v : old.idx_v + old.nv]
                getattr(model, array)[new.idx_v : new.idx_v + new.nv] = values
            continue
        for part in joints[i]:
            if part.ratio is None:
                at = model.joints[model.getJointId(part.name)].idx_v
                has_friction = any(getattr(raw, array)[part.rates].any() for array in arrays[1:])
                sliding += [name] * bool(part.rotated and has_friction)
                for array in arrays[: 1 if part.rotated else 3]:
                    values = getattr(raw, array)[part.rates]
                    getattr(model, array)[at : at + part.joint.nv] = values
    return tuple(dict.fromkeys(sliding))
