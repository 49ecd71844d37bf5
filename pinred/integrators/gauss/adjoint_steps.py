"""Backward pass over the steps of Gauss's methods, by the implicit function theorem.

For a step Y_i = y + Σ μ_ij L_j with L_j = h b_j f(Y_j), y₁ = y + Σ L_j, a covector λ₁ of y₁ is
propagated back by the same equations with μ transposed,

    Λ_j = λ₁ + Σ μ_ij Z_i,    Z_i = h b_i (∂f/∂y)ᵀ Λ_i,    λ = λ₁ + Σ Z_i

(see `tables` for μ). Fixed-point iteration solves both equations to round-off, whatever tolerance
the integrator used. The results are thus derivatives of the converged steps. The first guess of L
is the L that the run has stored. If the run has stored none, it is extrapolated from the step
treated before. The first guess of Z is extrapolated, too. All stages are evaluated at once, in SIMD
lanes. A state inside a step is the end of a shorter step.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...common.arrays import Array
from ..explicit.forward_sensitivities import across, to_unit
from ..stepping.compiling import compiled
from ..stepping.kernel_call import call, call_adjoint
from ..stepping.run_state import NEW, Y
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

# Rows after those of `stages`: μ transposed, the covectors Λ of the stages, and Z of this step, of
# the step treated before, and of a shorter step to a report time. Row NEW contains the covector at
# the end of the step.
TRANSPOSED, SEED, Z, OLD_Z, SUB_Z = range(ROWS, ROWS + 5)

_MOST = 400  # largest number of fixed-point iterations per solve
_PATIENCE = 2  # limit on iterations without improvement, near round-off
_WAVES = 20  # the same limit far from round-off, where slow convergence comes in waves
# Relative change above which an iteration that has stopped improving counts as not converged.
_CLOSE = 1e-10
_EPS = float(np.finfo(float).eps)
_SURE = 64.0 * _EPS  # change below which the ratio of two changes predicts the remaining error
_FURTHEST = 2.0  # limit of the extrapolation, in lengths of the step treated before


def reverse_rows(stages: int, n: int) -> Array:
    """Return the work rows of `reverse`, with the tables of the method stored in them."""
    return _first_rows(stages, n).copy()


@lru_cache(maxsize=16)
def _first_rows(stages: int, n: int) -> Array:
    stage_rows = work_rows(stages, n, 0)
    work = np.zeros((SUB_Z + 1, stage_rows.shape[1]))
    work[:ROWS] = stage_rows
    mu = tables(stages).mu
    work[TRANSPOSED, : mu.size] = mu.ravel()
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
    """Propagate a covector (n,) at the last step end back to the first, in place.

    Args:
        address: Address of the kernel.
        adjoint: Address of its adjoint kernel.
        params: Parameters, (p,).
        stages: Number of stages.
        lanes: Number of SIMD lanes, idle lanes included.
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        knots: Times of the step ends, (K,) [s].
        stored: States at the step ends, (K, n), or (K, n + n lanes) with the stage increments L of
            each step.
        times: Sorted report times, (T,) [s].
        at_times: Covectors of the states at the report times, (T, n); overwritten.
        covector: Covector, changed in place.
        by_params: Derivative with respect to the parameters, (p,); the result is added to it.
        work: Work rows, see `reverse_rows`.
        both: Workspace ((n + p) lanes,) for the output of the adjoint kernel.
    Returns:
        0, or 1 plus the index of the first step whose equations did not converge.
    """
    n, first, last_h = covector.shape[0], times.shape[0], 0.0
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
        near = 0.0 < h <= _FURTHEST * last_h
        if near:
            prepare_guess(work, lanes, stages, GUESS, -h / last_h, h / last_h)
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
        last_h = h
        for i in range(n * lanes):
            work[OLD, i] = work[L, i]
            work[OLD_Z, i] = work[Z, i]
        while first > 0 and times[first - 1] > knots[step]:
            first -= 1
            elapsed = times[first] - knots[step]
            prepare_guess(work, lanes, stages, WITHIN, 0.0, elapsed / h)
            guess(work, n, lanes, WITHIN, L, SUB)
            if not find_stages(address, params, work, n, lanes, SUB, elapsed):
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
                adjoint, params, work, lanes, SUB_Z, elapsed, at_times[first], by_params, both
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
    """Solve for the stage increments in `row` from a first guess, and write the stages to STAGE.

    Args:
        address: Address of the kernel.
        params: Parameters, (p,).
        work: Work rows.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes, idle lanes included.
        row: Row of the stage increments L.
        h: Length of the step [s].
    Returns:
        Whether the iteration converged.
    """
    scale_by_largest(work, n, lanes, Y, row)
    previous, best, idle = np.inf, np.inf, 0
    for _ in range(_MOST):
        multiply(work, STAGE, Y, MU, row, n, lanes)
        call(address, work[STAGE], params, work[RATE])
        change = refresh(work, row, n, lanes, h)
        if not change < np.inf:
            return False
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, previous, best, idle):
            multiply(work, STAGE, Y, MU, row, n, lanes)
            return best <= _CLOSE
        previous = change
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
    """Propagate a covector (n,) back over a step with stages in STAGE, in place.

    Args:
        adjoint: Address of the adjoint kernel.
        params: Parameters, (p,).
        work: Work rows.
        lanes: Number of SIMD lanes, idle lanes included.
        row: Row of Z, which contains a first guess.
        h: Length of the step [s].
        covector: Covector, changed in place.
        by_params: Derivative with respect to the parameters, (p,); the result is added to it.
        both: Workspace ((n + p) lanes,) for the output of the adjoint kernel.
    Returns:
        Whether the iteration converged.
    """
    n, p = covector.shape[0], by_params.shape[0]
    for i in range(n):
        work[NEW, i] = covector[i]
    scale_by_largest(work, n, lanes, NEW, row)
    previous, best, idle = np.inf, np.inf, 0
    converged = False
    for _ in range(_MOST):
        multiply(work, SEED, NEW, TRANSPOSED, row, n, lanes)
        call_adjoint(adjoint, work[STAGE], params, work[SEED], both)
        for i in range(n * lanes):
            work[RATE, i] = both[i]
        change = refresh(work, row, n, lanes, h)
        if not change < np.inf:
            return False
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, previous, best, idle):
            converged = best <= _CLOSE
            break
        previous = change
    for i in range(n):
        for j in range(lanes):
            covector[i] += work[row, i * lanes + j]
    for i in range(p):
        for j in range(lanes):
            by_params[i] += h * work[B, j] * both[(n + i) * lanes + j]
    return converged


@compiled
def _settled(change: float, previous: float, best: float, idle: int) -> bool:
    """Return whether further fixed-point iterations would not improve the solution."""
    if change <= _EPS or idle >= (_PATIENCE if best <= _CLOSE else _WAVES):
        return True
    ratio = change / previous
    return change <= _SURE and ratio < 1.0 and change * ratio <= _EPS * (1.0 - ratio)
