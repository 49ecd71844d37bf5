"""Repetition of stored steps with fixed lengths; tangents and cotangents propagated over them."""

from __future__ import annotations

from typing import NamedTuple

from ...common.arrays import Array
from .compiling import compiled
from .state_rows import copy_row, unit_alone


class Replay(NamedTuple):
    """The steps of a run.

    Attributes:
        address: Address of the kernel.
        quaternion: Index of the quaternion's first entry, −1 without a quaternion.
        params: Parameters, (p,).
        knots: Times of the step ends, (K,) [s].
        times: Sorted report times within the steps, (T,) [s].
    """

    address: int
    quaternion: int
    params: Array
    knots: Array
    times: Array


class Tangents(NamedTuple):
    """A state and tangent directions that are propagated over steps, and their reports.

    N rows contain one direction each, or SEEDS directions with consecutive values for each entry.

    Attributes:
        y: State, (n,), changed to the state at the end.
        along: Directions of the state, (N, n …), changed in place.
        along_params: Directions of the parameters, (N, p …).
        out: States at the report times, (T, n), output.
        out_along: Tangents of these states, (T, N, n …), output.
    """

    y: Array
    along: Array
    along_params: Array
    out: Array
    out_along: Array


class Cotangents(NamedTuple):
    """A covector propagated back over stored steps, with the covectors of reports added to it.

    Attributes:
        stored: States at the step ends, (K, n), or (K, n + …) with the stages of each step.
        covector: Covector (n,) at the last step end, changed to the covector at the first.
        at_times: Covectors of the states at the report times, (T, n); overwritten.
        by_params: Derivative with respect to the parameters, (p,); the result is added to it.
        both: Workspace for the output of the adjoint kernel, (n + p,) per state.
    """

    stored: Array
    covector: Array
    at_times: Array
    by_params: Array
    both: Array


@compiled
def across(y: Array, factor: float, quaternion: int, v: Array, width: int) -> None:
    """Apply the derivative of `unit_alone`, a symmetric matrix, to tangents or covectors v.

    Args:
        y: State after `unit_alone`.
        factor: Return value of `unit_alone`.
        quaternion: Index of the quaternion's first entry, −1 without a quaternion.
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
            v[k * width + lane] = (v[k * width + lane] - y[k] * radial) * factor


@compiled
def normalise_with(y: Array, quaternion: int, along: Array, width: int) -> None:
    """Normalise the quaternion of y and, with the derivative, all rows of tangents in `along`."""
    factor = unit_alone(y, quaternion)
    for row in range(along.shape[0]):
        across(y, factor, quaternion, along[row], width)


@compiled
def back_to_given(y0: Array, quaternion: int, covector: Array, y: Array) -> None:
    """Propagate a covector (n,) through the normalisation of the initial state y0.

    Args:
        y0: State before normalisation.
        quaternion: Index of the quaternion's first entry, −1 without a quaternion.
        covector: Covector, changed in place.
        y: Workspace (n,).
    """
    copy_row(y0, y)
    factor = unit_alone(y, quaternion)
    across(y, factor, quaternion, covector, 1)


@compiled
def report(tangents: Tangents, r: int, quaternion: int, width: int) -> None:
    """Write the state and its tangents as report r, with the quaternion normalised."""
    copy_row(tangents.y, tangents.out[r])
    for row in range(tangents.along.shape[0]):
        copy_row(tangents.along[row], tangents.out_along[r, row])
    normalise_with(tangents.out[r], quaternion, tangents.out_along[r], width)
