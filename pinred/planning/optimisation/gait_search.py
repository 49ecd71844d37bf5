"""The search for a Fourier gait: from an initial loop to an optimum within its limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift
from ...analysis.phases.phase import Phase, phase
from ...common.arrays import Array
from .limit_checks import LimitedLoop, Times, first_checks
from .nonlinear_program import Minimum, minimum, sharpened
from .objective import TargetAim, cost_of
from .transcription import Path, Task, fourier_path, problem_of

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
