"""Arcs: the smooth pieces that a gait is made of, Fourier series or polynomials.

An arc is a map of s in [0, 1] to shapes, and takes some time at constant ds/dt.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import comb

import numpy as np

from ...common.arrays import Array, freeze

TAU = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Arc(ABC):
    """A smooth path through shapes that takes `time` seconds."""

    time: float

    @abstractmethod
    def at(self, s: Array) -> tuple[Array, Array]:
        """Return shapes and their derivatives by s, (N, m) each, at s (N,) in [0, 1]."""

    @abstractmethod
    def part(self, start: float, end: float) -> Arc:
        """Return the arc between two values of s, traversed from start to end, either way."""

    @abstractmethod
    def mapped(self, factor: Array, shift: Array) -> Arc:
        """Return the arc of factor x + shift, joint by joint."""

    @abstractmethod
    def lasting(self, time: float) -> Arc:
        """Return the same path in another time."""

    @abstractmethod
    def extremes(self) -> Array:
        """Return values s (K,) among which each joint is least and greatest."""


@dataclass(frozen=True, eq=False)
class FourierArc(Arc):
    """x = mean + Σ_k cos_k cos kφ + sin_k sin kφ, k = 1 …, φ from `start` to `end` [rad].

    mean: (m,).  cos, sin: (harmonics, m).
    """

    mean: Array
    cos: Array
    sin: Array
    start: float = 0.0
    end: float = TAU

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def is_whole(self) -> bool:
        """Whether it goes round once, so that it is a smooth closed path."""
        return bool(abs(abs(self.end - self.start) - TAU) < 1e-12)

    def at(self, s: Array) -> tuple[Array, Array]:
        """Return shapes and slopes at s, as every arc."""
        k = np.arange(1, len(self.cos) + 1)
        angle = np.multiply.outer(self.start + (self.end - self.start) * s, k)
        c, s_ = np.cos(angle), np.sin(angle)
        slope = (self.end - self.start) * (
            c @ (k[:, None] * self.sin) - s_ @ (k[:, None] * self.cos)
        )
        return self.mean + c @ self.cos + s_ @ self.sin, slope

    def part(self, start: float, end: float) -> FourierArc:
        """Return a part, as every arc."""
        a, b = self.start, self.end - self.start
        return FourierArc(
            abs(end - start) * self.time, self.mean, self.cos, self.sin, a + b * start, a + b * end
        )

    def mapped(self, factor: Array, shift: Array) -> FourierArc:
        """Return factor x + shift, as every arc."""
        return FourierArc(
            self.time, factor * self.mean + shift, factor * self.cos, factor * self.sin,
            self.start, self.end,
        )  # fmt: skip

    def lasting(self, time: float) -> FourierArc:
        """Return the same path in another time."""
        return FourierArc(time, self.mean, self.cos, self.sin, self.start, self.end)

    def extremes(self) -> Array:
        """Return the roots of each joint's slope, as those of a polynomial in e^{iφ}."""
        found = [0.0, 1.0]
        k = np.arange(1, len(self.cos) + 1)
        for c, s in zip(self.cos.T, self.sin.T, strict=True):
            half = 0.5 * k * (s + 1j * c)  # of e^{ikφ} in the slope; its conjugate of e^{−ikφ}
            roots = np.roots(np.concatenate([half[::-1], [0.0], half.conj()]))
            near = roots[np.abs(np.abs(roots) - 1.0) < 1e-6]
            turn = (np.angle(near) - self.start) / (self.end - self.start)
            period = TAU / abs(self.end - self.start)
            turn = turn % period
            while (turn <= 1.0).any():
                found += [float(each) for each in turn[turn <= 1.0]]
                turn = turn + period
        return np.array(found)


@dataclass(frozen=True, eq=False)
class PolynomialArc(Arc):
    """x = Σ_k coefficients_k s^k.  coefficients: (degree + 1, m)."""

    coefficients: Array

    def __post_init__(self) -> None:
        freeze(self)

    def at(self, s: Array) -> tuple[Array, Array]:
        """Return shapes and slopes at s, as every arc."""
        c = self.coefficients
        powers = np.power.outer(s, np.arange(len(c)))
        k = np.arange(1, len(c))
        return powers @ c, powers[:, :-1] @ (k[:, None] * c[1:])

    def part(self, start: float, end: float) -> PolynomialArc:
        """Return a part, as every arc."""
        c, out = self.coefficients, np.zeros_like(self.coefficients)
        step = end - start
        for k in range(len(c)):
            for j in range(k + 1):
                out[j] += comb(k, j) * start ** (k - j) * step**j * c[k]
        return PolynomialArc(abs(step) * self.time, out)

    def mapped(self, factor: Array, shift: Array) -> PolynomialArc:
        """Return factor x + shift, as every arc."""
        c = factor * self.coefficients
        c[0] += shift
        return PolynomialArc(self.time, c)

    def lasting(self, time: float) -> PolynomialArc:
        """Return the same path in another time."""
        return PolynomialArc(time, self.coefficients)

    def extremes(self) -> Array:
        """Return the ends and the roots of each joint's slope."""
        found = [0.0, 1.0]
        for c in self.coefficients.T:
            roots = np.roots((np.arange(len(c)) * c)[:0:-1])
            real = np.asarray(roots[np.abs(roots.imag) < 1e-9].real, dtype=float)
            found += [s for s in real.tolist() if 0.0 < s < 1.0]
        return np.array(found)


def line(start: Array, end: Array, time: float) -> PolynomialArc:
    """Return the straight path between two shapes, at constant speed."""
    return PolynomialArc(time, np.stack([start, end - start]))
