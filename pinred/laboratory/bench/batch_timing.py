"""Trajectories per second of batches on one thread; simulate_many on two threads.

Batches of members run at a requested error, also with other tools. Their processor time is
measured instead of wall time: calls take milliseconds, and other processes on the machine would
distort their wall time.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError, PinredError
from ...common.waiting import Progress, one_by_one, quiet, shown
from ...judge.distances import FullMotion
from ...judge.reference_solution import FINEST
from ...scene.initial_state import random_state
from ...simulation.members.trajectories import Trajectories
from ...simulation.simulate_many import simulate_many
from ...system.system import System
from .member_batch import OWN, BatchSolver, PreparedBatch, generate_members
from .peers.heyoka import HEYOKA_BATCH
from .peers.mujoco import ROLLOUT
from .problems import Problem, problems_named
from .timing import Tables, alternating, repeated

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

    def tables(self) -> Tables:
        """Return a row of the csv file for each solver."""
        head = {"problem": self.problem, "members": self.members}
        return {"many": [{**head, **vars(rate)} for rate in self.rates]}

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
        scenes: Names in SCENES; those of `bench accuracy` if None or empty.
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
    problems, _ = problems_named(scenes or None)
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
    times = alternating(
        [repeated(prepared.run) for *_, prepared in ready],
        rounds=rounds,
        span=0.0,
        budget=_BUDGET,
        clock=time.process_time,
    )
    seconds = np.nanmedian(times, axis=0).tolist()
    rates = tuple(
        Rate(solver.name, tolerance, reached, min(count, solver.most) / spent)
        for (solver, tolerance, reached, _), spent in zip(ready, seconds, strict=True)
    )
    return ManyTiming(problem.name, count, problem.start.duration, rates, tuple(missing))


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


Counts = NDArray[np.int64]

DURATION = 2.0  # default duration of each motion [s]
THREAD_MEMBERS = 1000
FEW = 0.25  # fraction of the members in the smaller of two memory measurements
THREAD_ROUNDS = 5


@checks_arguments
@dataclass(frozen=True)
class ThreadsTiming(FrozenArrays):
    """Time and memory of calls of simulate_many; arrays are read-only.

    Attributes:
        robot: Name of the robot.
        members: Number of members.
        duration: Duration of each motion [s].
        wall: Median wall times with one thread and with two, (2,) [s].
        speedup: Median over rounds of the ratio of the two times.
        sizes: Numbers of members in the two calls whose memory was measured, (2,).
        results: Bytes of the reduced states in the results of these two calls, (2,).
        kept: Bytes kept by the trajectories, reduced states included, (2,).
        extra: Peak bytes in addition to `kept`, (2,).
    """

    robot: str
    members: int
    duration: float
    wall: Array
    speedup: float
    sizes: Counts
    results: Counts
    kept: Counts
    extra: Counts

    def tables(self) -> Tables:
        """Return rows of `threads` by number of threads, and of `threads_memory` by call."""
        head: dict[str, object] = {"robot": self.robot}
        times = [
            {**head, "members": self.members, "threads": k + 1, "wall": wall}
            for k, wall in enumerate(self.wall)
        ]
        names = ("sizes", "results", "kept", "extra")
        columns = zip(*(getattr(self, name) for name in names), strict=True)
        memory = [{**head, **dict(zip(names, row, strict=True))} for row in columns]
        return {"threads": times, "threads_memory": memory}

    def __str__(self) -> str:
        rows = [
            f"{n:>8} {a / 1e6:>13.2f} {b / 1e6:>15.2f} {c / 1e6:>19.2f}"
            for n, a, b, c in zip(self.sizes, self.results, self.kept, self.extra, strict=True)
        ]
        return "\n".join(
            [
                f"{self.robot}: {self.members} trajectories of {self.duration:g} s, whole call",
                f"one thread {self.wall[0]:.3f} s, two threads {self.wall[1]:.3f} s: "
                f"{self.speedup:.2f} times faster",
                "",
                f"{'members':>8} {'results [MB]':>13} {'all kept [MB]':>15} "
                f"{'peak beyond it [MB]':>19}",
                *rows,
            ]
        )


@checks_arguments
def bench_threads(
    system: System,
    *,
    members: int = THREAD_MEMBERS,
    duration: float = DURATION,
    rounds: int = THREAD_ROUNDS,
    progress: Progress | bool | None = None,
) -> ThreadsTiming:
    """Measure simulate_many from random states on one thread and on two.

    Memory allocated by Python and numpy is measured; the compiled code allocates none.

    Args:
        system: The system.
        members: Number of members, at least 4. Memory is measured with all members and
            with a quarter.
        duration: Duration of each motion [s].
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        Times and memory.
    Raises:
        InputError: Fewer than 4 members.
    """
    if members < 4:
        raise InputError(f"members must be at least 4, got {members}")
    with shown(progress, "threads") as bar:
        return _measure_threads(system, members, duration, rounds, bar or quiet)


def _measure_threads(
    system: System, members: int, duration: float, rounds: int, report: Progress
) -> ThreadsTiming:
    states = [random_state(system, seed) for seed in range(members)]
    x0, xdot0, xi0 = (np.array([getattr(s, name) for s in states]) for name in ("x", "xdot", "xi"))

    def call(size: int, threads: int) -> Trajectories:
        return simulate_many(
            system,
            x0=x0[:size],
            xdot0=xdot0[:size],
            xi0=xi0[:size],
            duration=duration,
            times=[duration],
            threads=threads,
        )

    times = alternating(
        [repeated(partial(call, members, threads)) for threads in (1, 2)],
        rounds=rounds,
        progress=lambda fraction: report(0.8 * fraction),
    )
    sizes = (round(FEW * members), members)
    results, kept, extra = [], [], []
    for k, size in enumerate(sizes):
        tracemalloc.start()
        try:
            trajectories = call(size, 2)
            current, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        results.append(trajectories.y.nbytes)
        kept.append(current)
        extra.append(peak - current)
        report(0.8 + 0.1 * (k + 1))
    return ThreadsTiming(
        robot=system.name,
        members=members,
        duration=duration,
        wall=np.median(times, axis=0),
        speedup=float(np.median(times[:, 0] / times[:, 1])),
        sizes=np.array(sizes),
        results=np.array(results),
        kept=np.array(kept),
        extra=np.array(extra),
    )
