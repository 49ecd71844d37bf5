"""optimise_gait(): the loop that does most to the body for what it costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection
from ...analysis.gaits.coefficients import coefficients_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift
from ...analysis.phases.phase import phase
from ...common.arrays import positive, whole
from ...common.errors import InputError, IntegrationError, NoOptimum, SingularInertiaError
from ...common.plain_names import brief
from ...common.progress import Progress, shown
from .aims import AIMS, AimKind, Along, Reach, along, reach
from .best_gait import BestGait
from .costs import CostKind, check_cost, cost_of
from .ipopt import Minimum, minimum
from .limits import LimitsLike, limits_of
from .margins import margins
from .optimum import Optimum, gathered
from .polar_polygon import polygon_gait, polygon_path
from .search import Lost, Search, fourier_path_of, within
from .transcription import Task, problem_of

RESIDUAL = 1e-4  # of the KKT conditions; more is no optimum
_CONTINUED = (1, 3, 5, 9)  # harmonics, one after another
_APART = 1e-6  # rad | m; what samples may say otherwise than the transcription


def optimise_gait(
    connection: Connection,
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
    starts: int = 5,
    seed: int = 0,
    progress: Progress | bool | None = None,
) -> BestGait:
    """Return the best loop in shape space at zero momentum, with all local optima found.

    objective: "rotation" about an axis, "displacement" along one (without a turn), or "target".
    axis: 'x', 'y', 'z' or a vector in the frame where the base starts; of rotation in space.
    target: with objective "target", a pose, or the rotation alone: an angle, or a rotation vector.
    cost: "length" ∫√(ẋᵀMẋ) dt, "torque" ∫Σ τ² dt, "power" ∫Σ (τẋ)² dt, "acceleration"
        ∫|∇ẋ|²_M dt, or "time" T.  What is made great is the objective per cost, to the power of the
        cost that makes it independent of the size of small loops: length, √torque, ⁴√power,
        √acceleration, time.  Of a target it is the least cost.  None: the objective per cycle,
        which has a meaning with two joints and a winding number only.
    most: bound on the cost, under which the objective per cycle is made great.
    harmonics: of the Fourier series.  vertices: a polygon of so many corners on rays from a free
        centre instead (two joints; cost "length" or None).
    winding: 1: of two joints, the loop goes round once, held by continuation from one harmonic,
        and the winding number is counted in the end.  None: it may go round as it likes.
    limits: of joints [rad | m]: r for [−r, r], or one for each joint, pairs (m, 2), or {joint: r or
        pair}.  If not given, those in the robot's file, else a whole turn either way.
    speeds, torques: greatest of each joint [rad/s | m/s], [N m | N], in the same forms.
    period: T [s], on which torques depend; with cost "time" it is found.
    starts: random first loops.  seed: of their random numbers.
    progress: True for a bar, or a function called with the part that is done.

    Raises InputError for what makes no sense, SymmetryError where gravity turns the base, NoOptimum
    if no start led to one.
    """
    task = _task(connection, objective, axis, target, cost, most, limits, speeds, torques, period)
    _check_loops(task, harmonics, vertices, winding, starts, seed)
    found: list[Optimum] = []
    lost: list[str] = []
    with shown(progress, "gaits") as done:
        for k in range(starts):
            rng = np.random.default_rng([seed, k])
            try:
                if vertices is not None:
                    found.append(_polygon(task, vertices, rng))
                else:
                    found.append(_fourier(task, harmonics, winding, rng))
            except (Lost, SingularInertiaError, IntegrationError) as error:
                lost.append(str(error))
            if done is not None:
                done((k + 1) / starts)
    if not found:
        raise NoOptimum(
            f"none of {starts} starts led to an optimum: {'; '.join(sorted(set(lost)))}; "
            "give more starts, other limits, or fewer harmonics"
        )
    return BestGait(task, gathered(found), starts, tuple(lost))


def _task(
    connection: Connection,
    objective: str,
    axis: str | ArrayLike | None,
    target: ArrayLike | None,
    cost: CostKind | None,
    most: float | None,
    limits: LimitsLike | None,
    speeds: LimitsLike | None,
    torques: LimitsLike | None,
    period: float,
) -> Task:
    """Return the task that options give.  Raises InputError."""
    if not isinstance(connection, Connection):
        raise InputError(
            f"optimise_gait takes a Connection, got {type(connection).__name__}; "
            "Connection.mechanical(system) makes one"
        )
    connection.refuse_gravity()
    if objective not in AIMS:
        raise InputError(f"objective must be one of {', '.join(AIMS)}, got {brief(objective)}")
    if connection.m < 2:
        raise InputError("a loop needs two joints: with one, every way back is the way there")
    if (objective == "target") != (target is not None):
        raise InputError("objective 'target' and target= go together")
    if cost is not None:
        check_cost(connection, cost)
    bounds = limits_of(connection, limits, speeds, torques)
    limited = np.isfinite(bounds.torque).any()
    if limited and not connection.has_metric:
        raise InputError(f"{connection.form.what} do not say what torques a motion needs")
    if cost == "time" and not (limited or np.isfinite(bounds.speed).any()):
        raise InputError("cost 'time' needs limits of speeds or torques: else no time is too short")
    aim: Along | Reach
    if target is not None:
        if cost is None or most is not None:
            raise InputError("a target is reached at the least cost; give a cost, and no bound")
        if axis is not None:
            raise InputError("axis says along what to go as far as possible; a target has none")
        aim = reach(connection.group, target)
    else:
        aim = along(connection.group, objective, axis)
    if most is not None and cost is None:
        raise InputError("most is a bound on a cost; say which")
    if cost is None and connection.m > 2:
        raise InputError(
            f"'more in a cycle' means nothing with {connection.m} joints: a cycle can go round as "
            "often as it likes.  Give a cost, or with it a bound, most="
        )
    bound = None if most is None else positive(most, "most")
    return Task(connection, aim, cost, bound, bounds, positive(period, "period"))


def _check_loops(
    task: Task,
    harmonics: int,
    vertices: int | None,
    winding: int | None,
    starts: int,
    seed: int,
) -> None:
    """Raise InputError for loops that are none."""
    whole(harmonics, "harmonics")
    whole(starts, "starts")
    whole(seed, "seed", 0)
    if winding not in (1, None):
        raise InputError(
            f"winding is 1, or None for any, got {brief(winding)}: a loop that goes round n times "
            "does n times as much for n times the cost"
        )
    if winding is None and task.cost is None:
        raise InputError("'more in a cycle' means nothing unless the winding number is held")
    if vertices is not None:
        if task.connection.m != 2:
            raise InputError(f"a polygon is for two joints, not {task.connection.m}")
        whole(vertices, "vertices", 3)
        if task.cost not in (None, "length"):
            raise InputError(
                f"at its corners a polygon costs no finite {task.cost}; leave vertices out"
            )
        if np.isfinite(task.limits.speed).any() or np.isfinite(task.limits.torque).any():
            raise InputError("speeds and torques of a polygon jump; leave vertices out")


def _fourier(task: Task, harmonics: int, winding: int | None, rng: np.random.Generator) -> Optimum:
    """Return the optimum that a random ellipse leads to.  Raises Lost."""
    m = task.connection.m
    held = winding is not None or m > 2
    ladder = sorted({h for h in _CONTINUED if h < harmonics and held} | {harmonics})
    gait = _first(task, ladder[0], rng)
    for h in ladder:
        search = Search(task, fourier_path_of(task, h))
        best = search.from_gait(gait)
        gait = search.gait(best.z)
    search, best = within(search, best, harmonics)
    gait = search.gait(best.z)
    turns = None
    if m == 2:
        turns = _winding(gait)
        if winding is not None and abs(turns) != winding:
            raise Lost(f"the loop went over to winding number {turns:g}")
    return _confirmed(search, best, gait, turns)


def _first(task: Task, harmonics: int, rng: np.random.Generator) -> Gait:
    """Return a random ellipse, or a random loop of more harmonics, that does what is wanted."""
    m, limits = task.connection.m, task.limits
    size = np.minimum(limits.reach, 1.5)
    mean = limits.middle + 0.3 * size * rng.uniform(-1.0, 1.0, m)
    k = np.arange(1.0, harmonics + 1.0)[:, None]
    cos, sin = 0.5 * size * rng.uniform(-1.0, 1.0, (2, harmonics, m)) / k**2
    gait = Gait.fourier(mean, cos, sin, period=task.period)
    if isinstance(task.aim, Along):
        c = coefficients_of(gait, harmonics)
        path = fourier_path_of(task, harmonics)
        pose = path_lift(task.connection, path.basis, c).pose
        if task.aim.value(pose)[0] < 0.0:
            gait = Gait.fourier(mean, cos, -sin, period=task.period)
    return gait


def _winding(gait: Gait) -> float:
    try:
        return gait.winding()
    except InputError:  # the loop passes through its own middle, as a figure of eight does
        return 0.0


def _confirmed(search: Search, best: Minimum, gait: Gait, turns: float | None) -> Optimum:
    """Return the optimum with the phase by samples of its own.  Raises Lost if it is none."""
    if not best.residual <= RESIDUAL:
        raise Lost(f"no optimum was reached in {best.iterations} iterations ({best.status})")
    task, path = search.task, search.path
    connection, c = task.connection, search.coefficients(best.z)
    lift = path_lift(connection, path.basis, c)
    sampled = phase(connection, gait, tolerance=1e-11)
    apart = connection.group.error(sampled.pose, lift.pose)
    if not max(float(apart.rotation), float(apart.translation)) <= _APART:
        raise Lost("the loop is too fine for the nodes of the transcription")
    spent = np.nan
    if task.cost is not None:
        spent = cost_of(task.cost, connection, path.basis, c, lift, gait.period).value
        if task.cost == "length":  # at any speed
            spent = sampled.length
    if isinstance(task.aim, Reach):
        value = float(np.linalg.norm(task.aim.missed(sampled.pose)[0]))
    else:
        value = task.aim.value(sampled.pose)[0]
    return Optimum(
        gait=gait, phase=sampled, value=value, cost=spent, merit=task.merit(value, spent),
        residual=best.residual, margins=margins(connection, gait, task.limits), winding=turns,
    )  # fmt: skip


def _polygon(task: Task, vertices: int, rng: np.random.Generator) -> Optimum:
    """Return the optimum that a random polygon leads to.  Raises Lost."""
    size = np.minimum(task.limits.reach, 1.5)
    y = np.concatenate(
        [
            task.limits.middle + 0.3 * size * rng.uniform(-1.0, 1.0, 2),
            size.min() * rng.uniform(0.3, 0.6, vertices),
        ]
    )
    path = polygon_path(vertices, clockwise=False)
    if isinstance(task.aim, Along):
        pose = path_lift(task.connection, path.basis, path.coefficients(y)).pose
        if task.aim.value(pose)[0] < 0.0:
            path = polygon_path(vertices, clockwise=True)
    problem = problem_of(task, path)
    # Distances are not negative.
    rows = np.vstack([problem.rows, np.eye(len(y))[2:]])
    problem = replace(
        problem, rows=rows,
        lower=np.concatenate([problem.lower, np.zeros(vertices)]),
        upper=np.concatenate([problem.upper, np.full(vertices, np.inf)]),
    )  # fmt: skip
    best = minimum(problem, y)
    gait = polygon_gait(path, best.z, task.period)
    return _confirmed(Search(task, path), best, gait, _winding(gait))
