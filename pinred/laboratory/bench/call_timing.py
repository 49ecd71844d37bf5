"""Times of whole calls: comparisons, Floquet multipliers, films, first calls, and batches.

Batches of members run at a requested error, also with other tools, on one thread; `simulate_many`
on two threads. The processor time of batches is measured instead of their wall time: calls take
milliseconds, and other processes on the machine would distort their wall time.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ...analysis.equilibria.find import relative_equilibria
from ...analysis.equilibria.relative_equilibrium import RelativeEquilibrium
from ...analysis.stability.along_motions import floquet, linearise
from ...analysis.stability.linearised_flow import without_base
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError, PinredError
from ...common.waiting import Progress, one_by_one, quiet, shown
from ...forces.kinds import Damper
from ...integrators.integrate_many import Solutions, integrate_many
from ...integrators.lanes.integrate_in_lanes import integrate_in_lanes
from ...integrators.methods import DOP853
from ...judge.compare import compare
from ...judge.reference_solution import FINEST, FullMotion
from ...kernels.build import jacobian_of, wide_rate
from ...reduction.pointwise_reduction import PointwiseReduction
from ...scene.initial_state import random_state
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.members.integrate_members import lanes_of
from ...simulation.members.trajectories import Trajectories
from ...simulation.plan import plan_of
from ...simulation.simulate import simulate
from ...simulation.simulate_many import simulate_many
from ...simulation.trajectory import Trajectory
from ...system.load import load
from ...system.system import System
from ...views.playback.film import SIZE, Frames
from ...views.playback.view_options import FILM_FPS, View
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
    select_named,
)
from .timing import Table, alternating, repeated, robots_to_measure

_ROUNDS = 7


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
    walls: list[list[float]] = [[] for _ in names]
    verdicts = [""] * len(names)

    def comparison(k: int) -> Callable[[], None]:
        def run() -> None:
            report = compare(motions[k])
            walls[k].append(report.wall_full)
            verdicts[k] = str(report.verdict)

        return run

    actions = [repeated(comparison(k)) for k in range(len(names))]
    times = alternating(actions, rounds=_ROUNDS, span=1e-3)
    seconds = np.nanmedian(times, axis=0).tolist()
    rows = [
        SimpleNamespace(
            scene=name, seconds=s, integrations=s / float(np.median(wall)), verdict=verdict
        )
        for name, s, wall, verdict in zip(names, seconds, walls, verdicts, strict=True)
    ]
    return Table("compare", tuple(rows), {"seconds": "s"})


# Robots with one rotation axis, and their angular momentum J [N·m·s].
PROBLEMS = {"double_spherical_pendulum": 2.0, "planar_chain5": 1.0}
ROUTES = ("pinred.floquet", "differences of pinred.simulate", "SciPy's DOP853 over the kernel")
_STEP = 1e-4  # step of the finite differences of shape [rad] and momentum [kg m²/s]


@checks_arguments
def bench_floquet(*, rounds: int = 5, progress: Progress | bool | None = None) -> Table:
    """Compute Floquet multipliers on three routes and compare them with e^{λT}.

    A relative equilibrium is periodic with any period T, and its multipliers follow from the
    eigenvalues λ of the linearised flow. The routes are `pinred.floquet`, which integrates the
    linearised flow in machine code; finite differences of `pinred.simulate`; and SciPy's DOP853
    over the same rates and Jacobian, called from Python. The steady motions have the lowest energy
    of each robot in PROBLEMS.

    Args:
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot and route: the period [s], the wall time [s], and the largest error of
        multipliers relative to the largest |μ|.
    """
    measure = partial(_measure_routes, rounds=rounds)
    tables = one_by_one(list(PROBLEMS), measure, progress, "floquet")
    rows = tuple(row for table in tables for row in table)
    return Table("floquet", rows, {"period": "s", "wall": "s"})


def _measure_routes(name: str, rounds: int) -> list[SimpleNamespace]:
    least = relative_equilibria(load(name), momentum=PROBLEMS[name], starts=50)[0]
    T = 2.0 * np.pi / float(least.frequencies[0])
    traj = simulate(least.scene(duration=T))
    eigenvalues = linearise(traj).eigenvalues
    exact = _sort_by_angle(np.exp(eigenvalues * T))
    routes: list[Callable[[], Array]] = [
        lambda: floquet(traj).monodromy,
        lambda: _differences(least, T),
        lambda: _by_scipy(traj.scene, T),
    ]
    computed = [_sort_by_angle(np.linalg.eigvals(route()).astype(complex)) for route in routes]
    error = [float(np.abs(mu - exact).max() / np.abs(exact).max()) for mu in computed]
    wall = np.median(alternating([repeated(route) for route in routes], rounds=rounds), axis=0)
    return [
        SimpleNamespace(robot=name, period=T, route=route, wall=seconds, error=largest)
        for route, seconds, largest in zip(ROUTES, wall.tolist(), error, strict=True)
    ]


def _sort_by_angle(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return multipliers sorted by their rounded angle, so that round-off keeps the order."""
    values = np.asarray(values, dtype=complex)
    return values[np.argsort(np.round(np.angle(values), 5), kind="stable")]


def _differences(least: RelativeEquilibrium, T: float) -> Array:
    """Compute the monodromy matrix, (2m, 2m), from central differences of simulations."""
    system, red = least.system, PointwiseReduction(least.system)
    r, m = system.r, system.m
    start = red.mass_matrix(least.x) @ np.concatenate([least.xi, least.xdot])
    scene = least.scene(duration=T)
    mu = np.zeros(r)  # with zero linear momentum, the angular momentum is the same about any point
    mu[-1] = least.momentum

    def final_state(change: Array) -> Array:
        x, pi = least.x + change[:m], start[r:] + change[m:]
        v = np.linalg.solve(red.mass_matrix(x), np.concatenate([mu, pi]))
        end = simulate(replace(scene, x0=x, xdot0=v[r:], xi0=v[:r], times=[T], duration=None))
        velocity = np.concatenate([end.xi[-1], end.xdot[-1]])
        return np.concatenate([end.x[-1], (red.mass_matrix(end.x[-1]) @ velocity)[r:]])

    columns = [(final_state(h) - final_state(-h)) / (2.0 * _STEP) for h in _STEP * np.eye(2 * m)]
    return np.array(columns).T


def _by_scipy(scene: Scene, T: float) -> Array:
    """Compute the monodromy matrix, (k, k), with SciPy's DOP853 applied to kernel and Jacobian."""
    flow = CompiledFlow.of_plan(plan_of(without_base(scene)))
    n = len(flow.y0)

    def rate(_t: float, z: Array) -> Array:
        y, Y = z[:n], z[n:].reshape(n, n)
        J = jacobian_of(flow.kernel, y, flow.parameters)
        return np.concatenate([flow.kernel.evaluate_rate(y, flow.parameters), (J @ Y).ravel()])

    z0 = np.concatenate([flow.y0, np.eye(n).ravel()])
    solution = solve_ivp(rate, (0.0, T), z0, method="DOP853", rtol=1e-11, atol=1e-13)
    return np.asarray(solution.y[n:, -1].reshape(n, n), dtype=float)


_FILMED, _FILMED_EXAMPLES = ("falling_cat", "satellite_two_arms"), ("solo12", "talos")
_SPAN, _TIMED = 2.0, 15  # duration [s] and number of frames of a measurement


@checks_arguments
def bench_films(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the time of a film's frame for each robot.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot: the number of triangles, the median processor time of a frame without
        its encoding [s], and frames per second.
    """
    names = robots_to_measure(robots, _FILMED, _FILMED_EXAMPLES)
    return Table("films", tuple(one_by_one(names, _bench_film, progress, "films")), {"frame": "s"})


def _bench_film(name: str) -> SimpleNamespace:
    traj = simulate(load(name, gravity=(0.0, 0.0, 0.0)), seed=1, duration=_SPAN)
    frames, times = Frames(traj, View(fps=FILM_FPS), SIZE), cycle(np.linspace(0.0, _SPAN, _TIMED))
    draw = repeated(lambda: frames.draw(float(next(times))))
    seconds = alternating([draw], rounds=_TIMED, span=0.0, clock=time.process_time)
    frame = float(np.median(seconds))
    return SimpleNamespace(
        robot=name, triangles=frames.triangles, frame=frame, per_second=1.0 / frame
    )


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
