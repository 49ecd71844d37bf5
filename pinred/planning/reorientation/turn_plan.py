"""TurnPlan: a joint motion from rest to rest that rotates the base, and its accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.connections.loop_connection import LoopConnectionCode
from ...analysis.connections.rotation_chart import RotationChart
from ...analysis.gaits.gait import Gait
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...forces.signals import Attitude
from ...judge.compare import compare
from ...judge.verdict import Report
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.system import System
from ..optimisation.limits import NOT_CONSIDERED
from ..optimisation.objective import TargetAim

TOLERANCES = (1e-12, 1e-14)  # relative and absolute tolerance of a plan's simulation


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class TurnPlan(FrozenArrays):
    """A reorientation: a loop of the joints, repeated from rest to rest.

    Attributes:
        system: The system.
        aim: The target.
        gait: The loop; balls move by rotation vectors about their initial attitudes.
        cycles: Number of cycles.
        duration: Total duration [s].
        pose: Final pose of the base, (size,).
        remaining: Remaining rotation from the final attitude to the target [rad].
        momentum: Initial body momentum, (r,).
        left: Final body twist of the base, (r,); zero at zero momentum.
        margins: Smallest distance to the limits of joints, speeds and torques.
        connection: The mechanical connection, over rotation vectors of balls, or over independent
            joints of a robot with closed loops.
    """

    system: System
    aim: TargetAim = field(repr=False)
    gait: Gait
    cycles: int
    duration: float
    pose: Array
    remaining: float
    momentum: Array
    left: Array
    margins: Mapping[str, float]
    connection: Connection = field(repr=False)

    @property
    def chart(self) -> RotationChart | None:
        """Rotation vectors of balls; None without balls."""
        return self.connection.chart

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion, simulated with a free base.

        The trajectory's `driving_torques` are the joint torques that the plan requires.
        """
        rtol, atol = TOLERANCES
        start, xdot = self.gait.at(0.0)
        formulas = rest_to_rest(self.gait, self.connection.joints, self.cycles, self.duration)
        if isinstance(self.connection.code, LoopConnectionCode):
            start, _ = self.connection.code.state(start, xdot)
        prescribed: dict[str, str | Attitude] = dict(formulas)
        if self.chart is not None:
            start = self.chart.shapes(start)
            for ball in self.chart.space.balls:
                vector = [prescribed.pop(ball.name + axis) for axis in ball.kind.rates]
                prescribed[ball.name] = Attitude(vector, self.chart.centre[ball.x])
        return simulate(
            self.system, x0=start, momentum=self.momentum, duration=self.duration,
            prescribed=prescribed, rtol=rtol, atol=atol,
        )  # fmt: skip

    @cached_property
    def report(self) -> Report:
        """Comparison of the trajectory with full ABA under the driving torques."""
        return compare(self.trajectory)

    @property
    def missed(self) -> float:
        """Remaining rotation to the target [rad] in the simulation."""
        group = self.system.group
        pose = self.trajectory.pose
        motion = group.compose(group.inverse(pose[0]), pose[-1])
        return float(np.linalg.norm(self.aim.error(motion)[0]))

    @property
    def turned(self) -> Array:
        """Total rotation of the base by all cycles: rotation vector (3,) or angle (1,) [rad]."""
        group = self.system.group
        return np.asarray(group.log(self.pose)[group.linear :])

    @property
    def tumble(self) -> float:
        """Angular speed of the base after the motion [rad/s], determined by the momentum."""
        return float(np.linalg.norm(self.left[self.system.group.linear :]))

    def __repr__(self) -> str:
        return (
            f"<TurnPlan of {self.system.name}: {self.cycles} cycles in {self.duration:g} s, "
            f"{self.remaining:.1e} rad remain>"
        )

    def __str__(self) -> str:
        degrees = ", ".join(f"{angle:.6f}" for angle in np.degrees(self.turned))
        lines = [
            f"{self.system.name} turns by its joints: {self.cycles} cycles, {self.duration:g} s",
            f"  turned [°]              {degrees}",
            f"  remaining [rad]         {self.remaining:.1e}",
        ]
        if self.momentum.any():
            lines.append(f"  tumble left [rad/s]     {self.tumble:.6g}, determined by the momentum")
        lines += [f"  margin to {name:<13} {value:.3g}" for name, value in self.margins.items()]
        return "\n".join([*lines, f"  not considered          {NOT_CONSIDERED}"])


def rest_to_rest(gait: Gait, joints: Sequence[str], cycles: int, duration: float) -> dict[str, str]:
    """Return the motion of each joint through several cycles of a gait, from rest to rest.

    The phase angle is the cycloid φ = cycles (a − sin a), a = 2πt/duration. Rates and accelerations
    are zero at both ends.

    Args:
        gait: Gait that is one Fourier series.
        joints: Names of the joints, in order.
        cycles: Number of cycles.
        duration: Duration of all cycles [s].
    Returns:
        A formula in t per joint, for `prescribed` of a Scene.
    """
    c = gait.series.coefficients()
    h = (len(c) - 1) // 2
    a = f"(2*pi*t/{float(duration)!r})"
    angle = f"({cycles}*({a} - sin({a})))"
    formulas = {}
    for j, name in enumerate(joints):
        terms = [repr(float(c[0, j]))]
        for k in range(1, h + 1):
            terms.append(f"({float(c[k, j])!r})*cos({k}*{angle})")
            terms.append(f"({float(c[h + k, j])!r})*sin({k}*{angle})")
        formulas[name] = " + ".join(terms)
    return formulas
