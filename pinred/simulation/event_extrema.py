"""Extrema of events between samples: where an event may reach zero and return."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..system.coordinates import Indices

# An extremum is sampled if its predicted value has the other sign, or is below the error of the
# prediction. This error is a cubic that vanishes at the three samples, in units of the largest of
# them: this factor times the product of the distances, over the third power of the span of times.
# It is at most _CLOSE.
_CUBIC, _CLOSE = 5.0, 0.25
_BEYOND = 0.25  # largest distance beyond an end at which it is predicted, relative to three samples
_APART = 0.05  # least distance of a new time from a sample, relative to the interval


def extremum_times(times: Array, values: Array) -> Array:
    """Predict the times between samples at which an event is closest to zero.

    A parabola is placed through each sample that is closer to zero than its neighbours, and through
    the outer three samples at either end.

    Args:
        times: Times of the samples, (T,) sorted [s].
        values: Values of the events, (E, T).
    Returns:
        Sorted times where a further sample may have another sign, (K,) [s].
    """
    if len(times) < 3:
        return np.empty(0)
    sizes = np.abs(values)
    low = np.ones(values.shape, dtype=bool)
    low[:, 1:] &= sizes[:, 1:] <= sizes[:, :-1]
    low[:, :-1] &= sizes[:, :-1] <= sizes[:, 1:]
    event, at = np.nonzero(low)
    return _times_near(times, values, event, at) if len(at) else np.empty(0)


def _times_near(times: Array, values: Array, event: Indices, at: Indices) -> Array:
    """Return the times of extrema close to zero near samples with indices `at` of events."""
    middle = np.clip(at, 1, len(times) - 2)
    a, b, c = (values[event, middle + k] for k in (-1, 0, 1))
    t, left, right = times[middle], *(times[middle + k] - times[middle] for k in (-1, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope_left, slope_right = (a - b) / left, (c - b) / right
        curvature = (slope_right - slope_left) / (right - left)
        slope = slope_left - curvature * left
        shift = -0.5 * slope / curvature
        extremum = b + 0.5 * slope * shift
    # At an end, the extremum lies between the end and its neighbour, up to errors of the parabola.
    least, most = np.where(at > middle, 0.0, left), np.where(at < middle, 0.0, right)
    beyond = np.where(at == middle, 0.0, _BEYOND * (right - left))
    inside = (shift > least - beyond) & (shift < most + beyond)
    shift = _apart(shift, left, right)
    size = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.abs(c))
    sign = np.sign(values[event, at])
    product = np.abs(shift * (shift - left) * (shift - right))
    error = size * np.minimum(_CLOSE, _CUBIC * product / (right - left) ** 3)
    is_needed = inside & (a * b > 0.0) & (b * c > 0.0) & (curvature * sign > 0.0)
    with np.errstate(invalid="ignore"):  # infinite without curvature
        is_needed &= extremum * sign < error
    times_of_extrema: Array = np.unique(t[is_needed] + shift[is_needed])
    return times_of_extrema


def _apart(shift: Array, left: Array, right: Array) -> Array:
    """Return shifts from the middle one of three samples, at some distance from all three."""
    side = np.where(shift == 0.0, np.where(right > -left, right, left), 0.0)
    side = np.where(shift < 0.0, left, np.where(shift > 0.0, right, side))
    return np.asarray(side * np.clip(np.abs(shift / side), _APART, 1.0 - _APART))
