"""Type of the motions that views accept: simulated motions, and recordings read from a file."""

from __future__ import annotations

from typing import TypeAlias

from ..simulation.recording import Recording
from ..simulation.trajectory import Trajectory

MotionSource: TypeAlias = Trajectory | Recording
