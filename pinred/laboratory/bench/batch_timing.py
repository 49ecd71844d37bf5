"""Trajectories per second on one thread, of many members at an error asked for.

Seconds are those of the processor: whole calls take milliseconds, and on a machine with other work
the time on the wall says more of that than of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

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
JUDGED = 2  # members whose ends Pinocchio's ABA judges
BATCH_SOLVERS = (*OWN, *HEYOKA_BATCH, *ROLLOUT)
_BUDGET = 10.0  # s, beyond which a way takes no further turn


@dataclass(frozen=True)
class Rate:
    """Trajectories per second of one way.

    tolerance: with which the error was kept.  error: of the members that were judged [rad | m].
    """

    solver: str
    tolerance: float
    error: float
    per_second: float


@dataclass(frozen=True)
class ManyTiming:
    """Ways to solve all members of one problem, on one thread.

    rates: of each.  missing: a line on each that was left out, or did not reach the error.
    """

    problem: str
    members: int
    duration: float
    rates: tuple[Rate, ...]
    missing: tuple[str, ...]

    def times(self, solver: str) -> float:
        """Return how many times the trajectories per second of the scalar integrator it makes."""
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


def bench_many(
    scenes: Sequence[str] | None = None,
    *,
    members: int = MEMBERS,
    error: float = ERROR,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> list[ManyTiming]:
    """Return how many trajectories per second there are on each scene, by pinred and by others.

    scenes: names in SCENES, those of `bench accuracy` if None.  members: they start near the
    scene's start.  error: at the end [rad | m], against Pinocchio's ABA on the full state; each way
    has the coarsest tolerance that keeps to it.  rounds: of which the median counts.
    Raises InputError for names and numbers that make no sense.
    """
    if members < JUDGED:
        raise InputError(f"members must be at least {JUDGED}, got {members}")
    problems, _ = problems_named(scenes)
    measure = partial(_measured, count=members, error=error, rounds=rounds)
    return one_by_one(problems, measure, progress, "many")


def _measured(problem: Problem, count: int, error: float, rounds: int) -> ManyTiming:
    members = generate_members(problem, count)
    truth = [each.full.run(each.full_start(), each.times, *FINEST) for each in members[:JUDGED]]
    ready: list[tuple[BatchSolver, float, float, PreparedBatch]] = []
    missing = []
    for solver in BATCH_SOLVERS:
        if why := solver.missing(problem):
            missing.append(why)
            continue
        some = members[: solver.most]
        try:
            ready.append((solver, *_tolerance(solver, some, truth, error)))
        except PinredError as stopped:
            missing.append(f"{solver.name}: {stopped}")
    seconds = _processor_seconds([way.run for *_, way in ready], rounds)
    rates = tuple(
        Rate(solver.name, tolerance, reached, min(count, solver.most) / spent)
        for (solver, tolerance, reached, _), spent in zip(ready, seconds, strict=True)
    )
    return ManyTiming(problem.name, count, problem.start.duration, rates, tuple(missing))


def _processor_seconds(actions: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Return the median seconds of a processor that each action takes, the actions taking turns."""
    seconds: list[list[float]] = [[] for _ in actions]
    for action in actions:
        action()  # what is compiled or loaded first does not count
    for _ in range(rounds):
        for spent, action in zip(seconds, actions, strict=True):
            if sum(spent) < _BUDGET:
                began = time.process_time()
                action()
                spent.append(time.process_time() - began)
    return [float(np.median(spent)) for spent in seconds]


def _tolerance(
    solver: BatchSolver, members: Sequence[Problem], truth: Sequence[FullMotion], error: float
) -> tuple[float, float, PreparedBatch]:
    """Return the coarsest tolerance of a way that keeps to an error, that error, and the way.

    Raises InputError if there is none.
    """
    reached = np.inf
    for tolerance in solver.tolerances:
        way = solver.prepare(members, tolerance)
        ends = way.ends(way.run(), len(truth))
        reached = max(
            member.apart(FullMotion(x=end.x[None], q=end.q[None]), true)
            for member, end, true in zip(members, ends, truth, strict=False)
        )
        if reached <= error:
            return tolerance, reached, way
    raise InputError(f"the error does not come below {reached:.1e}")
