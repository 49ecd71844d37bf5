"""Arcs: the smooth segments of a gait, as Fourier series or polynomials.

An arc maps s in [0, 1] to shapes and is traversed at constant ds/dt.

Closed paths of arcs: check of closure, and winding number.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import comb
from typing import Self

import numpy as np

from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError

TAU = 2.0 * np.pi
_OFF_CIRCLE = 1e-3  # distance from the unit circle of roots that may be multiple roots on it


@dataclass(frozen=True, eq=False)
class Arc(ABC, FrozenArrays):
    """A smooth path in shape space.

    Attributes:
        time: Duration [s].
    """

    time: float

    @abstractmethod
    def at(self, s: Array) -> tuple[Array, Array]:
        """Evaluate the arc and its derivative.

        Args:
            s: Path parameters in [0, 1], (N,).
        Returns:
            Shapes and their derivatives with respect to s, (N, m) each.
        """

    @abstractmethod
    def part(self, start: float, end: float) -> Arc:
        """Return the arc between two parameters, traversed from start to end, in either direction.

        Args:
            start: First path parameter, in [0, 1].
            end: Last path parameter, in [0, 1].
        Returns:
            The partial arc.
        """

    @abstractmethod
    def mapped(self, factor: Array, shift: Array) -> Arc:
        """Return the arc whose shapes are factor · x + shift.

        Args:
            factor: Factor of each joint, (m,).
            shift: Shift of each joint, (m,) [rad | m].
        Returns:
            The mapped arc.
        """

    def lasting(self, time: float) -> Self:
        """Return the same path with another duration.

        Args:
            time: Duration [s].
        Returns:
            The arc.
        """
        return replace(self, time=time)

    @abstractmethod
    def extremes(self) -> Array:
        """Return parameters s, (K,), that include the extremes of every joint."""


@dataclass(frozen=True, eq=False)
class FourierArc(Arc):
    """x = mean + rise φ/2π + Σ_k cos_k cos kφ + sin_k sin kφ, k = 1 …, φ from `start` to `end`.

    Attributes:
        time: Duration [s].
        mean: Constant term, (m,).
        cos: Cosine coefficients, (harmonics, m).
        sin: Sine coefficients, (harmonics, m).
        start: Initial phase angle [rad].
        end: Final phase angle [rad].
        rise: Change of each joint per period, (m,) [rad | m]; (1,) if all are equal.
    """

    mean: Array
    cos: Array
    sin: Array
    start: float = 0.0
    end: float = TAU
    rise: Array = field(default_factory=lambda: np.zeros(1))

    @property
    def is_whole(self) -> bool:
        """Whether the arc covers one full period, so that it is a smooth closed path."""
        return bool(abs(abs(self.end - self.start) - TAU) < 1e-12)

    def at(self, s: Array) -> tuple[Array, Array]:
        """Evaluate the arc and its derivative (see Arc.at)."""
        k = np.arange(1, len(self.cos) + 1)
        phase = self.start + (self.end - self.start) * s
        angle = np.multiply.outer(phase, k)
        cosines, sines = np.cos(angle), np.sin(angle)
        per_angle = self.rise / TAU
        slope = (self.end - self.start) * (
            per_angle + cosines @ (k[:, None] * self.sin) - sines @ (k[:, None] * self.cos)
        )
        steady = self.mean + np.multiply.outer(phase, per_angle)
        return steady + cosines @ self.cos + sines @ self.sin, slope

    def part(self, start: float, end: float) -> FourierArc:
        """Return a partial arc (see Arc.part)."""
        a, b = self.start, self.end - self.start
        time = abs(end - start) * self.time
        return replace(self, time=time, start=a + b * start, end=a + b * end)

    def mapped(self, factor: Array, shift: Array) -> FourierArc:
        """Return the arc of shapes factor · x + shift (see Arc.mapped)."""
        mean = factor * self.mean + shift
        cos, sin = factor * self.cos, factor * self.sin
        return replace(self, mean=mean, cos=cos, sin=sin, rise=factor * self.rise)

    def coefficients(self, harmonics: int | None = None) -> Array:
        """Return mean, cosines and sines as functions of the angle from the start of the arc.

        Args:
            harmonics: Number of harmonics to return, padded with zeros; by default the number of
                the arc.
        Returns:
            Mean, cosine and sine coefficients, (1 + 2 harmonics, m).
        """
        k = np.arange(1, len(self.cos) + 1)[:, None]
        cosine, sine = np.cos(k * self.start), np.sin(k * self.start)
        sense = np.sign(self.end - self.start)  # The phase angle is start + sense · angle.
        count = len(k) if harmonics is None else harmonics
        coefficients = np.zeros((1 + 2 * count, len(self.mean)))
        coefficients[0] = self.mean
        coefficients[1 : 1 + len(k)] = cosine * self.cos + sine * self.sin
        coefficients[1 + count : 1 + count + len(k)] = sense * (cosine * self.sin - sine * self.cos)
        return coefficients

    def extremes(self) -> Array:
        """Return both ends, 0 and 1, and the zeros of each joint's derivative."""
        parameters = [0.0, 1.0]
        rises = np.broadcast_to(self.rise / TAU, self.mean.shape)
        for c, s, rise in zip(self.cos.T, self.sin.T, rises, strict=True):
            candidates = (stationary_angles(c, s, float(rise)) - self.start) / (
                self.end - self.start
            )
            period = TAU / abs(self.end - self.start)
            candidates = candidates % period
            while (candidates <= 1.0).any():
                parameters += candidates[candidates <= 1.0].tolist()
                candidates = candidates + period
        return np.array(parameters)


@dataclass(frozen=True, eq=False)
class PolynomialArc(Arc):
    """x = Σ_k coefficients_k s^k.

    Attributes:
        time: Duration [s].
        coefficients: Coefficients of s^0, s^1, …, (degree + 1, m).
    """

    coefficients: Array

    def at(self, s: Array) -> tuple[Array, Array]:
        """Evaluate the arc and its derivative (see Arc.at)."""
        c = self.coefficients
        powers = np.power.outer(s, np.arange(len(c)))
        k = np.arange(1, len(c))
        return powers @ c, powers[:, :-1] @ (k[:, None] * c[1:])

    def part(self, start: float, end: float) -> PolynomialArc:
        """Return a partial arc (see Arc.part)."""
        c, coefficients = self.coefficients, np.zeros_like(self.coefficients)
        step = end - start
        for k in range(len(c)):
            for j in range(k + 1):
                coefficients[j] += comb(k, j) * start ** (k - j) * step**j * c[k]
        return PolynomialArc(abs(step) * self.time, coefficients)

    def mapped(self, factor: Array, shift: Array) -> PolynomialArc:
        """Return the arc of shapes factor · x + shift (see Arc.mapped)."""
        c = factor * self.coefficients
        c[0] += shift
        return PolynomialArc(self.time, c)

    def extremes(self) -> Array:
        """Return both ends, 0 and 1, and the zeros of each joint's derivative."""
        parameters = [0.0, 1.0]
        for c in self.coefficients.T:
            roots = np.roots((np.arange(len(c)) * c)[:0:-1])
            # Complex roots as well: round-off makes a multiple root complex.
            parameters += [s for s in roots.real.tolist() if 0.0 < s < 1.0]
        return np.array(parameters)


def stationary_angles(cos: Array, sin: Array, rise: float = 0.0) -> Array:
    """Return the angles φ at which Σ_k cos_k cos kφ + sin_k sin kφ + rise φ is stationary.

    They are roots z = e^{iφ} of a polynomial.  Round-off moves a multiple root off the unit circle,
    so that angles of other roots near the circle are returned as well.

    Args:
        cos: Cosine coefficients, (harmonics,).
        sin: Sine coefficients, (harmonics,).
        rise: Slope of the linear term.
    Returns:
        The angles, (K,) [rad].
    """
    # Coefficients of e^{ikφ} in the derivative; those of e^{−ikφ} are conjugate.
    half = 0.5 * np.arange(1, len(cos) + 1) * (sin + 1j * cos)
    roots = np.roots(np.concatenate([half[::-1], [rise], half.conj()]))
    return np.asarray(np.angle(roots[np.abs(np.abs(roots) - 1.0) < _OFF_CIRCLE]))


def raised(arcs: Sequence[Arc], rise: Array) -> Sequence[Arc]:
    """Return arcs shifted by a change of the shape, (m,) [rad]."""
    return [arc.mapped(np.ones(len(rise)), rise) for arc in arcs] if rise.any() else arcs


def line(start: Array, end: Array, time: float) -> PolynomialArc:
    """Return the straight path between two shapes, at constant speed."""
    return PolynomialArc(time, np.stack([start, end - start]))


_CLOSED = 1e-9  # largest gap between arcs, relative to the size of the path
_STEP = 0.05  # largest angle about the centre between two samples [turns]


def check_joined(arcs: Sequence[Arc], rise: Array) -> None:
    """Check that each arc ends where the next one starts, and that the last closes the path.

    Args:
        arcs: Arcs in order.
        rise: Change of the shape per cycle by complete turns, (m,) [rad].
    Raises:
        InputError: There is a gap, or a number is not finite.
    """
    ends = [arc.at(np.array([0.0, 1.0]))[0] for arc in arcs]
    if not all(np.isfinite(end).all() for end in ends):
        raise InputError("arcs: all coefficients of a gait must be finite")
    size = max(1.0, *(float(np.abs(end).max(initial=0.0)) for end in ends))
    starts = [*(end[0] for end in ends[1:]), ends[0][0] + rise]
    for k, (end, following) in enumerate(zip(ends, starts, strict=True)):
        gap = float(np.abs(following - end[1]).max(initial=0.0))
        if gap > _CLOSED * size:
            where = "it does not close" if k + 1 == len(ends) else f"it jumps after arc {k}"
            raise InputError(f"a gait is a closed path, but {where}: from {end[1]} to {following}")


def winding_number(arcs: Sequence[Arc], joints: Sequence[int], centre: Array) -> float:
    """Count the windings of a closed path around a centre in the plane of two joints.

    Args:
        arcs: Arcs in order.
        joints: Indices of the two joints.
        centre: Centre, (2,).
    Returns:
        The winding number, positive from the axis of the first joint to that of the second.
    Raises:
        InputError: The path passes through the centre, or too close to it.
    """
    count = 64
    while count <= 2**16:
        s = np.linspace(0.0, 1.0, count + 1)
        arms = np.concatenate([arc.at(s)[0][:, joints] for arc in arcs]) - centre
        if not np.hypot(*arms.T).min() > 1e-9:
            raise InputError(
                f"the gait passes through the centre {centre}, so its winding number is "
                "undefined. Choose another centre"
            )
        steps = np.diff(np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])))
        if np.abs(steps).max() < _STEP * TAU:
            return float(round(steps.sum() / TAU))
        count *= 4
    raise InputError(
        f"the gait passes too close to the centre {centre} to count its windings. "
        "Choose another centre"
    )
