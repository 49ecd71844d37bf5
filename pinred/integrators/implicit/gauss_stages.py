"""The stages of a step of Gauss–Legendre collocation, over a kernel that evaluates all at once.

The method with s stages has order 2s. The step is written in terms of L_j = h b_j f(Y_j): Y_i = y +
Σ_j μ_ij L_j, y₁ = y + Σ_j L_j, with μ_ij = a_ij / b_j. The method is symplectic and preserves
quadratic invariants if μ_ij + μ_ji = 1. Here this holds for the floating-point numbers, too
(M. Antoñana, J. Makazaga, A. Murua, Reducing and monitoring round-off error propagation for
symplectic implicit Runge–Kutta schemes, Numer. Algorithms 76 (2017) 861–880).

The work rows of a step contain the tables. A stage row stores the value of entry i at stage j as
number i·lanes + j. Kernels that evaluate all stages at once use the same layout.

Fixed-point iteration solves the stages; each iteration costs one call of the kernel. Vector
instructions compute all stages, one per SIMD lane.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., sections II.1.3, VIII.6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import sqrt
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ...common.arrays import Array, FrozenArrays
from ..stepping.compiling import compiled, inlined, make_intrinsic, numba_core
from ..stepping.intrinsics import VectorRows, add_pairwise, call
from ..stepping.run_state import NEW, Run, Y, lanes_of


@dataclass(frozen=True)
class Tables(FrozenArrays):
    """Coefficients of the method, padded with zeros to w SIMD lanes.

    Attributes:
        mu: Coefficients μ_ij, (w, w).
        b: Weights b_j of the stage rates in the step end, (w,).
        c: Nodes c_j, the stage times as fractions of the step, (w,).
        last: Weights for which Σ_j last_j L_j is h times the highest Legendre coefficient of ẏ,
            (w,).
        bary: Barycentric weights of c, (w,).
    """

    mu: Array
    b: Array
    c: Array
    last: Array
    bary: Array


@cache
def tables(stages: int) -> Tables:
    """Return the tables of the method with a number of stages."""
    x, weights = legendre.leggauss(stages)
    P = legendre.legvander(x, stages)  # P_k(x_i), (s, s + 1)
    # ∫ from −1 to x of P_k is (P_{k+1} − P_{k−1}) / (2k + 1), and x + 1 for k = 0.
    integrals = np.column_stack(
        [x + 1.0, *((P[:, k + 1] - P[:, k - 1]) / (2 * k + 1) for k in range(1, stages))]
    )
    degree = np.arange(stages)
    mu = 0.5 * integrals @ ((2 * degree + 1) * P[:, :stages]).T
    for i in range(stages):
        mu[i, i] = 0.5
        for j in range(i):
            # 1 − a is exact in floating point if a is at least ½, which holds for one of the two
            # entries.
            big, small = ((i, j), (j, i)) if mu[i, j] >= 0.5 else ((j, i), (i, j))
            mu[small] = 1.0 - mu[big]
    c, lanes = 0.5 * (x + 1.0), lanes_of(stages)
    gaps = c[:, None] - c[None, :] + np.eye(stages)
    padded_mu = np.zeros((lanes, lanes))
    padded_mu[:stages, :stages] = mu

    def padded(row: NDArray[np.floating[Any]]) -> Array:
        return np.concatenate([row, np.zeros(lanes - stages)])

    return Tables(
        mu=padded_mu,
        b=padded(0.5 * weights),
        c=padded(c),
        last=padded((2 * stages - 1) * P[:, stages - 1]),
        bary=padded(1.0 / gaps.prod(axis=1)),
    )


# Rows of `work` after the two state rows. L, OLD, SUB: stage increments L_j = h b_j f(Y_j) of this
# step, of the previous step, and of the shorter step to a report time. CARRY: compensation of the
# sum over all steps. CHANGE and BEST: see `refreshment`. SCALE: weights of the changes in their
# norm. INFO: largest change that may be round-off, and the contraction of an iteration. MU to
# BARY: tables of the method.
CARRY, NEXT_CARRY, STAGE, RATE, L, OLD, SUB, CHANGE, BEST, SCALE = range(2, 12)
MU, GUESS, WITHIN, B, C, LAST, BARY, INFO = range(12, 20)
ROWS = 20


def work_rows(stages: int, n: int, behind: int = 0) -> Array:
    """Allocate the work rows of a step and store the tables of the method in them.

    Args:
        stages: Number of stages.
        n: Number of entries of the state.
        behind: Number of additional floats after the rows, as workspace.
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
        types = numba_core.types
        cgutils = numba_core.cgutils

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
        types = numba_core.types
        cgutils = numba_core.cgutils

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
    cgutils = numba_core.cgutils
    get_function: Callable[..., Any] = cgutils.get_or_insert_function
    return get_function(builder.module, ir.FunctionType(T, [T]), f"llvm.fabs.v{lanes}f64")


def _variable(builder: Any, value: Any) -> Any:
    """Allocate a variable with an initial value; return its address."""
    cgutils = numba_core.cgutils
    return cgutils.alloca_once_value(builder, value)


_multiply4, _multiply8 = product(4), product(8)
_refresh4, _refresh8 = refreshment(4), refreshment(8)


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


# Largest numbers of fixed-point iterations for a step, and for a shorter step to a report time,
# whose first guess is worse.
MOST, MOST_WITHIN = 100, 300
_PATIENCE = 8  # limit on iterations without improvement, far from round-off
# Limits on the contraction, and on the change as a fraction of INFO[0]. Below either limit, the
# iteration stops at the first iteration without improvement.
_FAST, _NEAR = 0.3, 1e-8
_FIRST_SQUARE = 0.5  # contraction of two iterations that is assumed before it can be measured
ROUND_OFF = 0.0  # `limit` with which `iterate` continues until the changes stop decreasing
NO_SOLUTION = -1  # returned instead of a number of iterations if the iteration did not converge


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

    The polynomial through the stage rates of the first step is evaluated at the other step's
    stages.

    Args:
        work: Work rows.
        lanes: Number of SIMD lanes.
        stages: Number of stages.
        table: Row of the table.
        begin: Start of the other step, measured from the start of the first, in lengths of the
            first.
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
    before = previous = expected = np.inf  # sizes of the last two changes, and of the next one
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
        # Positions and momenta may change alternately, so a contraction is that of two iterations,
        # and two changes estimate those that remain.
        if iteration > 1 and size <= before:
            square = size / before if iteration > 2 else _FIRST_SQUARE
            work[INFO, 1] = sqrt(square)
            if limit > 0.0 and (previous + size) * square <= limit * (1.0 - square):
                return iteration
        before, previous = previous, size
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
        # Knuth's two-sum computes the exact round-off, whichever term is larger.
        back = new - old
        work[NEXT_CARRY, i] = (old - (new - back)) + (total - back)
        work[NEW, i] = new


@compiled
def add_increments(work: Array, row: int, lanes: int, y: Array) -> None:
    """Add the sums of the stage increments in a row to y, (n,)."""
    for i in range(y.shape[0]):
        total = 0.0
        for j in range(lanes):
            total += work[row, i * lanes + j]
        y[i] += total
