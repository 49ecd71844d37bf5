"""Forward sensitivities of the steps of Gauss's methods, by the implicit function theorem.

The stages Y_i = y + h Σ a_ij f(Y_j) are solved to round-off here, whatever tolerance the
integrator used. The results are thus derivatives of the converged steps. Along a direction

    δY_i = δy + h Σ a_ij (J_j δY_j + ∂f/∂p δp),          δy₁ = δy + h Σ b_j (J_j δY_j + …)

is solved by fixed-point iteration, which converges at the same rate as the iteration for the
stages. All stages are evaluated at once, in SIMD lanes. A state inside a step is the end of a
shorter step. E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section
VI.4.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ..explicit.forward_sensitivities import normalise_with
from ..stepping.compiling import compiled
from ..stepping.kernel_call import call, call_slopes

_MOST = 400  # largest number of fixed-point iterations per solve
_PATIENCE = 2  # limit on iterations without improvement, near round-off
_WAVES = 20  # the same limit far from round-off, where slow convergence comes in waves
# Relative change above which an iteration that has stopped improving counts as not converged.
_CLOSE = 1e-10


@compiled
def _iterate_once(
    start: Array, a: Array, lanes: int, h: float, rates: Array, found: Array
) -> tuple[float, float]:
    """Set stages (n lanes,) to start + h Σ a_jk rates_k; return their largest change and value."""
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
    """Return whether further fixed-point iterations would not improve the solution."""
    return change == 0.0 or idle >= (_PATIENCE if best <= _CLOSE * size else _WAVES)


@compiled
def _write_end(y: Array, b: Array, lanes: int, h: float, F: Array, out: Array) -> None:
    """Write the state at the end of a step with stage rates F; `out` may overlap F."""
    for i in range(y.shape[0]):
        total = 0.0
        for k in range(lanes):
            total += b[k] * F[i * lanes + k]
        out[i] = y[i] + h * total


@compiled
def find_stages(
    address: int, params: Array, a: Array, lanes: int, h: float, y: Array, Y: Array, F: Array
) -> int:
    """Solve the stages of a step, and compute their rates.

    Args:
        address: Address of the kernel.
        params: Parameters, (p,).
        a: Weights a_ij of the method, padded with zeros, (lanes, lanes).
        lanes: Number of SIMD lanes.
        h: Length of the step [s].
        y: State at the start of the step, (n,).
        Y: Stages, (n lanes,), output.
        F: Rates of the stages, (n lanes,), output.
    Returns:
        The number of iterations, or −1 if the iteration did not converge.
    """
    n = y.shape[0]
    for i in range(n):
        for j in range(lanes):
            Y[i * lanes + j] = y[i]
    call(address, Y, params, F)
    best, idle = np.inf, 0
    for iteration in range(_MOST):
        change, size = _iterate_once(y, a, lanes, h, F, Y)
        if not change < np.inf:
            return -1
        call(address, Y, params, F)
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, size, best, idle):
            return iteration + 1 if best <= _CLOSE * size else -1
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
    """Propagate a tangent direction over a step, in place.

    Args:
        slopes: Address of the tangent kernel.
        params: Parameters, (p,).
        a: Weights a_ij of the method, padded with zeros, (lanes, lanes).
        b: Weights b_j of the step end, padded with zeros, (lanes,).
        lanes: Number of SIMD lanes.
        h: Length of the step [s].
        Y: Stages of the step, (n lanes,).
        along: Direction of the state, (n,), changed in place.
        along_params: Direction of the parameters, (p,).
        D: Workspace for the stage directions, (n lanes,).
        G: Workspace for the rates of the stage directions, (n lanes,).
    Returns:
        The number of iterations, or −1 if the iteration did not converge.
    """
    n = along.shape[0]
    for i in range(n):
        for j in range(lanes):
            D[i * lanes + j] = along[i]
    call_slopes(slopes, Y, params, D, along_params, G)
    best, idle, iterations = np.inf, 0, -1
    for iteration in range(_MOST):
        change, size = _iterate_once(along, a, lanes, h, G, D)
        if not change < np.inf:
            return -1
        call_slopes(slopes, Y, params, D, along_params, G)
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, size, best, idle):
            iterations = iteration + 1 if best <= _CLOSE * size else -1
            break
    _write_end(along, b, lanes, h, G, along)
    return iterations


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
    """Propagate a state and tangent directions over steps with prescribed ends, in place.

    Args:
        address: Address of the kernel.
        slopes: Address of its tangent kernel.
        params: Parameters, (p,).
        a: Weights a_ij of the method, padded with zeros, (lanes, lanes).
        b: Weights b_j of the step end, padded with zeros, (lanes,).
        lanes: Number of SIMD lanes.
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        knots: Times of the step ends, (K,) [s].
        states: States at the step ends, (K, n), from which each step starts, or (0, n).
        times: Sorted report times, (T,) [s].
        y: State, (n,), changed to the state at the end.
        along: Directions of the state, (N, n), changed in place.
        along_params: Directions of the parameters, (N, p).
        out: States at the report times, (T, n), output.
        out_along: Tangents of these states, (T, N, n), output.
        Y: Workspace (n lanes,) for stage states.
        F: Workspace (n lanes,) for stage rates.
        D: Workspace (n lanes,) for stage directions.
        G: Workspace (n lanes,) for the rates of the stage directions.
    Returns:
        0, or 1 plus the index of the first step whose equations did not converge.
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
            _write_end(y, b, lanes, h, F, out[first])
            for d in range(count):
                for i in range(n):
                    out_along[first, d, i] = along[d, i]
                iterations = step_forward(
                    slopes, params, a, b, lanes, h, Y, out_along[first, d], along_params[d], D, G
                )
                if iterations < 0:
                    return step + 1
            normalise_with(out[first], quaternion, out_along[first], 1)
            first += 1
        h = knots[step + 1] - knots[step]
        if find_stages(address, params, a, lanes, h, y, Y, F) < 0:
            return step + 1
        _write_end(y, b, lanes, h, F, y)
        for d in range(count):
            if step_forward(slopes, params, a, b, lanes, h, Y, along[d], along_params[d], D, G) < 0:
                return step + 1
        while first < times.shape[0] and times[first] <= knots[step + 1]:
            _report(y, along, quaternion, out[first], out_along[first])
            first += 1
    return 0


@compiled
def _report(y: Array, along: Array, quaternion: int, out: Array, out_along: Array) -> None:
    """Write a state and its tangents, with the quaternion normalised."""
    for i in range(y.shape[0]):
        out[i] = y[i]
    for d in range(along.shape[0]):
        for i in range(y.shape[0]):
            out_along[d, i] = along[d, i]
    normalise_with(out, quaternion, out_along, 1)
