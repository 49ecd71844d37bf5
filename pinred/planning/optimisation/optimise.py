"""optimise_gait(): find loops that move the base much, relative to a cost, and compare them.

Optima are compared with the optimum over all loops, or polished to an exact extremal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection, ConnectionSource, connection_of, robot_of
from ...analysis.connections.loop_connection import LoopConnectionCode
from ...analysis.phases.gait import Gait
from ...analysis.phases.lift import path_lift, polygon_basis
from ...analysis.phases.phase import Phase
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, positive, whole
from ...common.errors import InputError, IntegrationError, NoOptimum, SingularInertiaError
from ...common.html import Rows, Summary
from ...common.names import brief
from ...common.waiting import Progress, Wait, shown
from ...judge.compare import compare
from ...judge.verdict import Report
from ...lie.group import PoseError
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.system import System
from .extremal import Extremal, polish, refuse_extremal
from .gait_search import (
    CONVEX,
    INSIDE,
    RESIDUAL,
    End,
    Path,
    Search,
    StartFailed,
    TargetMissed,
    Task,
    cost_unit,
    finish,
    fourier_path_of,
    loop_to_target,
    measure,
    merit_name,
    problem_of,
)
from .limits import NOT_CONSIDERED, LimitsLike, limits_of, margins, require_two_joints
from .nonlinear_program import Minimum, minimum, sharpened
from .objective import (
    ABOUT,
    AIMS,
    AimKind,
    AxisAim,
    CostKind,
    TargetAim,
    axis_aim,
    check_cost,
    target_aim,
)

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
        end = finish(Search(task, fourier_path_of(task, 2 * len(gait.series.cos))), gait)
    except StartFailed as error:
        return OptimumDistance(None, "none", f"with twice the harmonics, {error}")
    richer = measure(end.search, end.best, end.search.gait(end.best.z)).merit
    return OptimumDistance(richer - merit, "harmonics", reason)


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


_PIECES = 1  # number of quadrature segments of order 16 for each edge


def polygon_path(corners: int, *, clockwise: bool) -> Path:
    """Return the family of polygons whose corners lie on fixed rays from a variable centre.

    Corner k is centre + r_k (cos φ_k, sin φ_k) with φ_k = ±2πk/corners.  The unknowns are the
    centre, (2,), and the distances r_k ≥ 0.

    Args:
        corners: Number of corners.
        clockwise: Whether the corners are in clockwise order.
    Returns:
        The family of polygons.
    """
    angles = 2.0 * np.pi * np.arange(corners) / corners * (-1.0 if clockwise else 1.0)
    matrix = np.zeros((corners, 2, 2 + corners))
    matrix[:, 0, 0] = matrix[:, 1, 1] = 1.0
    for k, angle in enumerate(angles):
        matrix[k, :, 2 + k] = np.cos(angle), np.sin(angle)
    basis = polygon_basis(corners, _PIECES)
    return Path(basis, matrix.reshape(2 * corners, -1), np.zeros((corners, 2)))


_CONTINUED = (1, 3, 5, 9)  # numbers of harmonics in the successive optimisations of a continuation
# Relative perturbations before the last stage of the first and of further starts.  A small one
# leaves saddle points; large ones reach optima that the continuation from ellipses misses.
_PERTURBATIONS = (0.2, 1.2)


@checks_arguments
def optimise_gait(
    connection: ConnectionSource,
    *,
    objective: AimKind = "rotation",
    axis: str | ArrayLike | None = None,
    target: ArrayLike | None = None,
    cost: CostKind | None = "length",
    most: float | None = None,
    harmonics: int = 5,
    vertices: int | None = None,
    winding: int | None = 1,
    limits: LimitsLike | None = None,
    speeds: LimitsLike | None = None,
    torques: LimitsLike | None = None,
    period: float = 1.0,
    starts: int = 10,
    seed: int = 0,
    progress: Progress | bool | None = None,
) -> BestGait:
    """Find the best local optimum of several starts among loops in shape space at zero momentum.

    The maximised merit is the objective per cost.  The cost enters with the power that makes the
    merit independent of the size of small loops: length, √torque, ⁴√power, √acceleration or time.
    For a target, the cost is minimised.  Without a cost, the objective per cycle is maximised;
    this requires two joints and a winding number.  Velocity and effort limits of the robot file,
    and collisions between links, are not considered.

    Args:
        connection: The connection, or a System for its mechanical connection. The loops of balls
            are rotation vectors (`Connection.in_chart`).
        objective: "rotation" about an axis, "displacement" along an axis (with zero rotation),
            or "target".
        axis: 'x', 'y', 'z' or a vector in the initial frame of the base; required for rotations
            in space.
        target: With objective "target": a pose, an angle [rad] or a rotation vector [rad].
        cost: "length" ∫√(ẋᵀMẋ) dt, "torque" ∫Σ τ² dt, "power" ∫Σ (τẋ)² dt, "acceleration"
            ∫|∇ẋ|²_M dt, "time" T, or None.
        most: Bound on the cost, under which the objective per cycle is maximised.
        harmonics: Number of harmonics of the Fourier series.
        vertices: Optimise a polygon with this many corners on rays from a variable centre
            instead (two joints; cost "length" or None).
        winding: 1: the loop of two joints has winding number 1.  Continuation from one harmonic
            preserves this number, and a final check confirms it.  None: any winding number.
        limits: Limits of joints [rad | m]: r for [−r, r], one r or one pair for each joint,
            or {joint: r or pair}.  By default the limits in the robot file, or a
            full turn in either direction if the file has none.
        speeds: Largest speeds [rad/s | m/s], in the same formats.
        torques: Largest torques [N·m | N], in the same formats.
        period: Period T [s], which affects torques.  With cost "time", T is an unknown, and this is
            its initial value.
        starts: Number of random initial loops.
        seed: Seed of the random numbers for the initial loops.
        progress: True for a progress bar, or a function called with the completed fraction.
    Returns:
        The best local optimum of the starts, and the others. Other starts may reach a better loop.
    Raises:
        InputError: The options are invalid or contradict each other.
        SymmetryError: Gravity rotates the base.
        NoOptimum: No start converged to an optimum.
    """
    connection = connection_of(connection, "optimise_gait").in_chart()
    connection.refuse_gravity()
    require_two_joints(connection.m)
    if cost is not None:
        check_cost(connection, cost)
    aim = _aim(connection, objective, axis, target)
    bounds = limits_of(connection, limits, speeds, torques)
    bound = None if most is None else positive(most, "most")
    task = Task(connection, aim, cost, bound, bounds, positive(period, "period"))
    _check_task(task)
    _check_loops(task, vertices, winding)
    harmonics, starts, seed = (
        whole(harmonics, "harmonics"), whole(starts, "starts"), whole(seed, "seed", 0)
    )  # fmt: skip
    optima: list[Optimum] = []
    previous: list[End] = []
    failures: list[Exception] = []
    with shown(progress, "gaits", what="optimises a gait", reports=True) as report:
        for k in range(starts):
            rng = np.random.default_rng([seed, k])
            try:
                if vertices is not None:
                    optima.append(_optimise_polygon(task, vertices, rng))
                else:
                    change = _PERTURBATIONS[min(k, 1)]
                    optima.append(
                        _optimise_fourier(task, harmonics, winding, rng, change, previous)
                    )
            except (StartFailed, SingularInertiaError, IntegrationError) as error:
                failures.append(error)
            if report is not None:
                report((k + 1) / starts)
    lost = tuple(str(error) for error in failures)
    if not optima:
        missed = [error.deviation for error in failures if isinstance(error, TargetMissed)]
        if len(missed) == starts:
            raise NoOptimum(
                f"target: no loop from {starts} starts reaches it within the limits; the nearest "
                f"one deviates by {min(missed):.6g}. Choose a nearer target, larger limits or more "
                "harmonics."
            )
        raise NoOptimum(
            f"none of {starts} starts converged to an optimum: {'; '.join(sorted(set(lost)))}; "
            "try more starts, other limits, or fewer harmonics"
        )
    distinct = group_optima(optima)
    return BestGait(**vars(distinct[0]), task=task, optima=distinct, starts=starts, lost=lost)


def _aim(
    connection: Connection, objective: str, axis: str | ArrayLike | None, target: ArrayLike | None
) -> AxisAim | TargetAim:
    """Validate and create the objective."""
    if objective not in AIMS:
        raise InputError(f"objective must be one of {', '.join(AIMS)}, got {brief(objective)}")
    if (objective == "target") != (target is not None):
        raise InputError(
            "objective 'target' requires target=, and target= requires objective 'target'"
        )
    if target is None:
        return axis_aim(connection.group, objective, axis)
    if axis is not None:
        raise InputError("axis: expected none with a target. Omit axis=.")
    return target_aim(connection.group, target)


def _check_task(task: Task) -> None:
    """Raise InputError for a cost or a bound that does not suit the objective or the limits."""
    connection, cost = task.connection, task.cost
    limited = np.isfinite(task.limits.torque).any()
    if limited and not connection.has_metric:
        raise InputError(f"torques: {connection.form.what} define no joint torques. Omit torques=.")
    if cost == "time" and not (limited or np.isfinite(task.limits.speed).any()):
        raise InputError(
            "cost 'time' needs limits of speeds or torques, which bound the period from below"
        )
    if (
        isinstance(task.aim, AxisAim)
        and task.aim.kind == "displacement"
        and connection.is_mechanical
    ):
        raise InputError(
            "objective: at zero momentum the centre of mass rests, so a loop displaces nothing "
            "without rotation. Use 'rotation', a target, or a connection by drag, fluids or wheels."
        )
    if isinstance(task.aim, TargetAim) and (cost is None or task.most is not None):
        raise InputError("objective 'target' minimises a cost. Pass cost= and omit most=.")
    if task.most is not None and cost is None:
        raise InputError("most= bounds a cost. Pass cost= as well.")
    if cost is None and connection.m > 2:
        raise InputError(
            f"cost: expected a cost for {connection.m} joints, got None; without cost, a cycle "
            "could wind arbitrarily often.  Give a cost, or a cost with a bound, most="
        )


def _check_loops(task: Task, vertices: int | None, winding: int | None) -> None:
    """Raise InputError for invalid loops, or loops that do not suit the task."""
    if winding not in (1, None):
        raise InputError(
            f"winding must be 1, or None for any number, got {brief(winding)}: n turns have n "
            "times the effect for n times the cost"
        )
    if winding is None and task.cost is None:
        raise InputError(
            "winding=None needs a cost: a cycle without cost could wind arbitrarily often"
        )
    if vertices is not None:
        if task.connection.m != 2:
            raise InputError(f"vertices: a polygon needs two joints, got {task.connection.m}")
        whole(vertices, "vertices", 3)
        if task.cost not in (None, "length"):
            raise InputError(
                f"the {task.cost} of a polygon is infinite at its corners. Omit vertices=."
            )
        if np.isfinite(task.limits.speed).any() or np.isfinite(task.limits.torque).any():
            raise InputError(
                "limits of speeds and torques need a smooth loop. Omit vertices=, or these limits."
            )


def _optimise_fourier(
    task: Task,
    harmonics: int,
    winding: int | None,
    rng: np.random.Generator,
    change: float,
    known: list[End],
) -> Optimum:
    """Return the optimum reached from a random ellipse.

    Args:
        task: The task.
        harmonics: Number of harmonics.
        winding: Winding number 1, or None for any.
        rng: Random numbers.
        change: Relative perturbation before the last stage.
        known: Ends of the searches from other ellipses, to which this one is added.
    Returns:
        The optimum.
    Raises:
        StartFailed: No optimum was reached.
    """
    m = task.connection.m
    continued = winding is not None or m > 2
    ladder = sorted({h for h in _CONTINUED if h < harmonics and continued} | {harmonics})
    gait = _initial_loop(task, ladder[0], rng)
    search = Search(task, fourier_path_of(task, harmonics))
    targeted = isinstance(task.aim, TargetAim)
    reached = loop_to_target(task, search.path, gait) if targeted else gait
    for h in ladder[:-1]:
        stage = Search(task, fourier_path_of(task, h, action=True))
        gait = stage.gait(stage.optimise_from(gait, once=True).z)
    if len(ladder) > 1:
        z = search.unknowns(gait)
        y = z[: search.path.size]  # the loop without its period, which stays positive
        y += change * np.abs(y).max() * rng.uniform(-1.0, 1.0, len(y))
        gait = search.gait(z)
    if targeted:
        try:
            gait = loop_to_target(task, search.path, gait)
        except TargetMissed:
            gait = reached
    end = finish(search, gait, known=known)
    if end not in known:
        known.append(end)
    search, best = end.search, end.best
    gait = search.gait(best.z)
    turns = None
    if m == 2:
        turns = _winding(gait)
        if winding is not None and abs(turns) != winding:
            raise StartFailed(f"the loop has winding number {turns:g} instead of {winding}")
    return _verify(search, best, gait, turns)


def _initial_loop(task: Task, harmonics: int, rng: np.random.Generator) -> Gait:
    """Return a random Fourier loop, traversed in the direction that increases the objective."""
    m, limits = task.connection.m, task.limits
    size = np.minimum(limits.reach, 1.5)
    mean = limits.middle + 0.3 * size * rng.uniform(-1.0, 1.0, m)
    k = np.arange(1.0, harmonics + 1.0)[:, None]
    cos, sin = 0.5 * size * rng.uniform(-1.0, 1.0, (2, harmonics, m)) / k**2
    gait = Gait.fourier(mean, cos, sin, period=task.period)
    if isinstance(task.aim, AxisAim):
        c = gait.series.coefficients(harmonics)
        path = fourier_path_of(task, harmonics)
        pose = path_lift(task.connection, path.basis, c).pose
        if task.aim.value(pose)[0] < 0.0:
            gait = Gait.fourier(mean, cos, -sin, period=task.period)
    return gait


def _winding(gait: Gait, centre: Array | None = None) -> float:
    try:
        return gait.winding(centre=centre)
    except InputError:  # the loop passes through its centre, like a figure of eight
        return 0.0


def _verify(search: Search, best: Minimum, gait: Gait, turns: float | None) -> Optimum:
    """Return the certificate of an optimum.  Raises StartFailed."""
    task = search.task
    residual = best.residual / (CONVEX if isinstance(task.aim, TargetAim) else 1)
    if not residual <= RESIDUAL:
        raise StartFailed(f"no optimum was reached in {best.iterations} iterations ({best.status})")
    distances = margins(task.connection, gait, task.limits)
    if not min(distances.values()) >= 0.0:
        raise StartFailed("the loop still exceeds its limits")
    return Optimum(
        **vars(measure(search, best, gait)), residual=residual, margins=distances, winding=turns
    )


def _optimise_polygon(task: Task, vertices: int, rng: np.random.Generator) -> Optimum:
    """Return the optimum reached from a random polygon.  Raises StartFailed."""
    size = np.minimum(task.limits.reach, 1.5)
    y = np.concatenate(
        [
            task.limits.middle + 0.3 * size * rng.uniform(-1.0, 1.0, 2),
            size.min() * rng.uniform(0.3, 0.6, vertices),
        ]
    )
    path = polygon_path(vertices, clockwise=False)
    if isinstance(task.aim, AxisAim):
        pose = path_lift(task.connection, path.basis, path.coefficients(y)).pose
        if task.aim.value(pose)[0] < 0.0:
            path = polygon_path(vertices, clockwise=True)
    problem = problem_of(task, path)
    # Corners are within the limits, and distances from the centre are not negative.
    middle, reach = task.limits.middle, (1.0 - INSIDE) * task.limits.reach
    low, high = (np.tile(limit, vertices) for limit in (middle - reach, middle + reach))
    problem = replace(
        problem, rows=np.vstack([problem.rows, path.matrix, np.eye(len(y))[2:]]),
        lower=np.concatenate([problem.lower, low, np.zeros(vertices)]),
        upper=np.concatenate([problem.upper, high, np.full(vertices, np.inf)]),
    )  # fmt: skip
    best = sharpened(problem, minimum(problem, y))
    corners = path.coefficients(best.z)
    gait = Gait.waypoints(corners, period=task.period)
    # Triangles may pass through the middle of their ranges, but not through their mean corner.
    turns = _winding(gait, corners.mean(axis=0))
    return _verify(Search(task, path), best, gait, turns)
