"""Forward sensitivities of the steps of Gauss's methods, by the implicit function theorem.

For a step Y_i = y + Σ μ_ij L_j with L_j = h b_j f(Y_j), y₁ = y + Σ L_j, a tangent δy is propagated
by

    δY_i = δy + Σ μ_ij δL_j,    δL_j = h b_j (J_j δY_j + ∂f/∂p δp),    δy₁ = δy + Σ δL_j

(see `tables` for μ). Fixed-point iteration solves both equations to round-off, whatever tolerance
the integrator used. The results are thus derivatives of the converged steps. All stages are
evaluated at once, in SIMD lanes. A state inside a step is the end of a shorter step. E. Hairer,
C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section VI.4.
"""

from __future__ import annotations

from ...common.arrays import Array
from ..stepping.compiling import compiled
from ..stepping.replay import Replay, Tangents, normalise_with, report
from ..stepping.state_rows import NEW, Y, copy_row
from .fixed_points import SEED, Z, fill_tangent_rates, find_stages, find_tangents
from .stage_products import multiply, refresh
from .stage_rows import MU, L
from .stages import add_increments, start_evenly


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
