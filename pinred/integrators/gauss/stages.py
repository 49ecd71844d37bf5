"""One step of Gauss–Legendre collocation over a kernel that evaluates all stages at once.

Fixed-point iteration solves the stages; each iteration costs one call of the kernel. Vector
instructions compute all stages, one per SIMD lane.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section VIII.6.

A stage row stores the value of entry i at stage j as number i·lanes + j. Kernels that evaluate
all stages at once use the same layout.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types

from ...common.arrays import Array
from ..stepping.compiling import compiled, inlined, make_intrinsic
from ..stepping.kernel_call import call
from ..stepping.run_state import NEW, Run, Y
from ..stepping.vector_rows import VectorRows, add_pairwise
from .tables import lanes_of, tables

_CONTRACT = ("contract",)


def product(lanes: int) -> Callable[..., None]:
    """Return the compiled function multiply(work, out, base, table, row, n).

    It computes row `out` = row `base` + table · row `row` for n entries. `out` and `row` are stage
    rows. `base` has one number per entry, or is −1 for zero. `table` is (lanes, lanes), stored by
    columns.
    """

    @make_intrinsic
    def multiply(  # type: ignore[no-untyped-def]
        typing: Any, work: Any, out: Any, base: Any, table: Any, row: Any, n: Any
    ):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rows = VectorRows(context, builder, signature.args[0], arguments[0], lanes)
            out, base, table, row, n = arguments[1:]
            integer = n.type
            columns = [rows.load(table, integer(lanes * j)) for j in range(lanes)]
            with_base = builder.icmp_signed(">=", base, integer(0))
            with cgutils.for_range(builder, n) as loop:
                first = builder.mul(loop.index, integer(lanes))
                start = builder.select(
                    with_base,
                    rows.number(builder.select(with_base, base, integer(0)), loop.index),
                    ir.Constant(rows.vector, [0.0] * lanes),
                )
                terms = [
                    builder.fmul(
                        column,
                        rows.number(row, builder.add(first, integer(j))),
                        flags=_CONTRACT,
                    )
                    for j, column in enumerate(columns)
                ]
                total = builder.fadd(
                    start, add_pairwise(builder, terms, _CONTRACT), flags=_CONTRACT
                )
                rows.store(total, out, first)
            return context.get_dummy_value()

        integer_type = types.int64
        return types.void(
            work, integer_type, integer_type, integer_type, integer_type, integer_type
        ), generate

    return multiply


def refreshment(lanes: int) -> Callable[..., float]:
    """Return refresh(work, row, rate, last, best, scale, weights, n, h), one fixed-point iteration.

    It sets the stage row `row` to h weights · rate and returns Σ (change · scale)². `last` contains
    the changes of the previous iteration. Positions and momenta may change alternately, so the
    larger of two successive changes is compared, and `best` contains its minimum so far. The vector
    after the stages of `best` counts the entries whose minimum has improved.
    """

    @make_intrinsic
    def refresh(  # type: ignore[no-untyped-def]
        typing: Any, work: Any, row: Any, rate: Any, last: Any, best: Any, scale: Any,
        weights: Any, n: Any, h: Any,
    ):  # fmt: skip
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rows = VectorRows(context, builder, signature.args[0], arguments[0], lanes)
            row, rate, last, best, scale, weights, n, h = arguments[1:]
            integer, T = n.type, rows.vector
            zero, one = ir.Constant(T, [0.0] * lanes), ir.Constant(T, [1.0] * lanes)
            factor = builder.fmul(rows.splat(h), rows.load(weights, integer(0)))
            size, improvements = (_variable(builder, zero) for _ in range(2))
            fabs = _absolute(builder, T, lanes)
            with cgutils.for_range(builder, n) as loop:
                first = builder.mul(loop.index, integer(lanes))
                new = builder.fmul(factor, rows.load(rate, first))
                change = builder.call(fabs, [builder.fsub(new, rows.load(row, first))])
                rows.store(new, row, first)
                previous, smallest = rows.load(last, first), rows.load(best, first)
                rows.store(change, last, first)
                larger = builder.select(
                    builder.fcmp_ordered(">", change, previous), change, previous
                )
                improved = builder.and_(
                    builder.fcmp_ordered("<", larger, smallest),
                    builder.fcmp_ordered(">", larger, zero),
                )
                rows.store(builder.select(improved, larger, smallest), best, first)
                counted = builder.fadd(
                    builder.load(improvements), builder.select(improved, one, zero)
                )
                builder.store(counted, improvements)
                relative = builder.fmul(change, rows.number(scale, loop.index))
                total = builder.fadd(builder.load(size), builder.fmul(relative, relative))
                builder.store(total, size)
            rows.store(builder.load(improvements), best, builder.mul(n, integer(lanes)))
            summed = builder.load(size)
            sums = [builder.extract_element(summed, ir.IntType(32)(j)) for j in range(lanes)]
            return add_pairwise(builder, sums)

        integer_type = types.int64
        argument_types = (work, *(integer_type,) * 7, types.float64)
        return types.float64(*argument_types), generate

    return refresh


def _absolute(builder: Any, T: Any, lanes: int) -> Any:
    """Return LLVM's function for the absolute values of a vector."""
    get_function: Callable[..., Any] = cgutils.get_or_insert_function
    return get_function(builder.module, ir.FunctionType(T, [T]), f"llvm.fabs.v{lanes}f64")


def _variable(builder: Any, value: Any) -> Any:
    """Allocate a variable with an initial value; return its address."""
    allocate: Callable[..., Any] = cgutils.alloca_once_value
    return allocate(builder, value)


# Rows of `work` after the two state rows. L, OLD, SUB: stage increments L_j = h b_j f(Y_j) of this
# step, of the previous step, and of the shorter step to a report time. CARRY: compensation of the
# sum over all steps. CHANGE and BEST: see `refreshment`. SCALE: weights of the changes in their
# norm. INFO: largest change that may be round-off, and the ratio of the last two changes. MU to
# BARY: tables of the method.
CARRY, NEXT_CARRY, STAGE, RATE, L, OLD, SUB, CHANGE, BEST, SCALE = range(2, 12)
MU, GUESS, WITHIN, B, C, LAST, BARY, INFO = range(12, 20)
ROWS = 20

# Largest numbers of fixed-point iterations for a step, and for a shorter step to a report time,
# whose first guess is worse.
MOST, MOST_WITHIN = 100, 300
_PATIENCE = 8  # limit on iterations without improvement, far from round-off
# Limits on the contraction, and on the change as a fraction of INFO[0]. Below either limit, the
# iteration stops at the first iteration without improvement.
_FAST, _NEAR = 0.3, 1e-8
ROUND_OFF = 0.0  # `limit` with which `iterate` continues until the changes stop decreasing
NO_SOLUTION = -1  # returned instead of a number of iterations if the iteration did not converge

_multiply4, _multiply8 = product(4), product(8)
_refresh4, _refresh8 = refreshment(4), refreshment(8)


def work_rows(stages: int, n: int, behind: int) -> Array:
    """Allocate the work rows of a step and store the tables of the method in them.

    Args:
        stages: Number of stages.
        n: Number of entries of the state.
        behind: Number of additional floats behind the rows, as workspace.
    Returns:
        The rows, (ROWS + …, stride).
    """
    lanes = lanes_of(stages)
    stride = max((n + 1) * lanes, lanes * lanes)
    work = np.zeros((ROWS + -(-behind // stride), stride))
    method = tables(stages)
    work[MU, : lanes * lanes] = method.mu.T.ravel()
    for row, values in (
        (B, method.b), (C, method.c), (LAST, method.last), (BARY, method.bary),
    ):  # fmt: skip
        work[row, :lanes] = values
    return work


@inlined
def multiply(work: Array, out: int, base: int, table: int, row: int, n: int, lanes: int) -> None:
    """Compute a table times a stage row, plus a row.

    Args:
        work: Work rows.
        out: Stage row of the result.
        base: Row to add, one number per entry, −1 for zero.
        table: Row of the table, stored by columns.
        row: Stage row to multiply.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
    """
    if lanes == 4:
        _multiply4(work, out, base, table, row, n)
    else:
        _multiply8(work, out, base, table, row, n)


@inlined
def refresh(work: Array, row: int, n: int, lanes: int, h: float) -> float:
    """Set the stage increments in a row to h b RATE; return the weighted norm of their change.

    Args:
        work: Work rows.
        row: Row of the stage increments L.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        h: Length of the step [s].
    Returns:
        The norm, the square root of Σ (change · scale)².
    """
    if lanes == 4:
        total = _refresh4(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)
    else:
        total = _refresh8(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)
    return float(np.sqrt(total))


@compiled
def scale_by_largest(work: Array, n: int, lanes: int, base: int, row: int) -> None:
    """Fill SCALE with the reciprocal of the largest absolute value in two rows.

    Args:
        work: Work rows.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        base: Row with one number per entry.
        row: Stage row, often a first guess of the solution.
    """
    largest = 0.0
    for i in range(n):
        largest = max(largest, abs(work[base, i]))
        for j in range(lanes):
            largest = max(largest, abs(work[row, i * lanes + j]))
    inverse = 1.0 / largest if largest > 0.0 else 1.0
    for i in range(n):
        work[SCALE, i] = inverse


@compiled
def start_evenly(
    address: int, params: Array, work: Array, n: int, lanes: int, row: int, h: float
) -> None:
    """Set the stage increments in a row to h b ẏ(start) at all stages, as a first guess.

    Args:
        address: Address of the kernel.
        params: Parameters, (p,).
        work: Work rows.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        row: Row of the stage increments L.
        h: Length of the step [s].
    """
    for i in range(n):
        for j in range(lanes):
            work[STAGE, i * lanes + j] = work[Y, i]
    call(address, work[STAGE], params, work[RATE])
    for i in range(n):
        for j in range(lanes):
            work[row, i * lanes + j] = h * work[B, j] * work[RATE, i * lanes + j]


@compiled
def prepare_guess(
    work: Array, lanes: int, stages: int, table: int, begin: float, ratio: float
) -> None:
    """Compute the table that extrapolates the stage increments of one step to those of another.

    The polynomial through the stage rates of the first step gives the rates of the other step.

    Args:
        work: Work rows.
        lanes: Number of SIMD lanes.
        stages: Number of stages.
        table: Row of the table.
        begin: Start of the other step, in lengths of the first, from its start.
        ratio: Length of the other step, in lengths of the first.
    """
    c, b, bary = work[C], work[B], work[BARY]
    for k in range(stages):
        position = begin + ratio * c[k]
        for j in range(stages):
            basis = bary[j]
            for i in range(stages):
                if i != j:
                    basis *= position - c[i]
            work[table, j * lanes + k] = ratio * b[k] / b[j] * basis


@compiled
def guess(work: Array, n: int, lanes: int, table: int, source: int, row: int) -> None:
    """Extrapolate the stage increments of another step with a table of `prepare_guess`.

    Args:
        work: Work rows.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        table: Row of the table.
        source: Row of the known stage increments.
        row: Row of the extrapolated stage increments, output.
    """
    multiply(work, row, -1, table, source, n, lanes)


@compiled
def guess_evenly(run: Run, params: Array, work: Array, row: int, h: float) -> None:
    """Fill a row of stage increments with `start_evenly`, and count the evaluations.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        row: Row of the stage increments L.
        h: Length of the step [s].
    """
    start_evenly(run.address, params, work, run.n, run.lanes, row, h)
    run.evaluations += run.stages


@compiled
def iterate(run: Run, params: Array, work: Array, row: int, h: float, limit: float) -> int:
    """Solve for the stage increments in `row` by fixed-point iteration from a first guess.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        row: Row of the stage increments L.
        h: Length of the step [s].
        limit: Limit on the remaining error, measured by SCALE. With ROUND_OFF, the iteration
            continues until the change of no entry decreases.
    Returns:
        The number of iterations, or NO_SOLUTION.
    """
    n, lanes = run.n, run.lanes
    change, best = work[CHANGE], work[BEST]
    for i in range(n * lanes):
        change[i] = best[i] = np.inf
    previous = expected = np.inf
    idle = 0
    for iteration in range(1, (MOST_WITHIN if row == SUB else MOST) + 1):
        run.evaluations += run.stages
        multiply(work, STAGE, Y, MU, row, n, lanes)
        call(run.address, work[STAGE], params, work[RATE])
        size = refresh(work, row, n, lanes, h)
        if not size < np.inf or (iteration > 3 and size > 10.0 * previous and size > work[INFO, 0]):
            return NO_SOLUTION
        improved = 0.0
        for j in range(lanes):
            improved += best[n * lanes + j]
        if size == 0.0:
            return iteration
        # Round-off fluctuates, so a lack of improvement ends the iteration. Changes grow far above
        # round-off if the iteration diverges, and come in waves if it is slow.
        idle = idle + 1 if iteration > 2 and improved == 0.0 else 0
        expected = size if iteration == 1 else _FAST * expected
        if idle > 0 and size <= max(limit, work[INFO, 0]):
            patient = size > expected and size > _NEAR * work[INFO, 0]
            if idle >= (_PATIENCE if patient else 1):
                return iteration
        if iteration > 1 and size <= previous:
            ratio = size / previous
            work[INFO, 1] = ratio
            if limit > 0.0 and size * ratio <= limit * (1.0 - ratio):
                return iteration
        previous = size
    return NO_SOLUTION


@compiled
def finish(work: Array, n: int, lanes: int, row: int) -> None:
    """Compute the end of the step in row NEW by compensated summation.

    Args:
        work: Work rows.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        row: Row of the stage increments L.
    """
    for i in range(n):
        total = work[CARRY, i]
        for j in range(lanes):
            total += work[row, i * lanes + j]
        old = work[Y, i]
        new = old + total
        # Knuth's two-sum gives the exact round-off, whichever term is larger.
        back = new - old
        work[NEXT_CARRY, i] = (old - (new - back)) + (total - back)
        work[NEW, i] = new
