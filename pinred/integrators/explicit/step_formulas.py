"""Error estimates, first step and dense output of explicit methods, for one run or SIMD lanes.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
Springer 1993, sections II.4 to II.6. The formulas use no branches on states. They are bound to
numbers for a single run (SCALAR) and to vectors, with one member per lane, for batches.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import Bindings, inlined, unbound
from ..stepping.intrinsics import call
from ..stepping.run_state import NEW, TURN, Run, Y, in_quaternion, quaternions_of

# The state of a stage, the error rows, and the rates at both ends of a step. The rates of the other
# stages and the dense-output terms follow.
STAGE, ERROR, ERROR3, BEGIN_RATE, END_RATE, RATES = range(2, 8)


_SAFETY, _SHRINK, _GROW, _CRASH = 0.9, 0.333, 6.0, 0.1  # factors of the step control, from dop853.f


# --- names that a tableau and a number type bind ----------------------------------------------


HALVINGS, REST = 0, 1  # factorisation of the method's order: 2^HALVINGS · REST
FIRST, TERMS = RATES, 3  # first row and number of the dense-output terms


# Operations that act on all lanes: same(number) copies a number to each lane; get(rows, row, i)
# reads entry i of a row, and put(rows, row, i, value) sets it; choose(condition, yes, no) selects
# `yes` where the condition is true, else `no`; power(base, exponent) returns a power.
same = get = put = choose = power = unbound


@inlined
def _same(number: float) -> float:
    return number


@inlined
def _get(rows: Array, row: int, i: int) -> float:
    value: float = rows[row, i]
    return value


@inlined
def _put(rows: Array, row: int, i: int, value: float) -> None:
    rows[row, i] = value


@inlined
def _choose(condition: bool, yes: float, no: float) -> float:
    return yes if condition else no


@inlined
def _power(base: float, exponent: float) -> float:
    value: float = base**exponent
    return value


@inlined
def share(run: Run, i: int, term: Any) -> Any:  # noqa: ARG001
    """Return the share of this run in a sum over the state: all of the term of entry i."""
    return term


@inlined
def whole(share_of_run: Any) -> Any:
    """Return a sum over all entries of the state from the share of this run."""
    return share_of_run


@inlined
def entries(run: Run) -> int:
    """Return the number of entries of the state."""
    return run.n


SCALAR = {"same": _same, "get": _get, "put": _put, "choose": _choose, "power": _power}


# --- formulas -----------------------------------------------------------------------------------


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller of two values."""
    return choose(b < a, b, a)


def larger(a: Any, b: Any) -> Any:
    """Return the larger of two values."""
    return choose(b > a, b, a)


def root(value: Any) -> Any:
    """Return the p-th root, with p the order of the method."""
    for _ in range(HALVINGS):
        value = sqrt(value)
    return value if REST == 1 else power(value, 1.0 / REST)


def entry_tolerance(run: Run, work: Array, i: int) -> Any:
    """Return the tolerated error of entry i, atol + rtol |y|."""
    size = larger(abs(get(work, Y, i)), abs(get(work, NEW, i)))
    if in_quaternion(i, quaternions_of(run)):
        size = same(TURN)
    return run.atol + run.rtol * size


def one_error(run: Run, work: Array, h: Any) -> Any:
    """Return the error of a step in units of the tolerance: the RMS of one error row (II.4.11)."""
    total = same(0.0)
    for i in range(run.n):
        error = get(work, ERROR, i) / entry_tolerance(run, work, i)
        total = total + share(run, i, error * error)
    return h * sqrt(whole(total) / float(entries(run)))


def two_errors(run: Run, work: Array, h: Any) -> Any:
    """Return the error of a step in units of the tolerance, from two error rows (II.10.17)."""
    sum5, sum3 = same(0.0), same(0.0)
    for i in range(run.n):
        inverse = 1.0 / entry_tolerance(run, work, i)
        e5, e3 = get(work, ERROR, i) * inverse, get(work, ERROR3, i) * inverse
        sum5 = sum5 + share(run, i, e5 * e5)
        sum3 = sum3 + share(run, i, e3 * e3)
    sum5, sum3 = whole(sum5), whole(sum3)
    mixed = sum5 + 0.01 * sum3
    return choose(mixed == 0.0, 0.0, h * sum5 / sqrt(float(entries(run)) * mixed))


def first_step(run: Run, params: Array, work: Array) -> Any:
    """Return the length of the first step: Hairer's hinit, made independent of the unit of time.

    Hairer's first step depends on the unit of time of the model. Here √(|y|/|ÿ|) replaces this
    unit. Where |y| or |ẏ| vanishes, a fraction of the end time replaces their ratio. The function
    takes one evaluation.
    """
    longest = same(min(run.t_end, run.max_step))
    size, rate = same(0.0), same(0.0)
    for i in range(run.n):
        y, slope = get(work, Y, i), get(work, BEGIN_RATE, i)
        scale = run.atol + run.rtol * abs(y)
        if in_quaternion(i, quaternions_of(run)):
            scale = same(run.atol + run.rtol * TURN)
        put(work, ERROR, i, scale)
        y, slope = y / scale, slope / scale
        size = size + share(run, i, y * y)
        rate = rate + share(run, i, slope * slope)
    size, rate = whole(size), whole(rate)
    is_moving = (size > 1e-10) & (rate * (run.t_end * run.t_end) > 1e-10)
    unit_time = choose(is_moving, sqrt(size / rate), 1e-4 * run.t_end)
    h = smaller(0.01 * unit_time, longest)
    for i in range(run.n):
        put(work, STAGE, i, get(work, Y, i) + h * get(work, BEGIN_RATE, i))
    call(run.address, work[STAGE], params, work[END_RATE])
    bend = same(0.0)
    for i in range(run.n):
        change = get(work, END_RATE, i) - get(work, BEGIN_RATE, i)
        change = change / get(work, ERROR, i)
        bend = bend + share(run, i, change * change)
    bend = whole(bend)
    is_curved = (size > 1e-10) & (bend > 0.0)
    unit_time = choose(is_curved, sqrt(sqrt(size) * h / sqrt(bend)), unit_time)
    steepest = larger(sqrt(bend) / h * (unit_time * unit_time), sqrt(rate) * unit_time)
    limit = smaller(100.0 * h, longest)
    by_rates = smaller(limit, unit_time * root(0.01 / steepest))
    return choose(steepest < np.inf, choose(steepest <= 1e-15, limit, by_rates), h)


def next_step(error: Any, h: Any, accepted: Any, again: Any, max_step: float) -> Any:
    """Return the length of the next step.

    Args:
        error: Error of the step, in units of the tolerance.
        h: Length of the step [s].
        accepted: Whether the step is accepted.
        again: Whether the previous trial was rejected.
        max_step: Longest step [s].
    Returns:
        The length [s]; a rejected step becomes shorter.
    """
    ideal = _SAFETY / larger(root(error), same(1e-300))
    growth = smaller(same(_GROW), larger(same(_SHRINK), ideal))
    growth = choose(again, smaller(growth, same(1.0)), growth)
    shrink = choose((error > 1.0) & (error < np.inf), larger(same(_SHRINK), ideal), _CRASH)
    return choose(accepted, smaller(h * growth, same(max_step)), h * shrink)


def fill_hermite(run: Run, work: Array, h: Any) -> None:
    """Compute the first three dense-output rows: the terms of the cubic Hermite polynomial."""
    for i in range(run.n):
        difference = get(work, NEW, i) - get(work, Y, i)
        start, end = h * get(work, BEGIN_RATE, i), h * get(work, END_RATE, i)
        put(work, FIRST, i, difference)
        put(work, FIRST + 1, i, start - difference)
        put(work, FIRST + 2, i, 2.0 * difference - (start + end))


def dense_value(work: Array, i: int, x: Any) -> Any:
    """Return entry i of the state at fraction x of the step: the dense-output polynomial (II.6)."""
    y = 1.0 - x
    total = get(work, FIRST + TERMS - 1, i)
    for k in range(TERMS - 2, -1, -1):
        total = get(work, FIRST + k, i) + (x if k % 2 else y) * total
    return get(work, Y, i) + x * total


def add_formulas(bindings: Bindings, errors: int) -> None:
    """Bind the formulas of a tableau with one or two error rows, each after those that it calls."""
    for formula in (
        smaller, larger, root, entry_tolerance, first_step, next_step, fill_hermite, dense_value,
    ):  # fmt: skip
        bindings.add(formula)
    bindings.add(one_error if errors == 1 else two_errors, name="estimate")
