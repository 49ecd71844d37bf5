"""Discs on one axis with springs between neighbours, whose motion is known in closed form."""

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
    """Discs and their initial state.

    Attributes:
        moments: Moments of inertia, (m + 1,) [kg·m²].
        stiffness: Stiffness of the springs, which are relaxed at zero twist, (m,) [N·m/rad].
        x0: Initial twists of the springs, (m,) [rad].
        rates: Initial rates of the first disc and of the twists, (m + 1,) [rad/s].
        times: Times at which the motion is compared, (T,) [s].
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
        """Options of Scene for the initial state."""
        return {"x0": self.x0, "xdot0": self.rates[1:], "xi0": self.rates[:1]}

    @property
    def run(self) -> dict[str, Any]:
        """Options of Scene for times and springs."""
        names = self.system.shape_names
        pairs = [(k, 0.0) for k in self.stiffness]
        return {"times": self.times, "springs": dict(zip(names, pairs, strict=True))}

    def error(self, motion: Trajectory | State, *, relative: bool = False) -> float:
        """Return the largest error against the closed form [rad].

        relative: divide the error of each twist by the twist's largest value.
        """
        first, twists = discs(self.moments, self.stiffness, self.x0, self.rates, self.times)
        size = np.abs(twists).max(axis=0) if relative else 1.0
        errors = np.abs(motion.x - twists) / size
        return float(max(errors.max(), np.abs(motion.pose[:, 0] - first).max()))
