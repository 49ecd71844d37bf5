"""Adjoints of a run of a Gauss method, of the steps it took: by the implicit function theorem.

Of a step Y_i = y + Σ μ_ij L_j with L_j = h b_j f(Y_j), y₁ = y + Σ L_j, a covector λ₁ of y₁ goes
back by the same equations with μ turned round,

    Λ_j = λ₁ + Σ μ_ij Z_i,    Z_i = h b_i (∂f/∂y)ᵀ Λ_i,    λ = λ₁ + Σ Z_i

(see `tables` for μ).  Both are found by fixed points, to round-off, whatever an integrator has
left of its tolerance: derivatives are those of the converged steps.  Stages begin with the L that
the run has kept, if it has, else with those of the step behind, continued; so does Z.  All stages
are evaluated at once, in lanes.  A state between the ends of a step is the end of a shorter one.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...common.arrays import Array
from ..explicit.forward_sensitivities import across, to_unit
from ..stepping.compiling import compiled
from ..stepping.kernel_call import call, call_adjoint
from ..stepping.state_rows import NEW, Y
from .stages import (
    GUESS,
    MU,
    OLD,
    RATE,
    ROWS,
    STAGE,
    SUB,
    WITHIN,
    B,
    L,
    guess,
    multiply,
    prepare_guess,
    refresh,
    scale_by_largest,
    start_evenly,
    work_rows,
)
from .tables import tables

# Rows behind those of `stages`: μ turned round, the covectors Λ of the stages, Z of this step, of
# the one behind and of one for a report.  The covector at the end of a step is in row NEW.
TURNED, SEED, Z, OLD_Z, SUB_Z = range(ROWS, ROWS + 5)

_MOST = 400  # turns
_PATIENCE = 2  # turns without improvement at which round-off is all that is left
_WAVES = 20  # such turns where it is not: slow iterations come in waves
_CLOSE = 1e-10  # change, in parts of the largest number, above which nothing has converged
_EPS = float(np.finfo(float).eps)
_SURE = 64.0 * _EPS  # change below which the quotient of two says what is still to come
_FURTHEST = 2.0  # lengths of the step behind over which its rates are continued


def reverse_rows(stages: int, n: int) -> Array:
    """Return the rows that `reverse` works on, tables filled in."""
    return _first_rows(stages, n).copy()


@lru_cache(maxsize=16)
def _first_rows(stages: int, n: int) -> Array:
    first = work_rows(stages, n, 0)
    work = np.zeros((SUB_Z + 1, first.shape[1]))
    work[:ROWS] = first
    mu = tables(stages).mu
    work[TURNED, : mu.size] = mu.ravel()
    return work


@compiled
def reverse(
    address: int,
    adjoint: int,
    params: Array,
    stages: int,
    lanes: int,
    quaternion: int,
    knots: Array,
    stored: Array,
    times: Array,
    at_times: Array,
    covector: Array,
    by_params: Array,
    work: Array,
    both: Array,
) -> int:
    """Bring a covector (n,) at the last knot back to the first, in place.

    stored: (steps + 1, n) states at the knots, or (steps + 1, n + n lanes) with the L that led
    there.  at_times: (T, n) covectors of the states at times, which are lost.  by_params: (p,), to
    which the slopes by parameters are added.  both: ((n + p) lanes,).  Return 0, or 1 plus the
    first step that is not found.
    """
    n, first, behind = covector.shape[0], times.shape[0], 0.0
    for step in range(knots.shape[0] - 2, -1, -1):
        for i in range(n):
            work[Y, i] = stored[step + 1, i]
        size = to_unit(work[Y], quaternion)
        while first > 0 and times[first - 1] >= knots[step + 1]:
            first -= 1
            across(work[Y], size, quaternion, at_times[first], 1)
            for i in range(n):
                covector[i] += at_times[first, i]
        for i in range(n):
            work[Y, i] = stored[step, i]
        if step == 0:
            to_unit(work[Y], quaternion)
        h = knots[step + 1] - knots[step]
        near = 0.0 < h <= _FURTHEST * behind
        if near:
            prepare_guess(work, lanes, stages, GUESS, -h / behind, h / behind)
        if stored.shape[1] > n:
            for i in range(n * lanes):
                work[L, i] = stored[step + 1, n + i]
        elif near:
            guess(work, n, lanes, GUESS, OLD, L)
        else:
            start_evenly(address, params, work, n, lanes, L, h)
        if near:
            guess(work, n, lanes, GUESS, OLD_Z, Z)
        else:
            work[Z] = 0.0
        if not (
            find_stages(address, params, work, n, lanes, L, h)
            and step_back(adjoint, params, work, lanes, Z, h, covector, by_params, both)
        ):
            return step + 1
        behind = h
        for i in range(n * lanes):
            work[OLD, i] = work[L, i]
            work[OLD_Z, i] = work[Z, i]
        while first > 0 and times[first - 1] > knots[step]:
            first -= 1
            part = times[first] - knots[step]
            prepare_guess(work, lanes, stages, WITHIN, 0.0, part / h)
            guess(work, n, lanes, WITHIN, L, SUB)
            if not find_stages(address, params, work, n, lanes, SUB, part):
                return step + 1
            for i in range(n):
                total = 0.0
                for j in range(lanes):
                    total += work[SUB, i * lanes + j]
                both[i] = work[Y, i] + total
            size = to_unit(both[:n], quaternion)
            across(both[:n], size, quaternion, at_times[first], 1)
            work[SUB_Z] = 0.0
            if not step_back(
                adjoint, params, work, lanes, SUB_Z, part, at_times[first], by_params, both
            ):
                return step + 1
            for i in range(n):
                covector[i] += at_times[first, i]
    for r in range(first):
        for i in range(n):
            covector[i] += at_times[r, i]
    return 0


@compiled
def find_stages(
    address: int, params: Array, work: Array, n: int, lanes: int, row: int, h: float
) -> bool:
    """Find the L in `row` from a guess, and put the stages into STAGE; return whether it is."""
    scale_by_largest(work, n, lanes, Y, row)
    before, best, idle = np.inf, np.inf, 0
    for _ in range(_MOST):
        multiply(work, STAGE, Y, MU, row, n, lanes)
        call(address, work[STAGE], params, work[RATE])
        change = refresh(work, row, n, lanes, h)
        if not change < np.inf:
            return False
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, before, best, idle):
            multiply(work, STAGE, Y, MU, row, n, lanes)
            return best <= _CLOSE
        before = change
    return False


@compiled
def step_back(
    adjoint: int,
    params: Array,
    work: Array,
    lanes: int,
    row: int,
    h: float,
    covector: Array,
    by_params: Array,
    both: Array,
) -> bool:
    """Bring a covector (n,) back over a step with stages in STAGE, in place; return whether it is.

    row: of Z, with a guess in it.  both: ((n + p) lanes,).
    """
    n, p = covector.shape[0], by_params.shape[0]
    for i in range(n):
        work[NEW, i] = covector[i]
    scale_by_largest(work, n, lanes, NEW, row)
    before, best, idle = np.inf, np.inf, 0
    found = False
    for _ in range(_MOST):
        multiply(work, SEED, NEW, TURNED, row, n, lanes)
        call_adjoint(adjoint, work[STAGE], params, work[SEED], both)
        for i in range(n * lanes):
            work[RATE, i] = both[i]
        change = refresh(work, row, n, lanes, h)
        if not change < np.inf:
            return False
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, before, best, idle):
            found = best <= _CLOSE
            break
        before = change
    for i in range(n):
        for j in range(lanes):
            covector[i] += work[row, i * lanes + j]
    for i in range(p):
        for j in range(lanes):
            by_params[i] += h * work[B, j] * both[(n + i) * lanes + j]
    return found


@compiled
def _settled(change: float, before: float, best: float, idle: int) -> bool:
    """Whether further turns of a fixed point leave nothing to gain."""
    if change <= _EPS or idle >= (_PATIENCE if best <= _CLOSE else _WAVES):
        return True
    quotient = change / before
    return change <= _SURE and quotient < 1.0 and change * quotient <= _EPS * (1.0 - quotient)
