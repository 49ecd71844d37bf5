"""Repetition of stored steps with fixed lengths; tangents and cotangents propagated over them."""

from __future__ import annotations

from typing import TypeAlias

from ...common.arrays import Array
from .compiling import compiled
from .state_rows import copy_row, unit_alone

# These values are plain tuples: numba takes microseconds to find the type of a named tuple.

# The steps of a run: address of the kernel; index of the quaternion's first entry, −1 without a
# quaternion; parameters, (p,); times of the step ends, (K,) [s]; sorted report times, (T,) [s].
Replay: TypeAlias = tuple[int, int, Array, Array, Array]

# A state and tangent directions, and their reports. N rows contain one direction each, or SEEDS
# directions with consecutive values for each entry: state, (n,), and directions of the state,
# (N, n …), both changed in place; directions of the parameters, (N, p …); states at the report
# times, (T, n), and their tangents, (T, N, n …), both output.
Tangents: TypeAlias = tuple[Array, Array, Array, Array, Array]

# A covector that is propagated back over stored steps: states at the step ends, (K, n), or
# (K, n + …) with the stages of each step; covector (n,) at the last step end, changed to the
# covector at the first; covectors of the states at the report times, (T, n), overwritten;
# derivative with respect to the parameters, (p,), to which the result is added; workspace for the
# output of the adjoint kernel, (n + p,) per state.
Cotangents: TypeAlias = tuple[Array, Array, Array, Array, Array]


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
    y, along, _, out, out_along = tangents
    copy_row(y, out[r])
    for row in range(along.shape[0]):
        copy_row(along[row], out_along[r, row])
    normalise_with(out[r], quaternion, out_along[r], width)
