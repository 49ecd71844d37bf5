"""Forward sensitivities of the steps of explicit methods, with fixed step lengths.

With fixed step lengths a run is a function of its initial state and parameters. Tangents are
propagated through the same stages (A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed.,
SIAM 2008, chapter 3). For a single direction, one kernel computes the rates of the state and of
its tangent together. `adjoint_sweep` contains the backward pass. States inside a step come from
the dense output, which is linear in the rates of all stages.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import compiled
from ..stepping.kernel_call import SEEDS, call, call_slopes
from ..stepping.state_rows import Replay, Tangents, copy_row, normalise_with, report
from .tableau import Tableau

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
