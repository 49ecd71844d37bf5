"""BestGait: the best loop that was found, its certificate, and the other local optima."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...analysis.gaits.gait import Gait
from ...analysis.phases.phase import Phase
from ...common.errors import InputError
from ...judge.compare import compare
from ...judge.report import Report
from ...lie.group import PoseError
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.system import System
from .aims import Along, Reach
from .costs import ABOUT, DEGREES
from .optimum import Optimum
from .transcription import Task

_ROOTS = {1: "", 2: "√", 4: "⁴√"}


@dataclass(frozen=True, eq=False, repr=False)
class BestGait:
    """The best of the loops found, and all others.

    optima: local optima, best first, each with how often it was found.  starts: how many first
    loops there were.  lost: why others led to none.
    """

    task: Task = field(repr=False)
    optima: tuple[Optimum, ...]
    starts: int
    lost: tuple[str, ...]

    @property
    def gait(self) -> Gait:
        """The best loop."""
        return self.optima[0].gait

    @property
    def phase(self) -> Phase:
        """What one cycle of it does to the body."""
        return self.optima[0].phase

    @property
    def value(self) -> float:
        """The objective of one cycle [rad | m]; of a target, what is missing."""
        return self.optima[0].value

    @property
    def cost(self) -> float:
        """What one cycle costs; NaN without a cost."""
        return self.optima[0].cost

    @property
    def merit(self) -> float:
        """What was made great: the objective, per cost if that was asked for; or less the cost."""
        return self.optima[0].merit

    @property
    def winding(self) -> float | None:
        """How often it goes round, of two joints; None with more."""
        return self.optima[0].winding

    @cached_property
    def trajectory(self) -> Trajectory:
        """One cycle, simulated at zero momentum with the joints on the loop.

        `driving_torques` are those that it needs.  Raises InputError unless the connection is
        mechanical and the loop smooth.
        """
        return cycle(self._system(), self.gait)

    @cached_property
    def report(self) -> Report:
        """The judgement of the trajectory by full ABA, under the torques that follow the loop."""
        return compare(self.trajectory)

    @property
    def flow_error(self) -> PoseError:
        """How far the simulated base ends from the phase: rotation [rad], position [m].

        Less what it falls by, where there is gravity.
        """
        system, group, end = self._system(), self.task.connection.group, self.trajectory.pose[-1]
        fallen = 0.5 * system.gravity[: group.linear] * self.gait.period**2
        if len(fallen) == 3:
            end = end - np.pad(fallen, (0, len(end) - 3))
        return group.error(self.phase.pose, end)

    def _system(self) -> System:
        connection = self.task.connection
        if connection.system is None or not connection.is_mechanical:
            raise InputError(
                f"only a motion without drag and wheels can be simulated, not {connection}"
            )
        if not self.gait.is_smooth:
            raise InputError("at the corners of a polygon joints would need infinite torques")
        return connection.system

    def __repr__(self) -> str:
        best = self.optima[0]
        return (
            f"<BestGait of {self.task.connection}: merit {best.merit:.9g}, "
            f"{best.found} of {self.starts} starts, {len(self.optima)} local optima>"
        )

    def __str__(self) -> str:
        task, best, group = self.task, self.optima[0], self.task.connection.group
        lines = [f"best gait of {task.connection.form.what}, {group.name} × {task.connection.m}"]

        def row(name: str, value: float | str, note: str = "") -> None:
            shown = value if isinstance(value, str) else f"{value:.10g}"
            lines.append(f"  {name:<26} {shown:>16}{'  ' + note if note else ''}")

        if isinstance(task.aim, Reach):
            row("missing of the target", best.value)
        else:
            row(f"{task.aim.kind} a cycle [{task.aim.unit}]", best.value)
        if task.cost is not None:
            row(task.cost, best.cost, ABOUT[task.cost])
        if task.per_cost and isinstance(task.aim, Along):
            row(f"{task.aim.kind} / {_ROOTS[DEGREES[task.cost or 'time']]}{task.cost}", best.merit)
        row("period [s]", best.gait.period)
        if best.winding is not None:
            row("winding number", f"{best.winding:g}")
        error = best.phase.error
        row(
            "error of the phase",
            f"{float(error.rotation):.1e} rad",
            f"{float(error.translation):.1e} m, by doubled samples",
        )
        row("KKT residual", f"{best.residual:.1e}", "relative to the merit")
        for name, margin in best.margins.items():
            row(f"margin to {name}", f"{margin:.2e}")
        lines.append(f"  local optima, from {self.starts} starts:")
        lines += [
            f"    merit {each.merit:.10g}, found {each.found} times, residual {each.residual:.1e}"
            for each in self.optima
        ]
        lines += [f"    none {self.lost.count(why)} times: {why}" for why in sorted(set(self.lost))]
        return "\n".join(lines)


def cycle(system: System, gait: Gait) -> Trajectory:
    """Return one cycle of a gait from zero momentum, the base free and the joints on the loop."""
    x, xdot = gait.at(0.0)
    plan = gait.signals(system.shape_names)
    return simulate(system, x0=x, xdot0=xdot, momentum=0, prescribed=plan, duration=gait.period)
