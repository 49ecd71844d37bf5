"""The search for a Fourier gait: from an initial loop to an optimum within its limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift
from ...analysis.phases.phase import Phase, phase
from ...common.arrays import Array
from .ipopt import Minimum, kkt_residual, minimum
from .loop_peaks import Cells, cells_of, loop_peaks
from .objective import TargetAim, cost_of
from .transcription import Path, Task, fourier_path, problem_of

_PIECES = 2  # number of quadrature segments of order 16 per (harmonics + 3)
_CHECKS = 4  # number of times at which limits are imposed per (harmonics + 1)
_NEAR = 0.7  # peaks below this part of their limit constrain the last stage only if they exceed it
RESIDUAL = 1e-4  # largest relative KKT residual of an accepted optimum
# Weights of the root of the action in the length, in successive solves of the last stage.
_WEIGHTS = (0.1, 0.05, 0.025, 0.01, 0.003, 0.001, 0.0003, 0.0)
_QUICK = 1e-5  # residual that needs no second derivatives, if the cost is not the length
_QUICK_STEPS = 500  # largest number of iterations without second derivatives in the last stage
_NEWTON_STEPS = 40  # largest number of iterations with second derivatives
_PHASE_ERROR = 1e-6  # largest difference between sampled and transcribed phase [rad | m]
_TIMES = 512  # number of times at which rotation vectors of balls are checked
_ROUNDS = 8  # largest number of last stages, each with the cells that the previous one exceeded


class StartFailed(Exception):  # noqa: N818
    """An initial loop did not converge to an optimum; the message states the reason."""


@dataclass(frozen=True)
class Search:
    """An optimisation task, restricted to one family of paths.

    Attributes:
        task: The task.
        path: The family of paths over which the task is optimised.
    """

    task: Task
    path: Path

    def optimise_from(self, gait: Gait, *, most: int = 500) -> Minimum:
        """Find the optimum near a Fourier gait.

        Args:
            gait: A gait with at most as many harmonics as the paths.
            most: Maximum number of iterations.
        Returns:
            The result of IPOPT.
        """
        return minimum(problem_of(self.task, self.path), self.unknowns(gait), most=most)

    def polish(self, gait: Gait) -> Minimum:
        """Find the optimum near a Fourier gait with second derivatives.

        The length does not determine the speed along the loop, so that its Hessian is nearly
        singular.  The root of the action, which does, is faded out in several solves.

        Args:
            gait: A gait with at most as many harmonics as the paths.
        Returns:
            The result with the smallest residual, which is that of the problem without action.
        """
        asked, z = problem_of(self.task, self.path), self.unknowns(gait)
        results: list[Minimum] = []
        for weight in _WEIGHTS if self.task.cost == "length" else _WEIGHTS[-1:]:
            eased = problem_of(self.task, replace(self.path, action=weight))
            result = minimum(eased, z, tolerance=1e-10, most=_NEWTON_STEPS, newton=True)
            results.append(replace(result, residual=kkt_residual(asked, result.z)))
            if not result.residual <= RESIDUAL:
                break
            z = result.z
        return min(results, key=lambda result: result.residual)

    def unknowns(self, gait: Gait) -> Array:
        """Return the unknowns z of the optimisation for a Fourier gait."""
        y = self.path.unknowns(gait.series.coefficients((len(self.path.shift) - 1) // 2))
        return np.append(y, gait.period) if self.task.period_is_free else y

    def coefficients(self, z: Array) -> Array:
        """Return the path coefficients, (K, m), for the unknowns z of the optimisation."""
        return self.path.coefficients(z[: self.path.size])

    def gait(self, z: Array) -> Gait:
        """Return the Fourier gait for the unknowns z of the optimisation."""
        c = self.coefficients(z)
        h = (len(c) - 1) // 2
        T = float(z[-1]) if self.task.period_is_free else self.task.period
        return Gait.fourier(c[0], c[1 : 1 + h], c[1 + h :], period=T)


def fourier_path_of(
    task: Task, harmonics: int, more: Array | None = None, start: Array | None = None
) -> Path:
    """Return the family of Fourier paths for a task; limits are imposed at sample times.

    Args:
        task: The task.
        harmonics: Number of harmonics.
        more: Additional times s = t/T in [0, 1], (C,), at which limits are imposed.
        start: Common initial shape of all paths, (m,), or None.
    Returns:
        The family of paths.
    """
    count = _CHECKS * (harmonics + 1)
    even = np.arange(count) / count
    checks = even if more is None else np.union1d(even, more)
    pieces = _PIECES * (harmonics + 3)
    power = 2 if task.cost in ("torque", "power", "acceleration") else 1
    return fourier_path(
        harmonics, task.connection.m, pieces=pieces, checks=checks, power=power, start=start,
        passage=task.passage,
    )  # fmt: skip


def finish(search: Search, gait: Gait, *, newton: bool = True) -> tuple[Search, Minimum]:
    """Solve the problem with limits of the true extremes, from one with limits at sample times.

    With second derivatives, the length is not replaced by the root of the action either. Other
    costs need them only if the optimum is not stationary without them.

    Args:
        search: The search of the first optimum.
        gait: The first optimum.
        newton: Whether to use second derivatives, which cost one gradient per unknown.
    Returns:
        The search of the problem asked, and its optimum.
    Raises:
        StartFailed: The loop exceeds limits.
    """
    task = search.task
    every = cells_of(task.limits, len(gait.series.cos))
    peaks, first = _peaks(task, gait, every), gait
    use = np.asarray(peaks > _NEAR)
    quick = not newton or task.cost != "length"
    for _ in range(_ROUNDS):
        path = replace(search.path, cells=every.select(use), action=0.0 if newton else 1.0)
        search = Search(task, path)
        best = search.optimise_from(gait, most=_QUICK_STEPS) if quick else search.polish(gait)
        beyond = _peaks(task, search.gait(best.z), every) > 1.0
        if newton and quick and not beyond.any() and not best.residual <= _QUICK:
            polished = search.polish(search.gait(best.z))
            best = min(best, polished, key=lambda each: each.residual)
            beyond = _peaks(task, search.gait(best.z), every) > 1.0
        gait = search.gait(best.z)
        if not beyond.any():
            return search, best if (peaks > 1.0).any() else _better(search, first, best)
        use |= beyond
    raise StartFailed("the loop still exceeds its limits")


def _better(search: Search, first: Gait, best: Minimum) -> Minimum:
    """Return the better of a gait within its limits and an optimum."""
    problem, z = problem_of(search.task, search.path), search.unknowns(first)
    if problem.evaluate(z)[0][0] >= problem.evaluate(best.z)[0][0]:
        return best
    return replace(best, z=z, residual=kkt_residual(problem, z))


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


def _peaks(task: Task, gait: Gait, cells: Cells) -> Array:
    """Return the peaks of a gait, relative to the limits."""
    c = gait.series.coefficients()
    return loop_peaks(task.connection, task.limits, c, gait.period, cells).values
