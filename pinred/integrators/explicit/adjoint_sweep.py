"""Backward pass over the steps of explicit methods, with fixed step lengths.

With fixed step lengths a run is a function of its initial state and parameters. For a step
y₁ = y + h Σ b_i k_i with k_i = f(y + h Σ a_ij k_j), a covector λ₁ of y₁ is propagated back by

    g_i = h (b_i λ₁ + Σ a_ji z_j),    z_i = (∂f/∂y)ᵀ g_i,    λ = λ₁ + Σ z_i

from the last stage to the first (W. Hager, Numer. Math. 87 (2000) 247–282; A. Griewank,
A. Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, chapter 12). The rates k_i were stored by
the run, or they are recomputed from the state at the start of the step. States inside a step
come from the dense output, which is linear in the rates of all stages.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import Bindings, compiled, unbound
from ..stepping.state_rows import (
    Cotangents,
    Quaternions,
    Replay,
    across,
    add_row,
    padded_rows,
    unit_alone,
)
from .forward_sensitivities import fill_weights, weights_of
from .row_programs import Pullback, Rate, Sum, Terms, pullback_program, row_program
from .runge_kutta import digest
from .tableau import Tableau

# Rows of `work`: the state at the start of a step, the covector at the end of the step, the state
# of a stage, and the covector of a stage. Three blocks with one row per stage follow: the rates k,
# the covectors z, and the terms of g that come from report times inside the step.
BEGIN, COVECTOR, STAGE, SEED, RATES = range(5)


# --- names that a tableau binds -----------------------------------------------------------------


STAGES = SIZE = 1  # numbers of stages per step, without and with the stages of the dense output


# Row programs for a step of length h from row BEGIN. fill_rates computes the stage rates, and
# fill_dense_rates the rates of the additional stages of the dense output. pull_back computes z of
# the stages (see the module's formulas). pull_back_inside computes z of all stages of a step that
# contains report times.
fill_rates = fill_dense_rates = pull_back = pull_back_inside = unbound


# --- the sweep -----------------------------------------------------------------------------


def sweep_back(
    replay: Replay, adjoint: int, dense: Array, back: Cotangents, work: Array, w: Array
) -> None:
    """Propagate a covector (n,) at the last step end back to the first, in place.

    Args:
        replay: The steps.
        adjoint: Address of the adjoint kernel.
        dense: Weights of the stage rates in the dense output, see Weights.
        back: The covector, and the stored steps.
        work: Work rows, see AdjointSweep.
        w: Workspace (S,) for weights.
    """
    address, quaternions, params, knots, times = replay
    stored, covector, at_times, by_params, both = back
    n, first = covector.shape[0], times.shape[0]
    for step in range(knots.shape[0] - 2, -1, -1):
        h = knots[step + 1] - knots[step]
        last = first
        while first > 0 and times[first - 1] > knots[step]:
            first -= 1
        inside = last > first and times[first] < knots[step + 1]
        for r in range(first, last):
            if times[r] >= knots[step + 1]:
                add_row(at_times[r], covector)
        for k in range(n):
            work[STAGE, k] = stored[step + 1, k]
            work[BEGIN, k] = stored[step, k]
        across(work[STAGE], quaternions, covector, 1)
        unit_alone(work[BEGIN], quaternions)
        for k in range(n):
            work[COVECTOR, k] = covector[k]
        if stored.shape[1] > n:
            for i in range(STAGES):
                for k in range(n):
                    work[RATES + i, k] = stored[step + 1, (i + 1) * n + k]
        else:
            fill_rates(address, params, work, h)
        if inside:
            fill_dense_rates(address, params, work, h)
            for i in range(SIZE):
                for k in range(n):
                    work[RATES + 2 * SIZE + i, k] = 0.0
            for r in range(first, last):
                if times[r] < knots[step + 1]:
                    fill_weights(dense, (times[r] - knots[step]) / h, w)
                    pull_back_report(work, w, h, quaternions, at_times[r], covector)
            pull_back_inside(adjoint, params, work, both, by_params, h)
        else:
            pull_back(adjoint, params, work, both, by_params, h)
        for i in range(SIZE if inside else STAGES):
            for k in range(n):
                covector[k] += work[RATES + SIZE + i, k]
    for r in range(first):
        add_row(at_times[r], covector)


def pull_back_report(
    work: Array, w: Array, h: float, quaternions: Quaternions, at_time: Array, covector: Array
) -> None:
    """Propagate the covector of a state inside a step to the step's start and stage rates.

    Args:
        work: Work rows.
        w: Weights of the stage rates in that state, (S,).
        h: Length of the step [s].
        quaternions: Quaternions of the state.
        at_time: Covector of the state, (n,); overwritten.
        covector: Covector of the state at the start of the step, (n,); the result is added to it.
    """
    n = at_time.shape[0]
    for k in range(n):
        work[STAGE, k] = work[BEGIN, k]
    for i in range(SIZE):
        for k in range(n):
            work[STAGE, k] += h * w[i] * work[RATES + i, k]
    across(work[STAGE], quaternions, at_time, 1)
    add_row(at_time, covector)
    for i in range(SIZE):
        for k in range(n):
            work[RATES + 2 * SIZE + i, k] += h * w[i] * at_time[k]


# --- sweeps from tableaux ------------------------------------------------------------------------


@dataclass(frozen=True)
class AdjointSweep:
    """The adjoint sweep of a tableau.

    Attributes:
        sweep: Compiled function, see `sweep_back`.
        rows: Function of n that returns the work rows for states with n entries.
    """

    sweep: Callable[..., None]
    rows: Callable[[int], Array]


@once_for_all
def adjoint_sweep_of(tableau: Tableau) -> AdjointSweep:
    """Return the adjoint sweep of a tableau, compiled at its first call."""
    A, s, size = weights_of(tableau)[0], tableau.stages, len(tableau.A)

    def weighted(base: int, weights: Array) -> Terms:
        return [(base + j, a) for j, a in enumerate(weights.tolist()) if a != 0.0]

    def state(i: int) -> tuple[list[Sum], int]:
        """Return the sums that compute the state of stage i (empty for the first), and its row."""
        terms = weighted(RATES, A[i, :i])
        return ([Sum(STAGE, BEGIN, terms)], STAGE) if terms else ([], BEGIN)

    def rates(indices: range) -> list[Sum | Rate]:
        steps: list[Sum | Rate] = []
        for i in indices:
            sums, row = state(i)
            steps += [*sums, Rate(row, RATES + i)]
        return steps

    def backward(count: int, *, inside: bool) -> list[Sum | Pullback]:
        steps: list[Sum | Pullback] = []
        for i in range(count - 1, -1, -1):
            from_reports = RATES + 2 * size + i
            terms = [*weighted(RATES + size + i + 1, A[i + 1 : count, i])]
            if A[s, i] != 0.0:
                terms = [(COVECTOR, float(A[s, i])), *terms]
            if terms:
                steps.append(Sum(SEED, from_reports if inside else None, terms))
            sums, row = state(i)
            steps += [*sums, Pullback(row, SEED if terms else from_reports, RATES + size + i)]
        return steps

    bindings = Bindings(
        f"reverse_{digest(0, tableau)}",
        STAGES=s,
        SIZE=size,
        fill_rates=row_program(rates(range(s))),
        fill_dense_rates=row_program(rates(range(s, size))),
        pull_back=pullback_program(backward(s, inside=False)),
        pull_back_inside=pullback_program(backward(size, inside=True)),
    )
    bindings.add(pull_back_report, compiled)
    sweep = bindings.add(sweep_back, compiled)
    return AdjointSweep(sweep, lambda n: padded_rows(RATES + 3 * size, n))
