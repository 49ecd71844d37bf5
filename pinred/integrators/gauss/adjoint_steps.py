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

from ...common.arrays import Array
from ..stepping.compiling import compiled
from ..stepping.replay import Cotangents, Replay, across
from ..stepping.state_rows import NEW, Y, add_row, copy_row, unit_alone
from .fixed_points import OLD_Z, SUB_Z, Z, find_covectors, find_stages
from .stage_rows import GUESS, OLD, SUB, WITHIN, B, L
from .stages import add_increments, guess, prepare_guess, start_evenly

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
