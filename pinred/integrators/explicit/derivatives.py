"""Tangents of a run of an explicit method: along the steps it took, at their lengths.

A run is a map of its initial state and parameters once the lengths of its steps are constants.
Its tangent goes along with the stages (A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed.,
SIAM 2008, chapter 3); its adjoint is in `reverse`.  States between steps are those of the dense
output, which is linear in the rates of all stages.
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
    """A tableau as arrays for loops.  A: (S, S), the end in row s.  dense: (d + 3, S) weights.

    The rows of `dense` are those of the polynomial in Tableau, from F₀ on, over the rates.
    """

    A: Array
    dense: Array
    stages: int


@once_for_all
def weights_of(tableau: Tableau) -> Weights:
    """Return the weights of a tableau, made once."""
    s, size = tableau.stages, len(tableau.A)
    move = tableau.A[s]
    begin, end = np.zeros(size), np.zeros(size)
    begin[0], end[s] = 1.0, 1.0
    rows = [move, begin - move, 2.0 * move - begin - end, *tableau.dense]
    return Weights(np.ascontiguousarray(tableau.A), np.array(rows), s)


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
    """Fill states Y (S, n) and rates K (S, n) of the stages of a step from y.

    inside: whether those of the dense output, too; without, the end has a state and no rate.
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
    """Fill w (S,), the weights of the rates in the state at the part x of a step, over h."""
    terms, size = dense.shape
    for i in range(size):
        total = dense[terms - 1, i]
        for k in range(terms - 2, -1, -1):
            total = dense[k, i] + (x if k % 2 else 1.0 - x) * total
        w[i] = x * total


@compiled
def to_unit(y: Array, quaternion: int) -> float:
    """Bring the quaternion of y, if there is one, to length one; return what that was."""
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
    """Apply the derivative of `to_unit` to v, `width` numbers an entry; it is its own adjoint.

    y: after it.  size: what it returned.
    """
    if quaternion < 0:
        return
    for lane in range(width):
        along = 0.0
        for k in range(quaternion, quaternion + 4):
            along += y[k] * v[k * width + lane]
        for k in range(quaternion, quaternion + 4):
            v[k * width + lane] = (v[k * width + lane] - y[k] * along) / size


@compiled
def last_report(times: Array, knots: Array, step: int, first: int) -> int:
    """Return the first of the times after the end of a step."""
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
    """Follow a state y (n,) and directions over the steps between knots, in place.

    along: (B, n SEEDS), along_params: (B, p SEEDS), SEEDS directions each.  out: (T, n) and
    out_along: (T, B, n SEEDS) at times.  Y, K: (S, n).  V: (n SEEDS,).  L: (S, n SEEDS).  w: (S,).
    """
    n, batches = y.shape[0], along.shape[0]
    size = to_unit(y, quaternion)
    for b in range(batches):
        across(y, size, quaternion, along[b], SEEDS)
    first = 0
    while first < times.shape[0] and times[first] <= knots[0]:
        _copy(y, out[first])
        for b in range(batches):
            _copy(along[b], out_along[first, b])
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
                size = to_unit(out[r], quaternion)
                for b in range(batches):
                    across(out[r], size, quaternion, out_along[r, b], SEEDS)
        _copy(Y[stages], y)
        size = to_unit(y, quaternion)
        for b in range(batches):
            across(y, size, quaternion, along[b], SEEDS)
        while first < last:
            if times[first] >= knots[step + 1]:
                _copy(y, out[first])
                for b in range(batches):
                    _copy(along[b], out_along[first, b])
            first += 1


@compiled
def back_to_given(y0: Array, quaternion: int, covector: Array, y: Array) -> None:
    """Bring a covector (n,) of a state of unit length back to the state y0 as it is given."""
    _copy(y0, y)
    size = to_unit(y, quaternion)
    across(y, size, quaternion, covector, 1)


@compiled
def _add_up(out: Array, base: Array, w: Array, rows: Array, count: int, h: float) -> None:
    """Fill out with base + h Σ w rows over the first `count` rows."""
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
