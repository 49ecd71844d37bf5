"""Repetition of stored steps with fixed lengths; tangents and cotangents propagated over them."""

from __future__ import annotations

from typing import TypeAlias

from ...common.arrays import Array
from .compiling import compiled
from .state_rows import Quaternions, copy_row, first_entries, inverse_length, unit_alone

# These values are plain tuples: numba takes microseconds to find the type of a named tuple.

# The steps of a run: address of the kernel; quaternions; parameters, (p,); times of the step ends,
# (K,) [s]; sorted report times, (T,) [s].
Replay: TypeAlias = tuple[int, Quaternions, Array, Array, Array]

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
def across(y: Array, quaternions: Quaternions, v: Array, width: int) -> None:
    """Apply the derivative of `unit_alone` at y, a symmetric matrix, to tangents or covectors v.

    Args:
        y: State before normalisation.
        quaternions: Quaternions of the state.
        v: Tangents or covectors, (n width,), changed in place.
        width: Number of consecutive values in v for each entry of the state.
    """
    for first in first_entries(quaternions):
        factor = inverse_length(y, first)
        for lane in range(width):
            radial = 0.0
            for k in range(first, first + 4):
                radial += y[k] * factor * v[k * width + lane]
            for k in range(first, first + 4):
                across_unit = v[k * width + lane] - y[k] * factor * radial
                v[k * width + lane] = across_unit * factor


@compiled
def normalise_with(y: Array, quaternions: Quaternions, along: Array, width: int) -> None:
    """Normalise the quaternions of y and, with the derivative, all rows of tangents in `along`."""
    for row in range(along.shape[0]):
        across(y, quaternions, along[row], width)
    unit_alone(y, quaternions)


@compiled
def report(tangents: Tangents, r: int, quaternions: Quaternions, width: int) -> None:
    """Write the state and its tangents as report r, with normalised quaternions."""
    y, along, _, out, out_along = tangents
    copy_row(y, out[r])
    for row in range(along.shape[0]):
        copy_row(along[row], out_along[r, row])
    normalise_with(out[r], quaternions, out_along[r], width)
