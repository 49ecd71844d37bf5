"""Gait: a closed path in shape space, or one that closes up to turns of joints, as an object.

It consists of arcs, its smooth segments: Fourier series or polynomials.  An arc maps s in [0, 1] to
shapes and is traversed at constant ds/dt.

A gait may be read from recorded joint data. A .csv file has a header line with `t` and the joint
names, then one line per time. A .npz file has the arrays `t` (T,) and `x` (T, m), as a saved
Trajectory does. The last line repeats the first, one period later.
"""

from __future__ import annotations

import csv
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb
from pathlib import Path
from typing import Self
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import (
    Array,
    FrozenArrays,
    as_floats,
    positive,
    read_only,
    vector,
    vector_or_zero,
    vectors,
    whole,
)
from ...common.errors import InputError, LoadError
from ...common.names import joint_index, quoted_path
from ...forces.signals import Fourier
from ...lie.rotations import TAU

_DAMAGED = (BadZipFile, zlib.error, csv.Error, EOFError, NotImplementedError, MemoryError)
_CLOSED = 1e-6  # largest gap at the end of the data, relative to the range of the joints


def points_in(path: Path) -> tuple[Array, Array]:
    """Read the times and shapes of one cycle.

    Args:
        path: A .csv or .npz file.
    Returns:
        Times (T,) and shapes (T, m); the last shape equals the first.
    Raises:
        LoadError: The file cannot be read.
        InputError: The data is not one closed cycle.
    """
    name = quoted_path(path)
    if path.suffix not in (".csv", ".npz"):
        raise InputError(f"joint data is read from .csv or .npz files, got {name}")
    try:
        _refuse_pipe(path)
        t, x = _csv(path) if path.suffix == ".csv" else _npz(path)
    except (OSError, ValueError, KeyError, *_DAMAGED) as error:
        raise LoadError(f"cannot read joint data from {name}: {error}") from None
    if t.ndim != 1 or x.ndim != 2 or len(t) != len(x) or len(t) < 4:
        raise InputError(f"{name} must contain times (T,) and shapes (T, m), with T at least 4")
    if not (np.isfinite(t).all() and np.isfinite(x).all() and (np.diff(t) > 0.0).all()):
        raise InputError(f"times in {name} must increase, and all numbers must be finite")
    gap = np.abs(x[-1] - x[0])
    extent = np.ptp(x, axis=0)
    if (gap > _CLOSED * max(float(extent.max()), 1e-300)).any():
        raise InputError(
            f"the data in {name} is not a closed path: it starts at {x[0]} and ends at {x[-1]}"
        )
    return t, x


def _refuse_pipe(path: Path) -> None:
    """Raise ValueError unless a path is a regular file or missing; pipes wait for their writer."""
    if path.exists() and not path.is_file():
        raise ValueError("it is not a regular file")


def _csv(path: Path) -> tuple[Array, Array]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if not rows or not rows[0] or rows[0][0].strip() != "t":
        raise ValueError("the first line must contain t and the names of the joints")
    data = as_floats([[float(cell) for cell in row] for row in rows[1:] if row], "the lines")
    if data.ndim != 2:
        raise ValueError("there are no lines of numbers")
    return data[:, 0], data[:, 1:]


def _npz(path: Path) -> tuple[Array, Array]:
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return as_floats(file["t"], "t"), as_floats(file["x"], "x")


_MOST_SAMPLES = 10**7


@checks_arguments
@dataclass(frozen=True, eq=False)
class Gait:
    """A closed path in shape space, traversed once per period.

    A gait may wind around revolute joints: x(T) = x(0) + 2π n. The shape space is then a torus.

    Attributes:
        arcs: Smooth segments in order. Each starts where the previous one ends, and the last ends
            where the first starts, up to the turns.
        turns: Number n of complete turns of each joint per cycle, (m,); () if there are none.
    """

    arcs: tuple[Arc, ...]
    turns: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.arcs) == 0:
            raise InputError("arcs: expected at least one arc")
        turns = vector_or_zero(self.turns if len(self.turns) else 0, self.m, "turns")
        if (turns != np.round(turns)).any():
            raise InputError(f"turns: expected whole numbers, got {self.turns}")
        object.__setattr__(self, "turns", tuple(map(int, turns)) if turns.any() else ())
        check_joined(self.arcs, self.rise)

    @classmethod
    def fourier(
        cls,
        mean: ArrayLike,
        cos: ArrayLike,
        sin: ArrayLike,
        *,
        period: float = 1.0,
        turns: ArrayLike = 0,
    ) -> Gait:
        """Return the gait x(t) = mean + 2πnt/T + Σ_k cos_k cos(2πkt/T) + sin_k sin(2πkt/T).

        Args:
            mean: Constant term, (m,) [rad | m].
            cos: Cosine coefficients, (harmonics, m), for k = 1, 2, ….
            sin: Sine coefficients, (harmonics, m).
            period: Duration T of one cycle [s].
            turns: Turns n of each joint per cycle, (m,); none by default.
        Returns:
            The gait.
        Raises:
            InputError: The shapes of the arguments do not match.
        """
        centre = as_floats(mean, "mean")
        m = len(vector(centre, centre.size, "mean"))
        cosines, sines = vectors(cos, m, "cos"), vectors(sin, m, "sin")
        if cosines.ndim != 2 or cosines.shape != sines.shape or not len(cosines):
            raise InputError(
                f"cos and sin must both be (harmonics, {m}), got {cosines.shape} and {sines.shape}"
            )
        time = positive(period, "period")
        n = vector_or_zero(turns, m, "turns")
        arc = FourierArc(time, centre.copy(), cosines.copy(), sines.copy(), rise=TAU * n)
        return cls((arc,), tuple(n.tolist()))

    @classmethod
    def waypoints(cls, points: ArrayLike, *, period: float = 1.0, turns: ArrayLike = 0) -> Gait:
        """Return the closed polygon through some points, traversed at constant speed |ẋ|.

        Args:
            points: Corners, (K, m) [rad | m]. With turns, one is enough.
            period: Duration of one cycle [s].
            turns: Turns n of each joint per cycle, (m,); none by default. The last line leads from
                the last point to the first point + 2π n.
        Returns:
            The gait.
        Raises:
            InputError: There are fewer than two different points.
        """
        corners = _points(points, 1)
        n = vector_or_zero(turns, corners.shape[1], "turns")
        corners = _points(points, 1 if n.any() else 2)
        ends = np.vstack([corners[1:], corners[:1] + TAU * n])
        steps = np.linalg.norm(ends - corners, axis=1)
        if not steps.sum() > 0.0:
            raise InputError("points: expected at least two different points")
        share = positive(period, "period") * steps / steps.sum()
        arcs = [
            line(corners[k], ends[k], float(share[k]))
            for k in range(len(corners))
            if steps[k] > 0.0
        ]
        return cls(tuple(arcs), tuple(n.tolist()))

    @classmethod
    def spline(
        cls, points: ArrayLike, *, times: ArrayLike | None = None, period: float = 1.0
    ) -> Gait:
        """Return the periodic cubic spline through some points, twice differentiable.

        Args:
            points: Points, (K, m) [rad | m].
            times: Times of the points, (K,) [s], increasing from 0 and below the period; by default
                equally spaced.
            period: Duration of one cycle [s].
        Returns:
            The gait.
        Raises:
            InputError: There are fewer than three points, or the times are invalid.
        """
        from scipy.interpolate import CubicSpline

        knots, T = _points(points, 3), positive(period, "period")
        count = len(knots)
        if times is None:
            t = np.arange(count) * (T / count)
        else:
            t = vector(times, count, "times")
            if t[0] != 0.0 or not (np.diff(t) > 0.0).all() or t[-1] >= T:
                raise InputError("times: expected increasing values from 0 to below the period")
        t = np.append(t, T)
        coefficients = CubicSpline(t, np.vstack([knots, knots[:1]]), bc_type="periodic").c[::-1]
        steps = np.diff(t)
        scale = steps[None] ** np.arange(4)[:, None]
        return cls(
            tuple(
                PolynomialArc(float(steps[k]), scale[:, k, None] * coefficients[:, k])
                for k in range(count)
            )
        )

    @classmethod
    def strokes(
        cls,
        start: ArrayLike,
        moves: Sequence[Mapping[str, float]],
        joints: Sequence[str],
        *,
        period: float = 1.0,
    ) -> Gait:
        """Return straight strokes, one after another, of equal duration.

        Args:
            start: Initial shape, (m,) [rad | m].
            moves: Changes of each stroke, {joint: change [rad | m]}. Together they must close the
                path.
            joints: Names of all joints, in order, such as `connection.joints`.
            period: Duration of one cycle [s].
        Returns:
            The gait.
        Raises:
            InputError: A joint is unknown, or the path does not close.
        """
        names = list(joints)
        shape = vector(start, len(names), "start", names)
        time = positive(period, "period") / max(1, len(moves))
        arcs: list[Arc] = []
        for move in moves:
            end = shape.copy()
            for name, change in move.items():
                end[joint_index(name, names, "a stroke")] += float(change)
            arcs.append(line(shape, end, time))
            shape = end
        return cls(tuple(arcs))

    @classmethod
    def read(cls, path: str | Path, *, period: float | None = None) -> Gait:
        """Return the periodic spline through recorded joint data.

        Args:
            path: A .csv file with a header of `t` and joint names, or a .npz file with arrays `t`
                (T,) and `x` (T, m). The last line repeats the first, one period later.
            period: Duration of one cycle [s]; by default the duration of the data.
        Returns:
            The gait.
        Raises:
            LoadError: The file cannot be read.
            InputError: The data is not one closed cycle.
        """
        t, x = points_in(Path(path))
        gait = cls.spline(x[:-1], times=t[:-1] - t[0], period=float(t[-1] - t[0]))
        return gait if period is None else gait.lasting(period)

    def _repr_html_(self) -> str:
        from ...common.html import card, table

        kind = "Fourier series" if self.is_smooth else f"{len(self.arcs)} arcs"
        turns = self.turns or (0,) * self.m
        rows = [
            (str(k), float(low), float(high), float(turn))
            for k, ((low, high), turn) in enumerate(zip(self.limits, turns, strict=True))
        ]
        about = f"{kind} of {self.m} joints with period {self.period:g} s"
        return card("Gait", about, table("", ["joint", "least", "greatest", "turns"], rows))

    @cached_property
    def m(self) -> int:
        """Number of shape coordinates."""
        return int(self.arcs[0].at(np.zeros(1))[0].shape[1])

    @cached_property
    def period(self) -> float:
        """Time of one cycle [s]."""
        return sum(arc.time for arc in self.arcs)

    @property
    def rise(self) -> Array:
        """Change of the shape per cycle, 2π n, (m,) [rad]."""
        return TAU * np.array(self.turns, dtype=float) if self.turns else np.zeros(self.m)

    @property
    def is_smooth(self) -> bool:
        """Whether the gait is one Fourier series, hence smooth and periodic."""
        (arc, *further_arcs) = self.arcs
        return not further_arcs and isinstance(arc, FourierArc) and arc.is_whole

    @property
    def series(self) -> FourierArc:
        """The Fourier series of the gait.  Raises InputError if the gait is not one series."""
        arc = self.arcs[0]
        if not self.is_smooth or not isinstance(arc, FourierArc):
            raise InputError("gait: expected one Fourier series; create it with Gait.fourier")
        if self.turns:
            raise InputError(f"gait: expected a closed path without turns, got turns {self.turns}")
        return arc

    @cached_property
    def breaks(self) -> Array:
        """Start times of the arcs, and the period, (arcs + 1,) [s]."""
        return read_only(np.concatenate([[0.0], np.cumsum([arc.time for arc in self.arcs])]))

    def at(self, t: ArrayLike) -> tuple[Array, Array]:
        """Return shapes and shape rates at any times; the gait is periodic, up to its turns.

        Args:
            t: Times, (...,) [s].
        Returns:
            Shapes and rates, (..., m) each.
        """
        times = as_floats(t, "t")
        if self.is_smooth:
            x, slope = self.arcs[0].at(times.ravel() / self.period)
            shape = (*times.shape, self.m)
            return x.reshape(shape), (slope / self.period).reshape(shape)
        cycles, flat = np.divmod(times.ravel(), self.period)
        which = np.clip(np.searchsorted(self.breaks, flat, side="right") - 1, 0, len(self.arcs) - 1)
        x, xdot = np.empty((2, len(flat), self.m))
        for k, arc in enumerate(self.arcs):
            in_arc = which == k
            if in_arc.any():
                x[in_arc], slope = arc.at((flat[in_arc] - self.breaks[k]) / arc.time)
                xdot[in_arc] = slope / arc.time
        x += np.multiply.outer(cycles, self.rise)
        return x.reshape(*times.shape, self.m), xdot.reshape(*times.shape, self.m)

    def signals(self, joints: Sequence[str]) -> dict[str, Fourier]:
        """Return the gait as prescribed joint motions, for `prescribed` of a Scene.

        Args:
            joints: Names of all joints, in order.
        Returns:
            A periodic signal per joint.
        Raises:
            InputError: The gait is not one Fourier series (a simulation needs smooth signals), or
                the number of names is wrong.
        """
        coefficients = self.series.coefficients()
        names = list(joints)
        if len(names) != self.m:
            raise InputError(f"joints: expected {self.m} names, got {len(names)}")
        h = len(coefficients) // 2
        return {
            name: Fourier(c[0], c[1 : 1 + h], c[1 + h :], self.period)
            for name, c in zip(names, coefficients.T.tolist(), strict=True)
        }

    def samples(self, count: int) -> tuple[Array, Array]:
        """Return shapes and rates at equidistant times from 0.

        Args:
            count: Number of times.
        Returns:
            Shapes and rates, (count, m) each.
        Raises:
            InputError: The number is below 1, or too large.
        """
        number = whole(count, "count", most=_MOST_SAMPLES)
        return self.at(np.arange(number) * (self.period / number))

    @cached_property
    def limits(self) -> Array:
        """Exact minimum and maximum of each joint, (m, 2)."""
        x = np.concatenate([arc.at(arc.extremes())[0] for arc in self.arcs])
        return read_only(np.stack([x.min(axis=0), x.max(axis=0)], axis=1))

    @property
    def amplitude(self) -> Array:
        """Half the distance between minimum and maximum of each joint in the gait, (m,)."""
        return np.asarray(0.5 * (self.limits[:, 1] - self.limits[:, 0]))

    @property
    def centre(self) -> Array:
        """Mean of minimum and maximum of each joint in the gait, (m,)."""
        return np.asarray(self.limits.mean(axis=1))

    def lasting(self, period: float) -> Gait:
        """Return the same path with another period.

        Args:
            period: Duration of one cycle [s].
        Returns:
            The gait.
        """
        factor = positive(period, "period") / self.period
        return Gait(tuple(arc.lasting(factor * arc.time) for arc in self.arcs), self.turns)

    def scaled(self, factor: ArrayLike, *, about: ArrayLike | None = None) -> Gait:
        """Return the path with another amplitude.

        Args:
            factor: Factor of the amplitude, one number or (m,).
            about: Fixed shape, (m,); by default the centre.
        Returns:
            The gait.
        Raises:
            InputError: The factor of a joint that turns is not 1.
        """
        factors = as_floats(factor, "factor")
        f = vector(np.full(self.m, factors) if factors.ndim == 0 else factors, self.m, "factor")
        if (self.rise != f * self.rise).any():
            raise InputError(f"factor: expected 1 for joints that turn, got {factors}")
        fixed = self.centre if about is None else vector(about, self.m, "about")
        return Gait(tuple(arc.mapped(f, (1.0 - f) * fixed) for arc in self.arcs), self.turns)

    def shifted(self, phase: float) -> Gait:
        """Return the same path with a later start.

        Args:
            phase: Delay of the start, in periods.
        Returns:
            The gait.
        """
        at = float(vector(np.atleast_1d(as_floats(phase, "phase")), 1, "phase")[0]) % 1.0
        at *= self.period
        k = int(np.clip(np.searchsorted(self.breaks, at, side="right") - 1, 0, len(self.arcs) - 1))
        arc = self.arcs[k]
        s = (at - self.breaks[k]) / arc.time
        if self.is_smooth and isinstance(arc, FourierArc):
            turn = s * (arc.end - arc.start)
            later = replace(arc, start=arc.start + turn, end=arc.end + turn)
            return Gait((later,), self.turns)
        arcs = [arc.part(s, 1.0)] if s < 1.0 else []
        arcs += self.arcs[k + 1 :]
        before = [*self.arcs[:k], arc.part(0.0, s)] if s > 0.0 else self.arcs[:k]
        return Gait((*arcs, *raised(before, self.rise)), self.turns)

    def reversed(self) -> Gait:
        """Return the same path in reverse, from the same start."""
        arcs = [arc.part(1.0, 0.0) for arc in reversed(self.arcs)]
        return Gait(tuple(raised(arcs, -self.rise)), tuple(-n for n in self.turns))

    def then(self, other: Gait) -> Gait:
        """Return this gait followed by another.

        Args:
            other: Gait that starts at the same shape.
        Returns:
            The gait through both paths.
        """
        turns = np.round((self.rise + other.rise) / TAU).astype(int)
        return Gait((*self.arcs, *raised(other.arcs, self.rise)), tuple(turns.tolist()))

    def winding(
        self, *, joints: tuple[int, int] = (0, 1), centre: ArrayLike | None = None
    ) -> float:
        """Count the windings around a centre in the plane of two joints.

        Args:
            joints: Indices of the two joints.
            centre: Centre, (2,); by default the centre of the path.
        Returns:
            The winding number, positive from the axis of the first joint to that of the second.
        Raises:
            InputError: The path passes through the centre, or too close to it; or a joint turns.
        """
        pair = list(joints)
        if self.rise[pair].any():
            raise InputError(f"joints: expected joints that do not turn, got turns {self.turns}")
        c = self.centre[pair] if centre is None else vector(centre, 2, "centre")
        return winding_number(self.arcs, pair, c)


def _points(points: ArrayLike, least: int) -> Array:
    """Validate points (K, m) with at least `least` rows."""
    array = as_floats(points, "points")
    if array.ndim != 2 or len(array) < least or not array.shape[1]:
        raise InputError(f"points must be (K, m) with K at least {least}, got {array.shape}")
    return vectors(array, array.shape[1], "points")


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


_JOINED = 1e-9  # largest gap between arcs, relative to the size of the path
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
        if gap > _JOINED * size:
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
