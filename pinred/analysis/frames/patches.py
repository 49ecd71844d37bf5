"""Patches of shape space: boxes of joint values, and the disc spanned by a gait.

A patch is a smooth map from k parameters to shapes, with quadrature nodes and weights. Frames on it
are polynomials of the parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from ...common.arrays import Array, as_floats, freeze, vector
from ...common.errors import InputError
from ..gaits.gait import Gait

_RINGS, _SPOKES = 24, 64  # number of radial and of angular quadrature nodes of a disc


class Patch(ABC):
    """A map from parameters u in [−1, 1]^k, (N, k), to shapes (N, m)."""

    nodes: Array
    weights: Array

    @abstractmethod
    def shapes(self, u: Array) -> Array:
        """Return the shapes (N, m) at parameters u (N, k)."""

    @abstractmethod
    def slopes(self, u: Array) -> Array:
        """Return ∂x/∂u, (N, m, k), at parameters u (N, k)."""

    @abstractmethod
    def parameters(self, x: Array) -> Array:
        """Return the parameters (N, k) of shapes x (N, m) on the patch."""

    @property
    def k(self) -> int:
        """Number of parameters."""
        return int(self.nodes.shape[1])


@dataclass(frozen=True, eq=False)
class Box(Patch):
    """All values of some joints within limits, with the other joints fixed.

    Attributes:
        joints: Indices of the joints that vary, (k,).
        limits: Limits (low, high) of each varying joint, (k, 2) [rad | m].
        at: Shape that fixes the values of the other joints, (m,).
        count: Number of Gauss nodes per parameter.
        nodes: Quadrature nodes, (N, k).
        weights: Quadrature weights, (N,).
    """

    joints: tuple[int, ...]
    limits: Array
    at: Array
    count: int
    nodes: Array = field(init=False, repr=False)
    weights: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        k = len(self.joints)
        s, w = np.polynomial.legendre.leggauss(self.count)
        grids = np.meshgrid(*[s] * k, indexing="ij")
        object.__setattr__(self, "nodes", np.stack([grid.ravel() for grid in grids], axis=1))
        weights = np.ones(1)
        for _ in range(k):
            weights = np.multiply.outer(weights, w).ravel()
        object.__setattr__(self, "weights", weights)
        freeze(self)

    @property
    def _half(self) -> Array:
        return np.asarray(0.5 * (self.limits[:, 1] - self.limits[:, 0]))

    def shapes(self, u: Array) -> Array:
        """Return the shapes at parameters (see Patch.shapes)."""
        x = np.tile(self.at, (len(u), 1))
        x[:, list(self.joints)] = self.limits.mean(axis=1) + self._half * u
        return x

    def slopes(self, u: Array) -> Array:
        """Return the derivatives ∂x/∂u at parameters (see Patch.slopes)."""
        slopes = np.zeros((len(self.at), len(self.joints)))
        slopes[list(self.joints), np.arange(len(self.joints))] = self._half
        return np.broadcast_to(slopes, (len(u), *slopes.shape))

    def parameters(self, x: Array) -> Array:
        """Return the parameters of shapes (see Patch.parameters)."""
        return np.asarray((x[:, list(self.joints)] - self.limits.mean(axis=1)) / self._half)


@dataclass(frozen=True, eq=False)
class Disc(Patch):
    """The harmonic disc spanned by a Fourier gait: x = mean + Σ ρ^k (cos_k cos kφ + sin_k sin kφ).

    The parameters are u = (ρ cos φ, ρ sin φ), for any number of joints.

    Attributes:
        gait: Gait that is one Fourier series.
        nodes: Quadrature nodes, (N, 2).
        weights: Quadrature weights, (N,).
    """

    gait: Gait
    nodes: Array = field(init=False, repr=False)
    weights: Array = field(init=False, repr=False)
    _mean: Array = field(init=False, repr=False)
    _series: NDArray[np.complex128] = field(init=False, repr=False)  # x = mean + Re Σ series_k z^k

    def __post_init__(self) -> None:
        c = self.gait.series.coefficients()
        h = len(c) // 2
        object.__setattr__(self, "_mean", c[0])
        # On the edge of the disc, z = e^{iψ}, and ψ is the angle from the start of the gait.
        object.__setattr__(self, "_series", c[1 : 1 + h] - 1j * c[1 + h :])
        s, w = np.polynomial.legendre.leggauss(_RINGS)
        rho, angles = 0.5 * (s + 1.0), 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES
        ring, spoke = (grid.ravel() for grid in np.meshgrid(rho, angles, indexing="ij"))
        points = np.stack([ring * np.cos(spoke), ring * np.sin(spoke)], axis=1)
        object.__setattr__(self, "nodes", points)
        weights = np.repeat(0.5 * w * rho, _SPOKES) * (2.0 * np.pi / _SPOKES)
        object.__setattr__(self, "weights", weights)
        freeze(self)

    def _powers(self, u: Array) -> Array:
        z = u[:, 0] + 1j * u[:, 1]
        return np.power.outer(z, np.arange(len(self._series) + 1))

    def shapes(self, u: Array) -> Array:
        """Return the shapes at parameters (see Patch.shapes)."""
        return np.asarray(self._mean + (self._powers(u)[:, 1:] @ self._series).real)

    def slopes(self, u: Array) -> Array:
        """Return the derivatives ∂x/∂u at parameters (see Patch.slopes)."""
        k = np.arange(1, len(self._series) + 1)[:, None]
        by_z = self._powers(u)[:, :-1] @ (k * self._series)
        return np.stack([by_z.real, -by_z.imag], axis=2)

    def parameters(self, x: Array) -> Array:
        """Return the parameters of shapes (see Patch.parameters), for a gait with one harmonic."""
        if len(self._series) > 1 and self._series[1:].any():
            raise InputError(
                "shapes: they determine parameters only on the disc of a gait with one harmonic"
            )
        plane = np.stack([self._series[0].real, -self._series[0].imag], axis=1)
        return np.asarray(np.linalg.lstsq(plane, (x - self._mean).T, rcond=None)[0].T)


def box_of(
    m: int, limits: ArrayLike, joints: Sequence[int] | None, at: ArrayLike | None, count: int
) -> Box:
    """Build a box of one to three joints.

    Args:
        m: Number of joints.
        limits: (low, high) of each joint that varies, (k, 2).
        joints: Indices of these joints; by default the first ones.
        at: Values of the other joints, (m,); zero by default.
        count: Number of Gauss nodes per parameter.
    Returns:
        The box.
    Raises:
        InputError: Limits or joints are invalid.
    """
    bounds = as_floats(limits, "limits")
    if bounds.ndim != 2 or bounds.shape[1:] != (2,) or not 1 <= len(bounds) <= 3:
        raise InputError(f"limits must be (low, high) of one to three joints, got {limits!r}")
    if not np.isfinite(bounds).all() or (bounds[:, 0] >= bounds[:, 1]).any():
        raise InputError(f"limits must be finite and increase, got {limits!r}")
    chosen = tuple(range(len(bounds)) if joints is None else joints)
    if len(chosen) != len(bounds) or not set(chosen) <= set(range(m)):
        raise InputError(f"joints must be {len(bounds)} indices below {m}, got {chosen}")
    fixed = np.zeros(m) if at is None else vector(at, m, "at")
    return Box(chosen, bounds.copy(), fixed.copy(), count)


@dataclass(frozen=True, eq=False)
class Basis:
    """Products of Chebyshev polynomials up to a total degree, without the constant.

    Attributes:
        powers: Degree per parameter of each product, K tuples.
    """

    powers: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, k: int, degree: int) -> Basis:
        """Return the basis in k parameters of total degree at most `degree`."""
        exponents = product(range(degree + 1), repeat=k)
        return cls(tuple(powers for powers in exponents if 0 < sum(powers) <= degree))

    def values(self, u: Array) -> Array:
        """Return the polynomials at parameters u (N, k), (N, K)."""
        tables, _ = self._tables(u)
        return self._products(tables)

    def slopes(self, u: Array) -> Array:
        """Return the derivatives of the polynomials at parameters u (N, k), (N, k, K)."""
        tables, slopes = self._tables(u)
        derivatives = []
        for axis in range(u.shape[1]):
            factors = [*tables]
            factors[axis] = slopes[axis]
            derivatives.append(self._products(factors))
        return np.stack(derivatives, axis=1)

    def _tables(self, u: Array) -> tuple[list[Array], list[Array]]:
        degree = max(max(powers) for powers in self.powers)
        values = [chebyshev.chebvander(column, degree) for column in u.T]
        step = np.zeros((degree + 1, degree + 1))
        for k in range(1, degree + 1):
            series = chebyshev.chebder(np.eye(degree + 1)[k])
            step[: len(series), k] = series
        return values, [table @ step for table in values]

    def _products(self, tables: Sequence[Array]) -> Array:
        products = np.ones((len(tables[0]), len(self.powers)))
        for axis, table in enumerate(tables):
            products *= table[:, [powers[axis] for powers in self.powers]]
        return products
