"""The full simulation of a scene by Pinocchio's ABA, as what a trajectory is measured by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...judge.distances import FullMotion, Size
from ...judge.reference_solution import FINEST, FullState
from ...scene.scene import Scene
from ...simulation.trajectory import Trajectory


@dataclass(frozen=True)
class Truth:
    """The motion of a scene by ABA at some times, and how much a small kick grows in it."""

    full: FullState
    motion: FullMotion
    size: Size
    growth: float

    def error(self, traj: Trajectory, times: Array) -> float:
        """Return how far a trajectory is from it at its times, relative to the motion's size."""
        found = traj(times)
        return self.full.distance(self.motion, FullMotion(x=found.x, q=found.q)).worst(self.size)


def truth_of(scene: Scene, times: Array) -> Truth:
    """Return the motion of a scene at times (T,).  Raises IntegrationError."""
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, times, *FINEST)
    growth = float(full.growth(y0, motion, times, 1e-10, 1e-12)[-1])
    return Truth(full, motion, full.size(motion), growth)


def samples(scene: Scene, count: int = 21) -> Array:
    """Return even times in a scene, its end last, (count,) [s]."""
    return np.linspace(0.0, scene.end, count + 1)[1:]
