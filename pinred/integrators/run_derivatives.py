"""Derivatives of a run with its steps fixed: forward tangents and a backward adjoint pass.

The step lengths are treated as constants. The results are therefore the derivatives of the computed
states, exact to round-off. They approximate the derivatives of the exact flow only to the tolerance
of the run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError, NoConvergence
from .explicit import forward_sensitivities as explicit
from .explicit.adjoint_sweep import adjoint_sweep_of
from .explicit.forward_sensitivities import Weights, weights_of
from .gauss import adjoint_steps as gauss_reverse
from .gauss import stage_sensitivities as gauss
from .gauss.tables import tables
from .methods import AdaptiveGauss, Explicit, Gauss, Method
from .solution import Solution
from .stepping.kernel_call import SEEDS, from_lanes, to_lanes


@dataclass(frozen=True)
class Slopes:
    """Addresses of a kernel's derivative kernels, each compiled when first requested.

    Attributes:
        tangent: Address of the kernel of (y, params, δy, δparams), with SEEDS directions at once.
        adjoint: Address of the kernel of (y, params, λ).
        tangents: Function of the number of lanes that returns the address of the tangent kernel for
            as many states at once, with one direction for each state.
        adjoints: Function of the number of lanes that returns the address of the adjoint kernel for
            as many states at once.
    """

    tangent: Callable[[], int]
    adjoint: Callable[[], int]
    tangents: Callable[[int], int]
    adjoints: Callable[[int], int]


@dataclass(frozen=True)
class Along:
    """States of a run, and their derivatives along tangent directions.

    Attributes:
        y: States at the report times, (T, n).
        slopes: Derivatives of these states along N directions, (T, n, N).
        end: State at the end, (n,).
        end_slopes: Derivatives of the state at the end, (n, N).
    """

    y: Array
    slopes: Array
    end: Array
    end_slopes: Array


@dataclass(frozen=True)
class Back:
    """Cotangents of the inputs of a run.

    Attributes:
        by_state: Derivative with respect to the initial state, (n,).
        by_parameters: Derivative with respect to the parameters, (p,).
    """

    by_state: Array
    by_parameters: Array


def refuse_without_derivatives(method: Method) -> None:
    """Check that derivatives are implemented for the steps of a method.

    Args:
        method: The method.
    Raises:
        InputError: Derivatives are not implemented for this method.
    """
    if not isinstance(method, (Explicit, Gauss, AdaptiveGauss)):
        raise InputError(
            f"the steps of {method.name} have no derivatives; use DOP853, Tsit5, Gauss or "
            "AdaptiveGauss"
        )


def run_along(
    method: Method,
    address: int,
    slopes: Slopes,
    params: Array,
    y0: Array,
    knots: Array,
    times: Array,
    quaternion: int,
    along: Array,
    along_params: Array,
    states: Array | None = None,
) -> Along:
    """Repeat the steps of a run from y0, and propagate tangent directions with them.

    If y0 or the parameters differ from those of the original run, the original step lengths are
    still used.

    Args:
        method: Explicit or Gauss method.
        address: Address of the kernel.
        slopes: Addresses of the kernel's derivative kernels.
        params: Parameters, (p,).
        y0: Initial state, (n,).
        knots: Times of the step ends, (K,) [s].
        times: Sorted report times within the steps, (T,) [s].
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        along: Directions of the initial state, (n, N).
        along_params: Directions of the parameters, (p, N).
        states: States at the step ends, (K, n), from which implicit steps restart, so that
            iteration errors do not accumulate. If None, each step starts from the computed end of
            the previous step.
    Returns:
        States and tangents.
    Raises:
        NoConvergence: The equations of an implicit step did not converge.
    """
    params, knots, times = (read_only(array.view()) for array in (params, knots, times))
    if isinstance(method, Explicit):
        weights = weights_of(type(method).tableau())
        return _explicit_along(
            weights, address, slopes, params, y0, knots, times, quaternion, along, along_params
        )
    a, b, lanes = _gauss_weights(method)
    n, count = len(y0), along.shape[1]
    y, directions = y0.copy(), np.array(along.T, order="C")
    states_out, tangents_out = np.empty((len(times), n)), np.empty((len(times), count, n))
    Y, F, D, G = (np.zeros(n * lanes) for _ in range(4))
    tangents = slopes.tangents(lanes) if count else 0
    failed = gauss.forward(
        address, tangents, params, a, b, lanes, quaternion, knots,
        read_only(np.empty((0, n)) if states is None else states.view()), times, y, directions,
        np.ascontiguousarray(along_params.T), states_out, tangents_out, Y, F, D, G,
    )  # fmt: skip
    _refuse_failed(failed, knots, y)
    return Along(states_out, np.moveaxis(tangents_out, 1, 2), y, directions.T)


def run_back(
    method: Method,
    address: int,
    slopes: Slopes,
    params: Array,
    run: Solution,
    times: Array,
    quaternion: int,
    covector: Array,
    at_times: Array,
) -> Back:
    """Propagate covectors of a run's final and reported states back to its inputs.

    Args:
        method: Explicit or Gauss method.
        address: Address of the kernel.
        slopes: Addresses of the kernel's derivative kernels.
        params: Parameters, (p,).
        run: Stored steps of the run.
        times: Sorted report times, (T,) [s].
        quaternion: Index of the first of the quaternion's four entries, −1 for none.
        covector: Covector of the state at the end, (n,).
        at_times: Covectors of the states at the report times, (T, n).
    Returns:
        Derivatives with respect to the initial state and the parameters.
    Raises:
        NoConvergence: The adjoint equations of an implicit step did not converge.
    """
    knots, stored = run.knots, run.stored
    n, p = len(covector), len(params)
    covector, at_times, by_params = covector.copy(), at_times.copy(), np.zeros(p)
    if isinstance(method, Explicit):
        tableau = type(method).tableau()
        dense, adjoint = weights_of(tableau).dense, adjoint_sweep_of(tableau)
        adjoint.sweep(
            address, slopes.adjoint(), params, quaternion, dense, knots, stored, times, at_times,
            covector, by_params, adjoint.rows(n), np.empty(n + p), np.empty(dense.shape[1]),
        )  # fmt: skip
    else:
        stages, lanes = _stages_of(method)
        failed = gauss_reverse.reverse(
            address, slopes.adjoints(lanes), params, stages, lanes, quaternion, knots, stored,
            times, at_times, covector, by_params, gauss_reverse.reverse_rows(stages, n),
            np.empty((n + p) * lanes),
        )  # fmt: skip
        _refuse_failed(failed, knots, stored[max(failed - 1, 0), :n])
    explicit.back_to_given(stored[0, :n], quaternion, covector, np.empty(n))
    return Back(covector, by_params)


def _explicit_along(
    weights: Weights,
    address: int,
    slopes: Slopes,
    params: Array,
    y0: Array,
    knots: Array,
    times: Array,
    quaternion: int,
    along: Array,
    along_params: Array,
) -> Along:
    """Propagate tangents over the steps of an explicit method."""
    n, count, size = len(y0), along.shape[1], len(weights.A)
    batches = -(-count // SEEDS)
    y = y0.copy()
    directions, param_directions = (
        np.zeros((batches, len(a) * SEEDS)) for a in (along, along_params)
    )
    to_lanes(np.ascontiguousarray(along), directions)
    to_lanes(np.ascontiguousarray(along_params), param_directions)
    states, lanes = np.empty((len(times), n)), np.empty((len(times), batches, n * SEEDS))
    Y, K = (np.empty((size, n)) for _ in range(2))
    explicit.forward(
        address, slopes.tangent() if count else 0, params, weights.A, weights.dense, weights.stages,
        quaternion, knots, times, y, directions, param_directions, states, lanes, Y, K,
        np.empty(n * SEEDS), np.empty((size, n * SEEDS)), np.empty(size),
    )  # fmt: skip
    tangents, end_tangents = np.empty((len(times), n, count)), np.empty((n, count))
    for k in range(len(times)):
        from_lanes(lanes[k], tangents[k])
    from_lanes(directions, end_tangents)
    return Along(states, tangents, y, end_tangents)


def _stages_of(method: Method) -> tuple[int, int]:
    assert isinstance(method, (Gauss, AdaptiveGauss))
    return method.stages, method.lanes


def _gauss_weights(method: Method) -> tuple[Array, Array, int]:
    stages, lanes = _stages_of(method)
    table = tables(stages)
    return np.ascontiguousarray(table.mu * table.b), table.b.copy(), lanes


def _refuse_failed(failed: int, knots: Array, y: Array) -> None:
    if failed:
        time = float(knots[failed - 1])
        raise NoConvergence(
            f"the iteration for the derivative of the implicit step at t = {time:g} s did not "
            "converge; use shorter steps, or DOP853",
            time,
            y,
        )
