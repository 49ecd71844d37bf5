"""One step of Gauss–Legendre collocation over a kernel that evaluates all stages at once.

Fixed-point iteration solves the stages; each iteration costs one call of the kernel. Vector
instructions compute all stages, one per SIMD lane.
E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section VIII.6.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import compiled
from ..stepping.kernel_call import call
from ..stepping.run_state import Run
from ..stepping.state_rows import NEW, Y
from .stage_products import multiply, refresh
from .tables import (
    BARY,
    BEST,
    CARRY,
    CHANGE,
    INFO,
    MU,
    NEXT_CARRY,
    RATE,
    SCALE,
    STAGE,
    SUB,
    B,
    C,
)

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
