"""Derivatives of a run: tangents along with it, adjoints back over it, of the steps it took.

The lengths of the steps are constants here, so that these are the derivatives of what has been
computed, to round-off, and not of the exact flow, to the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError, NoConvergence
from .explicit import derivatives as explicit
from .explicit.derivatives import Weights, weights_of
from .explicit.reverse import reverse_of
from .gauss import derivatives as gauss
from .gauss import reverse as gauss_reverse
from .gauss.tables import tables
from .methods import AdaptiveGauss, Explicit, Gauss, Method
from .stepping.kernel_call import SEEDS
from .stepping.seed_lanes import from_lanes, to_lanes


class Steps(Protocol):
    """The steps of a run, as a Solution has them.

    Arrays are read-only.
    """

    @property
    def knots(self) -> Array:
        """The times of their ends, (K,) [s]."""

    @property
    def states(self) -> Array:
        """The states there, (K, n)."""

    @property
    def stored(self) -> Array:
        """The same with what is kept of the stages that led there, (K, n + …)."""


@dataclass(frozen=True)
class Slopes:
    """Addresses of the derivatives of a kernel, each made when it is first asked for.

    tangent: (y, params, δy, δparams), SEEDS directions at once.  adjoint: (y, params, λ).
    tangents, adjoints: of so many lanes, the same at as many states at once, one direction each.
    """

    tangent: Callable[[], int]
    adjoint: Callable[[], int]
    tangents: Callable[[int], int]
    adjoints: Callable[[int], int]


@dataclass(frozen=True)
class Along:
    """A run with directions.

    y: (T, n) and slopes: (T, n, N) at its times.  end: (n,) and end_slopes: (n, N) at its end.
    """

    y: Array
    slopes: Array
    end: Array
    end_slopes: Array


@dataclass(frozen=True)
class Back:
    """Slopes by what a run began with.  by_state: (n,).  by_parameters: (p,)."""

    by_state: Array
    by_parameters: Array


def refuse_without_derivatives(method: Method) -> None:
    """Raise InputError for a method whose steps have no derivatives here."""
    if not isinstance(method, (Explicit, Gauss, AdaptiveGauss)):
        raise InputError(
            f"{method.name} has no derivatives of its steps; take DOP853, Tsit5, Gauss or "
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
    """Repeat the steps between knots from y0 (n,) with directions along (n, N) of it.

    params: (p,).  along_params: (p, N).  times: (T,) sorted, within the knots.  states: (K, n) at
    the knots, from which implicit steps begin then, whatever the iteration has left of those
    before; else each begins where the one before ends.  With other states or parameters than those
    that the knots came from, this is the run on frozen steps.
    Raises NoConvergence if an implicit step has no solution that could be found.
    """
    params, knots, times = (read_only(each.view()) for each in (params, knots, times))
    if isinstance(method, Explicit):
        weights = weights_of(type(method).tableau())
        return _explicit_along(
            weights, address, slopes, params, y0, knots, times, quaternion, along, along_params
        )
    a, b, lanes = _gauss_weights(method)
    n, count = len(y0), along.shape[1]
    y, part = y0.copy(), np.array(along.T, order="C")
    out, out_along = np.empty((len(times), n)), np.empty((len(times), count, n))
    Y, F, D, G = (np.zeros(n * lanes) for _ in range(4))
    tangents = slopes.tangents(lanes) if count else 0
    failed = gauss.forward(
        address, tangents, params, a, b, lanes, quaternion, knots,
        read_only(np.empty((0, n)) if states is None else states.view()), times, y, part,
        np.ascontiguousarray(along_params.T), out, out_along, Y, F, D, G,
    )  # fmt: skip
    _refuse_failed(failed, knots, y)
    return Along(out, np.moveaxis(out_along, 1, 2), y, part.T)


def run_back(
    method: Method,
    address: int,
    slopes: Slopes,
    params: Array,
    run: Steps,
    times: Array,
    quaternion: int,
    covector: Array,
    at_times: Array,
) -> Back:
    """Bring a covector (n,) of the end of a run, and those (T, n) of its states at times, back.

    Raises NoConvergence if the adjoint of an implicit step has no solution that could be found.
    """
    knots, stored = run.knots, run.stored
    n, p = len(covector), len(params)
    covector, at_times, by_params = covector.copy(), at_times.copy(), np.zeros(p)
    if isinstance(method, Explicit):
        tableau = type(method).tableau()
        dense, found = weights_of(tableau).dense, reverse_of(tableau)
        found.sweep(
            address, slopes.adjoint(), params, quaternion, dense, knots, stored, times, at_times,
            covector, by_params, found.rows(n), np.empty(n + p), np.empty(dense.shape[1]),
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
    n, count, size = len(y0), along.shape[1], len(weights.A)
    batches = -(-count // SEEDS)
    y = y0.copy()
    part, part_params = (np.zeros((batches, len(a) * SEEDS)) for a in (along, along_params))
    to_lanes(np.ascontiguousarray(along), part)
    to_lanes(np.ascontiguousarray(along_params), part_params)
    out, out_along = np.empty((len(times), n)), np.empty((len(times), batches, n * SEEDS))
    Y, K = (np.empty((size, n)) for _ in range(2))
    explicit.forward(
        address, slopes.tangent() if count else 0, params, weights.A, weights.dense, weights.stages,
        quaternion, knots, times, y, part, part_params, out, out_along, Y, K,
        np.empty(n * SEEDS), np.empty((size, n * SEEDS)), np.empty(size),
    )  # fmt: skip
    found, end = np.empty((len(times), n, count)), np.empty((n, count))
    for k in range(len(times)):
        from_lanes(out_along[k], found[k])
    from_lanes(part, end)
    return Along(out, found, y, end)


def _stages_of(method: Method) -> tuple[int, int]:
    assert isinstance(method, (Gauss, AdaptiveGauss))
    return method.stages, method.lanes


def _gauss_weights(method: Method) -> tuple[Array, Array, int]:
    stages, lanes = _stages_of(method)
    found = tables(stages)
    return np.ascontiguousarray(found.mu * found.b), found.b.copy(), lanes


def _refuse_failed(failed: int, knots: Array, y: Array) -> None:
    if failed:
        time = float(knots[failed - 1])
        raise NoConvergence(
            f"the derivative of the implicit step after t = {time:g} s was not found by fixed "
            "points: take shorter steps, or DOP853",
            time,
            y,
        )
