"""Sensitivities of the steps of explicit methods, with fixed step lengths.

With fixed step lengths a run is a function of its initial state and parameters. Tangents are
propagated through the same stages (A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed.,
SIAM 2008, chapter 3). For a single direction, one kernel computes the rates of the state and of
its tangent together. States inside a step come from the dense output, which is linear in the rates
of all stages.

Back over the steps, for a step y₁ = y + h Σ b_i k_i with k_i = f(y + h Σ a_ij k_j), a covector λ₁
of y₁ is propagated by

    g_i = h (b_i λ₁ + Σ a_ji z_j),    z_i = (∂f/∂y)ᵀ g_i,    λ = λ₁ + Σ z_i

from the last stage to the first (W. Hager, Numer. Math. 87 (2000) 247–282; A. Griewank,
A. Walther, chapter 12). The rates k_i were stored by the run, or they are recomputed from the state
at the start of the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import Bindings, compiled, unbound
from ..stepping.intrinsics import SEEDS, call, call_slopes
from ..stepping.run_state import (
    Cotangents,
    Quaternions,
    Replay,
    Tangents,
    across,
    add_row,
    copy_row,
    normalise_with,
    padded_rows,
    report,
    unit_alone,
)
from .row_programs import Pullback, Rate, Sum, Terms, pullback_program, row_program
from .runge_kutta import Tableau, digest

# The coefficients of a tableau: weights of the rates in the state of each stage, (S, S), where row
# number `stages` is the step end; weights of the rates in the terms F₀, F₁, … of Tableau's
# polynomial, (d + 3, S); number of stages, without the step end.
Weights: TypeAlias = tuple[Array, Array, int]

# The arrays that a step overwrites: states and rates of the stages, both (S, n); stage directions,
# (n SEEDS,), and their rates, (S, n SEEDS); weights, (S,).
Workspace: TypeAlias = tuple[Array, Array, Array, Array, Array]


def workspace_of(weights: Weights, n: int) -> Workspace:
    """Allocate the workspace for states with n entries."""
    size = len(weights[0])
    Y, K = np.empty((2, size, n))
    return Y, K, np.empty(n * SEEDS), np.empty((size, n * SEEDS)), np.empty(size)


# The arrays that a step overwrites with one direction; each row is a state with its tangent:
# stages, (S, 2, n); their rates, (S, 2 n); start of the step, (2 n,); weights, (S,).
Pairs: TypeAlias = tuple[Array, Array, Array, Array]


def pairs_of(weights: Weights, n: int) -> Pairs:
    """Allocate the workspace of one direction for states with n entries."""
    size = len(weights[0])
    return np.empty((size, 2, n)), np.zeros((size, 2 * n)), np.empty(2 * n), np.empty(size)


@once_for_all
def weights_of(tableau: Tableau) -> Weights:
    """Return the weights of a tableau; the result is cached."""
    s, size = tableau.stages, len(tableau.A)
    end_weights = tableau.A[s]
    begin, end = np.zeros(size), np.zeros(size)
    begin[0], end[s] = 1.0, 1.0
    terms = [end_weights, begin - end_weights, 2.0 * end_weights - begin - end, *tableau.dense]
    return np.ascontiguousarray(tableau.A), np.array(terms), s


@compiled
def fill_weights(dense: Array, x: float, w: Array) -> None:
    """Compute the weights w (S,) of the stage rates in the state inside a step.

    The state at fraction x of a step of length h is y + h Σ w_i k_i.

    Args:
        dense: Weights of the polynomial's terms, see Weights.
        x: Fraction of the step.
        w: Weights, output.
    """
    terms, size = dense.shape
    for i in range(size):
        total = dense[terms - 1, i]
        for k in range(terms - 2, -1, -1):
            total = dense[k, i] + (x if k % 2 else 1.0 - x) * total
        w[i] = x * total


@compiled
def last_report(times: Array, knots: Array, step: int, first: int) -> int:
    """Return the index of the first report time after the end of a step.

    Args:
        times: Sorted report times, (T,) [s].
        knots: Times of the step ends, (K,) [s].
        step: Index of the step.
        first: Index at which the search starts.
    Returns:
        The index, or T if no report time is later.
    """
    last = first
    while last < times.shape[0] and times[last] <= knots[step + 1]:
        last += 1
    return last


@compiled
def forward(
    replay: Replay, slopes: int, weights: Weights, tangents: Tangents, work: Workspace
) -> None:
    """Propagate a state and tangent directions over steps with prescribed ends, in place.

    Args:
        replay: The steps.
        slopes: Address of the tangent kernel.
        weights: Weights of the method.
        tangents: The state and its tangents, SEEDS directions per row.
        work: Workspace.
    """
    address, quaternions, params, knots, times = replay
    (A, dense, stages), (Y, K, V, L, w) = weights, work
    y, along, along_params, out, out_along = tangents
    normalise_with(y, quaternions, along, SEEDS)
    first = 0
    while first < times.shape[0] and times[first] <= knots[0]:
        report(tangents, first, quaternions, SEEDS)
        first += 1
    for step in range(knots.shape[0] - 1):
        h = knots[step + 1] - knots[step]
        last = last_report(times, knots, step, first)
        # The stages of the dense output need the rate at the step end; other steps do not.
        inside = last > first and times[first] < knots[step + 1]
        end = A.shape[0] if inside else stages + 1
        for i in range(end):
            _add_up(Y[i], y, A[i], K, i, h)
            if inside or i < stages:
                call(address, Y[i], params, K[i])
        for b in range(along.shape[0]):
            for i in range(end):
                if i == stages and not inside:
                    break
                _add_up(V, along[b], A[i], L, i, h)
                call_slopes(slopes, Y[i], params, V, along_params[b], L[i])
            for r in range(first, last):
                if times[r] < knots[step + 1]:
                    fill_weights(dense, (times[r] - knots[step]) / h, w)
                    _add_up(out_along[r, b], along[b], w, L, end, h)
            _add_up(V, along[b], A[stages], L, stages, h)
            copy_row(V, along[b])
        for r in range(first, last):
            if times[r] < knots[step + 1]:
                fill_weights(dense, (times[r] - knots[step]) / h, w)
                _add_up(out[r], y, w, K, end, h)
                normalise_with(out[r], quaternions, out_along[r], SEEDS)
        copy_row(Y[stages], y)
        normalise_with(y, quaternions, along, SEEDS)
        while first < last:
            if times[first] >= knots[step + 1]:
                report(tangents, first, quaternions, SEEDS)
            first += 1


@compiled
def forward_pair(
    replay: Replay, pair: int, weights: Weights, tangents: Tangents, work: Pairs
) -> None:
    """Propagate a state and one tangent direction over steps with prescribed ends, in place.

    Args:
        replay: The steps.
        pair: Address of the kernel of (y, params, δy, δparams) → (ẏ, δẏ).
        weights: Weights of the method.
        tangents: The state and its tangent.
        work: Workspace.
    """
    _, quaternions, params, knots, times = replay
    (A, dense, stages), (Z, K, z, w) = weights, work
    y, along, along_params, out, out_along = tangents
    n = y.shape[0]
    rows = Z.reshape((Z.shape[0], 2 * n))
    normalise_with(y, quaternions, along, 1)
    first = 0
    while first < times.shape[0] and times[first] <= knots[0]:
        report(tangents, first, quaternions, 1)
        first += 1
    for step in range(knots.shape[0] - 1):
        h = knots[step + 1] - knots[step]
        last = last_report(times, knots, step, first)
        inside = last > first and times[first] < knots[step + 1]
        end = A.shape[0] if inside else stages + 1
        _join(y, along[0], z)
        for i in range(end):
            _add_up(rows[i], z, A[i], K, i, h)
            if inside or i < stages:
                call_slopes(pair, Z[i, 0], params, Z[i, 1], along_params[0], K[i])
        copy_row(Z[stages, 0], y)
        copy_row(Z[stages, 1], along[0])
        normalise_with(y, quaternions, along, 1)
        while first < last:
            if times[first] < knots[step + 1]:
                fill_weights(dense, (times[first] - knots[step]) / h, w)
                _add_up(rows[0], z, w, K, end, h)
                copy_row(Z[0, 0], out[first])
                copy_row(Z[0, 1], out_along[first, 0])
                normalise_with(out[first], quaternions, out_along[first], 1)
            else:
                report(tangents, first, quaternions, 1)
            first += 1


@compiled
def _join(y: Array, along: Array, z: Array) -> None:
    """Write a state and its tangent into one row."""
    n = y.shape[0]
    for k in range(n):
        z[k], z[n + k] = y[k], along[k]


@compiled
def _add_up(out: Array, base: Array, w: Array, rows: Array, count: int, h: float) -> None:
    """Compute out = base + h Σ w_i rows_i, summed over the first `count` rows."""
    for k in range(out.shape[0]):
        out[k] = base[k]
    for j in range(count):
        a = h * w[j]
        if a != 0.0:
            for k in range(out.shape[0]):
                out[k] += a * rows[j, k]


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
    return AdjointSweep(sweep, partial(padded_rows, RATES + 3 * size))
