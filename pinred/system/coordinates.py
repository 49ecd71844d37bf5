"""Points and velocities of the configuration manifold Q = G × B (group × shape space).

The shape space is a product of joints, with slices, labels, units and geometry.  The coordinates of
Q are also converted to Pinocchio's q and v.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..common.names import quoted
from ..lie.group import Group
from ..lie.rotations import (
    closest_rotation_vectors,
    left_jacobian,
    unwrapped_rotation_vectors,
)
from .copy_model import rebuild
from .joints import ElementaryJoint, elementary_joint

_UNIT = 1e-3  # largest deviation of a quaternion's norm from 1, for values of few decimals


@dataclass(frozen=True, eq=False)
class PlacedJoint:
    """A joint of a product.

    Attributes:
        name: Name of the joint.
        kind: Kind of the joint.
        x: Slice of its coordinates in x.
        v: Slice of its rates in ẋ.
    """

    name: str
    kind: ElementaryJoint
    x: slice
    v: slice


@dataclass(frozen=True, eq=False)
class ShapeSpace:
    """A product of joint manifolds with coordinates x, (nx,), and rates, (m,), along its frame.

    Without balls, nx = m and the rates are the derivatives of the coordinates.

    Attributes:
        joints: The joints in order.
    """

    joints: tuple[PlacedJoint, ...]

    @cached_property
    def nx(self) -> int:
        """Number of coordinates."""
        return sum(joint.kind.nx for joint in self.joints)

    @cached_property
    def m(self) -> int:
        """Number of rates, the dimension of the manifold."""
        return sum(joint.kind.m for joint in self.joints)

    @cached_property
    def x_names(self) -> tuple[str, ...]:
        """Labels of the coordinates, (nx,): joint names, with suffixes for quaternions."""
        return tuple(j.name + suffix for j in self.joints for suffix in j.kind.coordinates)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Labels of the rates, (m,): joint names, with suffixes for the axes of balls."""
        return tuple(j.name + suffix for j in self.joints for suffix in j.kind.rates)

    @cached_property
    def x_units(self) -> tuple[str, ...]:
        """Units of the coordinates, (nx,)."""
        return tuple(chain.from_iterable(j.kind.coordinate_units for j in self.joints))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of displacements along the frame, (m,)."""
        return tuple(chain.from_iterable(j.kind.units for j in self.joints))

    @cached_property
    def balls(self) -> tuple[PlacedJoint, ...]:
        """The ball joints."""
        return tuple(joint for joint in self.joints if joint.kind.is_ball)

    @cached_property
    def scalar_x(self) -> NDArray[np.intp]:
        """Indices in x of the coordinates of hinges and slides."""
        return _indices(j.x for j in self.joints if not j.kind.is_ball)

    @cached_property
    def scalar_v(self) -> NDArray[np.intp]:
        """Indices in ẋ of the rates of hinges and slides, in the order of `scalar_x`."""
        return _indices(j.v for j in self.joints if not j.kind.is_ball)

    @cached_property
    def ball_x(self) -> NDArray[np.intp]:
        """Indices in x of the quaternions of balls, four for each."""
        return _indices(j.x for j in self.balls)

    @cached_property
    def ball_v(self) -> NDArray[np.intp]:
        """Indices in ẋ of the rates of balls, three for each."""
        return _indices(j.v for j in self.balls)

    def coordinates_of(self, rates: Sequence[int]) -> list[int]:
        """Return the indices in x of hinges and slides, from the indices of their rates.

        Raises:
            InputError: A rate belongs to a ball, which has no coordinate for each axis.
        """
        if not self.balls:
            return list(rates)
        at = dict(zip(self.scalar_v.tolist(), self.scalar_x.tolist(), strict=True))
        for k in rates:
            if k not in at:
                raise InputError(
                    f"{quoted(self.names[k])} is an axis of a ball joint, along which there is no "
                    "coordinate; choose a hinge or slide, or a force on the ball"
                )
        return [at[k] for k in rates]

    def coordinates_of_joints(self, rates: Sequence[int]) -> list[int]:
        """Return the indices in x of whole joints, from the indices of all their rates."""
        if not self.balls:
            return list(rates)
        at = {joint.v.start: joint.x for joint in self.joints}
        return [k for v in rates if v in at for k in range(at[v].start, at[v].stop)]

    @property
    def size_in_words(self) -> str:
        """The number of joints, and the dimension if it differs."""
        count = len(self.joints)
        return f"{count} joints" if count == self.m else f"{count} joints (m = {self.m})"

    def rates_of(self, coordinate: int) -> tuple[int, ...]:
        """Return the indices of the rates that change a coordinate."""
        (joint,) = (j for j in self.joints if j.x.start <= coordinate < j.x.stop)
        return tuple(range(joint.v.start, joint.v.stop))

    @cached_property
    def structure(self) -> Array:
        """Structure constants c^γ_αβ of the frame, (m, m, m), indices γ, α, β."""
        c = np.zeros((self.m, self.m, self.m))
        for joint in self.balls:
            c[joint.v, joint.v, joint.v] = joint.kind.structure
        return read_only(c)

    @property
    def neutral(self) -> Array:
        """The shape at rest, (nx,): zeros and identity quaternions."""
        return np.concatenate([np.empty(0), *(joint.kind.neutral for joint in self.joints)])

    def integrate(self, x: Array, sigma: Array) -> Array:
        """Return x exp(σ), (..., nx), for displacements σ, (..., m), along the frame."""
        if not self.balls:
            return np.asarray(x + sigma)
        return self._by_joint(lambda j: j.kind.integrate(x[..., j.x], sigma[..., j.v]))

    def difference(self, x: Array, y: Array) -> Array:
        """Return the displacement σ, (..., m), with y = x exp(σ) and angles of balls up to π."""
        if not self.balls:
            return np.asarray(y - x)
        return self._by_joint(lambda j: j.kind.difference(x[..., j.x], y[..., j.x]))

    def chart(self, x: Array, *, near: Array | None = None) -> Array:
        """Return a coordinate for each rate over time, (T, m) [rad | m].

        The coordinates of a ball are its rotation vector, unwrapped so that it is continuous.

        Args:
            x: Shapes over time, (T, nx).
            near: Coordinates close to those of the shapes, (T, m), from which rotation vectors
                differ least; those of the shape before if None.
        Returns:
            Values of hinges and slides, and rotation vectors of balls.
        """
        if not self.balls:
            return x
        chart = np.empty((len(x), self.m))
        chart[:, self.scalar_v] = x[:, self.scalar_x]
        for joint in self.balls:
            q = x[:, joint.x]
            chart[:, joint.v] = (
                unwrapped_rotation_vectors(q)
                if near is None
                else closest_rotation_vectors(q, near[:, joint.v])
            )
        return chart

    def chart_rate(self, w: Array, sigma: Array) -> Array:
        """Return the derivatives, (T, m), of coordinates from `chart`, (T, m), at rates (T, m).

        The derivative of a rotation vector is J⁻¹σ with the right Jacobian J.
        """
        if not self.balls:
            return sigma
        wdot = sigma.copy()
        for joint in self.balls:
            J = left_jacobian(-w[:, joint.v])
            wdot[:, joint.v] = np.linalg.solve(J, sigma[:, joint.v, None])[..., 0]
        return wdot

    def rate_map(self, x: Array) -> Array:
        """Return E(x), (..., nx, m), which maps rates along the frame to derivatives of x."""
        E = np.zeros((*x.shape[:-1], self.nx, self.m))
        for joint in self.joints:
            E[..., joint.x, joint.v] = joint.kind.rate_map(x[..., joint.x])
        return E

    def frame_map(self, x: Array) -> Array:
        """Return the map from derivatives of x to rates along the frame, (..., m, nx).

        Quaternions may have any length; changes of the length map to zero.
        """
        F = np.swapaxes(self.rate_map(x), -1, -2)
        for joint in self.balls:
            q = x[..., joint.x]
            F[..., joint.v, joint.x] *= 4.0 / np.sum(q * q, axis=-1)[..., None, None]
        return F

    def random(self, rng: np.random.Generator, reach: float) -> Array:
        """Return a random shape, (nx,), at uniform displacements up to `reach` from rest."""
        displacement = rng.uniform(-reach, reach, self.m)
        return displacement if not self.balls else self.integrate(self.neutral, displacement)

    def normalized(self, x: Array, what: str, *, near: bool = True) -> Array:
        """Return x, (..., nx), with quaternions of length one.

        Args:
            x: Coordinates, (..., nx).
            what: Name of the argument in messages.
            near: Whether the quaternions must have a length near one.
        Returns:
            The coordinates; `x` itself without balls.
        Raises:
            InputError: A quaternion is zero, or its length is not near one.
        """
        if not self.balls:
            return x
        x = np.array(x, dtype=float)
        for joint in self.balls:
            length = np.linalg.norm(x[..., joint.x], axis=-1, keepdims=True)
            wrong = ~(np.abs(length - 1.0) <= _UNIT) if near else ~(length > 0.0)
            if wrong.any():
                raise InputError(
                    f"{what}: the quaternion of ball joint {quoted(joint.name)} must have length "
                    f"one, got {float(length[wrong][0]):g}. Pass (x, y, z, w), or a rotation "
                    "vector of three numbers by joint name."
                )
            x[..., joint.x] /= length
        return x

    def _by_joint(self, function: Callable[[PlacedJoint], Array]) -> Array:
        return np.concatenate([function(joint) for joint in self.joints], axis=-1)


def shape_space(names: Sequence[str], kinds: Sequence[ElementaryJoint]) -> ShapeSpace:
    """Return the product of joints, whose coordinates and rates are in the same order."""
    joints, x, v = [], 0, 0
    for name, kind in zip(names, kinds, strict=True):
        joints.append(PlacedJoint(name, kind, slice(x, x + kind.nx), slice(v, v + kind.m)))
        x, v = x + kind.nx, v + kind.m
    return ShapeSpace(tuple(joints))


def _indices(slices: Iterable[slice]) -> NDArray[np.intp]:
    indices = [k for entries in slices for k in range(entries.start, entries.stop)]
    return np.array(indices, dtype=np.intp)


def tree_space(model: pin.Model) -> ShapeSpace:
    """Return the manifold of all joints except the root.  They are hinges, slides and balls."""
    joints = [model.joints[i] for i in range(2, model.njoints)]
    kinds = [elementary for joint in joints if (elementary := elementary_joint(joint)) is not None]
    return shape_space([str(name) for name in model.names[2:]], kinds)


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
