"""Explicit Runge–Kutta methods over a kernel: steps, step control and dense output.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
Springer 1993, sections II.4 (step control, first step), II.5 and II.6 (dense output), and
Hairer's code dop853.f, whose constants are used here for all.

The state that a knot holds is the one that the step before has left, its quaternion not
yet back at length one: from it the step can be repeated to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from math import sqrt
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import bound, compiled, woven
from ..stepping.kernel_call import call
from ..stepping.run_record import AGAIN, DENSE, DONE, ENDS, NOT_FINITE, STAGES_KEPT, STEP, Run
from ..stepping.state_rows import (
    NEW,
    TURN,
    Y,
    copy_an_end,
    first_not_finite,
    in_quaternion,
    keep_state,
    padded_rows,
    unit,
    unit_alone,
)
from ..stepping.step_loop import Hooks, loops
from ..stepping.stepper import Stepper
from .row_sums import Rate, Sum, Terms, row_program
from .tableau import Tableau

# Rows of `work`: the state of a stage, the errors, the rates at both ends of a step; then those
# of the other stages, and what dense output takes.
STAGE, ERROR, ERROR3, BEGIN_RATE, END_RATE, RATES = 2, 3, 4, 5, 6, 7

_SAFETY, _SHRINK, _GROW, _CRASH = 0.9, 0.333, 6.0, 0.1


# --- what a tableau gives ------------------------------------------------------------------


STAGES = 1
HALVINGS, REST = 0, 1  # the order, 2^HALVINGS REST
FIRST, TERMS = RATES, 3  # of the rows of dense output


def fill_step(address: int, params: Array, work: Array, h: float) -> int:
    """Fill the rates of a step h from row Y with its rate, and row NEW; return the evaluations."""
    raise NotImplementedError


def fill_end(address: int, params: Array, work: Array, h: float) -> int:
    """Fill the rate at the end of a step, unless `fill_step` does; return the evaluations."""
    raise NotImplementedError


def fill_errors(address: int, params: Array, work: Array, h: float) -> int:
    """Fill the rows of errors."""
    raise NotImplementedError


def fill_dense(address: int, params: Array, work: Array, h: float) -> int:
    """Fill what goes beyond the cubic; return the evaluations."""
    raise NotImplementedError


def estimate(run: Run, work: Array, h: float) -> float:
    """Return the estimated error of a step in units of the tolerance."""
    raise NotImplementedError


@compiled
def one_error(run: Run, work: Array, h: float) -> float:
    """Return the mean of one row of errors (II.4.11)."""
    total = 0.0
    for i in range(run.n):
        size = max(abs(work[Y, i]), abs(work[NEW, i]))
        if in_quaternion(i, run.quaternion):
            size = TURN
        error = work[ERROR, i] / (run.atol + run.rtol * size)
        total += error * error
    return h * sqrt(total / run.n)


@compiled
def two_errors(run: Run, work: Array, h: float) -> float:
    """Return the estimate of two rows of errors (II.10.17)."""
    n, quaternion, rtol, atol = run.n, run.quaternion, run.rtol, run.atol
    sum5 = sum3 = 0.0
    for i in range(n):
        size = max(abs(work[Y, i]), abs(work[NEW, i]))
        if in_quaternion(i, quaternion):
            size = TURN
        inverse = 1.0 / (atol + rtol * size)
        e5, e3 = work[ERROR, i] * inverse, work[ERROR3, i] * inverse
        sum5 += e5 * e5
        sum3 += e3 * e3
    mixed = sum5 + 0.01 * sum3
    if mixed == 0.0:
        return 0.0
    return h * sum5 / sqrt(n * mixed)


# --- the steps -----------------------------------------------------------------------------


def root(value: float) -> float:
    """Return the root of the method's order."""
    for _ in range(HALVINGS):
        value = sqrt(value)
    return value if REST == 1 else value ** (1.0 / REST)


def begin(run: Run, params: Array, work: Array, knots_t: Array, knots_y: Array) -> int:
    """Do as driver.begin."""
    keep_state(run, work, 0.0, knots_t, knots_y)
    call(run.address, work[Y], params, work[BEGIN_RATE])
    run.evaluations += 1
    unit(work[Y], work[BEGIN_RATE], run.quaternion)
    run.entry = first_not_finite(work[BEGIN_RATE], run.n)
    if run.entry >= 0:
        return NOT_FINITE
    run.h = first_step(run, params, work)
    return DONE


def until(run: Run) -> float:
    """Do as driver.until."""
    return run.t_end if run.t + 1.01 * run.h >= run.t_end else run.t + run.h


def attempt(run: Run, params: Array, work: Array, t_new: float) -> int:
    """Do as driver.attempt."""
    h = t_new - run.t  # what the clock shows is what the state is moved by
    run.evaluations += fill_step(run.address, params, work, h)
    fill_errors(run.address, params, work, 1.0)
    run.error = estimate(run, work, h)
    if run.error <= 1.0:
        run.evaluations += fill_end(run.address, params, work, h)
        if first_not_finite(work[END_RATE], run.n) < 0:
            return DONE
    run.rejected += 1
    run.again = 1
    shrink = max(_SHRINK, _SAFETY / root(run.error))
    if not 1.0 < run.error < np.inf:  # something is not finite
        shrink = _CRASH
        run.entry = culprit(work, run.n)
    run.h = h * shrink
    return AGAIN


def accept(run: Run, work: Array, t_new: float) -> None:
    """Do as driver.accept."""
    for i in range(run.n):
        work[Y, i] = work[NEW, i]
        work[BEGIN_RATE, i] = work[END_RATE, i]
    unit(work[Y], work[BEGIN_RATE], run.quaternion)
    growth = min(_GROW, max(_SHRINK, _SAFETY / max(root(run.error), 1e-300)))
    if run.again:
        growth = min(growth, 1.0)
    else:
        run.entry = -1  # clear of what was not finite
    run.again = 0
    run.h = min((t_new - run.t) * growth, run.max_step)


def keep(run: Run, work: Array, t: float, knots_t: Array, knots_y: Array) -> None:
    """Write down a knot; with stages, behind it the rates of those that have led there."""
    keep_state(run, work, t, knots_t, knots_y)
    if run.keep == STAGES_KEPT:
        n, k = run.n, run.steps
        for i in range(n):
            knots_y[k, n + i] = work[BEGIN_RATE, i]
        for stage in range(STAGES - 1):
            for i in range(n):
                knots_y[k, (stage + 2) * n + i] = work[RATES + stage, i]


def load(run: Run, params: Array, work: Array, t_new: float, knots_y: Array, k: int) -> None:  # noqa: ARG001
    """Do as driver.load."""
    call(run.address, work[Y], params, work[BEGIN_RATE])
    unit(work[Y], work[BEGIN_RATE], run.quaternion)


def state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Do as driver.state, by a polynomial (II.6)."""
    if not copy_an_end(run, work, time, t_new, out):
        h = t_new - run.t
        if run.known == ENDS:
            fill_step(run.address, params, work, h)
            fill_end(run.address, params, work, h)
            run.known = STEP
        if run.known == STEP:
            run.known = DENSE
            prepare(run, params, work, h)
        x = (time - run.t) / h
        y = 1.0 - x
        for i in range(run.n):
            total = work[FIRST + TERMS - 1, i]
            for k in range(TERMS - 2, -1, -1):
                total = work[FIRST + k, i] + (x if k % 2 else y) * total
            out[i] = work[Y, i] + x * total
    unit_alone(out, run.quaternion)
    return DONE


def prepare(run: Run, params: Array, work: Array, h: float) -> None:
    """Fill the rows of dense output."""
    run.evaluations += fill_dense(run.address, params, work, h)
    for i in range(run.n):
        move, start, end = work[NEW, i] - work[Y, i], h * work[BEGIN_RATE, i], h * work[END_RATE, i]
        work[FIRST, i] = move
        work[FIRST + 1, i] = start - move
        work[FIRST + 2, i] = 2.0 * move - (start + end)


def culprit(work: Array, n: int) -> int:
    """Return the entry that was the first not to be finite in a trial step, −1 for none."""
    entry = first_not_finite(work[BEGIN_RATE], n)
    for row in range(RATES, RATES + STAGES - 1):
        if entry < 0:
            entry = first_not_finite(work[row], n)
    if entry < 0:
        entry = first_not_finite(work[NEW], n)
    if entry < 0:
        entry = first_not_finite(work[END_RATE], n)
    return entry


def first_step(run: Run, params: Array, work: Array) -> float:
    """Return the first step (Hairer's hinit), with time in units of √(|y|/|ÿ|).

    Hairer measures time in seconds, and so finds other steps for the same motion in other
    units.  Where |y| or |ẏ| is nothing, a fraction of the end time stands for their ratio.
    """
    n, quaternion = run.n, run.quaternion
    rtol, atol, t_end = run.rtol, run.atol, run.t_end
    size = rate = 0.0
    for i in range(n):
        scale = atol + rtol * abs(work[Y, i])
        if in_quaternion(i, quaternion):
            scale = atol + rtol * TURN
        work[ERROR, i] = scale
        size += (work[Y, i] / scale) ** 2
        rate += (work[BEGIN_RATE, i] / scale) ** 2
    unit_time: float = 1e-4 * t_end
    if size > 1e-10 and rate * t_end**2 > 1e-10:
        unit_time = sqrt(size / rate)
    h: float = min(0.01 * unit_time, t_end, run.max_step)
    for i in range(n):
        work[STAGE, i] = work[Y, i] + h * work[BEGIN_RATE, i]
    call(run.address, work[STAGE], params, work[END_RATE])
    run.evaluations += 1
    bend = 0.0
    for i in range(n):
        bend += ((work[END_RATE, i] - work[BEGIN_RATE, i]) / work[ERROR, i]) ** 2
    if size > 1e-10 and bend > 0.0:
        unit_time = sqrt(sqrt(size) * h / sqrt(bend))
    steepest = max(sqrt(bend) / h * unit_time**2, sqrt(rate) * unit_time)
    limit: float = min(100.0 * h, t_end, run.max_step)
    if not steepest < np.inf:
        return h
    if steepest <= 1e-15:
        return limit
    return min(limit, unit_time * root(0.01 / steepest))


# --- made of a tableau ---------------------------------------------------------------------


@dataclass(frozen=True)
class Steps:
    """A tableau as sums and evaluations, on rows of `work`.

    to_end: from row Y with its rate to row NEW, at_end: then to the rate there, errors: the rows
    of errors; dense: what the polynomial takes beyond the cubic, in rows from `first` + 3 on.
    early: whether the errors take the rate at the end, which `to_end` then gives.
    """

    to_end: list[Sum | Rate]
    at_end: list[Sum | Rate]
    errors: list[Sum | Rate]
    dense: list[Sum | Rate]
    early: bool
    first: int
    rows: int


def steps_of(tableau: Tableau) -> Steps:
    """Return the sums and evaluations of a tableau."""
    s, extra = tableau.stages, len(tableau.A) - tableau.stages - 1
    row_of = [BEGIN_RATE, *range(RATES, RATES + s - 1), END_RATE]
    first = RATES + s - 1 + extra
    row_of += range(first - extra, first)

    def weighted(weights: Array) -> Terms:
        rates = zip(row_of, weights.tolist(), strict=False)
        return [(row, weight) for row, weight in rates if weight != 0.0]

    def stages(some: range) -> list[Sum | Rate]:
        each = [(Sum(STAGE, Y, weighted(tableau.A[i])), Rate(STAGE, row_of[i])) for i in some]
        return [step for both in each for step in both]

    at_end: list[Sum | Rate] = [Rate(NEW, END_RATE)]
    early = bool(tableau.errors[:, s].any())
    to_end = [*stages(range(1, s)), Sum(NEW, Y, weighted(tableau.A[s]))]
    errors = zip((ERROR, ERROR3), tableau.errors, strict=False)
    return Steps(
        to_end=to_end + at_end if early else to_end,
        at_end=[] if early else at_end,
        errors=[Sum(row, None, weighted(some)) for row, some in errors],
        dense=[
            *stages(range(s + 1, s + 1 + extra)),
            *(Sum(first + 3 + k, None, weighted(some)) for k, some in enumerate(tableau.dense)),
        ],
        early=early,
        first=first,
        rows=first + 3 + len(tableau.dense),
    )


def order_in_twos(order: int) -> dict[str, int]:
    """Return HALVINGS and REST of an order, 2^HALVINGS REST."""
    return {"HALVINGS": (order & -order).bit_length() - 1, "REST": order // (order & -order)}


def make_stepper(name: str, order: int, tableau: Tableau) -> Stepper:
    """Return what runs a method of this name and order."""
    steps = steps_of(tableau)
    made = SimpleNamespace(
        STAGES=tableau.stages,
        **order_in_twos(order),
        FIRST=steps.first,
        TERMS=steps.rows - steps.first,
        fill_step=row_program(steps.to_end),
        fill_end=row_program(steps.at_end),
        fill_errors=row_program(steps.errors),
        fill_dense=row_program(steps.dense),
        estimate=one_error if len(tableau.errors) == 1 else two_errors,
    )
    told = f"{name}_{digest(order, tableau)}"

    def made_of(function: Any) -> Any:
        part = woven(bound(function, f"{told}_{function.__name__}", **vars(made)))
        setattr(made, function.__name__, part)
        return part

    for function in (root, first_step, culprit, prepare):
        made_of(function)
    hooks = Hooks(*map(made_of, (begin, until, attempt, accept, load, state, keep)))
    return Stepper(
        loops(told, hooks),
        lambda n, tangent: padded_rows(steps.rows, n),  # noqa: ARG005
        stages=tableau.stages,
    )


def digest(order: int, tableau: Tableau) -> str:
    """Return what tells a method from others in the names of its machine code."""
    numbers = (np.array([order]), tableau.A, tableau.errors, tableau.dense)
    return sha256(b"".join(part.tobytes() for part in numbers)).hexdigest()[:12]
