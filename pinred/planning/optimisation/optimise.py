"""optimise_gait(): find loops that move the base much, relative to a cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection, ConnectionSource, connection_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift, polygon_basis
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, positive, whole
from ...common.errors import InputError, IntegrationError, NoOptimum, SingularInertiaError
from ...common.names import brief
from ...common.waiting import Progress, shown
from .best_gait import BestGait, Optimum, group_optima
from .gait_search import (
    RESIDUAL,
    End,
    Search,
    StartFailed,
    TargetMissed,
    finish,
    fourier_path_of,
    loop_to_target,
    measure,
)
from .limits import LimitsLike, limits_of, margins, require_two_joints
from .nonlinear_program import Minimum, minimum, sharpened
from .objective import (
    AIMS,
    AimKind,
    AxisAim,
    CostKind,
    TargetAim,
    axis_aim,
    check_cost,
    target_aim,
)
from .transcription import CONVEX, INSIDE, Path, Task, problem_of

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


def polygon_gait(path: Path, y: Array, period: float) -> Gait:
    """Convert a polygon to a gait of constant speed.

    Args:
        path: The family of polygons.
        y: Unknowns of the polygon: centre and distances.
        period: Period [s].
    Returns:
        The gait.
    """
    return Gait.waypoints(path.coefficients(y), period=period)


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
    gait = polygon_gait(path, best.z, task.period)
    # Triangles may pass through the middle of their ranges, but not through their mean corner.
    turns = _winding(gait, path.coefficients(best.z).mean(axis=0))
    return _verify(Search(task, path), best, gait, turns)
