"""TurnPlan: joint motion from rest to rest that turns the base, and what remains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...analysis.gaits.coefficients import rest_to_rest
from ...analysis.gaits.gait import Gait
from ...common.arrays import Array, freeze
from ...judge.compare import compare
from ...judge.report import Report
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.system import System
from ..optimisation.aims import Reach

TOLERANCES = (1e-12, 1e-14)  # of the simulation of a plan: relative, absolute


@dataclass(frozen=True, eq=False, repr=False)
class TurnPlan:
    """A loop that the joints go round several times, from rest to rest.

    gait: the loop.  cycles: how often.  duration: of all cycles [s].  pose: (size,) of the base in
    the end.  remaining: what is left to the target there [rad].  momentum: (r,) body momentum at
    the start.  left: (r,) body twist of the base in the end, zero without momentum.  margins: least
    distance to the limits of joints, speeds and torques.
    """

    system: System
    aim: Reach = field(repr=False)
    gait: Gait
    cycles: int
    duration: float
    pose: Array
    remaining: float
    momentum: Array
    left: Array
    margins: Mapping[str, float]

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion, simulated with the base free.

        `driving_torques` are those that it needs.
        """
        rtol, atol = TOLERANCES
        return simulate(
            self.system, x0=self.gait.at(0.0)[0], momentum=self.momentum, duration=self.duration,
            prescribed=rest_to_rest(
                self.gait, self.system.shape_names, self.cycles, self.duration
            ),
            rtol=rtol, atol=atol,
        )  # fmt: skip

    @cached_property
    def report(self) -> Report:
        """The judgement of the trajectory by full ABA, under the torques that follow the plan."""
        return compare(self.trajectory)

    @property
    def missed(self) -> float:
        """What is left to the target in the end [rad], by the simulation."""
        group = self.system.group
        pose = self.trajectory.pose
        moved = group.compose(group.inverse(pose[0]), pose[-1])
        return float(np.linalg.norm(self.aim.missed(moved)[0]))

    @property
    def turned(self) -> Array:
        """The rotation vector (3,), or the angle (1,), of all cycles [rad]."""
        group = self.system.group
        return np.asarray(group.log(self.pose)[group.linear :])

    @property
    def tumble(self) -> float:
        """Angular velocity that is left in the end [rad/s]; momentum allows no other."""
        return float(np.linalg.norm(self.left[self.system.group.linear :]))

    def __repr__(self) -> str:
        return (
            f"<TurnPlan of {self.system.name}: {self.cycles} cycles in {self.duration:g} s, "
            f"{self.remaining:.1e} rad remain>"
        )

    def __str__(self) -> str:
        degrees = ", ".join(f"{each:.6f}" for each in np.degrees(self.turned))
        lines = [
            f"{self.system.name} turns by its joints: {self.cycles} cycles, {self.duration:g} s",
            f"  turned [°]              {degrees}",
            f"  remaining [rad]         {self.remaining:.1e}",
        ]
        if self.momentum.any():
            lines.append(f"  tumble left [rad/s]     {self.tumble:.6g}, which momentum fixes")
        lines += [f"  margin to {name:<13} {value:.3g}" for name, value in self.margins.items()]
        return "\n".join(lines)
