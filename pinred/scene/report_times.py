"""The times at which a scene reports."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.arrays import Array, as_floats, positive
from ..common.errors import InputError, ShapeError
from ..system.system import System
from .random_state import DURATION

EVEN_TIMES = 201  # where the scene does not say
_COUNTS = np.arange(float(EVEN_TIMES))


def report_times(given: Any, duration: float | None, system: System) -> Array:
    """Return the times to report, (T,) [s]: those given, or even ones to the end.

    Raises InputError or ShapeError unless they increase within the duration.
    """
    if given is None:
        own = system.initial.duration if system.initial else DURATION
        return _even_times(own if duration is None else float(duration))
    times = np.atleast_1d(as_floats(given, "times")).copy()
    end = np.inf if duration is None else float(duration)
    if times.ndim != 1 or times.size == 0 or not np.isfinite(times).all():
        raise ShapeError("times must be a vector of finite times")
    if (np.diff(times) <= 0.0).any() or times[0] < 0.0 or times[-1] > end:
        raise InputError(
            f"times must increase from 0 or later to the duration at most ({end:g} s), "
            f"got {times[0]:g} … {times[-1]:g}"
        )
    if duration is None:
        positive(times[-1], "the last of times, which stands for the duration,")
    return times


def _even_times(last: float) -> Array:
    times: Array = _COUNTS * (last / _COUNTS[-1])
    times[-1] = last
    return times
