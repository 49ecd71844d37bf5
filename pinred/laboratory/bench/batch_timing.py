"""Trajectories per second of batches on one thread; simulate_many on two threads.

Batches of members run at a requested error, also with other tools. Their processor time is
measured instead of wall time: calls take milliseconds, and other processes on the machine would
distort their wall time.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, IntegrationError, PinredError
from ...common.waiting import Progress, one_by_one, quiet, shown
from ...integrators.integrate_many import Solutions, integrate_many
from ...integrators.lanes.integrate_in_lanes import integrate_in_lanes
from ...integrators.methods import DOP853
from ...judge.reference_solution import FINEST, FullMotion
from ...kernels.derived_code import wide_rate
from ...scene.initial_state import random_state
from ...simulation.members.integrate_members import lanes_of
from ...simulation.members.trajectories import Trajectories
from ...simulation.simulate_many import simulate_many
from ...system.system import System
from .peers.heyoka import HEYOKA_BATCH
from .peers.mujoco import ROLLOUT
from .problems import (
    End,
    PreparedRun,
    Problem,
    Solver,
    compile_members,
    generate_members,
    problems_named,
)
from .timing import Table, alternating, repeated

_TOLERANCES = tuple(10.0 ** (-k / 3) for k in range(18, 40))


def _prepare(members: Sequence[Problem], rtol: float, *, in_lanes: bool) -> PreparedRun:
    flows, method = compile_members(members), DOP853(rtol, 1e-2 * rtol)
    kernel, times = flows.kernel, members[0].times
    duration = members[0].start.duration
    y0, params, quaternions = flows.y0, flows.parameters, kernel.layout.quaternions
    run: Callable[[], Solutions]
    if in_lanes:
        lanes = lanes_of(method, kernel)
        address = wide_rate(kernel, lanes, own_parameters=True).address
        run = partial(
            integrate_in_lanes, method, address, lanes, params, y0, duration, times, quaternions, 1
        )
    else:
        address = kernel.rate.address
        run = partial(integrate_many, method, address, params, y0, duration, times, quaternions, 1)

    def end(solutions: Solutions, member: int) -> End:
        if not solutions.ok.all():
            raise IntegrationError(f"{method.name} did not integrate all members to their end")
        return members[member].end(solutions.y[member, -1])

    return PreparedRun(run, end)


OWN = (
    Solver(
        "lanes",
        "DOP853, members in SIMD lanes",
        _TOLERANCES,
        partial(_prepare, in_lanes=True),
    ),
    Solver(
        "one by one",
        "DOP853, the scalar integrator, one after another",
        _TOLERANCES,
        partial(_prepare, in_lanes=False),
    ),
)


MEMBERS, ROUNDS, ERROR = 512, 5, 1e-8
JUDGED = 2  # number of members whose final state is compared with Pinocchio's ABA
BATCH_SOLVERS = (*OWN, *HEYOKA_BATCH, *ROLLOUT)
_BUDGET = 10.0  # processor time [s] after which a solver skips the remaining rounds


@checks_arguments
def bench_many(
    scenes: Sequence[str] | None = None,
    *,
    members: int = MEMBERS,
    error: float = ERROR,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> list[Table]:
    """Measure trajectories per second of pinred and other tools on each scene.

    Args:
        scenes: Names in SCENES; those of `bench accuracy` if None or empty.
        members: Number of members; their initial states are near that of the scene.
        error: Largest error of the final state against Pinocchio's ABA [rad | m]. Each solver
            runs at the coarsest tolerance that reaches it.
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A table for each scene, with a row for each solver: its coarsest tolerance that reaches the
        error, the largest error of the compared members [rad | m], its trajectories per second of
        processor time, and their ratio to those of pinred's scalar integrator. Notes say why
        solvers were left out.
    Raises:
        InputError: Unknown scene, or too few members.
    """
    if members < JUDGED:
        raise InputError(f"members must be at least {JUDGED}, got {members}")
    problems, _ = problems_named(scenes or None)
    measure = partial(_measure, count=members, error=error, rounds=rounds)
    return one_by_one(problems, measure, progress, "many")


def _measure(problem: Problem, count: int, error: float, rounds: int) -> Table:
    members = generate_members(problem, count)
    truth = [m.full.run(m.full_start(), m.times, *FINEST) for m in members[:JUDGED]]
    ready: list[tuple[Solver, float, float, PreparedRun]] = []
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
    speeds = {
        solver.name: min(count, solver.most) / seconds
        for (solver, *_), seconds in zip(ready, np.nanmedian(times, axis=0).tolist(), strict=True)
    }
    scalar = speeds.get(OWN[1].name, np.nan)
    rows = [
        SimpleNamespace(
            solver=solver.name, tolerance=tolerance, error=reached,
            per_second=speeds[solver.name], times=speeds[solver.name] / scalar,
        )
        for solver, tolerance, reached, _ in ready
    ]  # fmt: skip
    title = f"{problem.name}: {count} members of {problem.start.duration:g} s, one thread"
    shared = {"problem": problem.name, "members": count}
    return Table("many", tuple(rows), {"error": "rad | m"}, title, tuple(missing), shared)


def _find_tolerance(
    solver: Solver, members: Sequence[Problem], truth: Sequence[FullMotion], error: float
) -> tuple[float, float, PreparedRun]:
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
        result = prepared.run()
        reached = max(
            members[k].apart(prepared.end(result, k).motion, reference)
            for k, reference in enumerate(truth)
        )
        if reached <= error:
            return tolerance, reached, prepared
    raise InputError(f"its smallest error is {reached:.1e}")


DURATION = 2.0  # default duration of each motion [s]
THREAD_MEMBERS = 1000
FEW = 0.25  # fraction of the members in the smaller of two memory measurements
THREAD_ROUNDS = 5


@checks_arguments
def bench_threads(
    system: System,
    *,
    members: int = THREAD_MEMBERS,
    duration: float = DURATION,
    rounds: int = THREAD_ROUNDS,
    progress: Progress | bool | None = None,
) -> list[Table]:
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
        A table of the median wall times [s] by number of threads; and of memory by number of
        members: bytes of the reduced states in the results, bytes that the trajectories keep,
        reduced states included, and peak bytes in addition to those.
    Raises:
        InputError: Fewer than 4 members.
    """
    if members < 4:
        raise InputError(f"members must be at least 4, got {members}")
    with shown(progress, "threads") as bar:
        return _measure_threads(system, members, duration, rounds, bar or quiet)


def _measure_threads(
    system: System, members: int, duration: float, rounds: int, report: Progress
) -> list[Table]:
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
    memory = []
    for k, size in enumerate((round(FEW * members), members)):
        tracemalloc.start()
        try:
            trajectories = call(size, 2)
            kept, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        memory.append(
            SimpleNamespace(
                members=size, results=trajectories.y.nbytes, kept=kept,
                extra=peak - kept,
            )
        )  # fmt: skip
        report(0.8 + 0.1 * (k + 1))
    speedup = float(np.median(times[:, 0] / times[:, 1]))
    walls = [
        SimpleNamespace(threads=k + 1, wall=float(wall))
        for k, wall in enumerate(np.median(times, axis=0))
    ]
    title = f"{system.name}: {members} trajectories of {duration:g} s, whole call"
    notes = (f"two threads are {speedup:.2f} times faster",)
    robot = {"robot": system.name}
    in_bytes = dict.fromkeys(("results", "kept", "extra"), "bytes")
    return [
        Table("threads", tuple(walls), {"wall": "s"}, title, notes, {**robot, "members": members}),
        Table("threads_memory", tuple(memory), in_bytes, shared=robot),
    ]
