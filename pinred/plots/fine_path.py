"""A motion as a smooth path, whatever times it reports."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ..state import ShapeState, State
from ..trajectory import Trajectory
from .crossings import fine_times
from .motion_labels import Motion
from .recording import Recording

Path: TypeAlias = State | ShapeState | Recording


def fine_path(motion: Motion) -> Path:
    """Return the states at the report times and, of a Trajectory, close together in between."""
    if not isinstance(motion, Trajectory):
        return motion
    t, times = motion.t, fine_times(motion)
    return motion.at(np.union1d(t, times[(times >= t[0]) & (times <= t[-1])]))
