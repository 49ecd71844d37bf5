"""Step control of explicit methods in lanes: the formulas of explicit/runge_kutta, on vectors.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
Springer 1993, sections II.4 to II.6.  What is a branch for one run is a choice here.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from ...common.arrays import Array
from ..explicit.runge_kutta import BEGIN_RATE, END_RATE, ERROR, ERROR3
from ..stepping.compiling import woven
from ..stepping.kernel_call import call
from ..stepping.run_record import Run
from ..stepping.state_rows import NEW, TURN, Y, in_quaternion
from .vectors import choose, power

# Rows of what is made ready for lanes: states at the start and their rates, a state a little
# later and its rates, what entries are measured by.
READY_Y, READY_RATE, LATER, LATER_RATE, SCALE, READY_ROWS = range(6)

SAFETY, SHRINK, GROW, CRASH = 0.9, 0.333, 6.0, 0.1


# --- what a tableau and a width give -------------------------------------------------------


HALVINGS, REST = 0, 1  # the order, 2^HALVINGS REST
FIRST, TERMS = 7, 3  # of the rows of dense output


def same(number: float) -> Any:
    """Return a vector of one number."""
    raise NotImplementedError


def get(rows: Array, row: int, i: int) -> Any:
    """Return entry i of a row in all lanes."""
    raise NotImplementedError


def put(rows: Array, row: int, i: int, value: Any) -> None:
    """Set entry i of a row in all lanes."""
    raise NotImplementedError


# --- the formulas --------------------------------------------------------------------------


@woven
def least(a: Any, b: Any) -> Any:
    """Return the lesser of two."""
    return choose(b < a, b, a)


@woven
def most(a: Any, b: Any) -> Any:
    """Return the greater of two."""
    return choose(b > a, b, a)


def root(value: Any) -> Any:
    """Return the root of the method's order."""
    for _ in range(HALVINGS):
        value = sqrt(value)
    return value if REST == 1 else power(value, 1.0 / REST)


def one_error(run: Run, work: Array, h: Any) -> Any:
    """Return the mean of one row of errors (II.4.11)."""
    total = same(0.0)
    for i in range(run.n):
        size = most(abs(get(work, Y, i)), abs(get(work, NEW, i)))
        if in_quaternion(i, run.quaternion):
            size = same(TURN)
        error = get(work, ERROR, i) / (run.atol + run.rtol * size)
        total = total + error * error
    return h * sqrt(total / float(run.n))


def two_errors(run: Run, work: Array, h: Any) -> Any:
    """Return the estimate of two rows of errors (II.10.17)."""
    sum5, sum3 = same(0.0), same(0.0)
    for i in range(run.n):
        size = most(abs(get(work, Y, i)), abs(get(work, NEW, i)))
        if in_quaternion(i, run.quaternion):
            size = same(TURN)
        inverse = 1.0 / (run.atol + run.rtol * size)
        e5, e3 = get(work, ERROR, i) * inverse, get(work, ERROR3, i) * inverse
        sum5 = sum5 + e5 * e5
        sum3 = sum3 + e3 * e3
    mixed = sum5 + 0.01 * sum3
    return choose(mixed == 0.0, 0.0, h * sum5 / sqrt(float(run.n) * mixed))


def first_step(run: Run, params: Array, ready: Array) -> Any:
    """Return the first steps: see explicit/runge_kutta."""
    end = run.t_end
    size, rate = same(0.0), same(0.0)
    for i in range(run.n):
        y, slope = get(ready, READY_Y, i), get(ready, READY_RATE, i)
        scale = run.atol + run.rtol * abs(y)
        if in_quaternion(i, run.quaternion):
            scale = same(run.atol + run.rtol * TURN)
        put(ready, SCALE, i, scale)
        y, slope = y / scale, slope / scale
        size = size + y * y
        rate = rate + slope * slope
    moves = (size > 1e-10) & (rate * (end * end) > 1e-10)
    unit_time = choose(moves, sqrt(size / rate), 1e-4 * end)
    h = least(0.01 * unit_time, same(min(end, run.max_step)))
    for i in range(run.n):
        put(ready, LATER, i, get(ready, READY_Y, i) + h * get(ready, READY_RATE, i))
    call(run.address, ready[LATER], params, ready[LATER_RATE])
    bend = same(0.0)
    for i in range(run.n):
        turn = get(ready, LATER_RATE, i) - get(ready, READY_RATE, i)
        turn = turn / get(ready, SCALE, i)
        bend = bend + turn * turn
    bends = (size > 1e-10) & (bend > 0.0)
    unit_time = choose(bends, sqrt(sqrt(size) * h / sqrt(bend)), unit_time)
    steepest = most(sqrt(bend) / h * unit_time * unit_time, sqrt(rate) * unit_time)
    limit = least(100.0 * h, same(min(end, run.max_step)))
    long = least(limit, unit_time * root(0.01 / steepest))
    found = choose(steepest <= 1e-15, limit, long)
    return choose(steepest < np.inf, found, h)


def unit(run: Run, rows: Array, y: int, rate: int, some: Any) -> None:
    """Bring quaternions in row y to length one in some lanes, and their rates with them."""
    if run.quaternion >= 0:
        square = same(0.0)
        for i in range(run.quaternion, run.quaternion + 4):
            square = square + get(rows, y, i) * get(rows, y, i)
        factor = choose(some, 1.0 / sqrt(square), 1.0)
        for i in range(run.quaternion, run.quaternion + 4):
            put(rows, y, i, get(rows, y, i) * factor)
            put(rows, rate, i, get(rows, rate, i) * factor)


def finite(run: Run, rows: Array, row: int) -> Any:
    """Return in which lanes all entries of a row are finite."""
    total = same(0.0)
    for i in range(run.n):
        value = get(rows, row, i)
        total = total + (value - value)  # NaN for infinities and NaN, else zero
    return total == 0.0


def accept(run: Run, work: Array, taken: Any) -> None:
    """Take the ends of steps for the begins of the next, where they are taken."""
    for i in range(run.n):
        put(work, Y, i, choose(taken, get(work, NEW, i), get(work, Y, i)))
        put(work, BEGIN_RATE, i, choose(taken, get(work, END_RATE, i), get(work, BEGIN_RATE, i)))
    unit(run, work, Y, BEGIN_RATE, taken)


def next_step(error: Any, h: Any, taken: Any, again: Any, max_step: float) -> Any:
    """Return the next steps, after steps h with their errors in units of the tolerance.

    again: where the last trial was rejected, too.
    """
    wish = SAFETY / most(root(error), same(1e-300))
    growth = least(same(GROW), most(same(SHRINK), wish))
    growth = choose(again, least(growth, same(1.0)), growth)
    shrink = choose((error > 1.0) & (error < np.inf), most(same(SHRINK), wish), CRASH)
    return choose(taken, least(h * growth, same(max_step)), h * shrink)


def prepare(run: Run, work: Array, h: Any) -> None:
    """Fill the rows of dense output that do not depend on further stages."""
    for i in range(run.n):
        move = get(work, NEW, i) - get(work, Y, i)
        start, end = h * get(work, BEGIN_RATE, i), h * get(work, END_RATE, i)
        put(work, FIRST, i, move)
        put(work, FIRST + 1, i, start - move)
        put(work, FIRST + 2, i, 2.0 * move - (start + end))


def between(run: Run, work: Array, x: Any, out: int) -> None:
    """Fill a row with the states at the parts x of the steps (II.6)."""
    y = 1.0 - x
    for i in range(run.n):
        total = get(work, FIRST + TERMS - 1, i)
        for k in range(TERMS - 2, -1, -1):
            total = get(work, FIRST + k, i) + (x if k % 2 else y) * total
        put(work, out, i, get(work, Y, i) + x * total)
