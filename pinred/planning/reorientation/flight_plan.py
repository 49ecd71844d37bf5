"""FlightPlan: the joint motion of least effort that lands a flying robot at an attitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...forces.signals.signal import Spline
from ...judge.compare import compare
from ...judge.verdict import Report
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.system import System
from ..optimisation.objective import TargetAim

TOLERANCES = (1e-11, 1e-13)  # relative and absolute tolerance of a plan's simulation


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class FlightPlan(FrozenArrays):
    """A joint motion in flight, from rest to rest of the joints, with the least effort found.

    Attributes:
        system: The system.
        momentum: Initial body momentum, (r,).
        duration: Time of flight [s].
        aim: The target.
        times: Times of the knots of the cubic splines of the joints, (K,) [s].
        shapes: Shapes at these times, (K, m) [rad | m]; the rates at both ends are zero.
        effort: "torque" or "rate".
        cost: Mean over time of the sum of squared torques or rates.
        reached: Whether the target is reached; otherwise the plan ends at the nearest attitude
            that was found.
        remaining: Remaining rotation from the final attitude to the target [rad].
        kkt: Largest entry of the gradient of the Lagrangian of the nonlinear program, relative to
            the largest entry of the gradient of its objective.
        violation: Largest violation of an equation or a bound of the nonlinear program.
        starts: Cost, on a coarse grid, of the solution from each start; NaN without a solution.
        margins: Smallest distance to the limits of joints, speeds and torques.
        active: Kind and joint of the limits that the motion reaches.
        shortest: If the target is not reached, the shortest longer duration found that suffices
            [s], or NaN if none was found; otherwise None.
    """

    system: System
    momentum: Array
    duration: float
    aim: TargetAim = field(repr=False)
    times: Array
    shapes: Array
    effort: str
    cost: float
    reached: bool
    remaining: float
    kkt: float
    violation: float
    starts: Array
    margins: Mapping[str, float]
    active: tuple[str, ...]
    shortest: float | None = field(default=None)

    @property
    def prescribed(self) -> dict[str, Spline]:
        """Motion of each joint, for `prescribed` of a Scene."""
        columns = zip(self.system.shape_names, self.shapes.T, strict=True)
        return {name: Spline(self.times, values, end="clamped") for name, values in columns}

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion, simulated with a free base.

        The trajectory's `driving_torques` are the joint torques that the plan requires.
        """
        rtol, atol = TOLERANCES
        return simulate(
            self.system, x0=self.shapes[0], momentum=self.momentum, duration=self.duration,
            prescribed=self.prescribed, rtol=rtol, atol=atol,
        )  # fmt: skip

    @cached_property
    def report(self) -> Report:
        """Comparison of the trajectory with full ABA under the driving torques."""
        return compare(self.trajectory)

    @property
    def missed(self) -> float:
        """Remaining rotation to the target [rad] in the simulation."""
        group, pose = self.system.group, self.trajectory.pose
        motion = group.compose(group.inverse(pose[0]), pose[-1])
        return float(np.linalg.norm(self.aim.error(motion)[0]))

    def __repr__(self) -> str:
        remain = f"{self.remaining:.1e} rad remain"
        return f"<FlightPlan of {self.system.name}: {self.duration:g} s, {remain}>"

    def __str__(self) -> str:
        costs = ", ".join(f"{cost:.4g}" for cost in np.sort(self.starts) if np.isfinite(cost))
        solved = self.starts[np.isfinite(self.starts)]
        quantity = "mean Σ torque²" if self.effort == "torque" else "mean Σ rate²"
        lines = [
            f"{self.system.name} lands after {self.duration:g} s",
            f"  remaining [rad]         {self.remaining:.1e}",
            f"  {quantity:<23} {self.cost:.6g}",
            f"  starts                  {len(solved)} of {len(self.starts)} solved",
            f"  of each, coarse grid    {costs or 'none'}",
            f"  KKT residual            {self.kkt:.1e}, equations {self.violation:.1e}",
            *(f"  margin to {name:<13} {value:.3g}" for name, value in self.margins.items()),
            f"  active limits           {', '.join(self.active) or 'none'}",
        ]
        if not self.reached:
            suffices = "no longer duration that was tried suffices"
            if self.shortest is not None and np.isfinite(self.shortest):
                suffices = f"{self.shortest:.4g} s suffice"
            lines.append(
                "  out of reach            the nearest attitude found misses the target by "
                f"{self.remaining:.4g} rad; {suffices}"
            )
        return "\n".join([*lines, "  not considered          collisions between links"])
