"""The search for a Fourier gait: a nonlinear program, solved from an initial loop within limits.

The coefficients of a path are affine in the unknowns y: c = L y + c₀.  The period is an additional
unknown if it is minimised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.phases.gait import Gait
from ...analysis.phases.lift import Drift, PathBasis, cycloid_basis, fourier_basis, path_lift
from ...analysis.phases.phase import Phase, phase
from ...common.arrays import Array
from ...common.errors import NoConvergence, SingularInertiaError
from .limits import LimitChecks, LimitedLoop, Limits, Times, first_checks
from .nonlinear_program import Minimum, Problem, minimum, sharpened
from .objective import DEGREES, AxisAim, CostKind, TargetAim, cost_of

INSIDE = 1.5e-8  # relative margin to limits and bounds, above the accepted violation
# Power of the size of a loop that is minimised for a target.  Small loops reach targets in
# proportion to the square of their size, so that smaller powers are not convex in the target.
CONVEX = 4
_SHORTEST = 1e-6  # lower bound of a variable period [s]
_ROOTS = {1: "", 2: "√", 4: "⁴√"}  # of costs, by their degree


@dataclass(frozen=True, eq=False)
class Passage:
    """The motion along a loop from rest to rest: several cycles with a cycloidal time law.

    Attributes:
        cycles: Number of cycles.
        drift: Motion of the base caused by nonzero momentum.
        more: Number of additional quadrature segments that resolve the drift.
    """

    cycles: int
    drift: Drift
    more: int


@dataclass(frozen=True, eq=False)
class Task:
    """The task of a gait optimisation: objective, cost and limits.

    Attributes:
        connection: The connection.
        aim: The objective.
        cost: The cost, or None.
        most: Bound on the cost, or None.
        limits: Limits of the joints.
        period: Period T [s]; if the period is minimised, its initial value.
        passage: Motion from rest to rest, or None for a periodic loop.
    """

    connection: Connection
    aim: AxisAim | TargetAim
    cost: CostKind | None
    most: float | None
    limits: Limits
    period: float
    passage: Passage | None = None

    @property
    def drift(self) -> Drift | None:
        """Motion of the base caused by nonzero momentum, or None at zero momentum."""
        return None if self.passage is None else self.passage.drift

    @property
    def period_is_free(self) -> bool:
        """Whether the period is an unknown."""
        return self.cost == "time"

    @property
    def per_cost(self) -> bool:
        """Whether the objective per cost is maximised."""
        return isinstance(self.aim, AxisAim) and self.cost is not None and self.most is None

    def merit(self, value: float, cost: float) -> float:
        """Compute the merit, the quantity that the optimisation maximises.

        Args:
            value: Objective of one cycle.
            cost: Cost of one cycle.
        Returns:
            The value without a cost, the value divided by a power of the cost, or the negative cost
            for a target.
        """
        if isinstance(self.aim, TargetAim):
            return -cost
        if self.cost is None or not self.per_cost:
            return value
        return float(value / cost ** (1.0 / DEGREES[self.cost]))


@dataclass(frozen=True, eq=False)
class Path:
    """A family of paths whose coefficients are affine in unknowns y: c = L y + c₀.

    Attributes:
        basis: Basis functions at the Gauss nodes.
        matrix: Matrix L of the affine map, (K m, n).
        shift: Constant term c₀ of the affine map, (K, m).
        checks: Checks of the limits of Fourier series; None for other paths.
        action: Whether the root of the action replaces the cost "length".
    """

    basis: PathBasis
    matrix: Array
    shift: Array
    checks: LimitChecks | None = None
    action: bool = False

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.matrix.shape[1])

    def coefficients(self, y: Array) -> Array:
        """Return the path coefficients c, (K, m), for unknowns y."""
        return np.asarray(self.shift + (self.matrix @ y).reshape(self.shift.shape))

    def unknowns(self, coefficients: Array) -> Array:
        """Return the unknowns, (n,), of the path nearest to given coefficients, (K, m)."""
        deviation = (coefficients - self.shift).ravel()
        return np.asarray(np.linalg.lstsq(self.matrix, deviation, rcond=None)[0])


def fourier_path(
    harmonics: int,
    m: int,
    *,
    pieces: int,
    power: int,
    start: Array | None = None,
    passage: Passage | None = None,
) -> Path:
    """Return the family of Fourier series; its unknowns are scaled means, cosines and sines.

    Args:
        harmonics: Number of harmonics.
        m: Number of joints.
        pieces: Number of quadrature segments per cycle.
        power: Unknowns of harmonic k are k^power times its coefficients, so that all harmonics
            contribute equally to a cost of derivatives of this order.
        start: Common initial shape of all paths, (m,), or None.  If set, it determines the mean,
            which is then not an unknown.
        passage: Motion from rest to rest, or None for constant speed in s.
    Returns:
        The family of paths.
    """
    K, k = 1 + 2 * harmonics, np.arange(1.0, harmonics + 1.0)
    scale: Array = np.concatenate([[1.0], k ** float(-power), k ** float(-power)])
    matrix: Array = np.kron(np.diag(scale), np.eye(m)).astype(float)
    shift = np.zeros((K, m))
    if start is not None:  # mean = start − Σ cosines
        matrix = matrix[:, m:]
        for j in range(m):
            matrix[j, j : harmonics * m : m] = -scale[1 : 1 + harmonics]
        shift[0] = start
    if passage is None:
        basis = fourier_basis(harmonics, pieces)
    else:
        basis = cycloid_basis(harmonics, passage.cycles * pieces + passage.more, passage.cycles)
    return Path(basis, matrix, shift)


def problem_of(task: Task, path: Path) -> Problem:
    """Create the nonlinear program of a task.

    Args:
        task: The task.
        path: The family of paths over which the task is optimised.
    Returns:
        The problem; it has no limits of polygons.
    """
    connection, aim, limits = task.connection, task.aim, task.limits
    n, free = path.size, int(task.period_is_free)
    size = n + free

    def evaluate(z: Array) -> tuple[Array, Array]:
        c, T = path.coefficients(z[:n]), float(z[n]) if free else task.period
        results: list[Array] = []
        jacobian: list[Array] = []

        def add(value: Array, by_c: Array, by_T: Array | float = 0.0) -> None:
            """Append values, (k,), with their derivatives in c, (k, K, m), and T, (k,)."""
            derivative = np.zeros((len(value), size))
            derivative[:, :n] = by_c.reshape(len(value), len(path.matrix)) @ path.matrix
            if free:
                derivative[:, n] = by_T
            results.append(value)
            jacobian.append(derivative)

        lift = path_lift(connection, path.basis, c, task.drift)
        cost = None
        if task.cost is not None:
            cost = cost_of(task.cost, connection, path.basis, c, lift, T, action=path.action)
        size_of_cost = 1.0 if cost is None else max(cost.value, 1e-300)
        power = 1.0 / DEGREES[task.cost or "time"]
        root = size_of_cost**power
        if isinstance(aim, TargetAim) and cost is not None:
            powered = root**CONVEX
            factor = CONVEX * power * powered / size_of_cost
            add(np.array([powered]), factor * cost.slope[None], factor * cost.by_log_period / T)
            residual, by_twist = aim.error(lift.pose)
        elif isinstance(aim, AxisAim):
            value, by_twist = aim.value(lift.pose)
            slope = np.tensordot(by_twist, lift.twist, 1)
            if cost is None or not task.per_cost:
                add(np.array([-value]), -slope[None])
            else:
                factor = power * value / (root * size_of_cost)
                by_c = factor * cost.slope - slope / root
                add(np.array([-value / root]), by_c[None], factor * cost.by_log_period / T)
            residual, by_twist = aim.constraint(lift.pose)
        if len(residual):
            add(residual, np.tensordot(by_twist, lift.twist, 1))
        if task.most is not None and cost is not None:
            add(
                np.array([cost.value / task.most]), cost.slope[None] / task.most,
                cost.by_log_period / T / task.most,
            )  # fmt: skip
        if path.checks is not None:
            checked = LimitedLoop(connection, limits, c, T).values(path.checks)
            add(checked.values, checked.by_c, checked.by_log_period / T)
        return np.concatenate(results), np.vstack(jacobian)

    def evaluate_or_nan(z: Array) -> tuple[Array, Array]:
        """Return NaN where the lift fails or T ≤ 0, so that a line search shortens its step."""
        try:
            if free and not z[n] > 0.0:  # SLSQP also evaluates points beyond linear constraints
                raise FloatingPointError("period")
            return evaluate(z)
        except (SingularInertiaError, NoConvergence, FloatingPointError):
            count = 1 + len(g_lower)
            return np.full(count, np.nan), np.full((count, size), np.nan)

    g_lower, g_upper = _bounds(task, path)
    rows = np.eye(size)[n:]
    return Problem(
        size, evaluate_or_nan, rows, np.append(g_lower, np.full(free, _SHORTEST)),
        np.append(g_upper, np.full(free, np.inf)),
    )  # fmt: skip


def _bounds(task: Task, path: Path) -> tuple[Array, Array]:
    """Return the bounds of the nonlinear constraints."""
    identity = task.connection.group.identity()
    residual, _ = (
        task.aim.error(identity)
        if isinstance(task.aim, TargetAim)
        else task.aim.constraint(identity)
    )
    lower, upper = [np.zeros(len(residual))], [np.zeros(len(residual))]
    if task.most is not None:
        lower.append(np.array([-np.inf]))
        upper.append(np.array([1.0 - INSIDE]))
    if path.checks is not None:
        lower.append(np.full(len(path.checks.times.s), -np.inf))
        upper.append(np.full(len(path.checks.times.s), 1.0 - INSIDE))
    return np.concatenate(lower), np.concatenate(upper)


def cost_unit(connection: Connection, kind: CostKind) -> str:
    """Return the unit of a cost, which depends on what the connection's metric measures.

    The metric of momenta gives twice the kinetic energy of a shape rate [J], that of drag the
    dissipated power [W].
    """
    joints = set(connection.form.units)
    torque = "N m" if joints == {"rad"} else "N" if joints == {"m"} else "N m | N"
    is_kinetic = connection.form.momentum
    units = {
        "length": "m √kg" if is_kinetic else "√(J s)",
        "torque": f"({torque})² s",
        "power": "W² s",
        "acceleration": "W" if is_kinetic else "W/s",
        "time": "s",
    }
    return units[kind]


def merit_name(task: Task) -> tuple[str, str]:
    """Return the name and the unit of the merit of a task (see Task.merit)."""
    aim = task.aim
    if not isinstance(aim, AxisAim):
        return f"−{task.cost}", cost_unit(task.connection, task.cost) if task.cost else "1"
    if task.cost is None or not task.per_cost:
        return aim.kind, aim.unit
    root, unit = _ROOTS[DEGREES[task.cost]], cost_unit(task.connection, task.cost)
    per = f"{root}({unit})" if root or (" " in unit and not unit.startswith("√")) else unit
    return f"{aim.kind} / {root}{task.cost}", f"{aim.unit}/{per}"


_PIECES = 2  # number of quadrature segments of order 16 per (harmonics + 3)
RESIDUAL = 1e-4  # largest relative KKT residual of an accepted optimum
_PHASE_ERROR = 1e-6  # largest difference between sampled and transcribed phase [rad | m]
_BOX = 0.1  # first box around a start, if torques make its limits strongly nonlinear [rad | m]
_NEARBY = 0.2  # first box around the loop of an earlier round, relative to the loop
_MISSED = 1e-4  # smallest deviation of a target that is out of reach [rad | m]
_ROUNDS = 20  # largest number of rounds, each with checks at the peaks of the previous loop
_POLISHES = 3  # number of further rounds with checks at the peaks of an optimum
_AT_LIMIT = 1e-5  # relative distance to its limit below which a peak gets a check
_EQUAL = 1e-8  # relative difference of objectives of equal loops
_TIMES = 512  # number of times at which rotation vectors of balls are checked


class StartFailed(Exception):  # noqa: N818
    """An initial loop did not converge to an optimum; the message states the reason."""


class TargetMissed(StartFailed):
    """No loop near an initial one reaches the target within the limits.

    Attributes:
        deviation: Smallest deviation from the target [rad | m].
    """

    def __init__(self, deviation: float) -> None:
        """Create the error; its message does not depend on the deviation."""
        super().__init__("no loop near this start reaches the target within the limits")
        self.deviation = deviation


@dataclass(frozen=True)
class Search:
    """An optimisation task, restricted to one family of paths.

    Attributes:
        task: The task.
        path: The family of paths over which the task is optimised.
    """

    task: Task
    path: Path

    def optimise_from(
        self, gait: Gait, *, most: int = 1000, radius: float = np.inf, once: bool = False
    ) -> Minimum:
        """Find the optimum near a Fourier gait.

        Args:
            gait: A gait with at most as many harmonics as the paths.
            most: Maximum number of iterations.
            radius: Half width of the first box around the gait.
            once: Whether the search ends after one successful run.
        Returns:
            The optimum, if the search converged.
        """
        if np.isfinite(self.task.limits.torque).any():
            radius = min(radius, _BOX)
        problem = problem_of(self.task, self.path)
        return minimum(problem, self.unknowns(gait), most=most, radius=radius, once=once)

    def unknowns(self, gait: Gait) -> Array:
        """Return the unknowns z of the optimisation for a Fourier gait."""
        y = self.path.unknowns(gait.series.coefficients((len(self.path.shift) - 1) // 2))
        return np.append(y, gait.period) if self.task.period_is_free else y

    def coefficients(self, z: Array) -> Array:
        """Return the path coefficients, (K, m), for the unknowns z of the optimisation."""
        return self.path.coefficients(z[: self.path.size])

    def peaks_beyond(self, z: Array, level: float = 1.0) -> Times:
        """Return the peaks of the loop with the unknowns z beyond limits, times a level."""
        task, c, T = self.task, self.coefficients(z), self.gait(z).period
        return LimitedLoop(task.connection, task.limits, c, T).peaks_beyond(level)

    def with_checks_at(self, peaks: Times, z: Array) -> Search:
        """Return the search with further checks at peaks of the loop with the unknowns z."""
        assert self.path.checks is not None
        checks = self.path.checks.refined(peaks, self.coefficients(z))
        return Search(self.task, replace(self.path, checks=checks))

    def gait(self, z: Array) -> Gait:
        """Return the Fourier gait for the unknowns z of the optimisation."""
        c = self.coefficients(z)
        h = (len(c) - 1) // 2
        T = float(z[-1]) if self.task.period_is_free else self.task.period
        return Gait.fourier(c[0], c[1 : 1 + h], c[1 + h :], period=T)


def fourier_path_of(
    task: Task, harmonics: int, *, start: Array | None = None, action: bool = False
) -> Path:
    """Return the family of Fourier paths for a task.

    Args:
        task: The task.
        harmonics: Number of harmonics.
        start: Common initial shape of all paths, (m,), or None.
        action: Whether the root of the action replaces the cost "length".
    Returns:
        The family of paths.
    """
    power = 2 if task.cost in ("torque", "power", "acceleration") else 1
    path = fourier_path(
        harmonics, task.connection.m, pieces=_PIECES * (harmonics + 3), power=power, start=start,
        passage=task.passage,
    )  # fmt: skip
    return replace(path, checks=first_checks(task.limits, harmonics), action=action)


@dataclass(frozen=True, eq=False)
class End:
    """The end of a search.

    Attributes:
        search: The search with the checks of the last round.
        best: Its optimum.
        objectives: Objectives of the optima of all rounds.
    """

    search: Search
    best: Minimum
    objectives: tuple[float, ...]


def finish(
    search: Search,
    gait: Gait,
    *,
    most: int = 1000,
    sharp: bool = True,
    known: Sequence[End] = (),
) -> End:
    """Find the optimum near a Fourier gait whose peaks between checks are within the limits.

    Args:
        search: The search.
        gait: The gait.
        most: Maximum number of iterations of each round.
        sharp: Whether Newton's method improves the optimum of the last round.
        known: Ends of searches for the same task from other gaits.
    Returns:
        The end of the search; a known one, if its objective was equal after as many rounds.
    Raises:
        StartFailed: The loop exceeds limits.
    """
    objectives: list[float] = []
    radius = np.inf
    for k in range(_ROUNDS):
        best = search.optimise_from(gait, most=most, radius=radius, once=sharp)
        if sharp and not best.residual < np.inf:
            raise StartFailed(f"no loop within the limits was found ({best.status})")
        objectives.append(best.value)
        for end in known:
            if np.isclose(end.objectives[k : k + 1], best.value, rtol=_EQUAL, atol=0.0).any():
                return end
        beyond = search.peaks_beyond(best.z)
        if not len(beyond.s):
            return End(*(_sharpened(search, best) if sharp else (search, best)), tuple(objectives))
        gait, search = search.gait(best.z), search.with_checks_at(beyond, best.z)
        radius = _NEARBY * float(np.abs(best.z).max())
    raise StartFailed("the loop still exceeds its limits")


def _sharpened(search: Search, best: Minimum) -> tuple[Search, Minimum]:
    """Improve the optimum of the last round by Newton's method, with checks at its peaks.

    Checks beside a peak have other derivatives than the peak, which enter the conditions of an
    optimum.

    Args:
        search: The search.
        best: Its optimum, whose peaks are within the limits.
    Returns:
        The search with further checks, and its optimum.
    """
    for _ in range(_POLISHES):
        trial = search.with_checks_at(search.peaks_beyond(best.z, 1.0 - _AT_LIMIT), best.z)
        problem = problem_of(search.task, trial.path)
        better = sharpened(problem, minimum(problem, best.z))
        if not better.residual < RESIDUAL:
            break
        beyond = trial.peaks_beyond(better.z)
        if len(beyond.s):
            search = trial.with_checks_at(beyond, better.z)
        else:
            search, best = trial, better
    return search, best


def loop_to_target(task: Task, path: Path, gait: Gait) -> Gait:
    """Return a loop near a Fourier gait that reaches the target within the limits.

    The squared deviation is minimised.  A search for the least cost from a loop that misses the
    target can end at a loop that satisfies no constraint.

    Args:
        task: The task, with a target.
        path: The family of paths.
        gait: The gait.
    Returns:
        The loop.
    Raises:
        TargetMissed: A local minimum of the deviation exceeds _MISSED.
    """
    assert isinstance(task.aim, TargetAim)
    problem, search = problem_of(task, path), Search(task, path)
    k = 1 + len(task.aim.error(task.connection.group.identity())[0])

    def evaluate(z: Array) -> tuple[Array, Array]:
        values, slopes = problem.evaluate(z)
        errors, by_z = values[1:k], slopes[1:k]
        return (
            np.append(0.5 * (errors @ errors + _MISSED**2), values[k:]),
            np.vstack([errors @ by_z, slopes[k:]]),
        )  # fmt: skip

    nearest = replace(
        problem, evaluate=evaluate, lower=problem.lower[k - 1 :], upper=problem.upper[k - 1 :]
    )
    z = minimum(nearest, search.unknowns(gait), once=True).z
    deviation = float(np.linalg.norm(problem.at(z)[0][1:k]))
    if not deviation <= _MISSED:
        raise TargetMissed(deviation)
    return search.gait(z)


@dataclass(frozen=True, eq=False)
class Measured:
    """A loop with the numbers of its certificate, sampled independently of the optimiser.

    Attributes:
        gait: The loop.
        phase: Geometric phase of one cycle.
        value: Objective of one cycle [rad | m]; for a target, the deviation from the target.
        cost: Cost of one cycle; NaN if no cost is selected.
        merit: The maximised quantity; see `Task.merit`.
    """

    gait: Gait
    phase: Phase
    value: float
    cost: float
    merit: float


def measure(search: Search, best: Minimum, gait: Gait) -> Measured:
    """Compute the merit of a loop with an independently sampled phase.

    Args:
        search: The search.
        best: Its optimum.
        gait: The loop of the optimum.
    Returns:
        The loop and its merit.
    Raises:
        StartFailed: The nodes of the transcription do not resolve the loop, or the loop leaves the
            chart of a ball.
    """
    task, path = search.task, search.path
    connection, c = task.connection, search.coefficients(best.z)
    chart, w = connection.chart, gait.samples(_TIMES)[0]
    if chart is not None and (ball := chart.ball_beyond(w)):
        raise StartFailed(
            f"the rotation vector of ball joint '{ball}' reaches 2π, where it is singular; set "
            "smaller limits or another centre"
        )
    lift = path_lift(connection, path.basis, c)
    sampled = phase(connection, gait, tolerance=1e-11)
    difference = connection.group.error(sampled.pose, lift.pose)
    if not max(float(difference.rotation), float(difference.translation)) <= _PHASE_ERROR:
        raise StartFailed("the transcription has too few nodes to resolve the loop")
    cost = np.nan
    if task.cost is not None:
        cost = cost_of(task.cost, connection, path.basis, c, lift, gait.period).value
        if task.cost == "length":  # the length does not depend on the speed
            cost = sampled.length
    if isinstance(task.aim, TargetAim):
        value = float(np.linalg.norm(task.aim.error(sampled.pose)[0]))
    else:
        value = task.aim.value(sampled.pose)[0]
    return Measured(gait, sampled, value, cost, task.merit(value, cost))
