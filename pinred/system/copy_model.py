"""Copies of a model built joint by joint: other joints, another root, or another order.

pin.buildReducedModel crashes on models without joint frames, and fails if a link and a joint
share a name.  pin.appendModel drops gravity, armature and limits.  This module therefore uses
neither function.

Joints with several degrees of freedom are split into hinges, slides and balls when a model is
loaded, if their motion can be carried out by these parts, one after the other.  This is exact: the
massless bodies between the parts add no inertia.  A new type is one more entry of `TYPES`.

Pinocchio's derivatives of the mass matrix are wrong for joints whose axes vary with q within the
joint (Universal, SphericalZYX, and composites).  These joints never reach them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array
from ..common.errors import InputError, ModelError
from ..common.names import listed, nearest, quoted
from .joints import RootChain, is_shape_joint, motion_group, places_on_root, root_chain
from .locked_joints import LockValue
from .loops.loop import Loop, LoopFile
from .robot_file_contents import Coupling

# Prismatic joints along x, y and z, which are faster than the last one, for an arbitrary axis.
PRISMATIC = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPrismaticUnaligned)
REVOLUTE = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRevoluteUnaligned)
RATE_LIMITS = ("lowerVelocityLimit", "upperVelocityLimit", "lowerEffortLimit", "upperEffortLimit")
_HINGES = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}
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
class Carrier:
    """The joint of a model that moves a body (0 is the world), and the body's placement on it."""

    joint: int
    at: pin.SE3


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
    carriers = {0: Carrier(base if chain is None else 0, pin.SE3.Identity())}
    model.inertias[base] += raw.inertias[0]
    on_root = {} if chain is None else places_on_root(raw, chain)
    for i in order or range(1, raw.njoints):
        under, joint = carriers[raw.parents[i]], raw.joints[i]
        at = under.at * raw.jointPlacements[i]
        qs = slice(joint.idx_q, joint.idx_q + joint.nq)
        if chain is not None and i <= chain.last:
            carrier = Carrier(base, on_root[str(raw.names[i])])
        elif i in frozen:
            q[qs] = frozen[i]
            motion = joint.createData()
            joint.calc(motion, q)
            carrier = Carrier(under.joint, at * motion.M)
        elif i in replaced:
            body = replaced[i][-1].body
            carrier = Carrier(
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
            carrier, copied[i] = Carrier(k, pin.SE3.Identity()), k
        model.appendBodyToJoint(carrier.joint, raw.inertias[i], carrier.at)
        carriers[i] = carrier
    numbers = {0: 0}  # {frame of the old model: frame of the new model}
    for number, frame in enumerate(raw.frames):
        above = numbers.get(int(frame.parentFrame), 0)
        if number == 0 or number in without_frames:
            numbers[number] = above
            continue
        on = carriers[frame.parentJoint]
        at = on.at * frame.placement
        numbers[number] = model.addFrame(
            pin.Frame(frame.name, on.joint, above, at, frame.type), False
        )
    model = builder.finish()
    for i, k in copied.items():
        old, new = raw.joints[i], model.joints[k]
        for kind in RATE_LIMITS:
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


@dataclass(frozen=True, eq=False)
class Part:
    """A hinge, slide or ball of a joint.

    Attributes:
        suffix: Suffix of its name: the part of joint "wrist" is "wrist.suffix".  The part that
            keeps the name of the joint has no suffix.
        joint: Revolute, prismatic or spherical joint.
        placement: Placement on the body of the part before.
        ratio: Displacement per displacement of the part before, if the part follows it; else None.
        rotated: Whether the joint's rate along the part is a component of a vector in the axes of
            the child.  Armature and damping are constant along the part only if they are equal
            for all such components.
    """

    suffix: str
    joint: pin.JointModel
    placement: pin.SE3
    ratio: float | None = None
    rotated: bool = False


def part(
    suffix: str, joint: pin.JointModel, ratio: float | None = None, *, rotated: bool = False
) -> Part:
    """Return a part at the origin of the part before.

    Args:
        suffix: Suffix of its name.
        joint: Revolute, prismatic or spherical joint.
        ratio: Displacement per displacement of the part before, or None.
        rotated: See Part.
    Returns:
        The part.
    """
    return Part(suffix, joint, pin.SE3.Identity(), ratio, rotated)


_ALONG_AXES = {
    "JointModelHX": (pin.JointModelRX, pin.JointModelPX),
    "JointModelHY": (pin.JointModelRY, pin.JointModelPY),
    "JointModelHZ": (pin.JointModelRZ, pin.JointModelPZ),
}


def _screw(joint: pin.JointModel) -> tuple[Part, ...]:
    """Return a hinge, and a slide along the same axis that follows it.

    The joint's value is the angle of the hinge.  The slide moves by the pitch per radian.
    """
    screw = joint.extract()
    if joint.shortname() in _ALONG_AXES:
        hinge, slide = (kind() for kind in _ALONG_AXES[joint.shortname()])
    else:
        hinge = pin.JointModelRevoluteUnaligned(screw.axis)
        slide = pin.JointModelPrismaticUnaligned(screw.axis)
    return part("", hinge), part("slide", slide, float(screw.pitch))


def _universal(joint: pin.JointModel) -> tuple[Part, ...]:
    """Return two hinges, the second of which is carried by the first."""
    universal = joint.extract()
    hinges = (pin.JointModelRevoluteUnaligned(axis) for axis in (universal.axis1, universal.axis2))
    return tuple(part(suffix, hinge) for suffix, hinge in zip("12", hinges, strict=True))


# The linear velocity of Pinocchio's free and planar joints has components in the axes of the child.
# The rates of these slides are components in the axes of the parent.
_TURNED = (
    part("x", pin.JointModelPX(), rotated=True),
    part("y", pin.JointModelPY(), rotated=True),
    part("z", pin.JointModelPZ(), rotated=True),
)
# The hinges, slides and balls of joints, by Pinocchio's names without "JointModel": from the parent
# to the child, or a function that returns them.  The coordinates of independent parts are, in this
# order, those of the joint.
TYPES: Mapping[str, tuple[Part, ...] | Callable[[pin.JointModel], tuple[Part, ...]]] = {
    "SphericalZYX": (
        part("yaw", pin.JointModelRZ()),
        part("pitch", pin.JointModelRY()),
        part("roll", pin.JointModelRX()),
    ),
    # The ball has the quaternion and the angular velocity of the free joint.
    "FreeFlyer": (*_TURNED, part("ball", pin.JointModelSpherical())),
    "Planar": (*_TURNED[:2], part("turn", pin.JointModelRUBZ())),
    "Translation": tuple(replace(slide, rotated=False) for slide in _TURNED),
    "Universal": _universal,
    **dict.fromkeys(("HX", "HY", "HZ", "HelicalUnaligned"), _screw),
}


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
            joint_parts = [part for part in self.parts.get(name, (name,)) if part not in followers]
            if len(joint_parts) > 1 and value != 0.0:
                raise InputError(
                    f"lock: joint {quoted(name)} has {len(joint_parts)} degrees of freedom and can "
                    f"only be locked at zero; lock its parts instead: {listed(joint_parts)}"
                )
            values |= dict.fromkeys(joint_parts, value)
        return values

    def whole(self, parts: Collection[str]) -> set[str]:
        """Return the joints, as named before the split, all of whose parts are among `parts`."""
        return {n for n, part_names in self.parts.items() if {*part_names} <= {*parts}} | {*parts}


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
        parts = TYPES[name]
        return parts(joint) if callable(parts) else parts
    if is_shape_joint(joint):
        return (Part("", joint, pin.SE3.Identity()),)
    if name != "Composite":
        return None
    composite, joined = joint.extract(), list[Part]()
    places = composite.jointPlacements
    for k, (component, place) in enumerate(zip(composite.joints, places, strict=True), start=1):
        inner = _parts_of(component)
        if inner is None:
            return None
        for j, part in enumerate(inner):
            suffix = f"{k}.{part.suffix}" if part.suffix else str(k)
            placement = place * part.placement if j == 0 else part.placement
            joined.append(replace(part, suffix=suffix, placement=placement))
    return tuple(joined)


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


def with_joint_types(raw: pin.Model, loops: LoopFile) -> pin.Model:
    """Return a model whose joints have the types of a file of loops.

    A universal joint becomes two hinges, whose names end in _X, _Y or _Z, as in
    example-parallel-robots.

    Args:
        raw: Model of the URDF.
        loops: The file.
    Returns:
        The model; `raw` itself if the types are those of the URDF.
    Raises:
        InputError: The model lacks a joint or a frame that the file names.
    """
    names = [str(name) for name in raw.names]
    for name in loops.joints:
        _check_name(loops.path, "joint_name", name, names[1:], "joint")
    if loops.path:
        frames = [str(frame.name) for frame in raw.frames][1:]
        for loop in loops.loops:
            assert isinstance(loop, Loop)
            for frame in (loop.frame_a, loop.frame_b):
                _check_name(loops.path, "closed_loop", frame, frames, "link or frame")
    chains = {
        names.index(name): _joints_of(name, kind)
        for name, kind in loops.joints.items()
        if kind != "FIXED"
    }
    if not chains:
        return raw
    model = rebuild(raw, replaced=chains)
    copy_losses(raw, model, dict.fromkeys(chains, ()))
    return model


def _check_name(path: str, key: str, name: str, known: list[str], what: str) -> None:
    if name not in known:
        raise InputError(
            f"{path}: {key}: the robot has no {what} {quoted(name)}; "
            f"{nearest(name, known)}the names are {listed(known, 60)}"
        )


def _joints_of(name: str, kind: str) -> list[NewJoint]:
    """Return the joints that replace a joint of the URDF."""
    identity = pin.SE3.Identity()
    if kind == "SPHERICAL":
        return [NewJoint(name, pin.JointModelSpherical(), identity)]
    axes = "XY" if kind == "CARDAN" else kind[-2:]
    return [NewJoint(f"{name}_{axis}", _HINGES[axis](), identity) for axis in axes]
