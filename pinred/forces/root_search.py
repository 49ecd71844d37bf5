"""All roots of smooth functions of time within spans, or an error if some might be missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array
from ..common.errors import InputError
from ..system.coordinates import Indices
from .vector_program import VectorProgram

MOST_TIMES = 100_000  # largest number of switches of all runs that are prepared together
_MOST_INTERVALS = 1 << 16  # largest number of intervals in which g is undecided
_ITERATIONS = 100  # largest number of steps of Newton's method and of bisection


@dataclass(frozen=True)
class Spans:
    """Spans of time, (P,), in which an argument is smooth.

    Attributes:
        run: Index of the run.
        start: Start time [s].
        stop: End time [s].
    """

    run: Indices
    start: Array
    stop: Array


def linear_roots(
    program: VectorProgram, spans: Spans, columns: list[Array], *, whole: bool
) -> tuple[Indices, Array]:
    """Return the indices of spans, and the roots in them, of an argument linear in time."""
    shape = spans.start.shape
    offset, slope = (np.broadcast_to(v, shape) for v in program(0.0, *columns))
    if not whole:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.arange(len(offset)), -offset / slope
    ends = np.array([offset + slope * spans.start, offset + slope * spans.stop])
    at, target = _whole_numbers(ends.min(axis=0), ends.max(axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return at, (target - offset[at]) / slope[at]


def _whole_numbers(low: Array, high: Array) -> tuple[Indices, Array]:
    """Return all whole numbers in intervals [low, high], with the indices of their intervals."""
    first = np.ceil(low)
    counts = np.maximum(np.floor(high) - first + 1.0, 0.0)
    total = float(counts.sum())
    if not total <= MOST_TIMES:
        raise InputError(
            f"forces: a condition on time changes {total:g} times, more than {MOST_TIMES}. Shorten "
            "the motion, or use a smooth function"
        )
    number = counts.astype(int)
    at = np.repeat(np.arange(len(low)), number)
    within = np.arange(len(at)) - np.repeat(np.cumsum(number) - number, number)
    return at, first[at] + within


def bisected_roots(
    program: VectorProgram, spans: Spans, columns: list[Array], *, whole: bool, tiny: float
) -> tuple[Indices, Array]:
    """Return the indices of spans, and the roots in them, by bisection with bounds.

    Args:
        program: The argument g and its derivative.
        spans: The spans.
        columns: All inputs of g except time, (P,) each.
        whole: Whether roots are the times at which g is a whole number.
        tiny: Length of intervals that are not bisected further [s].
    Returns:
        Indices and roots.
    Raises:
        InputError: There are too many roots, or g stays too close to zero.
    """
    at, a, b = np.arange(len(spans.start)), spans.start, spans.stop
    found: list[tuple[Indices, Array]] = []
    while at.size:
        if at.size > _MOST_INTERVALS:
            raise InputError(
                "forces: a condition on time cannot be decided, because its argument stays close "
                f"to its threshold near t = {float(a[0]):g} s. State the times as a Hold"
            )
        own = [(column[at], column[at]) for column in columns]
        bounds = [
            [np.broadcast_to(side, a.shape) for side in pair]
            for pair in program.bounds([(a, b), *own])
        ]
        (low, high), (least, most) = bounds
        possible = (np.ceil(low) <= np.floor(high)) if whole else (low <= 0.0) & (high >= 0.0)
        possible &= ~((least == 0.0) & (most == 0.0))  # g is zero throughout: no change
        single = possible & ((least > 0.0) | (most < 0.0))
        short = possible & ~single & (b - a <= tiny)
        if short.any():
            found.append((at[short], 0.5 * (a[short] + b[short])))
        if single.any():
            found.append(_in_brackets(program, columns, at[single], a[single], b[single], whole))
        split = possible & ~single & ~short
        at, a, b = at[split], a[split], b[split]
        middle = 0.5 * (a + b)
        at, a, b = np.tile(at, 2), np.append(a, middle), np.append(middle, b)
    if not found:
        return np.empty(0, int), np.empty(0)
    at, time = (np.concatenate(rows) for rows in zip(*found, strict=True))
    return _changes(program, spans, columns, at, time, whole=whole)


def _changes(
    program: VectorProgram,
    spans: Spans,
    columns: list[Array],
    at: Indices,
    time: Array,
    *,
    whole: bool,
) -> tuple[Indices, Array]:
    """Return the roots at which the condition changes.

    Where g only touches zero, round-off makes it zero many times. Between such roots, g is zero up
    to round-off. They count as one root, which is left out if g has the same sign on both sides.
    """
    order = np.lexsort((time, at))
    at, time = at[order], time[order]
    is_first = np.append(True, np.diff(at) > 0)[: len(at)]
    is_last = np.append(np.diff(at) > 0, True)[-len(at) :]
    last_time = np.where(is_first, spans.start[at], np.append(0.0, time[:-1]))
    next_time = np.where(is_last, spans.stop[at], np.append(time[1:], 0.0))
    sides = []
    for middle in (0.5 * (last_time + time), 0.5 * (time + next_time)):
        points = [(column[at], column[at]) for column in columns]
        low, high = (
            np.broadcast_to(side, time.shape)
            for side in program.bounds([(middle,) * 2, *points])[0]
        )
        low, high = (np.floor(low), np.floor(high)) if whole else (np.sign(low), np.sign(high))
        sides.append(np.where((low == high) & (whole | (low != 0.0)), low, np.nan))
    before, after = sides
    first = np.flatnonzero(is_first | ~np.isnan(before))
    last = np.append(first[1:], len(at)) - 1
    keep = ~(before[first] == after[last])
    chosen = ((first + last) // 2)[keep]
    return at[chosen], time[chosen]


def _in_brackets(
    program: VectorProgram, columns: list[Array], at: Indices, a: Array, b: Array, whole: bool
) -> tuple[Indices, Array]:
    """Return the roots in intervals in which g is monotonic."""

    def g(time: Array, at: Indices) -> tuple[Array, Array]:
        value, slope = program(time, *(column[at] for column in columns))
        return np.broadcast_to(value, time.shape), np.broadcast_to(slope, time.shape)

    at_a, at_b = g(a, at)[0], g(b, at)[0]
    if whole:
        which, target = _whole_numbers(np.minimum(at_a, at_b), np.maximum(at_a, at_b))
    else:
        which = np.flatnonzero(np.sign(at_a) * np.sign(at_b) <= 0.0)
        target = np.zeros(len(which))
    at, a, b, rising = at[which], a[which], b[which], (at_b > at_a)[which]
    time = 0.5 * (a + b)
    for _ in range(_ITERATIONS):
        value, slope = g(time, at)
        above: NDArray[np.bool_] = (value > target) == rising
        a, b = np.where(above, a, time), np.where(above, time, b)
        with np.errstate(all="ignore"):
            newton = time - (value - target) / slope
        inside = (newton >= a) & (newton <= b)
        following = np.where(inside, newton, 0.5 * (a + b))
        moved = np.abs(following - time)
        time = following
        if (moved <= np.spacing(np.abs(time))).all():
            break
    return at, time
