"""Points and velocities of Q = G × B, and their coordinates in Pinocchio's q and v."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array
from ..lie.group import Group
from .rebuild import rebuild

Indices: TypeAlias = NDArray[np.intp]


@dataclass(frozen=True)
class InitialState:
    """A generic initial state, with the time over which its motion is interesting.

    Attributes:
        x: Shape, (m,) [rad | m].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist of the base [linear; angular], (r,).
        duration: Duration [s].
    """

    x: Array
    xdot: Array
    xi: Array
    duration: float


@dataclass(frozen=True)
class Configuration:
    """A point of Q = G × B.

    Attributes:
        pose: Pose of the base, (..., size).
        x: Shape, (..., m) [rad | m].
    """

    pose: Array
    x: Array


@dataclass(frozen=True)
class Velocity:
    """A velocity on Q = G × B.

    Attributes:
        xi: Body twist of the base [linear; angular], (..., r).
        xdot: Shape rate, (..., m) [rad/s | m/s].
    """

    xi: Array
    xdot: Array


@dataclass(frozen=True, eq=False)
class CoordinateMap:
    """Positions of the coordinates y = (pose, x of all joints) in Pinocchio's q.

    Attributes:
        plain: Coordinates that q holds unchanged, as indices in y.
        plain_q: Their indices in q.
        angle: Angles that q holds as cosine and sine, as indices in y.
        angle_q: Indices of their cosines in q.  Each sine follows its cosine.
    """

    plain: Indices
    plain_q: Indices
    angle: Indices
    angle_q: Indices

    def to_q(self, y: Array) -> Array:
        """Return q (..., nq) for y."""
        q = np.empty((*y.shape[:-1], len(self.plain) + 2 * len(self.angle)))
        q[..., self.plain_q] = y[..., self.plain]
        q[..., self.angle_q] = np.cos(y[..., self.angle])
        q[..., self.angle_q + 1] = np.sin(y[..., self.angle])
        return q

    def from_q(self, q: Array) -> Array:
        """Return y for q (..., nq), with angles in (−π, π]."""
        y = np.empty((*q.shape[:-1], len(self.plain) + len(self.angle)))
        y[..., self.plain] = q[..., self.plain_q]
        # −0.0 + 0.0 is 0.0, so half a turn is π and not −π.
        y[..., self.angle] = np.arctan2(q[..., self.angle_q + 1] + 0.0, q[..., self.angle_q])
        return y


def coordinate_map(model: pin.Model, group: Group) -> CoordinateMap:
    """Return the positions of pose and joint values in q of a model on a root of `group`."""
    plain = [(k, k) for k in range(group.size)]  # pairs of indices in y and in q
    angle: list[tuple[int, int]] = []
    if model.joints[1].nq > group.size:
        angle.append(plain.pop())
    for i in range(2, model.njoints):
        joint = model.joints[i]
        (angle if joint.nq == 2 else plain).append((group.size + i - 2, joint.idx_q))
    columns = (np.array(pairs, dtype=np.intp).reshape(-1, 2).T for pairs in (plain, angle))
    return CoordinateMap(*(column for pair in columns for column in pair))


@dataclass(frozen=True, eq=False)
class JointOrder:
    """Positions of the original q and v in those of a model with reordered joints.

    Attributes:
        q: Index in the new q of every entry of the original q, (nq,).
        v: Index in the new v of every entry of the original v, (nv,).
    """

    q: Indices
    v: Indices


def reordered(model: pin.Model, order: list[int]) -> tuple[pin.Model, JointOrder]:
    """Return a model with its joints in another order, and the positions of its q and v."""
    new = rebuild(model, order=order)
    q: list[int] = []
    v: list[int] = []
    for k in np.argsort(order).tolist():
        joint = new.joints[k + 1]
        q += range(joint.idx_q, joint.idx_q + joint.nq)
        v += range(joint.idx_v, joint.idx_v + joint.nv)
    return new, JointOrder(np.array(q), np.array(v))
