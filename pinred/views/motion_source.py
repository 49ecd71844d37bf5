"""Type of motions that views accept: simulated, or read from a file."""

from __future__ import annotations

from typing import TypeAlias

from ..simulation.recording import Recording
from ..simulation.trajectory import Trajectory

MotionSource: TypeAlias = Trajectory | Recording
