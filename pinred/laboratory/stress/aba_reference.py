"""Reference solution of a scene, integrated with Pinocchio's ABA on the full state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...judge.distances import FullMotion, Size
from ...judge.reference_solution import FINEST, FullState
from ...scene.scene import Scene
from ...simulation.trajectory import Trajectory


@dataclass(frozen=True)
class AbaReference:
    """Reference solution of a scene at some times.

    Attributes:
        full: Full simulation of the scene.
        motion: Reference solution at the times.
        size: Size of the motion, which serves as the unit of errors.
        growth: Factor by which a small perturbation grows until the last time.
    """

    full: FullState
    motion: FullMotion
    size: Size
    growth: float

    def error(self, traj: Trajectory, times: Array) -> float:
        """Return the largest error of a trajectory at `times`, relative to the motion's size."""
        states = traj(times)
        return self.error_of(FullMotion(x=states.x, q=states.q))

    def error_of(self, motion: FullMotion) -> float:
        """Return the largest error of a motion at the same times, relative to its size."""
        return self.full.distance(self.motion, motion).worst(self.size)


def aba_reference(scene: Scene, times: Array) -> AbaReference:
    """Integrate a scene with ABA at times (T,); raise IntegrationError if the integration fails."""
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, times, *FINEST)
    growth = float(full.growth(y0, motion, times, 1e-10, 1e-12)[-1])
    return AbaReference(full, motion, full.size(motion), growth)


def samples(scene: Scene, count: int = 21) -> Array:
    """Return evenly spaced times of a scene, including its end, (count,) [s]."""
    return np.linspace(0.0, scene.end, count + 1)[1:]
