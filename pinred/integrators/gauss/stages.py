"""One step of Gauss–Legendre collocation over a kernel that evaluates all stages at once.

Fixed-point iteration solves the stages; each iteration costs one call of the kernel.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section VIII.6.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import compiled
from ..stepping.kernel_call import call
from ..stepping.run_record import Run
from ..stepping.state_rows import NEW, Y
from .lane_sums import product, refreshment
from .tables import lanes_of, tables

# Rows of `work` after the two state rows. L and OLD: h b f of this step and the previous one. SUB:
# h b f of a step to a report time. CARRY: round-off of the sum of all steps. CHANGE and BEST: see
# `refreshment`. SCALE: factors by which changes are measured. INFO: largest change that may be
# round-off, and the ratio of the last two changes. MU to BARY: tables of the method.
CARRY, NEXT_CARRY, STAGE, RATE, L, OLD, SUB, CHANGE, BEST, SCALE = range(2, 12)
MU, GUESS, WITHIN, B, C, LAST, BARY, INFO = range(12, 20)
ROWS = 20

MOST, MOST_WITHIN = 100, 300  # iterations; for a report time, with its worse first guess
_PATIENCE = 8  # iterations without improvement far from round-off
# Contraction, and fraction of INFO[0], below which one iteration without improvement suffices.
_FAST, _NEAR = 0.3, 1e-8
ROUND_OFF = 0.0  # limit of `iterate` that continues until the changes stop decreasing
NO_SOLUTION = -1  # returned instead of a number of iterations

_multiply4, _multiply8 = product(4), product(8)
_refresh4, _refresh8 = refreshment(4), refreshment(8)


def work_rows(stages: int, n: int, behind: int) -> Array:
    """Allocate the work rows of a step and fill in the tables.

    Args:
        stages: Number of stages.
        n: Entries of the state.
        behind: Numbers of additional space behind the rows.
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


@compiled
def multiply(work: Array, out: int, base: int, table: int, row: int, n: int, lanes: int) -> None:
    """Compute a table times a stage row, plus a row.

    Args:
        work: Work rows.
        out: Stage row of the result.
        base: Row to add, one number per entry, −1 for zero.
        table: Row of the table, stored by columns.
        row: Stage row to multiply.
        n: Entries of the state.
        lanes: Number of SIMD lanes.
    """
    if lanes == 4:
        _multiply4(work, out, base, table, row, n)
    else:
        _multiply8(work, out, base, table, row, n)


@compiled
def refresh(work: Array, row: int, n: int, lanes: int, h: float) -> float:
    """Set L in a row to h b RATE; return the norm of the change, weighted by SCALE.

    Args:
        work: Work rows.
        row: Row of L.
        n: Entries of the state.
        lanes: Number of SIMD lanes.
        h: Length of the step [s].
    Returns:
        The norm.
    """
    if lanes == 4:
        return float(np.sqrt(_refresh4(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)))
    return float(np.sqrt(_refresh8(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)))


@compiled
def scale_by_largest(work: Array, n: int, lanes: int, base: int, row: int) -> None:
    """Fill SCALE with 1 / the largest number in two rows.

    Args:
        work: Work rows.
        n: Entries of the state.
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
    """Set a row of L to h b ẏ(start) at all stages, as a first guess.

    Args:
        address: Address of the kernel.
        params: Parameters, (p,).
        work: Work rows.
        n: Entries of the state.
        lanes: Number of SIMD lanes.
        row: Row of L.
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
    """Compute the table that extrapolates L of one step to L of another.

    The rates of the other step are those of the polynomial through the stage rates of the first.

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
    """Fill a row of L from another by a table of `prepare_guess`.

    Args:
        work: Work rows.
        n: Entries of the state.
        lanes: Number of SIMD lanes.
        table: Row of the table.
        source: Row of the known L.
        row: Row of the guess.
    """
    multiply(work, row, -1, table, source, n, lanes)


@compiled
def guess_evenly(run: Run, params: Array, work: Array, row: int, h: float) -> None:
    """Fill a row of L by `start_evenly`, and count the evaluations.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        row: Row of L.
        h: Length of the step [s].
    """
    start_evenly(run.address, params, work, run.n, run.lanes, row, h)
    run.evaluations += run.stages


@compiled
def iterate(run: Run, params: Array, work: Array, row: int, h: float, limit: float) -> int:
    """Iterate the L in `row` from a guess to the solution, by fixed points.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        row: Row of L.
        h: Length of the step [s].
        limit: Limit on the remaining error, measured by SCALE. With ROUND_OFF, the iteration
            continues until no number's change decreases.
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
        # Round-off fluctuates, so a lack of improvement ends the iteration. A diverging one grows
        # far above round-off; a slowly converging one may improve in waves.
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
        n: Entries of the state.
        lanes: Number of SIMD lanes.
        row: Row of L.
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
