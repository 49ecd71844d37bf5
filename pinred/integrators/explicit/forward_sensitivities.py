"""Forward sensitivities of the steps of explicit methods, with fixed step lengths.

With fixed step lengths a run is a function of its initial state and parameters. Tangents are
propagated through the same stages (A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed.,
SIAM 2008, chapter 3). `adjoint_sweep` contains the backward pass. States inside a step come from
the dense output, which is linear in the rates of all stages.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import compiled
from ..stepping.kernel_call import SEEDS, call, call_slopes
from .tableau import Tableau


@dataclass(frozen=True)
class Weights:
    """The coefficients of a tableau as arrays for compiled loops.

    Attributes:
        A: Weights of the rates in the state of each stage, (S, S); row `stages` is the step end.
        dense: Weights of the rates in the terms F₀, F₁, … of Tableau's polynomial, (d + 3, S).
        stages: Number of stages, without the step end.
    """

    A: Array
    dense: Array
    stages: int


@once_for_all
def weights_of(tableau: Tableau) -> Weights:
    """Return the weights of a tableau, which are cached."""
    s, size = tableau.stages, len(tableau.A)
    end_weights = tableau.A[s]
    begin, end = np.zeros(size), np.zeros(size)
    begin[0], end[s] = 1.0, 1.0
    terms = [end_weights, begin - end_weights, 2.0 * end_weights - begin - end, *tableau.dense]
    return Weights(np.ascontiguousarray(tableau.A), np.array(terms), s)


@compiled
def fill_stages(
    address: int,
    params: Array,
    A: Array,
    stages: int,
    inside: bool,
    h: float,
    y: Array,
    Y: Array,
    K: Array,
    n: int,
) -> None:
    """Compute the states and rates of the stages of a step.

    Args:
        address: Address of the kernel.
        params: Parameters, (p,).
        A: Weights of the stage rates in each stage state, see Weights.
        stages: Number of stages, without the step end.
        inside: Whether to add the stages of the dense output. Without these stages, the rate at the
            step end is not computed.
        h: Length of the step [s].
        y: State at the start of the step, (n,).
        Y: States of the stages, (S, n), output.
        K: Rates of the stages, (S, n), output.
        n: Number of entries of the state.
    """
    last = A.shape[0] if inside else stages + 1
    for i in range(last):
        for k in range(n):
            Y[i, k] = y[k]
        for j in range(i):
            a = h * A[i, j]
            if a != 0.0:
                for k in range(n):
                    Y[i, k] += a * K[j, k]
        if inside or i < stages:
            call(address, Y[i], params, K[i])


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
def to_unit(y: Array, quaternion: int) -> float:
    """Normalise the quaternion of y; return its previous length. quaternion: index, −1 for none."""
    if quaternion < 0:
        return 1.0
    total = 0.0
    for k in range(quaternion, quaternion + 4):
        total += y[k] * y[k]
    size = sqrt(total)
    for k in range(quaternion, quaternion + 4):
        y[k] /= size
    return size


@compiled
def across(y: Array, size: float, quaternion: int, v: Array, width: int) -> None:
    """Apply the derivative of `to_unit`, a symmetric matrix, to tangents or covectors v.

    Args:
        y: State after `to_unit`.
        size: Return value of `to_unit`.
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        v: Tangents or covectors, (n width,), changed in place.
        width: Number of consecutive values in v for each entry of the state.
    """
    if quaternion < 0:
        return
    for lane in range(width):
        radial = 0.0
        for k in range(quaternion, quaternion + 4):
            radial += y[k] * v[k * width + lane]
        for k in range(quaternion, quaternion + 4):
            v[k * width + lane] = (v[k * width + lane] - y[k] * radial) / size


@compiled
def normalise_with(y: Array, quaternion: int, along: Array, width: int) -> None:
    """Normalise the quaternion of y and, with the derivative, all rows of tangents in `along`."""
    size = to_unit(y, quaternion)
    for row in range(along.shape[0]):
        across(y, size, quaternion, along[row], width)


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
    address: int,
    slopes: int,
    params: Array,
    A: Array,
    dense: Array,
    stages: int,
    quaternion: int,
    knots: Array,
    times: Array,
    y: Array,
    along: Array,
    along_params: Array,
    out: Array,
    out_along: Array,
    Y: Array,
    K: Array,
    V: Array,
    L: Array,
    w: Array,
) -> None:
    """Propagate a state and tangent directions over steps with prescribed ends, in place.

    Args:
        address: Address of the kernel.
        slopes: Address of its tangent kernel.
        params: Parameters, (p,).
        A: Weights of the stage rates in each stage state, see Weights.
        dense: Weights of the stage rates in the dense output, see Weights.
        stages: Number of stages, without the step end.
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        knots: Times of the step ends, (K,) [s].
        times: Sorted report times, (T,) [s].
        y: State, (n,), changed to the state at the end.
        along: Directions of the state in B blocks of SEEDS directions, (B, n SEEDS); changed in
            place.
        along_params: Directions of the parameters, (B, p SEEDS).
        out: States at the report times, (T, n), output.
        out_along: Tangents of these states, (T, B, n SEEDS), output.
        Y: Workspace (S, n) for stage states.
        K: Workspace (S, n) for stage rates.
        V: Workspace (n SEEDS,) for directions of a stage.
        L: Workspace (S, n SEEDS) for directions of the rates.
        w: Workspace (S,) for weights.
    """
    n, batches = y.shape[0], along.shape[0]
    normalise_with(y, quaternion, along, SEEDS)
    first = 0
    while first < times.shape[0] and times[first] <= knots[0]:
        _copy_report(y, along, out[first], out_along[first])
        first += 1
    for step in range(knots.shape[0] - 1):
        h = knots[step + 1] - knots[step]
        last = last_report(times, knots, step, first)
        inside = last > first and times[first] < knots[step + 1]
        fill_stages(address, params, A, stages, inside, h, y, Y, K, n)
        end = A.shape[0] if inside else stages + 1
        for b in range(batches):
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
            _copy(V, along[b])
        for r in range(first, last):
            if times[r] < knots[step + 1]:
                fill_weights(dense, (times[r] - knots[step]) / h, w)
                _add_up(out[r], y, w, K, end, h)
                normalise_with(out[r], quaternion, out_along[r], SEEDS)
        _copy(Y[stages], y)
        normalise_with(y, quaternion, along, SEEDS)
        while first < last:
            if times[first] >= knots[step + 1]:
                _copy_report(y, along, out[first], out_along[first])
            first += 1


@compiled
def back_to_given(y0: Array, quaternion: int, covector: Array, y: Array) -> None:
    """Propagate a covector (n,) through the normalisation of the initial state y0.

    Args:
        y0: Initial state before normalisation, (n,).
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        covector: Covector of the normalised state, changed in place.
        y: Workspace (n,).
    """
    _copy(y0, y)
    size = to_unit(y, quaternion)
    across(y, size, quaternion, covector, 1)


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


@compiled
def _copy(source: Array, out: Array) -> None:
    for k in range(out.shape[0]):
        out[k] = source[k]


@compiled
def _copy_report(y: Array, along: Array, out: Array, out_along: Array) -> None:
    _copy(y, out)
    for row in range(along.shape[0]):
        _copy(along[row], out_along[row])
