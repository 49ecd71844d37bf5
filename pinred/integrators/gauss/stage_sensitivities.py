"""Tangents of a run of a Gauss method, of the steps it took: by the implicit function theorem.

Stages Y_i = y + h Σ a_ij f(Y_j) hold to round-off here, whatever an integrator has left of its
tolerance, so derivatives are those of the converged steps.  Along a direction

    δY_i = δy + h Σ a_ij (J_j δY_j + ∂f/∂p δp),          δy₁ = δy + h Σ b_j (J_j δY_j + …)

by fixed points, which converge as the stages do; all stages are evaluated at once, in lanes.
A state between the ends of a step is the end of a shorter one.  E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration, 2nd ed., section VI.4.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ..explicit.forward_sensitivities import normalise_with
from ..stepping.compiling import compiled
from ..stepping.kernel_call import call, call_slopes

_MOST = 400  # turns
_PATIENCE = 2  # turns without improvement at which round-off is all that is left
_WAVES = 20  # such turns where it is not: slow iterations come in waves
_CLOSE = 1e-10  # relative change above which an iteration that stops has not converged


@compiled
def _turn(
    start: Array, a: Array, lanes: int, h: float, rates: Array, found: Array
) -> tuple[float, float]:
    """Set stages (n lanes,) to start + h Σ a_jk rates_k; return their change and their size."""
    change = size = 0.0
    for i in range(start.shape[0]):
        for j in range(lanes):
            total = 0.0
            for k in range(lanes):
                total += a[j, k] * rates[i * lanes + k]
            new = start[i] + h * total
            change = max(change, abs(new - found[i * lanes + j]))
            size = max(size, abs(new))
            found[i * lanes + j] = new
    return change, size


@compiled
def _settled(change: float, size: float, best: float, idle: int) -> bool:
    """Whether further turns of a fixed point leave nothing to gain."""
    return change == 0.0 or idle >= (_PATIENCE if best <= _CLOSE * size else _WAVES)


@compiled
def _move(y: Array, b: Array, lanes: int, h: float, F: Array, out: Array) -> None:
    """Write the end of a step with rates F, which may overlap `out`."""
    for i in range(y.shape[0]):
        total = 0.0
        for k in range(lanes):
            total += b[k] * F[i * lanes + k]
        out[i] = y[i] + h * total


@compiled
def find_stages(
    address: int, params: Array, a: Array, lanes: int, h: float, y: Array, Y: Array, F: Array
) -> int:
    """Fill stages Y (n lanes,) and their rates F; return the turns, −1 if there are none found.

    a: (lanes, lanes) weights.
    """
    n = y.shape[0]
    for i in range(n):
        for j in range(lanes):
            Y[i * lanes + j] = y[i]
    call(address, Y, params, F)
    best, idle = np.inf, 0
    for turn in range(_MOST):
        change, size = _turn(y, a, lanes, h, F, Y)
        if not change < np.inf:
            return -1
        call(address, Y, params, F)
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, size, best, idle):
            return turn + 1 if best <= _CLOSE * size else -1
    return -1


@compiled
def step_forward(
    slopes: int,
    params: Array,
    a: Array,
    b: Array,
    lanes: int,
    h: float,
    Y: Array,
    along: Array,
    along_params: Array,
    D: Array,
    G: Array,
) -> int:
    """Bring a direction (n,) over a step with stages Y, in place; return the turns or −1.

    along_params: (p,).  D, G: (n lanes,).
    """
    n = along.shape[0]
    for i in range(n):
        for j in range(lanes):
            D[i * lanes + j] = along[i]
    call_slopes(slopes, Y, params, D, along_params, G)
    best, idle, turns = np.inf, 0, -1
    for turn in range(_MOST):
        change, size = _turn(along, a, lanes, h, G, D)
        if not change < np.inf:
            return -1
        call_slopes(slopes, Y, params, D, along_params, G)
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, size, best, idle):
            turns = turn + 1 if best <= _CLOSE * size else -1
            break
    _move(along, b, lanes, h, G, along)
    return turns


@compiled
def forward(
    address: int,
    slopes: int,
    params: Array,
    a: Array,
    b: Array,
    lanes: int,
    quaternion: int,
    knots: Array,
    states: Array,
    times: Array,
    y: Array,
    along: Array,
    along_params: Array,
    out: Array,
    out_along: Array,
    Y: Array,
    F: Array,
    D: Array,
    G: Array,
) -> int:
    """Follow a state y (n,) and directions over the steps between knots, in place.

    states: (steps + 1, n) at the knots, from which every step begins if there are any.
    along: (N, n), along_params: (N, p).  out: (T, n) and out_along: (T, N, n) at times.  Y, F, D,
    G: (n lanes,).  Return 0, or 1 plus the first step that is not found.
    """
    n, count = y.shape[0], along.shape[0]
    normalise_with(y, quaternion, along, 1)
    first = 0
    while first < times.shape[0] and times[first] <= knots[0]:
        _report(y, along, quaternion, out[first], out_along[first])
        first += 1
    for step in range(knots.shape[0] - 1):
        if step > 0 and states.shape[0] > 0:
            for i in range(n):
                y[i] = states[step, i]
        while first < times.shape[0] and times[first] < knots[step + 1]:
            h = times[first] - knots[step]
            if find_stages(address, params, a, lanes, h, y, Y, F) < 0:
                return step + 1
            _move(y, b, lanes, h, F, out[first])
            for d in range(count):
                for i in range(n):
                    out_along[first, d, i] = along[d, i]
                turns = step_forward(
                    slopes, params, a, b, lanes, h, Y, out_along[first, d], along_params[d], D, G
                )
                if turns < 0:
                    return step + 1
            normalise_with(out[first], quaternion, out_along[first], 1)
            first += 1
        h = knots[step + 1] - knots[step]
        if find_stages(address, params, a, lanes, h, y, Y, F) < 0:
            return step + 1
        _move(y, b, lanes, h, F, y)
        for d in range(count):
            if step_forward(slopes, params, a, b, lanes, h, Y, along[d], along_params[d], D, G) < 0:
                return step + 1
        while first < times.shape[0] and times[first] <= knots[step + 1]:
            _report(y, along, quaternion, out[first], out_along[first])
            first += 1
    return 0


@compiled
def _report(y: Array, along: Array, quaternion: int, out: Array, out_along: Array) -> None:
    """Write a state and its directions with a quaternion of length one."""
    for i in range(y.shape[0]):
        out[i] = y[i]
    for d in range(along.shape[0]):
        for i in range(y.shape[0]):
            out_along[d, i] = along[d, i]
    normalise_with(out, quaternion, out_along, 1)
