"""Joints locked by `load(lock=…)`: the robot as a function of their values, with derivatives.

Followers of locked joints are locked too, and their values vary with those of their leaders.  The
carrier of a locked joint is the next moving joint toward the root.  Inertias and joints behind
the locked joint are attached to the carrier.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats, entries_of
from ..common.errors import InputError
from ..common.names import brief, listed, quoted
from .joints import attitude_of, joint_configuration

# Value of a locked joint [rad | m].  The attitude of a ball is a rotation vector of three numbers
# [rad], or a quaternion (x, y, z, w) of any length; zero is the attitude at rest.
LockValue: TypeAlias = float | tuple[float, ...]


def lock_values(lock: Iterable[str] | Mapping[str, ArrayLike]) -> dict[str, LockValue]:
    """Return {joint to lock: value}; a value defaults to zero.  Raises InputError."""
    if isinstance(lock, str):
        raise InputError(f"lock must be a list of joint names, not text; use [{lock!r}]")
    names = list(lock) if isinstance(lock, Mapping) else entries_of(lock)
    if names is None:
        raise InputError(
            f"lock must be a list of joint names or a mapping to values, got {brief(lock)}"
        )
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"lock must contain names of joints, got {brief(names)}")
    values = dict(lock.items()) if isinstance(lock, Mapping) else dict.fromkeys(names, 0.0)
    return {str(name): _lock_value(name, value) for name, value in values.items()}


def _lock_value(name: str, value: ArrayLike) -> LockValue:
    """Return a number, or the three or four finite numbers of an attitude."""
    what = f"lock: the value for joint {quoted(name)}"
    numbers = as_floats(value, what)
    if numbers.shape in ((3,), (4,)):
        attitude_of(numbers, what)
        return tuple(numbers.tolist())
    if numbers.ndim or not np.isfinite(numbers):
        raise InputError(
            f"{what} must be finite: a number, or for a ball a rotation vector of 3 numbers or a "
            f"quaternion (x, y, z, w); got {brief(value)}"
        )
    return float(numbers)


def lock_attitude(name: str, value: LockValue, remedy: str = "") -> Array:
    """Return the unit quaternion (x, y, z, w) at which a ball is locked, (4,).

    Args:
        name: Name of the ball.
        value: Value at which the ball is locked.
        remedy: Another way to lock the ball, for the message.
    Raises:
        InputError: The value is a number other than zero.
    """
    if isinstance(value, tuple):
        return attitude_of(value, f"lock: the value for joint {quoted(name)}")
    if value != 0.0:
        raise InputError(
            f"lock: joint {quoted(name)} is a ball: expected 0, a rotation vector [x, y, z] in rad "
            f"or a quaternion [x, y, z, w], got {value:g}{remedy}"
        )
    return np.array([0.0, 0.0, 0.0, 1.0])


def separate_attitudes(
    lock: Mapping[str, LockValue], balls: Collection[str], joints: Collection[str]
) -> tuple[dict[str, float], dict[str, Array]]:
    """Separate the attitudes of balls from the values of other joints.

    Args:
        lock: Values of joints to lock.
        balls: Names of ball joints.
        joints: Names of all joints.
    Returns:
        Values of all joints to lock [rad | m], zero for balls; and the unit quaternions (x, y, z,
        w) of the locked balls, {ball: (4,)}.
    Raises:
        InputError: A ball has a number other than zero, or another joint has several numbers.
    """
    attitudes = {name: lock_attitude(name, lock[name]) for name in lock if name in balls}
    values: dict[str, float] = {}
    for name, value in lock.items():
        if isinstance(value, tuple) and name in joints and name not in balls:
            raise InputError(
                f"lock: joint {quoted(name)} is not a ball: expected one number [rad | m], got "
                f"{brief(list(value))}"
            )
        values[name] = 0.0 if isinstance(value, tuple) else value
    return values, attitudes


def frozen_configurations(
    raw: pin.Model, locked: Mapping[str, float], attitudes: Mapping[str, Array]
) -> dict[int, Array]:
    """Return Pinocchio's configurations of the joints to lock, {joint index: (nq,)}.

    Args:
        raw: Model with the joints.
        locked: Values of all joints to lock [rad | m].
        attitudes: Unit quaternions of the balls to lock, {ball: (4,)}.
    Raises:
        InputError: A joint is unknown, or has several degrees of freedom, is not a ball, and has a
            value other than zero.
    """
    configurations: dict[int, Array] = {}
    neutral = pin.neutral(raw)
    for name, value in locked.items():
        if name not in list(raw.names)[1:]:
            names = listed(list(raw.names)[1:], 60)
            raise InputError(f"lock: no joint {quoted(name)}; the joints are {names}")
        joint = raw.joints[raw.getJointId(name)]
        if joint.nv > 1 and value != 0.0:
            raise InputError(
                f"lock: joint {quoted(name)} has {joint.nv} degrees of freedom and "
                "can only be locked at zero"
            )
        q = neutral[joint.idx_q : joint.idx_q + joint.nq].copy()
        if joint.nv == 1:
            q[:] = joint_configuration(joint, value)
        elif name in attitudes:
            q[:] = attitudes[name]
        configurations[joint.id] = q
    return configurations


@dataclass(frozen=True, eq=False)
class Carried:
    """The placement of a joint of the raw model on its carrier.

    Attributes:
        joint: Name of the carrier in the reduced model; "" for the world or a new base.
        at: Placement of the joint on the carrier at joint value zero.
        moved: Placement of the joint's body on the carrier, at the joint's value.
        twists: Derivatives of `moved` with respect to the values of locked joints, as
            twists in the carrier's frame at its origin, {locked joint: (6,)}.
    """

    joint: str
    at: pin.SE3
    moved: pin.SE3
    twists: Mapping[str, Array]


@dataclass(frozen=True)
class Tie:
    """A locked joint that follows another locked joint: x = Σ coefficients[k] (x_leader − at)ᵏ.

    Attributes:
        leader: Name of the leader.
        coefficients: Coefficients of the polynomial.
        at: Reference value of the leader [rad | m].
    """

    leader: str
    coefficients: tuple[float, ...]
    at: float = 0.0

    def follow(self, leader: float) -> tuple[float, float]:
        """Return the follower's value for a value of the leader, and its derivative."""
        law = np.polynomial.Polynomial(self.coefficients)
        return float(law(leader - self.at)), float(law.deriv()(leader - self.at))


@dataclass(frozen=True, eq=False)
class LockedJoints:
    """The joints that were locked.

    Attributes:
        raw: Model that contains all joints whose value may vary, before they are locked.
        frozen: Values of all locked joints [rad | m]; zero for balls.
        ties: Ties of locked joints to their leaders, {follower: tie}.
        root: Joints of the raw model that the root joint replaces, {joint: placement of its body
            on the root joint}.  Empty if the root was added, or is a joint of the raw model.
        root_name: Name of the root joint.
        several: Locked joints with several degrees of freedom, whose coordinates are fixed.
        attitudes: Unit quaternions (x, y, z, w) of locked balls, {ball: (4,)}.
        shared: Locked joints in couplings with several leaders, whose values are fixed.
        names: Locked joints whose values may vary as parameters.
    """

    raw: pin.Model
    frozen: Mapping[str, float]
    ties: Mapping[str, Tie] = field(default_factory=dict)
    root: Mapping[str, pin.SE3] = field(default_factory=dict)
    root_name: str = ""
    several: tuple[str, ...] = ()
    attitudes: Mapping[str, Array] = field(default_factory=dict)
    shared: tuple[str, ...] = ()
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(n for n in self.frozen if not self.why_not(n)))

    def why_not(self, name: str) -> str:
        """Return why the value of a locked joint cannot vary; "" if it can."""
        raw = self.raw
        if name in self.ties:
            leader = self.ties[name].leader
            return f"it follows '{leader}', with which it is locked; vary '{leader}.lock'"
        if name in self.attitudes:
            return (
                "it is a ball, whose attitude cannot vary; "
                f"load(lock={{'{name}': [x, y, z]}}) again"
            )
        if name in self.several:
            return "it has several degrees of freedom, so it can only be locked at zero"
        if name in self.shared:
            return f"it is coupled with several joints; load(lock={{'{name}': …}}) again"
        if not raw.existJointName(name) or self._carries_root(raw.getJointId(name)):
            return (
                "it carries the root, or is part of it, and only places it in the world; "
                f"load(lock={{'{name}': …}}) again"
            )
        return ""

    def _carries_root(self, joint: int) -> bool:
        raw = self.raw
        roots = [name for name in (self.root_name, *self.root) if raw.existJointName(name)]
        return any(joint in list(raw.supports[raw.getJointId(name)])[1:] for name in roots)

    def value(self, name: str, values: Mapping[str, float]) -> tuple[float, str, float]:
        """Return the value of a locked joint, the joint that determines it, and the derivative.

        Args:
            name: Name of the joint.
            values: Values by joint that replace the locked values [rad | m].
        """
        tie = self.ties.get(name)
        if tie is None:
            return float(values.get(name, self.frozen[name])), name, 1.0
        leader_value, leader, slope = self.value(tie.leader, values)
        value, ratio = tie.follow(leader_value)
        return value, leader, ratio * slope

    def carried(self, values: Mapping[str, float]) -> dict[int, Carried]:
        """Return the placements of all joints of the raw model on their carriers, by joint index.

        Args:
            values: Values of locked joints that replace the locked values [rad | m].
        """
        raw, q, identity = self.raw, pin.neutral(self.raw), pin.SE3.Identity()
        places = {0: Carried("", identity, identity, {})}
        for i in range(1, raw.njoints):
            name, joint, under = str(raw.names[i]), raw.joints[i], places[raw.parents[i]]
            at = under.moved * raw.jointPlacements[i]
            if name in self.root:
                places[i] = Carried("", identity, self.root[name], {})
                continue
            if name not in self.frozen:
                # A moving joint is its own carrier.
                places[i] = Carried(name, identity, identity, {})
                continue
            twists = dict(under.twists)
            motion = joint.createData()
            if joint.nv == 1:
                value, leader, slope = self.value(name, values)
                k = slice(joint.idx_q, joint.idx_q + joint.nq)
                q[k] = joint_configuration(joint, value)
                twist = at.toActionMatrix() @ np.asarray(motion.S).ravel() * slope
                twists[leader] = twists.get(leader, 0.0) + twist
            elif name in self.attitudes:
                q[joint.idx_q : joint.idx_q + joint.nq] = self.attitudes[name]
            joint.calc(motion, q)
            places[i] = Carried(under.joint, at, at * motion.M, twists)
        return places

    def inertia(self, joint: str, values: Mapping[str, float]) -> tuple[Array, dict[str, Array]]:
        """Return the pseudo-inertia of all bodies on a carrier, (4, 4), and its derivatives.

        Derivatives are with respect to the values of locked joints, {locked joint: (4, 4)}.

        Args:
            joint: Name of the carrier; "" for a root that was added.
            values: Values of locked joints [rad | m].
        """
        total, slopes = np.zeros((4, 4)), {name: np.zeros((4, 4)) for name in self.names}
        for i, place in self.carried(values).items():
            if place.joint != joint:
                continue
            T = place.moved.homogeneous
            J = T @ pin.PseudoInertia.FromInertia(self.raw.inertias[i]).toMatrix() @ T.T
            total += J
            for name in place.twists.keys() & slopes.keys():
                S = pin.Motion(place.twists[name]).homogeneous
                slopes[name] += S @ J + J @ S.T
        return total, slopes

    def placements(
        self, values: Mapping[str, float]
    ) -> dict[str, tuple[pin.SE3, Mapping[str, Array]]]:
        """Return the placement of each moving joint on its carrier, and its derivatives.

        Derivatives are twists, (6,), with respect to the value of each locked joint.
        """
        placements, places = {}, self.carried(values)
        for i, place in places.items():
            if i and place.joint == str(self.raw.names[i]):
                under = places[self.raw.parents[i]]
                placements[place.joint] = under.moved * self.raw.jointPlacements[i], under.twists
        return placements

    def frames(self, model: pin.Model, locked: Collection[str]) -> dict[int, int]:
        """Return the frames whose placement on their body depends on the value of a locked joint.

        Args:
            model: Reduced model.
            locked: Names of locked joints.
        Returns:
            {frame in the reduced model: same frame in the raw model}.  Frames with the same name
            and type are matched in order.
        """
        moving = {i for i, place in self.carried({}).items() if place.twists.keys() & set(locked)}
        raw: dict[tuple[str, pin.FrameType], list[int]] = {}
        for k, frame in enumerate(self.raw.frames):
            raw.setdefault((str(frame.name), frame.type), []).append(k)
        matches = {}
        for k, frame in enumerate(model.frames):
            candidates = raw.get((str(frame.name), frame.type), [])
            if candidates and self.raw.frames[first := candidates.pop(0)].parentJoint in moving:
                matches[k] = first
        return matches


def moments_of(J: Array) -> Array:
    """Return the moments, (10,), of a pseudo-inertia or of its derivative, (4, 4).

    The moments are mass m, first moment m c, and the moments of inertia about the origin, xx, xy,
    xz, yy, yz, zz.
    """
    I = np.trace(J[:3, :3]) * np.eye(3) - J[:3, :3]
    return np.concatenate([[J[3, 3]], J[:3, 3], I[0], I[1, 1:], I[2, 2:]])
