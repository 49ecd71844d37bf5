"""Joints that `load(lock=…)` froze: the robot with other values of them, and how it moves so.

All that such a joint carries sits on the body of the next joint inward that moves, its carrier:
inertias that belong to it, and the joints behind.
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


@dataclass(frozen=True, eq=False)
class LockedJoints:
    """The joints of one degree of freedom that were locked.

    raw: the model with all joints.  frozen: {joint: value}, of all that were locked [rad | m].
    names: those whose value may vary.
    """

    raw: pin.Model
    frozen: Mapping[str, float]
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        raw = self.raw
        single = [n for n in self.frozen if raw.joints[raw.getJointId(n)].nv == 1]
        object.__setattr__(self, "names", tuple(single))

    def carried(self, values: Mapping[str, float]) -> dict[int, Carried]:
        """Return the places of all joints of the raw model; others than these have their own."""
        raw, q = self.raw, pin.neutral(self.raw)
        found = {0: Carried("", pin.SE3.Identity(), pin.SE3.Identity(), {})}
        for i in range(1, raw.njoints):
            name, joint, under = str(raw.names[i]), raw.joints[i], found[raw.parents[i]]
            at = under.moved * raw.jointPlacements[i]
            if name not in self.frozen:
                here = Carried(name, pin.SE3.Identity(), pin.SE3.Identity(), {})
                # Its own placement is that on its carrier.
                found[i] = here
                continue
            twists = dict(under.twists)
            moved = joint.createData()
            if joint.nv == 1:
                value = float(values.get(name, self.frozen[name]))
                k = slice(joint.idx_q, joint.idx_q + joint.nq)
                q[k] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
                axis = np.asarray(moved.S).ravel()
                twists[name] = at.toActionMatrix() @ axis
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
            for name, twist in place.twists.items():
                S = _hat(twist)
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
