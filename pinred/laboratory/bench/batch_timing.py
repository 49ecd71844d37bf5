"""Trajectories per second on one thread, for batches of members at a requested error.

Processor time is measured instead of wall time: calls take milliseconds, and other processes on
the machine would distort their wall time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, PinredError
from ...common.progress import Progress, one_by_one
from ...judge.distances import FullMotion
from ...judge.reference_solution import FINEST
from .member_batch import OWN, BatchSolver, PreparedBatch, generate_members
from .peers.heyoka_batch import HEYOKA_BATCH
from .peers.mujoco_rollout import ROLLOUT
from .problems import Problem
from .scenes import problems_named

MEMBERS, ROUNDS, ERROR = 512, 5, 1e-8
JUDGED = 2  # number of members whose final state is compared with Pinocchio's ABA
BATCH_SOLVERS = (*OWN, *HEYOKA_BATCH, *ROLLOUT)
_BUDGET = 10.0  # processor time [s] after which a solver skips the remaining rounds


@dataclass(frozen=True)
class Rate:
    """Trajectories per second of one solver.

    Attributes:
        solver: Name of the solver.
        tolerance: Coarsest tolerance that reaches the requested error.
        error: Largest error of the compared members [rad | m].
        per_second: Trajectories per second of processor time.
    """

    solver: str
    tolerance: float
    error: float
    per_second: float


@checks_arguments
@dataclass(frozen=True)
class ManyTiming:
    """Trajectories per second of all solvers for the members of one problem, on one thread.

    Attributes:
        problem: Name of the problem.
        members: Number of members.
        duration: Duration of each motion [s].
        rates: Results of the solvers.
        missing: Reasons why solvers were omitted or did not reach the requested error.
    """

    problem: str
    members: int
    duration: float
    rates: tuple[Rate, ...]
    missing: tuple[str, ...]

    def times(self, solver: str) -> float:
        """Return a solver's trajectories per second relative to the scalar integrator's.

        Args:
            solver: Name of the solver.
        Returns:
            The ratio; NaN if the scalar integrator is missing.
        """
        by_name = {rate.solver: rate.per_second for rate in self.rates}
        return by_name[solver] / by_name.get(OWN[1].name, float("nan"))

    def __str__(self) -> str:
        lines = [
            f"{self.problem}: {self.members} members of {self.duration:g} s, one thread",
            f"{'':22} {'tolerance':>10} {'error':>9} {'per second':>11} {'times':>7}",
        ]
        lines += [
            f"{rate.solver:22} {rate.tolerance:>10.1e} {rate.error:>9.1e} "
            f"{rate.per_second:>11.1f} {self.times(rate.solver):>7.2f}"
            for rate in self.rates
        ]
        return "\n".join([*lines, *self.missing])


@checks_arguments
def bench_many(
    scenes: Sequence[str] | None = None,
    *,
    members: int = MEMBERS,
    error: float = ERROR,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> list[ManyTiming]:
    """Measure trajectories per second of pinred and other tools on each scene.

    Args:
        scenes: Names in SCENES; those of `bench accuracy` if None.
        members: Number of members; their initial states are near that of the scene.
        error: Largest error of the final state against Pinocchio's ABA [rad | m]. Each solver
            runs at the coarsest tolerance that reaches it.
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each scene.
    Raises:
        InputError: Unknown scene, or too few members.
    """
    if members < JUDGED:
        raise InputError(f"members must be at least {JUDGED}, got {members}")
    problems, _ = problems_named(scenes)
    measure = partial(_measure, count=members, error=error, rounds=rounds)
    return one_by_one(problems, measure, progress, "many")


def _measure(problem: Problem, count: int, error: float, rounds: int) -> ManyTiming:
    members = generate_members(problem, count)
    truth = [m.full.run(m.full_start(), m.times, *FINEST) for m in members[:JUDGED]]
    ready: list[tuple[BatchSolver, float, float, PreparedBatch]] = []
    missing = []
    for solver in BATCH_SOLVERS:
        if why := solver.missing(problem):
            missing.append(why)
            continue
        try:
            ready.append((solver, *_find_tolerance(solver, members[: solver.most], truth, error)))
        except PinredError as failure:
            missing.append(f"{solver.name}: {failure}")
    seconds = _processor_seconds([prepared.run for *_, prepared in ready], rounds)
    rates = tuple(
        Rate(solver.name, tolerance, reached, min(count, solver.most) / spent)
        for (solver, tolerance, reached, _), spent in zip(ready, seconds, strict=True)
    )
    return ManyTiming(problem.name, count, problem.start.duration, rates, tuple(missing))


def _processor_seconds(actions: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Return the median processor time of each action [s], measured in alternating rounds."""
    seconds: list[list[float]] = [[] for _ in actions]
    for action in actions:
        action()  # run once before timing, to exclude compilation and loading
    for _ in range(rounds):
        for spent, action in zip(seconds, actions, strict=True):
            if sum(spent) < _BUDGET:
                began = time.process_time()
                action()
                spent.append(time.process_time() - began)
    return [float(np.median(spent)) for spent in seconds]


def _find_tolerance(
    solver: BatchSolver, members: Sequence[Problem], truth: Sequence[FullMotion], error: float
) -> tuple[float, float, PreparedBatch]:
    """Find the coarsest tolerance of a solver that reaches an error.

    Args:
        solver: The solver.
        members: Members of the batch.
        truth: Reference solutions of the first members.
        error: Requested error [rad | m].
    Returns:
        The tolerance, its error, and the prepared run.
    Raises:
        InputError: No tolerance reaches the error.
    """
    reached = np.inf
    for tolerance in solver.tolerances:
        prepared = solver.prepare(members, tolerance)
        ends = prepared.ends(prepared.run(), len(truth))
        reached = max(
            member.apart(FullMotion(x=end.x[None], q=end.q[None]), reference)
            for member, end, reference in zip(members, ends, truth, strict=False)
        )
        if reached <= error:
            return tolerance, reached, prepared
    raise InputError(f"its smallest error is {reached:.1e}")
