"""Timed calls: kernels, compare, first calls, members and threads.

All measurements share the harness `alternating`, whose actions run alternately, and `Table`, the
table of results.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError, PinredError
from ...common.object_cache import ObjectCache
from ...common.waiting import Progress, one_by_one, quiet, shown
from ...forces.kinds import Damper
from ...integrators.integrate_many import Solutions, integrate_many
from ...integrators.lanes.integrate_in_lanes import integrate_in_lanes
from ...integrators.methods import DOP853
from ...judge.compare import compare
from ...judge.reference_solution import FINEST, FullMotion
from ...judge.verdict import Report
from ...kernels.build import build_kernel, wide_rate
from ...kernels.kernel import Kernel, Structure, repeat
from ...reduction.cyclic_joints import cyclic_joints
from ...reduction.pointwise_reduction import PointwiseReduction
from ...simulation.members.integrate_members import lanes_of
from ...simulation.simulate import simulate
from ...simulation.simulate_many import simulate_many
from ...simulation.trajectory import Trajectory
from ...system.find_robot_files import has_example_robots
from ...system.load import load
from ...system.system import System
from .peers.heyoka import HEYOKA_BATCH
from .peers.mujoco import ROLLOUT
from .problems import (
    FAMILIES,
    End,
    PreparedRun,
    Problem,
    Solver,
    chain,
    compile_members,
    generate_members,
    problems_named,
    select_named,
)

T = TypeVar("T")
Action: TypeAlias = Callable[[int], object]  # repeats its work a given number of times

ROUNDS = 15  # default number of rounds; the median over rounds is reported
SPAN = 0.01  # least duration of an action in a round [s]; short actions are repeated
LOADING = 20.0  # a first call shorter than this [s] is repeated, because it may include compilation
FEWEST = 3  # least number of rounds of a slow action


@checks_arguments
@dataclass(frozen=True)
class Table(Sequence[Any]):
    """Results of a measurement: a sequence of rows, which `str` formats.

    Attributes:
        file: Name of the csv file, without suffix.
        rows: The results. Their attributes are the columns of the table and of the csv file.
        units: Units of columns, by name.
        title: Line above the table.
        notes: Lines below the table.
        shared: Values that all rows share: further columns of the csv file.
    """

    file: str
    rows: tuple[SimpleNamespace, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    notes: tuple[str, ...] = ()
    shared: Mapping[str, object] = field(default_factory=dict)

    @property
    def records(self) -> list[dict[str, object]]:
        """The rows of the csv file."""
        return [{**self.shared, **vars(row)} for row in self.rows]

    def __getitem__(self, index: Any) -> Any:
        """Return a row, or some rows."""
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        columns: list[list[str]] = []
        for name in vars(self.rows[0]) if self.rows else ():
            values = [getattr(row, name) for row in self.rows]
            units = [f"[{self.units[name]}]" if name in self.units else ""] * bool(self.units)
            cells = [name, *units, *map(cell, values)]
            side, width = ">" if columns else "<", max(map(len, cells))
            columns.append([f"{cell:{side}{width}}" for cell in cells])
        lines = ["  ".join(cells).rstrip() for cells in zip(*columns, strict=True)]
        return "\n".join([*([self.title] if self.title else []), *lines, *self.notes])


def cell(value: Any) -> str:
    """Format a value with three digits, but numbers from 1000 on as whole numbers."""
    if not isinstance(value, float):
        return str(value)
    if np.isnan(value):
        return "—"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.3g}"


def robots_to_measure(
    names: Iterable[str], bundled: Sequence[str], examples: Sequence[str]
) -> list[str]:
    """Return the given names; by default, bundled robots and, if installed, examples."""
    return list(names) or [*bundled, *(examples if has_example_robots() else ())]


def alternating(
    actions: Sequence[Action],
    *,
    rounds: int = ROUNDS,
    span: float | None = None,
    budget: float = np.inf,
    clock: Callable[[], float] | None = None,
    progress: Progress = quiet,
) -> Array:
    """Time actions that run alternately.

    Args:
        actions: Functions that repeat their work a given number of times. Each is called once or
            twice before timing.
        rounds: Number of rounds.
        span: Least duration of an action in a round [s]; SPAN if None. The number of repetitions
            is chosen for it.
        budget: Time limit for an action over all rounds [s]. A slow action skips rounds, but is
            timed in at least FEWEST of them.
        clock: Function that returns the time [s]; time.perf_counter if None.
        progress: Called with the completed fraction.
    Returns:
        (rounds, actions) seconds per repetition; NaN in skipped rounds.
    """
    counts, numbers_of_rounds = [], []
    span = SPAN if span is None else span
    clock = time.perf_counter if clock is None else clock

    def measure(action: Action, count: int) -> float:
        began = clock()
        action(count)
        return clock() - began

    for j, action in enumerate(actions):
        first, count = measure(action, 1), 1
        if span <= first < LOADING:
            first = measure(action, 1)
        while (last := measure(action, count) if first < span else first) < span:
            count *= 2
        counts.append(count)
        numbers_of_rounds.append(int(min(rounds, max(FEWEST, budget / last))))
        progress((j + 1) / len(actions) / (rounds + 1))
    seconds = np.full((rounds, len(actions)), np.nan)
    for k in range(rounds):
        for j, (action, count) in enumerate(zip(actions, counts, strict=True)):
            n = numbers_of_rounds[j]
            if k * n // rounds < (k + 1) * n // rounds:  # select n evenly spread rounds
                seconds[k, j] = measure(action, count) / count
        progress((k + 2) / (rounds + 1))
    return seconds


def timed(action: Callable[[], T]) -> tuple[T, float]:
    """Call an action once; return its result and its wall time [s]."""
    began = time.perf_counter()
    result = action()
    return result, time.perf_counter() - began


def repeated(action: Callable[[], object]) -> Action:
    """Return a function that calls an action a given number of times."""

    def repeat_action(count: int) -> None:
        for _ in range(count):
            action()

    return repeat_action


_ROBOTS = ("coupled_planar", "planar_chain5", "falling_cat", "satellite_two_arms")
_EXAMPLE_ROBOTS = ("ur5", "solo12", "talos")
_CHAIN = re.compile(f"({'|'.join(FAMILIES)})-([0-9]+)")


class _NoCache(ObjectCache):
    """A kernel cache that stores nothing, so that compilation is measured."""

    def get(self, key: str) -> None:
        """Return None: nothing is cached."""

    def put(self, key: str, code: bytes) -> bool:  # noqa: ARG002
        """Discard the code, and return False."""
        return False


@checks_arguments
def bench_kernels(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the cost of each robot's kernel, with momentum and without forces.

    Args:
        robots: Names or files, and chains such as planar-20 and spatial-100; four bundled robots
            and, if installed, ur5, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot: its number of joints, the instructions of the CasADi graph, the time
        from the model to the address of machine code [s], the time of an evaluation of the kernel
        and of `pin.aba` called from Python [µs], and the ratio of these two.
    """
    names = robots_to_measure(robots, _ROBOTS, _EXAMPLE_ROBOTS)
    rows = tuple(one_by_one(names, _bench_kernel, progress, "kernels"))
    return Table("kernels", rows, {"build": "s", "kernel": "µs", "pin_aba": "µs"})


def _bench_kernel(name: str) -> SimpleNamespace:
    system = _robot(name)

    def build() -> Kernel:
        structure = Structure(zero_momentum=False, cyclic=cyclic_joints(PointwiseReduction(system)))
        return build_kernel(system, structure, cache=_NoCache())

    kernel, seconds = timed(build)
    rng = np.random.default_rng(0)
    y = rng.normal(size=kernel.layout.size)
    parameters = rng.normal(size=kernel.layout.parameters)
    model, data = system.model, system.model.createData()
    q = system.q(system.group.identity(), rng.normal(size=system.m))
    v = system.joint_rates(rng.normal(size=system.n))
    tau = np.zeros(model.nv)
    actions: list[Action] = [
        partial(repeat, kernel.rate.address, parameters, y),
        repeated(lambda: pin.aba(model, data, q, v, tau)),
    ]
    cost, aba = (1e6 * np.median(alternating(actions), axis=0)).tolist()
    return SimpleNamespace(
        robot=name, joints=system.m, instructions=kernel.instructions, build=seconds, kernel=cost,
        pin_aba=aba, ratio=aba / cost,
    )  # fmt: skip


def _robot(name: str) -> System:
    """Return a chain, or load a robot without gravity."""
    if match := _CHAIN.fullmatch(name):
        return chain(match[1], int(match[2]))
    return load(name, group="SE3" if name == "ur5" else None, gravity=(0.0, 0.0, 0.0))


_ROUNDS_OF_COMPARE = 7


def _free(robot: str, duration: float) -> Callable[[], Trajectory]:
    """Return a function that simulates a free motion from a random state."""
    return lambda: simulate(load(robot, gravity=(0.0, 0.0, 0.0)), seed=1, duration=duration)


def _driven() -> Trajectory:
    """Simulate the cat with a prescribed joint and a damper."""
    return simulate(
        load("falling_cat"),
        prescribed={"bend": "0.5*sin(2*t)"},
        forces=[Damper("sway", 0.1)],
        xdot0=[1.0, 0.5, 0.0],
        duration=10.0,
    )


BUNDLED: dict[str, Callable[[], Trajectory]] = {
    "falling_cat, 2 s": _free("falling_cat", 2.0),
    "falling_cat, 10 s, driven": _driven,
}
EXAMPLES: dict[str, Callable[[], Trajectory]] = {
    "solo12, 2 s": _free("solo12", 2.0),
    "solo12, 10 s": _free("solo12", 10.0),
    "talos, 2 s": _free("talos", 2.0),
}
SCENES = {**BUNDLED, **EXAMPLES}


@checks_arguments
def bench_compare(scenes: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the time of `compare`.

    Args:
        scenes: Names of SCENES; by default all whose robots are installed.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each scene: the time of `compare` [s], the same relative to one integration by ABA
        at the scene's tolerance, which is a part of the comparison, and the verdict. Times are
        medians of rounds that alternate between the scenes.
    Raises:
        InputError: A scene is unknown.
    """
    selected = select_named(robots_to_measure(scenes, [*BUNDLED], [*EXAMPLES]), SCENES, "scene")
    names = list(selected)
    motions = one_by_one(names, lambda name: selected[name](), progress, "scenes")
    reports: dict[str, list[Report]] = {name: [] for name in names}

    def comparison(name: str, motion: Trajectory) -> Action:
        return repeated(lambda: reports[name].append(compare(motion)))

    actions = [comparison(*case) for case in zip(names, motions, strict=True)]
    seconds_of_rounds = alternating(actions, rounds=_ROUNDS_OF_COMPARE, span=1e-3)
    times = np.nanmedian(seconds_of_rounds, axis=0).tolist()
    rows = []
    for seconds, (name, own) in zip(times, reports.items(), strict=True):
        integrations = seconds / float(np.median([report.wall_full for report in own]))
        verdict = str(own[-1].verdict)
        rows.append(
            SimpleNamespace(scene=name, seconds=seconds, integrations=integrations, verdict=verdict)
        )
    return Table("compare", tuple(rows), {"seconds": "s"})


_PROCESSES = 3  # number of timed processes of each first call
CALLS = {  # source text of each call
    "simulate": "pinred.simulate(system, seed=1, duration=0.5)",
    "simulate, Radau": "pinred.simulate(system, seed=1, duration=0.5, method='Radau')",
    "simulate, Gauss": "pinred.simulate(system, seed=1, duration=0.5, method='Gauss(0.01)')",
    "simulate_many": "pinred.simulate_many(system, seeds=range(8), times=[0.5])",
    "flow.jacobian": "pinred.flow(system, wrt=['x0'], seed=1, duration=0.5).jacobian()",
    "flow.vjp": "pinred.flow(system, wrt=['x0'], seed=1, duration=0.5)"
    ".vjp({'pose': numpy.ones(system.group.dim)})",
    "simulate, compare": "pinred.compare(pinred.simulate(system, seed=1, duration=0.5))",
}
# The harness is imported first: neither it nor the engine's modules that it needs are measured.
_PROGRAM = """
import time, numpy, pinred, pinred.laboratory.bench.timing
system = pinred.load("falling_cat")
began = time.perf_counter()
{call}
print(time.perf_counter() - began)
"""


@checks_arguments
def bench_first_calls(
    calls: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> Table:
    """Measure first calls in fresh processes with empty caches, after the robot was loaded.

    Args:
        calls: Names of CALLS; by default all.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each call: the median time, with machine code generated from the package's
        bitcode [s].
    Raises:
        InputError: A call is unknown.
    """
    programs = [*select_named(calls, CALLS, "call").items()]

    def measure(named_call: tuple[str, str]) -> SimpleNamespace:
        name, call = named_call
        seconds = [time_in_fresh_process(call) for _ in range(_PROCESSES)]
        return SimpleNamespace(call=name, seconds=float(np.median(seconds)))

    rows = tuple(one_by_one(programs, measure, progress, "calls"))
    return Table("first_calls", rows, {"seconds": "s"})


def time_in_fresh_process(call: str) -> float:
    """Return the time of a call, given as source text, in a process with an empty cache [s]."""
    with TemporaryDirectory() as cache:
        # Installed packages contain bytecode, so the processes write and read it.
        settings = {"PINRED_CACHE_DIR": cache, "PYTHONDONTWRITEBYTECODE": ""}
        done = subprocess.run(
            [sys.executable, "-c", _PROGRAM.format(call=call)], stdout=subprocess.PIPE, text=True,
            check=True, env={**os.environ, **settings},
        )  # fmt: skip
    return float(done.stdout)


_TOLERANCES = tuple(10.0 ** (-k / 3) for k in range(18, 40))


def _prepare(members: Sequence[Problem], rtol: float, *, in_lanes: bool) -> PreparedRun:
    flows, method = compile_members(members), DOP853(rtol, 1e-2 * rtol)
    kernel, times = flows.kernel, members[0].times
    duration = members[0].start.duration
    y0, params, quaternions = flows.y0, flows.parameters, kernel.layout.quaternions
    integrate: Callable[..., Solutions] = integrate_many
    code: tuple[int, ...] = (kernel.rate.address,)
    if in_lanes:
        lanes = lanes_of(method, kernel)
        integrate = integrate_in_lanes
        code = wide_rate(kernel, lanes, own_parameters=True).address, lanes
    run = partial(integrate, method, *code, params, y0, duration, times, quaternions, 1)

    def end(solutions: Solutions, member: int) -> End:
        if not solutions.ok.all():
            raise IntegrationError(f"{method.name} did not integrate all members to their end")
        return members[member].end(solutions.y[member, -1])

    return PreparedRun(run, end)


_LANES = partial(_prepare, in_lanes=True)
_SCALAR = partial(_prepare, in_lanes=False)
OWN = (
    Solver("lanes", "DOP853, members in SIMD lanes", _TOLERANCES, _LANES),
    Solver("one by one", "DOP853, one member after another", _TOLERANCES, _SCALAR),
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


_DURATION = 2.0  # duration of each motion on one and two threads [s]


@checks_arguments
def bench_threads(
    robot: str = "solo12",
    *,
    members: int = 1000,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> Table:
    """Measure simulate_many from random states on one thread and on two.

    Args:
        robot: Name or file.
        members: Number of members.
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each number of threads: the median wall time of the whole call [s].
    Raises:
        InputError: No member.
    """
    system = load(robot, gravity=(0.0, 0.0, 0.0))
    call = partial(simulate_many, system, seeds=range(members), times=[_DURATION])
    actions = [repeated(partial(call, threads=threads)) for threads in (1, 2)]
    with shown(progress, "threads") as bar:
        times = alternating(actions, rounds=rounds, progress=bar or quiet)
    walls = np.median(times, axis=0).tolist()
    rows = tuple(SimpleNamespace(threads=k + 1, wall=wall) for k, wall in enumerate(walls))
    title = f"{system.name}: {members} trajectories of {_DURATION:g} s, whole call"
    notes = (f"two threads are {np.median(times[:, 0] / times[:, 1]):.2f} times faster",)
    shared = {"robot": system.name, "members": members}
    return Table("threads", rows, {"wall": "s"}, title, notes, shared)
