"""Gait: a closed path through shapes, as a value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, as_floats, positive, read_only, vector, vectors
from ...common.errors import InputError
from ...common.names import joint_index
from ...forces.signals import Fourier
from .arcs import TAU, Arc, FourierArc, PolynomialArc, line

_CLOSED = 1e-9  # rad | m, relative to the size of the path
_TURNS = 0.05  # of a turn that two samples may be apart, seen from the centre


@dataclass(frozen=True, eq=False)
class Gait:
    """A closed path in shape space, passed through once in a period.

    arcs: its smooth pieces in order; where one ends the next begins, and the last ends where the
    first begins.  Shapes are (m,) [rad | m], times [s].
    """

    arcs: tuple[Arc, ...]

    def __post_init__(self) -> None:
        if not self.arcs:
            raise InputError("a gait needs at least one arc")
        ends = [arc.at(np.array([0.0, 1.0]))[0] for arc in self.arcs]
        if not all(np.isfinite(end).all() for end in ends):
            raise InputError("a gait must be finite")
        size = max(1.0, *(float(np.abs(end).max(initial=0.0)) for end in ends))
        for k, end in enumerate(ends):
            following = ends[(k + 1) % len(ends)][0]
            gap = float(np.abs(following - end[1]).max(initial=0.0))
            if gap > _CLOSED * size:
                where = "it does not close" if k + 1 == len(ends) else f"it jumps after arc {k}"
                raise InputError(
                    f"a gait is a closed path, but {where}: from {end[1]} to {following}"
                )

    @classmethod
    def fourier(
        cls, mean: ArrayLike, cos: ArrayLike, sin: ArrayLike, *, period: float = 1.0
    ) -> Gait:
        """Return the Fourier series x(t) = mean + Σ_k cos_k cos(2πkt/T) + sin_k sin(2πkt/T).

        mean: (m,).  cos, sin: (harmonics, m), of k = 1, 2, ….  period: T [s].
        """
        centre = as_floats(mean, "mean")
        m = len(vector(centre, centre.size, "mean"))
        c, s = vectors(cos, m, "cos"), vectors(sin, m, "sin")
        if c.ndim != 2 or c.shape != s.shape or not len(c):
            raise InputError(
                f"cos and sin must both be (harmonics, {m}), got {c.shape} and {s.shape}"
            )
        time = positive(period, "period")
        return cls((FourierArc(time, centre.copy(), c.copy(), s.copy()),))

    @classmethod
    def waypoints(cls, points: ArrayLike, *, period: float = 1.0) -> Gait:
        """Return the polygon through points (K, m), from the last back to the first.

        Straight from point to point at one speed, the norm of ẋ, all the way.
        """
        corners = _points(points, 2)
        steps = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        if not steps.sum() > 0.0:
            raise InputError("the waypoints of a gait must not all be the same")
        share = positive(period, "period") * steps / steps.sum()
        count = len(corners)
        return cls(
            tuple(
                line(corners[k], corners[(k + 1) % count], float(share[k]))
                for k in range(count)
                if steps[k] > 0.0
            )
        )

    @classmethod
    def spline(
        cls, points: ArrayLike, *, times: ArrayLike | None = None, period: float = 1.0
    ) -> Gait:
        """Return the periodic cubic spline through points (K, m), twice differentiable.

        times: (K,) increasing, at which it is at them, the first at 0 and all before the period;
        equally spaced if not given.
        """
        from scipy.interpolate import CubicSpline

        knots, T = _points(points, 3), positive(period, "period")
        count = len(knots)
        if times is None:
            t = np.arange(count) * (T / count)
        else:
            t = vector(times, count, "times")
            if t[0] != 0.0 or not (np.diff(t) > 0.0).all() or t[-1] >= T:
                raise InputError("times must begin with 0, increase, and end before the period")
        t = np.append(t, T)
        found = CubicSpline(t, np.vstack([knots, knots[:1]]), bc_type="periodic").c[::-1]
        steps = np.diff(t)
        scale = steps[None] ** np.arange(4)[:, None]
        return cls(
            tuple(
                PolynomialArc(float(steps[k]), scale[:, k, None] * found[:, k])
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
        """Return straight strokes one after another, each with the same time.

        start: (m,).  moves: of each stroke, {joint: change [rad | m]}; together they must close.
        joints: names of all joints, in order, as `connection.joints`.
        """
        names = list(joints)
        at = vector(start, len(names), "start", names)
        time = positive(period, "period") / max(1, len(moves))
        arcs: list[Arc] = []
        for move in moves:
            to = at.copy()
            for name, change in move.items():
                to[joint_index(name, names, "a stroke")] += float(change)
            arcs.append(line(at, to, time))
            at = to
        return cls(tuple(arcs))

    @classmethod
    def read(cls, path: str | Path, *, period: float | None = None) -> Gait:
        """Return the periodic spline through recorded joint data, a .csv or .npz file.

        See `recorded.py` for what the files hold.  period: of the data's own times if not given.
        """
        from .recorded import points_in

        t, x = points_in(Path(path))
        T = float(t[-1] - t[0])
        closed = np.vstack([x[:-1]])
        gait = cls.spline(closed, times=t[:-1] - t[0], period=T)
        return gait if period is None else gait.lasting(period)

    @cached_property
    def m(self) -> int:
        """Number of shape coordinates."""
        return int(self.arcs[0].at(np.zeros(1))[0].shape[1])

    @cached_property
    def period(self) -> float:
        """Time of one cycle [s]."""
        return sum(arc.time for arc in self.arcs)

    @property
    def is_smooth(self) -> bool:
        """Whether it is one Fourier series, so that everything along it is smooth and periodic."""
        (arc, *others) = self.arcs
        return not others and isinstance(arc, FourierArc) and arc.is_whole

    @cached_property
    def breaks(self) -> Array:
        """Times at which arcs begin, and the period at the end, (arcs + 1,) [s]."""
        return read_only(np.concatenate([[0.0], np.cumsum([arc.time for arc in self.arcs])]))

    def at(self, t: ArrayLike) -> tuple[Array, Array]:
        """Return shapes and rates, (..., m) each, at times t (...,) of any cycle."""
        times = as_floats(t, "t")
        if self.is_smooth:
            x, slope = self.arcs[0].at(times.ravel() / self.period)
            shape = (*times.shape, self.m)
            return x.reshape(shape), (slope / self.period).reshape(shape)
        flat = times.ravel() % self.period
        which = np.clip(np.searchsorted(self.breaks, flat, side="right") - 1, 0, len(self.arcs) - 1)
        x, xdot = np.empty((2, len(flat), self.m))
        for k, arc in enumerate(self.arcs):
            own = which == k
            if own.any():
                x[own], slope = arc.at((flat[own] - self.breaks[k]) / arc.time)
                xdot[own] = slope / arc.time
        return x.reshape(*times.shape, self.m), xdot.reshape(*times.shape, self.m)

    def signals(self, joints: Sequence[str]) -> dict[str, Fourier]:
        """Return the plan of each joint, for `prescribed` of a Scene: the gait again and again.

        joints: names of all joints, in order.  Raises InputError for a gait that is not one
        Fourier series: what is simulated has no corners.
        """
        arc = self.arcs[0]
        if not self.is_smooth or not isinstance(arc, FourierArc):
            raise InputError("only a gait that is one Fourier series can be simulated as a plan")
        names = list(joints)
        if len(names) != self.m:
            raise InputError(f"the gait moves {self.m} joints, got {len(names)} names")
        k = np.arange(1, len(arc.cos) + 1)[:, None]
        sense = 1.0 if arc.end > arc.start else -1.0
        c, s = np.cos(k * arc.start), np.sin(k * arc.start)
        # φ = start ± 2πt/T.
        cos = arc.cos * c + arc.sin * s
        sin = sense * (arc.sin * c - arc.cos * s)
        return {
            name: Fourier(float(arc.mean[j]), cos[:, j].tolist(), sin[:, j].tolist(), self.period)
            for j, name in enumerate(names)
        }

    def samples(self, count: int) -> tuple[Array, Array]:
        """Return shapes and rates at `count` equidistant times from 0, (count, m) each."""
        return self.at(np.arange(count) * (self.period / count))

    @cached_property
    def limits(self) -> Array:
        """Least and greatest value of each joint on the way, exactly, (m, 2)."""
        x = np.concatenate([arc.at(arc.extremes())[0] for arc in self.arcs])
        return read_only(np.stack([x.min(axis=0), x.max(axis=0)], axis=1))

    @property
    def amplitude(self) -> Array:
        """Half of what each joint moves from end to end, (m,)."""
        return np.asarray(0.5 * (self.limits[:, 1] - self.limits[:, 0]))

    @property
    def centre(self) -> Array:
        """Middle of what each joint moves through, (m,)."""
        return np.asarray(self.limits.mean(axis=1))

    def lasting(self, period: float) -> Gait:
        """Return the same path in another period [s]."""
        factor = positive(period, "period") / self.period
        return Gait(tuple(arc.lasting(factor * arc.time) for arc in self.arcs))

    def scaled(self, factor: ArrayLike, *, about: ArrayLike | None = None) -> Gait:
        """Return the path with its amplitude changed by a factor, one for all or each joint.

        about: (m,) the shape that stays, the centre if not given.
        """
        given = as_floats(factor, "factor")
        f = vector(np.full(self.m, given) if given.ndim == 0 else given, self.m, "factor")
        fixed = self.centre if about is None else vector(about, self.m, "about")
        return Gait(tuple(arc.mapped(f, (1.0 - f) * fixed) for arc in self.arcs))

    def shifted(self, phase: float) -> Gait:
        """Return the same path begun later by `phase` of a period."""
        at = float(vector(np.atleast_1d(as_floats(phase, "phase")), 1, "phase")[0]) % 1.0
        at *= self.period
        k = int(np.clip(np.searchsorted(self.breaks, at, side="right") - 1, 0, len(self.arcs) - 1))
        arc = self.arcs[k]
        s = (at - self.breaks[k]) / arc.time
        if self.is_smooth and isinstance(arc, FourierArc):
            turn = s * (arc.end - arc.start)
            moved = FourierArc(
                arc.time, arc.mean, arc.cos, arc.sin, arc.start + turn, arc.end + turn
            )
            return Gait((moved,))
        pieces = [arc.part(s, 1.0)] if s < 1.0 else []
        pieces += [*self.arcs[k + 1 :], *self.arcs[:k]]
        if s > 0.0:
            pieces.append(arc.part(0.0, s))
        return Gait(tuple(pieces))

    def reversed(self) -> Gait:
        """Return the same path backwards, from the same start."""
        return Gait(tuple(arc.part(1.0, 0.0) for arc in reversed(self.arcs)))

    def then(self, other: Gait) -> Gait:
        """Return this gait followed by another, which starts at the same shape."""
        return Gait((*self.arcs, *other.arcs))

    def winding(
        self, *, joints: tuple[int, int] = (0, 1), centre: ArrayLike | None = None
    ) -> float:
        """Return how often the path goes round a centre in the plane of two joints.

        centre: (2,), the middle of the path if not given.  Positive from the first joint's axis
        towards the second's.  Raises InputError if the path passes through the centre.
        """
        pair = list(joints)
        c = self.centre[pair] if centre is None else vector(centre, 2, "centre")
        count = 64
        while count <= 2**16:
            s = np.linspace(0.0, 1.0, count + 1)
            arms = np.concatenate([arc.at(s)[0][:, pair] for arc in self.arcs]) - c
            if not np.hypot(*arms.T).min() > 1e-9:
                raise InputError(
                    f"the gait passes through the centre {c}: it has no winding number"
                )
            steps = np.diff(np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])))
            if np.abs(steps).max() < _TURNS * TAU:
                return float(round(steps.sum() / TAU))
            count *= 4
        raise InputError(f"the gait passes too near to the centre {c} to count its windings")


def _points(points: ArrayLike, least: int) -> Array:
    """Return points (K, m), at least so many.  Raises ShapeError or InputError."""
    array = as_floats(points, "points")
    if array.ndim != 2 or len(array) < least or not array.shape[1]:
        raise InputError(f"points must be (K, m) with K at least {least}, got {array.shape}")
    return vectors(array, array.shape[1], "points")
