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
from .explicit import run_sensitivities as explicit
from .explicit.run_sensitivities import adjoint_sweep_of, weights_of
from .implicit import gauss_sensitivities as gauss
from .integrate import Solution
from .methods import AdaptiveGauss, Explicit, Gauss, Method
from .stepping.intrinsics import SEEDS, from_lanes, to_lanes
from .stepping.run_state import Quaternions, Replay, across


@dataclass(frozen=True)
class SmoothField:
    """A kernel and its derivative kernels, each compiled when first requested.

    Attributes:
        address: Address of the kernel.
        quaternions: Quaternions of the state, see `integrate`.
        tangent: Address of the kernel of (y, params, δy, δparams), with SEEDS directions at once.
        pair: Address of the kernel of (y, params, δy, δparams) → (ẏ, δẏ), for one direction.
        adjoint: Address of the kernel of (y, params, λ).
        tangents: Function of the number of lanes that returns the address of the tangent kernel for
            as many states at once, with one direction for each state.
        adjoints: Function of the number of lanes that returns the address of the adjoint kernel for
            as many states at once.
    """

    address: int
    quaternions: Quaternions
    tangent: Callable[[], int]
    pair: Callable[[], int]
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
    field: SmoothField,
    params: Array,
    y0: Array,
    knots: Array,
    times: Array,
    along: Array,
    along_params: Array,
    states: Array | None = None,
) -> Along:
    """Repeat the steps of a run from y0, and propagate tangent directions with them.

    If y0 or the parameters differ from those of the original run, the original step lengths are
    still used.

    Args:
        method: Explicit or Gauss method.
        field: The kernel and its derivative kernels.
        params: Parameters, (p,).
        y0: Initial state, (n,).
        knots: Times of the step ends, (K,) [s].
        times: Sorted report times within the steps, (T,) [s].
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
    params, knots, times = (
        read_only(np.ascontiguousarray(array).view()) for array in (params, knots, times)
    )
    replay = (field.address, field.quaternions, params, knots, times)
    if isinstance(method, Explicit):
        return _explicit_along(method, field, replay, y0, along, along_params)
    (n, count), (stages, lanes) = along.shape, _stages_of(method)
    y, directions = y0.copy(), np.array(along.T, order="C")
    out, out_along = np.empty((len(times), n)), np.empty((len(times), count, n))
    tangents = (y, directions, np.ascontiguousarray(along_params.T), out, out_along)
    slopes = field.tangents(lanes) if count else 0
    starts = read_only(np.empty((0, n)) if states is None else np.ascontiguousarray(states).view())
    rows = gauss.sensitivity_rows(stages, n)
    failed = gauss.forward(replay, slopes, lanes, starts, tangents, rows)
    _refuse_failed(failed, knots, y)
    return Along(out, np.moveaxis(out_along, 1, 2), y, directions.T)


def run_back(
    method: Method,
    field: SmoothField,
    run: Solution,
    times: Array,
    covector: Array,
    at_times: Array,
) -> Back:
    """Propagate covectors of a run's final and reported states back to its inputs.

    Args:
        method: Explicit or Gauss method.
        field: The kernel and its derivative kernels.
        run: Stored steps of the run.
        times: Sorted report times, (T,) [s].
        covector: Covector of the state at the end, (n,).
        at_times: Covectors of the states at the report times, (T, n).
    Returns:
        Derivatives with respect to the initial state and the parameters.
    Raises:
        NoConvergence: The adjoint equations of an implicit step did not converge.
    """
    knots, stored = run.knots, run.stored
    replay = (field.address, field.quaternions, run.params, knots, times)
    n, p = len(covector), len(run.params)
    covector, by_params, lanes = covector.copy(), np.zeros(p), method.lanes
    back = (stored, covector, at_times.copy(), by_params, np.empty((n + p) * lanes))
    if isinstance(method, Explicit):
        tableau = type(method).tableau()
        (_, dense, _), adjoint = weights_of(tableau), adjoint_sweep_of(tableau)
        w = np.empty(dense.shape[1])
        adjoint.sweep(replay, field.adjoint(), dense, back, adjoint.rows(n), w)
    else:
        stages, _ = _stages_of(method)
        rows = gauss.sensitivity_rows(stages, n)
        failed = gauss.reverse(replay, field.adjoints(lanes), stages, lanes, back, rows)
        _refuse_failed(failed, knots, stored[max(failed - 1, 0), :n])
    across(stored[0, :n], field.quaternions, covector, 1)  # the initial state is normalised
    return Back(covector, by_params)


def _explicit_along(
    method: Explicit,
    field: SmoothField,
    replay: Replay,
    y0: Array,
    along: Array,
    along_params: Array,
) -> Along:
    """Propagate tangents over the steps of an explicit method."""
    if along.shape[1] == 1:
        return _explicit_pair(method, field, replay, y0, along, along_params)
    (n, count), T = along.shape, len(replay[-1])
    weights, batches = weights_of(type(method).tableau()), -(-count // SEEDS)
    directions, param_directions = (
        np.zeros((batches, len(a) * SEEDS)) for a in (along, along_params)
    )
    to_lanes(np.ascontiguousarray(along), directions)
    to_lanes(np.ascontiguousarray(along_params), param_directions)
    out, out_lanes = np.empty((T, n)), np.empty((T, batches, n * SEEDS))
    y = y0.copy()
    tangents = (y, directions, param_directions, out, out_lanes)
    slopes = field.tangent() if count else 0
    explicit.forward(replay, slopes, weights, tangents, explicit.workspace_of(weights, n))
    out_along, end_along = np.empty((T, n, count)), np.empty((n, count))
    for k in range(T):
        from_lanes(out_lanes[k], out_along[k])
    from_lanes(directions, end_along)
    return Along(out, out_along, y, end_along)


def _explicit_pair(
    method: Explicit,
    field: SmoothField,
    replay: Replay,
    y0: Array,
    along: Array,
    along_params: Array,
) -> Along:
    """Propagate one tangent over the steps of an explicit method."""
    n, T, weights = len(along), len(replay[-1]), weights_of(type(method).tableau())
    y, direction, out, out_along = y0.copy(), along.T.copy(), np.empty((T, n)), np.empty((T, 1, n))
    tangents = (y, direction, np.ascontiguousarray(along_params.T), out, out_along)
    explicit.forward_pair(replay, field.pair(), weights, tangents, explicit.pairs_of(weights, n))
    return Along(out, np.moveaxis(out_along, 1, 2), y, direction.T)


def _stages_of(method: Method) -> tuple[int, int]:
    assert isinstance(method, (Gauss, AdaptiveGauss))
    return method.stages, method.lanes


def _refuse_failed(failed: int, knots: Array, y: Array) -> None:
    if failed:
        time = float(knots[failed - 1])
        raise NoConvergence(
            f"the iteration for the derivative of the implicit step at t = {time:g} s did not "
            "converge; use shorter steps, or DOP853",
            time,
            y,
        )
