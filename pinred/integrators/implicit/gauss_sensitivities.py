"""Sensitivities of steps of Gauss's methods, forward and back, by the implicit function theorem.

For a step Y_i = y + Σ μ_ij L_j with L_j = h b_j f(Y_j), y₁ = y + Σ L_j (see `tables` for μ), a
tangent δy is propagated by

    δY_i = δy + Σ μ_ij δL_j,    δL_j = h b_j (J_j δY_j + ∂f/∂p δp),    δy₁ = δy + Σ δL_j,

and a covector λ₁ of y₁ is propagated back by the same equations with μ transposed,

    Λ_j = λ₁ + Σ μ_ij Z_i,    Z_i = h b_i (∂f/∂y)ᵀ Λ_i,    λ = λ₁ + Σ Z_i.

Fixed-point iteration solves the equations to round-off, whatever tolerance the integrator used. The
results are thus derivatives of the converged steps. All stages are evaluated at once, in SIMD
lanes. A state inside a step is the end of a shorter step. In the backward pass, the first guess of
L is the L that the run has stored. If the run has stored none, it is extrapolated from the step
treated before. The first guess of Z is extrapolated, too. E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration, 2nd ed., section VI.4.

The three systems of equations have the form V_i = v + Σ T_ij Z_j, Z_j = h b_j g(V_j). For the
stages, v is the state, T is μ (see `tables`), and g the vector field. For tangents, v is a
direction of the state, and g the derivative of the vector field along V_j. For covectors, v is the
covector at the end of the step, T is μ transposed, and g the adjoint of the vector field.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import bind_globals, compiled, inlined, unbound
from ..stepping.intrinsics import call, call_adjoint, call_slopes
from ..stepping.run_state import (
    NEW,
    Cotangents,
    Replay,
    Tangents,
    Y,
    across,
    add_row,
    copy_row,
    normalise_with,
    report,
    unit_alone,
)
from .gauss_stages import (
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
    add_increments,
    guess,
    multiply,
    prepare_guess,
    refresh,
    scale_by_largest,
    start_evenly,
    tables,
    work_rows,
)

# Rows after those of `work_rows`: μ transposed; the tangents or covectors of the stages; their
# increments Z of this step, of the step treated before, and of a shorter step to a report time.
TRANSPOSED, SEED, Z, OLD_Z, SUB_Z = range(ROWS, ROWS + 5)

_MOST = 400  # largest number of fixed-point iterations per solve
_PATIENCE = 2  # limit on iterations without improvement, near round-off
_WAVES = 20  # the same limit far from round-off, where slow convergence comes in waves
# Relative change above which an iteration that has stopped improving counts as not converged.
_CLOSE = 1e-10
_EPS = float(np.finfo(float).eps)
_SURE = 64.0 * _EPS  # change below which the ratio of two changes predicts the remaining error


def sensitivity_rows(stages: int, n: int) -> Array:
    """Return work rows for the steps of a run, with the tables of the method stored in them."""
    return _first_rows(stages, n).copy()


@lru_cache(maxsize=16)
def _first_rows(stages: int, n: int) -> Array:
    stage_rows = work_rows(stages, n, 0)
    work = np.zeros((SUB_Z + 1, stage_rows.shape[1]))
    work[:ROWS] = stage_rows
    mu = tables(stages).mu
    work[TRANSPOSED, : mu.size] = mu.ravel()
    return work


# --- names that `_solver` binds -----------------------------------------------------------------


BASE = TABLE = OUT = 0  # rows of v, of T, and of V
evaluate = unbound  # (address, params, work, more, count): write g(V), `count` numbers, to RATE


def solve(
    address: int, params: Array, work: Array, n: int, lanes: int, row: int, h: float, more: Array
) -> bool:
    """Solve for the increments in `row` from a first guess, and write V.

    Args:
        address: Address of the kernel, the tangent kernel or the adjoint kernel.
        params: Parameters, (p,).
        work: Work rows.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        row: Row of the increments Z.
        h: Length of the step [s].
        more: For tangents, the direction of the parameters, (p,); for covectors, workspace for the
            output of the adjoint kernel, ((n + p) lanes,).
    Returns:
        Whether the iteration converged.
    """
    scale_by_largest(work, n, lanes, BASE, row)
    previous, best, idle = np.inf, np.inf, 0
    for _ in range(_MOST):
        multiply(work, OUT, BASE, TABLE, row, n, lanes)
        evaluate(address, params, work, more, n * lanes)
        change = refresh(work, row, n, lanes, h)
        if not change < np.inf:
            return False
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, previous, best, idle):
            multiply(work, OUT, BASE, TABLE, row, n, lanes)
            return best <= _CLOSE
        previous = change
    return False


@compiled
def _settled(change: float, previous: float, best: float, idle: int) -> bool:
    """Return whether further fixed-point iterations would not improve the solution."""
    if change <= _EPS or idle >= (_PATIENCE if best <= _CLOSE else _WAVES):
        return True
    ratio = change / previous
    return change <= _SURE and ratio < 1.0 and change * ratio <= _EPS * (1.0 - ratio)


@inlined
def fill_rates(address: int, params: Array, work: Array, more: Array, count: int) -> None:  # noqa: ARG001
    """Evaluate the vector field at the stages."""
    call(address, work[STAGE], params, work[RATE])


@inlined
def fill_tangent_rates(address: int, params: Array, work: Array, more: Array, count: int) -> None:  # noqa: ARG001
    """Evaluate the derivative of the vector field along the tangents of the stages."""
    call_slopes(address, work[STAGE], params, work[SEED], more, work[RATE])


@inlined
def fill_adjoint_rates(address: int, params: Array, work: Array, more: Array, count: int) -> None:
    """Evaluate the adjoint of the vector field for the covectors of the stages."""
    call_adjoint(address, work[STAGE], params, work[SEED], more)
    for i in range(count):
        work[RATE, i] = more[i]


def _solver(
    name: str, rates: Callable[..., None], base: int, table: int, out: int
) -> Callable[..., bool]:
    bound = bind_globals(solve, f"gauss_{name}", evaluate=rates, BASE=base, TABLE=table, OUT=out)
    return compiled(bound)


find_stages = _solver("stages", fill_rates, Y, MU, STAGE)
find_tangents = _solver("tangents", fill_tangent_rates, NEW, MU, SEED)
find_covectors = _solver("covectors", fill_adjoint_rates, NEW, TRANSPOSED, SEED)


@compiled
def forward(
    replay: Replay, slopes: int, lanes: int, states: Array, tangents: Tangents, work: Array
) -> int:
    """Propagate a state and tangent directions over steps with prescribed ends, in place.

    Args:
        replay: The steps.
        slopes: Address of the tangent kernel.
        lanes: Number of SIMD lanes, idle lanes included.
        states: States at the step ends, (K, n), from which each step starts, or (0, n).
        tangents: The state and its tangents, one direction per row.
        work: Work rows, see `sensitivity_rows`.
    Returns:
        0, or 1 plus the index of the first step whose equations did not converge.
    """
    _, quaternions, _, knots, times = replay
    y, along, along_params, out, out_along = tangents
    normalise_with(y, quaternions, along, 1)
    first = 0
    while first < times.shape[0] and times[first] <= knots[0]:
        report(tangents, first, quaternions, 1)
        first += 1
    for step in range(knots.shape[0] - 1):
        if step > 0 and states.shape[0] > 0:
            copy_row(states[step], y)
        while first < times.shape[0] and times[first] < knots[step + 1]:
            copy_row(y, out[first])
            for d in range(along.shape[0]):
                copy_row(along[d], out_along[first, d])
            h = times[first] - knots[step]
            if not _step(
                replay, slopes, lanes, h, out[first], out_along[first], along_params, work
            ):
                return step + 1
            normalise_with(out[first], quaternions, out_along[first], 1)
            first += 1
        h = knots[step + 1] - knots[step]
        if not _step(replay, slopes, lanes, h, y, along, along_params, work):
            return step + 1
        while first < times.shape[0] and times[first] <= knots[step + 1]:
            report(tangents, first, quaternions, 1)
            first += 1
    return 0


@compiled
def _step(
    replay: Replay,
    slopes: int,
    lanes: int,
    h: float,
    y: Array,
    along: Array,
    along_params: Array,
    work: Array,
) -> bool:
    """Propagate a state (n,) and directions (N, n) over a step; return whether it was solved."""
    n, (address, _, params, _, _) = y.shape[0], replay
    for i in range(n):
        work[Y, i] = y[i]
    start_evenly(address, params, work, n, lanes, L, h)
    if not find_stages(address, params, work, n, lanes, L, h, params):
        return False
    add_increments(work, L, lanes, y)
    for d in range(along.shape[0]):
        for i in range(n):
            work[NEW, i] = along[d, i]
        work[Z] = 0.0
        multiply(work, SEED, NEW, MU, Z, n, lanes)
        fill_tangent_rates(slopes, params, work, along_params[d], n * lanes)
        refresh(work, Z, n, lanes, h)
        if not find_tangents(slopes, params, work, n, lanes, Z, h, along_params[d]):
            return False
        add_increments(work, Z, lanes, along[d])
    return True


_FURTHEST = 2.0  # limit of the extrapolation, in lengths of the step treated before


@compiled
def reverse(
    replay: Replay, adjoint: int, stages: int, lanes: int, back: Cotangents, work: Array
) -> int:
    """Propagate a covector (n,) at the last step end back to the first, in place.

    Args:
        replay: The steps.
        adjoint: Address of the adjoint kernel.
        stages: Number of stages.
        lanes: Number of SIMD lanes, idle lanes included.
        back: The covector, and the stored steps.
        work: Work rows, see `sensitivity_rows`.
    Returns:
        0, or 1 plus the index of the first step whose equations did not converge.
    """
    address, quaternions, params, knots, times = replay
    stored, covector, at_times, _, both = back
    n, first, last_h = covector.shape[0], times.shape[0], 0.0
    for step in range(knots.shape[0] - 2, -1, -1):
        for i in range(n):
            work[Y, i] = stored[step + 1, i]
        while first > 0 and times[first - 1] >= knots[step + 1]:
            first -= 1
            across(work[Y], quaternions, at_times[first], 1)
            add_row(at_times[first], covector)
        for i in range(n):
            work[Y, i] = stored[step, i]
        if step == 0:
            unit_alone(work[Y], quaternions)
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
            find_stages(address, params, work, n, lanes, L, h, params)
            and step_back(adjoint, params, work, lanes, Z, h, covector, back)
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
            if not find_stages(address, params, work, n, lanes, SUB, elapsed, params):
                return step + 1
            inside = both[:n]
            copy_row(work[Y], inside)
            add_increments(work, SUB, lanes, inside)
            across(inside, quaternions, at_times[first], 1)
            work[SUB_Z] = 0.0
            if not step_back(adjoint, params, work, lanes, SUB_Z, elapsed, at_times[first], back):
                return step + 1
            add_row(at_times[first], covector)
    for r in range(first):
        add_row(at_times[r], covector)
    return 0


@compiled
def step_back(
    adjoint: int,
    params: Array,
    work: Array,
    lanes: int,
    row: int,
    h: float,
    covector: Array,
    back: Cotangents,
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
        back: Derivative with respect to the parameters, and workspace.
    Returns:
        Whether the iteration converged.
    """
    n, (_, _, _, by_params, both) = covector.shape[0], back
    for i in range(n):
        work[NEW, i] = covector[i]
    converged: bool = find_covectors(adjoint, params, work, n, lanes, row, h, both)
    add_increments(work, row, lanes, covector)
    for i in range(by_params.shape[0]):
        for j in range(lanes):
            by_params[i] += h * work[B, j] * both[(n + i) * lanes + j]
    return converged
