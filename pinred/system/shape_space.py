"""The coordinates and rates of a product of joints: slices, labels, units, and its geometry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..common.names import quoted
from ..lie.rotations import (
    closest_rotation_vectors,
    left_jacobian,
    unwrapped_rotation_vectors,
)
from .elementary_joints import ElementaryJoint

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
