"""Results of a gait optimisation: the best local optimum of the starts, and the others.

Optima are compared with the optimum over all loops, or polished to an exact extremal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...analysis.connections.connection import robot_of
from ...analysis.connections.loop_connection import LoopConnectionCode
from ...analysis.gaits.gait import Gait
from ...analysis.phases.phase import Phase
from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, NoOptimum
from ...common.html import Rows, Summary
from ...common.waiting import Wait
from ...judge.compare import compare
from ...judge.verdict import Report
from ...lie.group import PoseError
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.system import System
from .extremal_loop import Extremal, polish, refuse_extremal
from .gait_search import Search, StartFailed, finish, fourier_path_of, measure
from .limits import NOT_CONSIDERED
from .objective import ABOUT, TargetAim
from .transcription import Task, cost_unit, merit_name

SAME = 1e-5  # relative difference of merits below which two optima are considered equal


@checks_arguments
@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum: a loop that no small admissible change improves.

    Attributes:
        gait: The loop.
        phase: Geometric phase of one cycle, computed on samples independent of the optimiser's.
        value: Objective of one cycle [rad | m]; for a target, the deviation from
            the target.
        cost: Cost of one cycle, in the unit of the selected cost; NaN if no cost is selected.
        merit: The maximised quantity; see `Task.merit`.
        residual: Residual of the Karush–Kuhn–Tucker conditions, relative to the merit.
        margins: Smallest distance to the limits of each kind; see `limits.margins`.
        winding: Winding number of the loop in the plane of two joints; None for more joints.
        found: Number of starts that converged to this optimum.
    """

    gait: Gait
    phase: Phase
    value: float
    cost: float
    merit: float
    residual: float
    margins: Mapping[str, float]
    winding: float | None
    found: int = 1


def group_optima(optima: list[Optimum]) -> tuple[Optimum, ...]:
    """Merge optima of equal merit; return the distinct optima, best first, with start counts."""
    distinct: list[Optimum] = []
    for optimum in sorted(optima, key=lambda optimum: -optimum.merit):
        if distinct and distinct[-1].merit - optimum.merit <= SAME * abs(distinct[-1].merit):
            distinct[-1] = replace(distinct[-1], found=distinct[-1].found + 1)
        else:
            distinct.append(optimum)
    return tuple(distinct)


_SHOWN = 3  # number of local optima in the text


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class BestGait(Summary, Optimum):
    """The best local optimum of the starts of an optimisation, with the other local optima.

    Other starts may reach a better loop.

    Attributes:
        gait: The best loop of the starts.
        phase: Geometric phase of one cycle of this loop.
        value: Objective of one cycle [rad | m]; for a target, the deviation from the target.
        cost: Cost of one cycle; NaN if no cost is selected.
        merit: The maximised quantity: the objective, the objective per cost, or the negative cost.
        residual: Residual of the Karush–Kuhn–Tucker conditions, relative to the merit.
        margins: Smallest distance to the limits of each kind.
        winding: Winding number of the loop in the plane of two joints; None for more joints.
        found: Number of starts that converged to this loop, or to loops of the same merit.
        task: The optimisation task.
        optima: Local optima, best first.
        starts: Number of initial loops.
        lost: For each start that failed, the reason.
    """

    task: Task = field(repr=False)
    optima: tuple[Optimum, ...]
    starts: int
    lost: tuple[str, ...]

    @cached_property
    def trajectory(self) -> Trajectory:
        """One cycle, simulated at zero momentum with all joints of the gait prescribed.

        The trajectory's `driving_torques` are the joint torques that the loop requires.  Other
        joints of a robot with closed loops follow.

        Raises:
            InputError: The connection is not mechanical, or the loop has corners.
        """
        system, (x, xdot) = self._system(), self.gait.at(0.0)
        connection = self.task.connection
        signals, chart = self.gait.signals(connection.joints), connection.chart
        if isinstance(connection.code, LoopConnectionCode):
            x, xdot = connection.code.state(x, xdot)
        if chart is None:
            return simulate(
                system, x0=x, xdot0=xdot, momentum=0, duration=self.gait.period, prescribed=signals
            )
        return simulate(
            system, x0=chart.shapes(x), xdot0=chart.rates(x, xdot), momentum=0,
            duration=self.gait.period, prescribed=chart.motions(signals),
        )  # fmt: skip

    @cached_property
    def report(self) -> Report:
        """Comparison of the trajectory with full ABA under the driving torques."""
        return compare(self.trajectory)

    @property
    def flow_error(self) -> PoseError:
        """Distance between the simulated final pose and the geometric phase [rad, m].

        Under gravity, the displacement by free fall is subtracted first.
        """
        system, group, end = self._system(), self.task.connection.group, self.trajectory.pose[-1]
        fall = 0.5 * system.gravity[: group.linear] * self.gait.period**2
        if len(fall) == 3:
            end = end - np.pad(fall, (0, len(end) - 3))
        return group.error(self.phase.pose, end)

    def distance(self) -> OptimumDistance:
        """Compute the merit that the gait lacks, from the extremal or twice the harmonics.

        With cost "length" and no active limit, the distance is that to the extremal nearby (see
        `pinred.extremal`). Otherwise the gait is optimised again with twice the harmonics.

        Returns:
            The distance, and the route by which it was found.
        """
        return distance_of(self.task, self.gait, self.merit, self.cost)

    def _system(self) -> System:
        connection = self.task.connection
        system = robot_of(connection)
        if system is None or not connection.is_mechanical:
            raise InputError(
                f"expected a mechanical connection, got {connection.title()}; motions "
                "with drag or wheels cannot be simulated"
            )
        if not self.gait.is_smooth:
            raise InputError(
                "a polygon cannot be simulated, because its corners need infinite torques"
            )
        return system

    def title(self) -> str:
        """Return the first line of the text."""
        connection = self.task.connection
        starts = f"best local optimum of {self.starts} start{'s' * (self.starts > 1)}"
        name = f"{connection.group.name} × {connection.m}"
        return f"gait of {connection.form.what}, {name}: {starts}"

    def rows(self) -> Rows:
        """Return the rows of the text: objective, cost, accuracy, margins and local optima."""
        task, error = self.task, self.phase.error
        if isinstance(task.aim, TargetAim):
            rows = [("deviation from target", f"{self.value:.10g}")]
        else:
            rows = [(f"{task.aim.kind} a cycle [{task.aim.unit}]", f"{self.value:.10g}")]
        if task.cost is not None:
            unit = cost_unit(task.connection, task.cost)
            rows.append((f"{task.cost} [{unit}]", f"{self.cost:.10g}  {ABOUT[task.cost]}"))
        if task.per_cost:
            name, unit = merit_name(task)
            rows.append((f"{name} [{unit}]", f"{self.merit:.10g}"))
        if isinstance(task.connection.code, LoopConnectionCode):
            rows.append(("independent joints", ", ".join(task.connection.joints)))
        rows.append(("period [s]", f"{self.gait.period:.10g}"))
        if self.winding is not None:
            rows.append(("winding number", f"{self.winding:g}"))
        accuracy = f"{float(error.rotation):.1e} rad, {float(error.translation):.1e} m"
        rows += [
            ("error of the phase", f"{accuracy}, by doubled samples"),
            ("KKT residual", f"{self.residual:.1e}, relative to the merit"),
        ]
        if self.margins:
            margins = ", ".join(f"{name} {value:.2e}" for name, value in self.margins.items())
            rows.append(("margins", margins))
        rows.append(("not considered", NOT_CONSIDERED))
        merits = ", ".join(f"{o.merit:.10g} ({o.found} times)" for o in self.optima[:_SHOWN])
        more = f", and {len(self.optima) - _SHOWN} more" if len(self.optima) > _SHOWN else ""
        rows.append((f"optima of {self.starts} starts", f"merit {merits}{more}"))
        failed = [f"{self.lost.count(why)} times: {why}" for why in sorted(set(self.lost))]
        return [*rows, ("failed starts", "; ".join(failed))] if failed else rows


@checks_arguments
@dataclass(frozen=True)
class OptimumDistance:
    """The merit that an optimised gait lacks, by comparison with a better loop nearby.

    Attributes:
        value: Merit of the better loop minus merit of the gait; None if it is not known.
        route: The better loop: the "extremal" nearby, which is stationary among all loops, or the
            optimum with twice the "harmonics", which bounds the distance from below; or "none".
        reason: Why the extremal does not apply; empty if it does.
    """

    value: float | None
    route: str
    reason: str

    def __str__(self) -> str:
        if self.value is None:
            return f"not known: {self.reason}"
        if self.route == "extremal":
            return f"{self.value:.1e}, to the extremal nearby"
        return f"at least {self.value:.1e}, to the optimum with twice the harmonics"


def distance_of(task: Task, gait: Gait, merit: float, cost: float) -> OptimumDistance:
    """Compute the distance of an optimum from a better loop nearby.

    Args:
        task: The task.
        gait: Its optimum.
        merit: Merit of the optimum.
        cost: Cost of the optimum.
    Returns:
        The distance.
    """
    try:
        refuse_extremal(task, gait, cost)
        return OptimumDistance(polish(task, gait, merit).merit - merit, "extremal", "")
    except (InputError, NoOptimum) as error:
        reason = str(error)
    if not gait.is_smooth:
        return OptimumDistance(None, "none", reason)
    try:
        return OptimumDistance(_doubled(task, gait) - merit, "harmonics", reason)
    except StartFailed as error:
        return OptimumDistance(None, "none", f"with twice the harmonics, {error}")


def _doubled(task: Task, gait: Gait) -> float:
    """Return the merit of the optimum with twice the harmonics.  Raises StartFailed."""
    search = Search(task, fourier_path_of(task, 2 * len(gait.series.cos)))
    end = finish(search, gait)
    return measure(end.search, end.best, end.search.gait(end.best.z)).merit


@checks_arguments
@Wait("iterates a gait to an extremal")
def extremal(best: BestGait) -> Extremal:
    """Compute the extremal near an optimised gait: a loop that obeys Wong's equations.

    A loop of least length for its displacement, or of largest displacement per length, obeys
    ∇_ẋ ẋ = M⁻¹⟨μ, B(·, ẋ)⟩ with a charge μ that is constant in space. The boundary value problem of
    a closed loop is solved by multiple shooting and a Levenberg–Marquardt iteration that starts
    from the Fourier gait.

    Args:
        best: An optimum of `optimise_gait` with cost "length", within its limits.
    Returns:
        The extremal, with its charge and the residual of the boundary value problem.
    Raises:
        InputError: The cost is not the length, the gait is a polygon, or a limit is active.
        NoOptimum: No extremal was found near the gait, or it exceeds the limits.
    """
    refuse_extremal(best.task, best.gait, best.cost)
    return polish(best.task, best.gait, best.merit)
