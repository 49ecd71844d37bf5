"""Points and velocities of the configuration manifold Q = G × B (group × shape space).

The module also converts their coordinates to Pinocchio's q and v.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..lie.group import Group
from .rebuild import rebuild
from .shape_space import ShapeSpace

Indices: TypeAlias = NDArray[np.intp]


@checks_arguments
@dataclass(frozen=True)
class InitialState:
    """A generic initial state, with a duration that shows its typical motion.

    Attributes:
        x: Shape, (nx,) [rad | m | 1].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist of the base [linear; angular], (r,).
        duration: Duration [s].
    """

    x: Array
    xdot: Array
    xi: Array
    duration: float


@checks_arguments
@dataclass(frozen=True)
class Configuration:
    """A point of the configuration manifold Q = G × B.

    Attributes:
        pose: Pose of the base, (..., size).
        x: Shape, (..., nx) [rad | m | 1].
    """

    pose: Array
    x: Array


@checks_arguments
@dataclass(frozen=True)
class Velocity:
    """A velocity on the configuration manifold Q = G × B.

    Attributes:
        xi: Body twist of the base [linear; angular], (..., r).
        xdot: Shape rate, (..., m) [rad/s | m/s].
    """

    xi: Array
    xdot: Array


@dataclass(frozen=True, eq=False)
class CoordinateMap:
    """Map between the coordinates y = (pose, coordinates of all joints) and Pinocchio's q.

    Attributes:
        plain: Indices in y of the coordinates that q stores unchanged.
        plain_q: Indices in q of the same coordinates.
        angle: Indices in y of the angles that q stores as cosine and sine.
        angle_q: Indices in q of the cosines of these angles.  Each sine follows its cosine.
    """

    plain: Indices
    plain_q: Indices
    angle: Indices
    angle_q: Indices

    def to_q(self, y: Array) -> Array:
        """Convert coordinates y to Pinocchio's q, (..., nq)."""
        if not len(self.angle):
            return y.copy()  # both store the same numbers in the same order
        angle = y.take(self.angle, axis=-1)
        columns = np.concatenate([y, np.cos(angle), np.sin(angle)], axis=-1)
        return columns.take(self._columns, axis=-1)

    @cached_property
    def _columns(self) -> Indices:
        """Index of each entry of q among the entries of y, the cosines and the sines."""
        y, angles = len(self.plain) + len(self.angle), np.arange(len(self.angle))
        columns = np.empty(y + len(angles), dtype=np.intp)
        columns[self.plain_q] = self.plain
        columns[self.angle_q], columns[self.angle_q + 1] = y + angles, y + len(angles) + angles
        return columns

    def from_q(self, q: Array) -> Array:
        """Convert Pinocchio's q, (..., nq), to y, with angles in (−π, π]."""
        y = np.empty((*q.shape[:-1], len(self.plain) + len(self.angle)))
        y[..., self.plain] = q[..., self.plain_q]
        # Adding 0.0 turns −0.0 into 0.0, so that half a turn is π and not −π.
        y[..., self.angle] = np.arctan2(q[..., self.angle_q + 1] + 0.0, q[..., self.angle_q])
        return y


def coordinate_map(model: pin.Model, group: Group, tree: ShapeSpace) -> CoordinateMap:
    """Return the map between (pose, coordinates of all joints) and q.

    Args:
        model: Model whose root moves in the group.
        group: Group of the root.
        tree: Manifold of all joints except the root.
    Returns:
        The map.
    """
    plain = [(k, k) for k in range(group.size)]  # pairs of indices in y and in q
    angle: list[tuple[int, int]] = []
    if model.joints[1].nq > group.size:
        angle.append(plain.pop())
    for i, placed in enumerate(tree.joints, start=2):
        joint, first = model.joints[i], group.size + placed.x.start
        if joint.nq == 2:
            angle.append((first, joint.idx_q))
        else:
            plain += [(first + k, joint.idx_q + k) for k in range(joint.nq)]
    columns = (np.array(pairs, dtype=np.intp).reshape(-1, 2).T for pairs in (plain, angle))
    return CoordinateMap(*(column for pair in columns for column in pair))


@dataclass(frozen=True, eq=False)
class JointOrder:
    """Indices that convert q and v between the original and the reordered joint order.

    Attributes:
        q: Index in the reordered q of every entry of the original q, (nq,).
        v: Index in the reordered v of every entry of the original v, (nv,).
    """

    q: Indices
    v: Indices


def reordered(model: pin.Model, order: list[int]) -> tuple[pin.Model, JointOrder]:
    """Return a copy of a model with reordered joints, and the indices that convert q and v."""
    new = rebuild(model, order=order)
    q: list[int] = []
    v: list[int] = []
    for k in np.argsort(order).tolist():
        joint = new.joints[k + 1]
        q += range(joint.idx_q, joint.idx_q + joint.nq)
        v += range(joint.idx_v, joint.idx_v + joint.nv)
    return new, JointOrder(np.array(q), np.array(v))
