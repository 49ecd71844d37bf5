"""Discs on one axis with springs between them: a robot whose motion is known in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.arrays import Array
from ...simulation.trajectory import Trajectory
from ...system.state_fields import State
from ...system.system import System
from .closed_forms import discs
from .generated_robots import disc_stack


@dataclass(frozen=True)
class SprungDiscs:
    """Discs, and how they begin.

    moments: (m + 1,) [kg·m²].  stiffness: (m,) of the springs between neighbours [N·m/rad], at
    rest untwisted.  x0: (m,) twists [rad].  rates: (m + 1,) of the first disc and of the twists
    [rad/s].  times: (T,) at which the motion is judged [s].
    """

    moments: Array
    stiffness: Array
    x0: Array
    rates: Array
    times: Array

    @property
    def system(self) -> System:
        """The discs as a robot; the first is the base."""
        return disc_stack(self.moments.tolist())

    @property
    def start(self) -> dict[str, Array]:
        """The initial state, by the names that Scene has for it."""
        return {"x0": self.x0, "xdot0": self.rates[1:], "xi0": self.rates[:1]}

    @property
    def run(self) -> dict[str, Any]:
        """Times and springs, by the names that Scene has for them."""
        names = self.system.shape_names
        pairs = [(k, 0.0) for k in self.stiffness]
        return {"times": self.times, "springs": dict(zip(names, pairs, strict=True))}

    def error(self, found: Trajectory | State, *, relative: bool = False) -> float:
        """Return how far a motion is from the closed form [rad].

        relative: each twist in parts of its largest.
        """
        first, twists = discs(self.moments, self.stiffness, self.x0, self.rates, self.times)
        size = np.abs(twists).max(axis=0) if relative else 1.0
        apart = np.abs(found.x - twists) / size
        return float(max(apart.max(), np.abs(found.pose[:, 0] - first).max()))
