"""Joints that `load(lock=…)` froze: the robot with other values of them, and how it moves so.

Joints that follow locked ones are locked with them, and move as these are varied.  All that a
locked joint carries sits on the body of the next joint inward that moves, its carrier: inertias
that belong to it, and the joints behind.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..common.arrays import Array


@dataclass(frozen=True, eq=False)
class Carried:
    """The place of a joint of the raw model.

    joint: name of the joint of the reduced model that carries it, "" for the world or a base that
    was put there.  at: its placement on that before it moves, and after.  twists: how it moves per
    unit of each locked joint, (6,) in the carrier's frame, taken at its origin.
    """

    joint: str
    at: pin.SE3
    moved: pin.SE3
    twists: Mapping[str, Array]


@dataclass(frozen=True)
class Tie:
    """A locked joint that follows another locked one: x = Σ coefficients[k] (x_leader − at)ᵏ.

    Coordinates are those of the joints [rad | m].
    """

    leader: str
    coefficients: tuple[float, ...]
    at: float = 0.0

    def follow(self, leader: float) -> tuple[float, float]:
        """Return the value, and its slope by that of the leader."""
        law = np.polynomial.Polynomial(self.coefficients)
        return float(law(leader - self.at)), float(law.deriv()(leader - self.at))


@dataclass(frozen=True, eq=False)
class LockedJoints:
    """The joints that were locked.

    raw: the model with all joints whose value may vary, and perhaps others.  frozen: {joint:
    value}, of all that were locked [rad | m].  ties: those of them that follow others.  root: the
    joints of the raw model in whose place the root is, with where their bodies sit on it; none if
    the root was put there, or is one of the raw model by its own name.  several: those with several
    degrees of freedom, which freeze at zero.
    names: those whose value may vary.
    """

    raw: pin.Model
    frozen: Mapping[str, float]
    ties: Mapping[str, Tie] = field(default_factory=dict)
    root: Mapping[str, pin.SE3] = field(default_factory=dict)
    root_name: str = ""
    several: tuple[str, ...] = ()
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(n for n in self.frozen if not self.why_not(n)))

    def why_not(self, name: str) -> str:
        """Return why the value of a locked joint does not vary; "" if it may."""
        raw = self.raw
        if name in self.ties:
            leader = self.ties[name].leader
            return f"it follows '{leader}', with which it is locked; vary '{leader}.lock'"
        if name in self.several:
            return "it has several degrees of freedom, and freezes at zero only"
        if not raw.existJointName(name) or self._carries_root(raw.getJointId(name)):
            return (
                "it carries the root, or is part of it, and only says where the world is; "
                f"load(lock={{'{name}': …}}) again"
            )
        return ""

    def _carries_root(self, joint: int) -> bool:
        raw = self.raw
        for name in (self.root_name, *self.root):
            i = raw.getJointId(name) if raw.existJointName(name) else 0
            while i:
                if i == joint:
                    return True
                i = raw.parents[i]
        return False

    def value(self, name: str, values: Mapping[str, float]) -> tuple[float, str, float]:
        """Return where a locked joint is, whose value decides that, and its slope by that."""
        tie = self.ties.get(name)
        if tie is None:
            return float(values.get(name, self.frozen[name])), name, 1.0
        at, who, slope = self.value(tie.leader, values)
        here, by = tie.follow(at)
        return here, who, by * slope

    def carried(self, values: Mapping[str, float]) -> dict[int, Carried]:
        """Return the places of all joints of the raw model; others than these have their own."""
        raw, q, still = self.raw, pin.neutral(self.raw), pin.SE3.Identity()
        found = {0: Carried("", still, still, {})}
        for i in range(1, raw.njoints):
            name, joint, under = str(raw.names[i]), raw.joints[i], found[raw.parents[i]]
            at = under.moved * raw.jointPlacements[i]
            if name in self.root:
                found[i] = Carried("", still, self.root[name], {})
                continue
            if name not in self.frozen:
                found[i] = Carried(name, still, still, {})  # its placement is that on its carrier
                continue
            twists = dict(under.twists)
            moved = joint.createData()
            if joint.nv == 1:
                value, who, slope = self.value(name, values)
                k = slice(joint.idx_q, joint.idx_q + joint.nq)
                q[k] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
                twist = at.toActionMatrix() @ np.asarray(moved.S).ravel() * slope
                twists[who] = twists.get(who, 0.0) + twist
            joint.calc(moved, q)
            found[i] = Carried(under.joint, at, at * moved.M, twists)
        return found

    def inertia(self, joint: str, values: Mapping[str, float]) -> tuple[Array, dict[str, Array]]:
        """Return the pseudo-inertia (4, 4) of all that moves with a joint, and its slopes.

        joint: "" for the root that was put there.
        """
        total, slopes = np.zeros((4, 4)), {name: np.zeros((4, 4)) for name in self.names}
        for i, place in self.carried(values).items():
            if place.joint != joint:
                continue
            T = place.moved.homogeneous
            J = T @ _pseudo_inertia(self.raw.inertias[i]) @ T.T
            total += J
            for name in place.twists.keys() & slopes.keys():
                S = _hat(place.twists[name])
                slopes[name] += S @ J + J @ S.T
        return total, slopes

    def placements(
        self, values: Mapping[str, float]
    ) -> dict[str, tuple[pin.SE3, Mapping[str, Array]]]:
        """Return the placements of all joints that are left, and how each locked one moves them."""
        found, places = {}, self.carried(values)
        for i, place in places.items():
            if i and place.joint == str(self.raw.names[i]):
                under = places[self.raw.parents[i]]
                found[place.joint] = (under.moved * self.raw.jointPlacements[i], under.twists)
        return found

    def frames(self, model: pin.Model, locked: Collection[str]) -> dict[int, int]:
        """Return the frames of a model without these joints that some of those move on a body.

        As {frame of the model: that of the raw one}; what has two of a kind and a name is found in
        order.
        """
        moved = {i for i, place in self.carried({}).items() if place.twists.keys() & set(locked)}
        raw: dict[tuple[str, pin.FrameType], list[int]] = {}
        for k, frame in enumerate(self.raw.frames):
            raw.setdefault((str(frame.name), frame.type), []).append(k)
        found = {}
        for k, frame in enumerate(model.frames):
            known = raw.get((str(frame.name), frame.type), [])
            if known and self.raw.frames[here := known.pop(0)].parentJoint in moved:
                found[k] = here
        return found


def _hat(twist: Array) -> Array:
    v, w = twist[:3], twist[3:]
    return np.vstack([np.hstack([pin.skew(w), v[:, None]]), np.zeros((1, 4))])


def _pseudo_inertia(body: pin.Inertia) -> Array:
    about = body.inertia
    c, m = np.asarray(body.lever), float(body.mass)
    J = np.zeros((4, 4))
    J[:3, :3] = 0.5 * np.trace(about) * np.eye(3) - about + m * np.outer(c, c)
    J[:3, 3] = J[3, :3] = m * c
    J[3, 3] = m
    return J


def moments_of(J: Array) -> Array:
    """Return mass, first and second moments (10,) of a pseudo-inertia, or of a slope of one.

    m, m c, then the inertia about the origin, xx, xy, xz, yy, yz, zz.
    """
    I = np.trace(J[:3, :3]) * np.eye(3) - J[:3, :3]
    return np.concatenate([[J[3, 3]], J[:3, 3], I[0], I[1, 1:], I[2, 2:]])
