"""One step of Gauss–Legendre collocation over a kernel that evaluates all stages at once.

The stages are found by fixed-point iteration, which costs one call of such a kernel a turn.
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

# Rows of `work` behind the state.  L and OLD are h b f of this step and the one before; SUB that
# of a step for a report; CARRY what the sum of the steps has rounded away; CHANGE and BEST see
# `refreshment`.  SCALE holds an inverse for each number, INFO what change round-off may leave,
# and the quotient of the last two changes.
CARRY, NEXT_CARRY, STAGE, RATE, L, OLD, SUB, CHANGE, BEST, SCALE = range(2, 12)
MU, GUESS, WITHIN, B, C, LAST, BARY, INFO = range(12, 20)
ROWS = 20

MOST, MOST_WITHIN = 100, 300  # turns of the iteration; for a report, which is guessed worse
_PATIENCE = 8  # turns without improvement, where round-off is far and so is convergence
_FAST, _NEAR = 0.3, 1e-8  # quotient of changes; part of INFO: neither asks for patience
ROUND_OFF = 0.0  # as a limit: go on until nothing improves
NO_SOLUTION = -1  # in place of a number of turns

_multiply4, _multiply8 = product(4), product(8)
_refresh4, _refresh8 = refreshment(4), refreshment(8)


def work_rows(stages: int, n: int, behind: int) -> Array:
    """Return the rows that a step of so many stages works on, tables filled in.

    behind: how many numbers are to have room behind the rows.
    """
    lanes = lanes_of(stages)
    stride = max((n + 1) * lanes, lanes * lanes)
    work = np.zeros((ROWS + -(-behind // stride), stride))
    method = tables(stages)
    work[MU, : lanes * lanes] = method.mu.T.ravel()
    for row, numbers in (
        (B, method.b), (C, method.c), (LAST, method.last), (BARY, method.bary),
    ):  # fmt: skip
        work[row, :lanes] = numbers
    return work


@compiled
def multiply(work: Array, out: int, base: int, table: int, row: int, n: int, lanes: int) -> None:
    """Fill row `out` with row `base`, or nothing for −1, and a table times row `row`."""
    if lanes == 4:
        _multiply4(work, out, base, table, row, n)
    else:
        _multiply8(work, out, base, table, row, n)


@compiled
def refresh(work: Array, row: int, n: int, lanes: int, h: float) -> float:
    """Set L in a row to h b RATE; return the norm of the change, weighted by SCALE."""
    if lanes == 4:
        return float(np.sqrt(_refresh4(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)))
    return float(np.sqrt(_refresh8(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)))


@compiled
def scale_by_largest(work: Array, n: int, lanes: int, base: int, row: int) -> None:
    """Fill SCALE with the inverse of the largest number in row `base` and in stage row `row`."""
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
    """Put h b ẏ at the start of the step into `row`, all lanes alike: a first guess."""
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
    """Fill the table that makes, of L of a step, that of another, `ratio` times as long.

    begin: of the other one, 0 where the step begins and 1 where it ends.  The rates are those
    of the polynomial through the rates of the stages.
    """
    c, b, bary = work[C], work[B], work[BARY]
    for k in range(stages):
        at = begin + ratio * c[k]
        for j in range(stages):
            basis = bary[j]
            for i in range(stages):
                if i != j:
                    basis *= at - c[i]
            work[table, j * lanes + k] = ratio * b[k] / b[j] * basis


@compiled
def guess(work: Array, n: int, lanes: int, table: int, source: int, row: int) -> None:
    """Fill `row` from the L in `source` by a table of prepare_guess."""
    multiply(work, row, -1, table, source, n, lanes)


@compiled
def guess_evenly(run: Run, params: Array, work: Array, row: int, h: float) -> None:
    """Do as start_evenly, in a run that counts its evaluations."""
    start_evenly(run.address, params, work, run.n, run.lanes, row, h)
    run.evaluations += run.stages


@compiled
def iterate(run: Run, params: Array, work: Array, row: int, h: float, limit: float) -> int:
    """Bring the L in `row` from a guess to the solution; return the turns it took.

    limit: on what is still to come, by SCALE; ROUND_OFF to go on until no number changes by
    less than before in two turns.  NO_SOLUTION if that does not come about.
    """
    n, lanes = run.n, run.lanes
    change, best = work[CHANGE], work[BEST]
    for i in range(n * lanes):
        change[i] = best[i] = np.inf
    before = expected = np.inf
    idle = 0
    for turn in range(1, (MOST_WITHIN if row == SUB else MOST) + 1):
        run.evaluations += run.stages
        multiply(work, STAGE, Y, MU, row, n, lanes)
        call(run.address, work[STAGE], params, work[RATE])
        size = refresh(work, row, n, lanes, h)
        if not size < np.inf or (turn > 3 and size > 10.0 * before and size > work[INFO, 0]):
            return NO_SOLUTION
        improved = 0.0
        for j in range(lanes):
            improved += best[n * lanes + j]
        if size == 0.0:
            return turn
        # Round-off goes to and fro; an iteration that does not converge does so by far, and one
        # that converges slowly may do it in waves.
        idle = idle + 1 if turn > 2 and improved == 0.0 else 0
        expected = size if turn == 1 else _FAST * expected
        if idle > 0 and size <= max(limit, work[INFO, 0]):
            patient = size > expected and size > _NEAR * work[INFO, 0]
            if idle >= (_PATIENCE if patient else 1):
                return turn
        if turn > 1 and size <= before:
            part = size / before
            work[INFO, 1] = part
            if limit > 0.0 and size * part <= limit * (1.0 - part):
                return turn
        before = size
    return NO_SOLUTION


@compiled
def finish(work: Array, n: int, lanes: int, row: int) -> None:
    """Put the end of the step into NEW, by compensated summation."""
    for i in range(n):
        total = work[CARRY, i]
        for j in range(lanes):
            total += work[row, i * lanes + j]
        old = work[Y, i]
        new = old + total
        # Knuth's two-sum: exact, whichever of the two is larger.
        back = new - old
        work[NEXT_CARRY, i] = (old - (new - back)) + (total - back)
        work[NEW, i] = new
