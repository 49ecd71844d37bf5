"""The longest steps that resolve the functions of time in the forces of a run.

An integrator sees a function of time at the stages of its steps only. It can miss a bump, or take
the samples of a fast oscillation for a slow one, and then its error estimate does not hold. The
functions are known before a run. The time is divided into panels on which the Chebyshev
coefficients of all functions decay below the tolerance of the run, and steps that are not longer
than the panels see all of each function.

L. N. Trefethen, Approximation Theory and Approximation Practice, SIAM 2019, chapters 3 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, read_only
from ..common.memo import recent
from ..forces.force_model import ForceModel
from ..forces.force_numbers import SpanNumbers
from ..forces.switch_times import time_within
from ..system.coordinates import Indices

DEGREE = 16  # degree of the polynomials on panels
_TAIL = 2  # number of the last coefficients that estimate the remainder
# Error of the integral of a function over a panel, in units of rtol times the range of its integral
# over the run.
_ALLOWED = 1.0
_ROUND_OFF = 8.0 * float(np.finfo(float).eps)
_FIRST = 64  # number of panels of the first division of a run, at least
_LOOK, _MOST = 1 << 13, 1 << 18  # numbers of panels at which searches end
_SHORTEST = 2.0**-30  # length of the shortest panel, as a fraction of the run
# A panel is bisected if the bounds of a function on it exceed the range of the samples by the
# first factor, down to panels of a fraction _SEEN of the run; and by the second factor on any
# panel, if the bounds are wider than a fraction _FAINT of the range over the run.
_UNSEEN, _HIDDEN, _SEEN, _FAINT = 8.0, 1e3, 1.0 / 512.0, 1e-3
# Steps of methods of lower order than _HIGH are shorter by the power _LOW of the ratio of orders:
# their error estimates hold for a smaller part of a period.
_HIGH, _LOW = 10.0, 2.5
_RUNS = 16  # number of runs whose limits are cached
_TOGETHER = 256  # number of runs whose functions are evaluated at once
_RESTART = 2.0  # cost of a stop, in steps
_PANELS = 4096  # number of panels that are evaluated at once, few enough for the CPU's cache
_PER_OCTAVE = 2.0  # number of longest steps per factor of two among which the cheapest is chosen


class Limited(NamedTuple):
    """A longest step for a whole run, with stops where steps have to be shorter.

    Attributes:
        longest: The longest step [s].
        stops: The stops, (S,) [s].
    """

    longest: float
    stops: Array


@dataclass(frozen=True)
class StepLimits:
    """Panels of time with the longest steps that resolve all functions of time on them.

    Attributes:
        ends: End of each panel, (P,) sorted [s].
        longest: Longest step that touches the panel, (P,) [s].
        decay: Chebyshev coefficients of the functions on each panel times its length, relative to
            the range of the function's integral over the run; the largest of all functions,
            (P, DEGREE + 1).
        unresolved: Times near which the search ended before a function was resolved, (U,) [s].
        share: Factor by which the longest steps are shorter than the panels.
    """

    ends: Array
    longest: Array
    decay: Array
    unresolved: Array
    share: float = 1.0

    def shorter(self, share: float) -> StepLimits:
        """Return the limits with all steps shorter by a factor."""
        if share == 1.0:
            return self
        return replace(self, longest=share * self.longest, share=share * self.share)

    def within(self, starts: Array, ends: Array) -> Array:
        """Return the longest step in each of K intervals of time, (K,) [s].

        Args:
            starts: Starts of the intervals, (K,) [s].
            ends: Their ends, (K,) [s].
        Returns:
            The lengths.
        """
        last = len(self.ends) - 1
        first = np.minimum(np.searchsorted(self.ends, starts, side="right"), last)
        after = np.minimum(np.searchsorted(self.ends, ends, side="left"), last) + 1
        pairs = np.column_stack([first, np.maximum(after, first + 1)]).ravel()
        return np.asarray(np.minimum.reduceat(np.append(self.longest, np.inf), pairs)[::2])

    def stops(self, longest: float) -> Array:
        """Return stops between which no step is too long, (S,) sorted [s].

        Args:
            longest: Longest step elsewhere [s]. Panels that resolve it need no stops.
        Returns:
            The stops.
        """
        if not (self.longest < longest).any():
            return np.empty(0)
        lengths = np.diff(self.ends, prepend=0.0)
        counts = np.where(self.longest < longest, np.ceil(lengths / self.longest), 1.0).astype(int)
        starts = np.repeat(self.ends - lengths, counts)
        starts += (
            np.arange(len(starts)) - np.repeat(np.cumsum(counts) - counts, counts)
        ) * np.repeat(lengths / counts, counts)
        limits = np.repeat(self.longest, counts)
        stops: list[float] = []
        begin, limit, previous = 0.0, np.inf, np.inf
        for start, end, count in zip(
            starts.tolist(), [*starts[1:].tolist(), self.ends[-1]], limits.tolist(), strict=True
        ):
            if count >= longest:
                if previous < longest:
                    stops.append(start)
            elif previous >= longest or end - begin > min(limit, count):
                stops.append(start)
                begin, limit = start, count
            else:
                limit = min(limit, count)
            previous = count
        return np.array(stops[1:] if stops and stops[0] == 0.0 else stops)

    @cached_property
    def cheapest(self) -> Limited:
        """The longest step and the stops that resolve all functions with the fewest steps."""
        end = float(self.ends[-1])
        lengths = np.diff(self.ends, prepend=0.0)
        octaves = np.floor(_PER_OCTAVE * np.log2(self.longest)) / _PER_OCTAVE
        candidates = np.unique([self.longest.min(), *np.exp2(octaves), np.inf])
        order = np.argsort(self.longest)
        sums = np.append(0.0, np.cumsum((lengths / self.longest)[order]))
        stops = sums[np.searchsorted(self.longest[order], candidates, side="left")]
        longest = float(candidates[np.argmin(end / candidates + _RESTART * stops)])
        return Limited(longest, self.stops(longest))

    def error_of_equal_steps(self, step: float, order: int) -> float:
        """Estimate the error of integrals of functions by equal steps, relative to their ranges.

        Args:
            step: Length of the steps [s].
            order: Order of the method.
        Returns:
            The estimate, the sum over all panels.
        """
        lengths = np.diff(self.ends, prepend=0.0)
        ratio = np.minimum(step / lengths, 1.0)[:, None] ** np.arange(DEGREE + 1)
        degree = min(order, DEGREE - 1)
        return float((self.decay * ratio)[:, degree:].sum())


def step_limits(
    forces: ForceModel,
    end: float,
    numbers: Array,
    rtol: float,
    order: int,
    tables: SpanNumbers | None = None,
) -> StepLimits:
    """Return the limits of a run with force parameters (p,), cached.

    Args:
        forces: The forces, which contain functions of time.
        end: End of the run [s].
        numbers: Force parameters, (p,).
        rtol: Relative tolerance of the run.
        order: Order of the solution whose error controls the steps.
        tables: Tables of the run; None for those of the forces.
    Returns:
        The limits.
    """
    tables = forces.tables if tables is None else tables
    key = end, rtol, order, tables, numbers[functions_depend_on(forces)].tobytes()

    def make() -> StepLimits:
        return limits_of_runs(forces, end, numbers[None], rtol, order, tables)[0]

    return recent(forces.time_functions, key, make, _RUNS, StepLimits)


def limits_of_runs(
    forces: ForceModel,
    end: float,
    numbers: Array,
    rtol: float,
    order: int,
    tables: SpanNumbers | None = None,
) -> list[StepLimits]:
    """Return the limits of N runs with force parameters (N, p); see `step_limits`.

    Args:
        forces: The forces.
        end: End of the runs [s].
        numbers: Force parameters, (N, p).
        rtol: Relative tolerance of the runs.
        order: Order of the solution whose error controls the steps.
        tables: Tables of the runs; None for those of the forces.
    Returns:
        The limits of each run.
    """
    tables = forces.tables if tables is None else tables
    share = min(1.0, order / _HIGH) ** _LOW
    limits = []
    for first in range(0, len(numbers), _TOGETHER):
        runs = slice(first, first + _TOGETHER)
        search = _Search(forces, end, numbers[runs], rtol, tables[runs])
        limits += [limits_of_run.shorter(share) for limits_of_run in search.run()]
    return limits


def functions_depend_on(forces: ForceModel) -> list[int]:
    """Return the indices of the numbers on which functions of time and their breaks depend."""
    within = range(forces.within.start, forces.within.stop)
    used = {*forces.time_functions.used, *forces.switching.used}
    return sorted(used.difference(within))


class _Panels(NamedTuple):
    """P panels of a division by repeated bisection, with F functions on them.

    Attributes:
        span: Index of the span between breaks, (P,).
        level: Number of bisections of the span, (P,).
        place: Index among the panels of this level, (P,).
        coefficients: Chebyshev coefficients, (P, F, DEGREE + 1).
        noise: Round-off of the coefficients, (P, F).
        range: Range of the samples, (P, F).
        bounds: Width of intervals that contain all values, infinity if they are unknown, (P, F).
        total: Range of the samples of each sum of functions, (P, S).
    """

    span: Indices
    level: Indices
    place: Indices
    coefficients: Array
    noise: Array
    range: Array
    bounds: Array
    total: Array

    def at(self, which: Any) -> _Panels:
        """Return the panels with given indices, or a mask."""
        return _Panels(*(column[which] for column in self))


class _Search:
    """The search for panels that resolve the functions of time of N runs."""

    def __init__(
        self, forces: ForceModel, end: float, numbers: Array, rtol: float, tables: SpanNumbers
    ) -> None:
        """Store the arguments of `limits_of_runs`."""
        breaks = [forces.switching.breaks(end, p, tables[k]) for k, p in enumerate(numbers)]
        self._starts = np.concatenate([np.append(0.0, b) for b in breaks])
        self._stops = np.concatenate([np.append(b, end) for b in breaks])
        self._run = np.repeat(np.arange(len(numbers)), [len(b) + 1 for b in breaks])
        within = time_within(self._starts, self._stops)
        width = forces.within.stop - forces.within.start
        self._of_spans = np.ascontiguousarray(tables.at(within, self._run)[:, :width].T)
        self._forces, self._end, self._numbers, self._rtol = forces, end, numbers, rtol

    def run(self) -> list[StepLimits]:
        """Bisect panels until they resolve all functions, and join those that do so together."""
        lengths = self._stops - self._starts
        levels = np.ceil(np.log2(np.maximum(_FIRST * lengths / self._end, 1.0))).astype(int)
        span = np.repeat(np.arange(len(lengths)), 1 << levels)
        index = np.concatenate([np.arange(1 << level) for level in levels.tolist()])
        panels = self._panels(span, levels[span], index)
        while True:
            scale = self._scales(panels)
            divided = self._are_divided(panels, scale)
            if not divided.any():
                break
            parents = panels.at(divided)
            halves = [
                np.concatenate([parents.span, parents.span]),
                np.concatenate([parents.level, parents.level]) + 1,
                np.concatenate([2 * parents.place, 2 * parents.place + 1]),
            ]
            panels = _joined(panels.at(~divided), self._panels(halves[0], halves[1], halves[2]))
        resolved = self._growth(panels, scale) >= 1.0
        failed = panels.at(~resolved)
        panels = _joined(self._join(panels.at(resolved), scale), failed)
        starts, lengths = self._times(panels)
        order = np.lexsort((starts, self._run[panels.span]))
        panels, starts, lengths = panels.at(order), starts[order], lengths[order]
        growth = np.clip(self._growth(panels, scale), 1.0, 2.0)
        longest = np.where(panels.level == 0, np.inf, lengths * growth)
        relative = lengths[:, None, None] / _positive(scale[self._run[panels.span]])[:, :, None]
        decay = (np.abs(panels.coefficients) * relative).max(axis=1)
        unresolved = self._times(failed)[0]
        firsts = np.searchsorted(self._run[panels.span], np.arange(len(self._numbers) + 1))
        return [
            StepLimits(
                read_only((starts + lengths)[first:last]),
                read_only(longest[first:last]),
                read_only(decay[first:last]),
                read_only(np.sort(unresolved[self._run[failed.span] == k])),
            )
            for k, (first, last) in enumerate(pairwise(firsts.tolist()))
        ]

    def _times(self, panels: _Panels) -> tuple[Array, Array]:
        """Return starts and lengths, (P,) [s]."""
        lengths = (self._stops - self._starts)[panels.span] * np.exp2(-panels.level)
        return self._starts[panels.span] + panels.place * lengths, lengths

    def _panels(
        self, span: Indices, level: Indices, index: Indices, *, bounded: bool = True
    ) -> _Panels:
        """Evaluate the functions on panels, and their bounds if `bounded`."""
        if len(span) > _PANELS:
            chunks = [slice(k, k + _PANELS) for k in range(0, len(span), _PANELS)]
            pieces = (self._panels(span[c], level[c], index[c], bounded=bounded) for c in chunks)
            return _joined(*pieces)
        functions, nodes, transform = self._forces.time_functions, *_chebyshev()
        bare = _Panels(span, level, index, *[np.empty(0)] * 5)
        starts, lengths = self._times(bare)
        times = starts[:, None] + 0.5 * lengths[:, None] * (1.0 + nodes)
        of_spans = self._of_spans[:, span]
        # Scalars allow for tighter bounds, for example of powers.
        alone = len(self._numbers) == 1
        numbers = self._numbers[0] if alone else self._numbers[self._run[span]].T
        everywhere = numbers if alone else numbers[..., None]
        values = functions(times, everywhere, self._forces.within, of_spans[..., None])
        values = np.moveaxis(values, 0, 1)
        values = np.where(np.isfinite(values), values, 0.0)
        rates = np.abs(np.diff(values)).max(axis=2) / (np.diff(nodes).min() * 0.5)
        sizes = np.abs(values).max(axis=2)
        # A time t is rounded, which changes the function by its rate times the round-off of t.
        late = ((starts + lengths) / lengths)[:, None]
        noise = _ROUND_OFF * (sizes + np.minimum(rates * late, np.inf))
        bounds = np.zeros(sizes.T.shape)
        if bounded:
            bounds = functions.widths(
                starts, starts + lengths, numbers, self._forces.within, of_spans
            )
        total = np.ptp(np.add.reduceat(values, functions.firsts, axis=1), axis=2)
        return _Panels(
            span, level, index, values @ transform, noise, np.ptp(values, axis=2), bounds.T, total
        )

    def _scales(self, panels: _Panels) -> Array:
        """Return the range over each run of the integral of the sum with each function, (N, F)."""
        starts, lengths = self._times(panels)
        run = self._run[panels.span]
        order = np.lexsort((starts, run))
        first = np.searchsorted(run[order], np.arange(len(self._numbers)))
        firsts = self._forces.time_functions.firsts
        means = np.add.reduceat(panels.coefficients[:, :, ::2] @ _MEANS, firsts, axis=1)
        steps = (lengths[:, None] * means)[order]
        sums = np.cumsum(steps, axis=0)
        sums -= (sums - steps)[first][run[order]]
        highest = np.maximum(np.maximum.reduceat(sums, first), 0.0)
        lowest = np.minimum(np.minimum.reduceat(sums, first), 0.0)
        inside = np.maximum.reduceat((lengths[:, None] * panels.total)[order], first) / DEGREE
        terms = np.diff(firsts, append=panels.range.shape[1])
        return np.repeat(np.maximum(highest - lowest, inside), terms, axis=1)

    def _growth(self, panels: _Panels, scale: Array) -> Array:
        """Return the ratio of the longest resolved step to each panel, (P,)."""
        lengths = self._times(panels)[1][:, None]
        tails = np.abs(panels.coefficients[:, :, -_TAIL:]).max(axis=2)
        sizes = scale[self._run[panels.span]]
        allowed = _ALLOWED * self._rtol * sizes / lengths + panels.noise
        ratio = np.where(tails <= 0.0, np.inf, allowed / _positive(tails))
        return np.asarray(ratio.min(axis=1, initial=np.inf) ** (1.0 / (DEGREE - 1)))

    def _are_divided(self, panels: _Panels, scale: Array) -> NDArray[np.bool_]:
        """Return which panels do not resolve a function, or may hide a part of it."""
        lengths, run = self._times(panels)[1] / self._end, self._run[panels.span]
        counts = np.bincount(run, minlength=len(self._numbers))[run]
        rough = self._growth(panels, scale) < 1.0
        wide, widths = panels.bounds > _UNSEEN * panels.range, panels.bounds
        unseen = wide & (lengths[:, None] > _SEEN)
        ranges = np.zeros_like(scale)
        np.maximum.at(ranges, run, panels.range)
        visible = (widths > _FAINT * ranges[run]) & np.isfinite(widths)
        hidden = (widths > _HIDDEN * panels.range) & visible & (counts < _LOOK)[:, None]
        divided = rough | (unseen | hidden).any(axis=1)
        return divided & (lengths > _SHORTEST) & (counts <= _MOST)

    def _join(self, panels: _Panels, scale: Array) -> _Panels:
        """Replace pairs of panels by the panel that contains both, where it is resolved."""
        for level in range(int(panels.level.max(initial=0)), 0, -1):
            indices = np.flatnonzero(panels.level == level)
            order = indices[np.lexsort((panels.place[indices], panels.span[indices]))]
            span, index = panels.span[order], panels.place[order]
            pairs = (index[:-1] % 2 == 0) & (np.diff(index) == 1) & (np.diff(span) == 0)
            first = np.flatnonzero(pairs)
            if not first.size:
                continue
            levels = np.full(first.size, level - 1)
            joined = self._panels(span[first], levels, index[first] // 2, bounded=False)
            joins = self._growth(joined, scale) >= 1.0
            kept = np.ones(len(panels.span), dtype=bool)
            kept[order[first[joins]]] = kept[order[first[joins] + 1]] = False
            panels = _joined(panels.at(kept), joined.at(joins))
        return panels


def _joined(*parts: _Panels) -> _Panels:
    return _Panels(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _positive(values: Array) -> Array:
    """Return values without zeros, for division."""
    return np.maximum(values, np.finfo(float).tiny)


@cache
def _chebyshev() -> tuple[Array, Array]:
    """Return the Chebyshev points, (d,) from −1 to 1, and the matrix to coefficients, (d, d)."""
    k = np.arange(DEGREE + 1)
    nodes: Array = -np.cos(np.pi * k / DEGREE)
    weights = np.ones(DEGREE + 1)
    weights[[0, -1]] = 0.5
    transform: Array = 2.0 / DEGREE * np.cos(np.pi * np.outer(DEGREE - k, k) / DEGREE)
    transform *= weights[:, None] * weights
    return read_only(nodes), read_only(transform)


# Mean of the Chebyshev polynomials of even degree over a panel.
_MEANS = np.array([1.0 / (1.0 - k * k) for k in range(0, DEGREE + 1, 2)])
