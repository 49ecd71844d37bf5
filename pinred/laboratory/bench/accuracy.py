"""Run time against error, for every method at every tolerance, timed in alternating rounds.

Results can be recorded in a folder; a run then continues the record of earlier runs.

Errors refer to a reference solution, whose own error is estimated. With heyoka, Taylor's method
solves pinred's reduced equations in quadruple precision, at two tolerances and from an initial
state that differs by round-off. Without heyoka, Hairer's DOP853 solves the equations of the full
state. In both cases the result is compared with Pinocchio's ABA on the full state.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only
from ...common.errors import IntegrationError, PinredError
from ...common.files import write_atomic, write_table
from ...common.waiting import Progress, ProgressBar, quiet, shown
from ...integrators.methods import DOP853_LEAST, METHODS, RKMK4, AdaptiveGauss, Explicit, Gauss
from ...integrators.methods import Method as Integrator
from ...judge.reference_solution import FINEST, FullMotion
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.compiled.integrator import integrator
from ...simulation.plan import plan_of
from ...simulation.simulate import simulate
from ...system.state_fields import with_base
from .accuracy_record import ERRORS, NAME, Point, WorkPrecision, read_record, write_record
from .peers.aba import ABA
from .peers.cvodes import CVODES
from .peers.drake import DRAKE
from .peers.heyoka import HEYOKA, has_heyoka, reduced_graph, taylor_expressions
from .peers.mujoco import MUJOCO
from .problems import (
    ATOL,
    End,
    PreparedRun,
    Problem,
    Solver,
    compute_drift,
    decades,
    halvings,
    problems_named,
    select_named,
)
from .timing import Action, Table, alternating, repeated, timed

FROM_TOLERANCE = decades(2, 14)


@checks_arguments
def own_method(
    name: str,
    about: str,
    make: Callable[[float], Integrator] | None = None,
    *,
    tolerances: tuple[float, ...] = FROM_TOLERANCE,
    fixed: bool = False,
) -> Solver:
    """Return a benchmark method that calls `simulate` with an integrator of pinred.

    Args:
        name: Name of the method.
        about: Description of the timed work.
        make: Creates the integrator from a tolerance, or from a step [s] if `fixed`. If None,
            `simulate` chooses it.
        tolerances: Tolerances from coarse to fine, see Solver.
        fixed: Whether the integrator has fixed steps.
    Returns:
        The method.
    """

    def prepare(problem: Problem, tolerance: float) -> PreparedRun:
        start, scaled = problem.start, tolerance * (problem.start.duration if fixed else 1.0)
        options: dict[str, Any] = {"rtol": tolerance, "atol": ATOL * tolerance}
        if make is not None:
            options = {"method": make(scaled)}

        def run() -> Any:
            traj = simulate(
                problem.system, x0=start.x, xdot0=start.xdot, xi0=start.xi, times=problem.times,
                **options,
            )  # fmt: skip
            return traj.states, traj.run.evaluations

        return PreparedRun(run, lambda result: problem.end_of(*result))

    return Solver(name, about, tolerances, prepare, fixed=fixed)


def _integration(problem: Problem, tolerance: float) -> PreparedRun:
    plan = plan_of(problem.scene(rtol=tolerance, atol=ATOL * tolerance))
    flow = CompiledFlow.of_plan(plan)

    def end(solution: Any) -> End:
        states = flow.states(problem.times, solution.at(problem.times))
        return problem.end_of(with_base(states, problem.name), solution.evaluations)

    integrate = integrator(flow, plan, None)
    parameters = read_only(flow.parameters.copy())
    return PreparedRun(lambda: integrate(0.0, plan.scene.end, flow.y0, parameters), end)


def _explicit(name: str, kind: type[Explicit]) -> Solver:
    return own_method(
        f"pinred-{name.lower()}",
        f"simulate() with {name}, whole call",
        lambda tol: kind(max(tol, DOP853_LEAST), ATOL * tol),
    )


def _fixed(name: str, text: str, make: Callable[[float], Integrator], count: int) -> Solver:
    about = f"simulate() with {text}, equal steps, whole call"
    return own_method(f"pinred-{name}", about, make, tolerances=halvings(50, count), fixed=True)


OWN = (
    own_method("pinred", "simulate(), whole call from initial values"),
    Solver(
        "pinred-integration",
        "its integration alone, as heyoka is timed",
        FROM_TOLERANCE,
        _integration,
    ),
    *(_explicit(name, kind) for name, kind in METHODS.items() if issubclass(kind, Explicit)),
    own_method(
        "pinred-gauss",
        "simulate() with AdaptiveGauss, whole call",
        lambda tol: AdaptiveGauss(tol, ATOL * tol),
    ),
    _fixed("gauss6", "Gauss of order 6", lambda step: Gauss(step, 6), 8),
    _fixed("rkmk4", "RKMK4", RKMK4, 14),
)


SOLVERS: tuple[Solver, ...] = (*OWN, *ABA, *MUJOCO, *DRAKE, *CVODES, *HEYOKA)


def solvers_named(names: Sequence[str] | None) -> tuple[Solver, ...]:
    """Return the named methods, or all if None; raise InputError for an unknown name."""
    return tuple(
        select_named(names, {method.name: method for method in SOLVERS}, "method").values()
    )


YARDSTICK = "pinred"  # method that every run contains, so that time ratios stay within a run


@checks_arguments
@dataclass(frozen=True)
class Effort:
    """Time limits and repetitions of a benchmark.

    Attributes:
        name: Name of the effort, stored in the record.
        rounds: Number of rounds, of which the median is reported.
        patience: Time limit [s]; after a longer run, finer tolerances of the method are skipped.
        budget: Time limit for all rounds of one method at one tolerance [s].
        every: Stride through the tolerances of a method; 1 measures all.
    """

    name: str
    rounds: int
    patience: float
    budget: float
    every: int = 1


QUICK = Effort("quick", rounds=3, patience=0.1, budget=0.1, every=3)
DEFAULT = Effort("default", rounds=7, patience=0.4, budget=0.5)
FULL = Effort("full", rounds=15, patience=10.0, budget=30.0)


def run_name() -> str:
    """Return a unique name for a run, from the time and the process id."""
    return f"{time.strftime('%Y%m%dT%H%M%S')}-{os.getpid()}"


@checks_arguments
def bench_accuracy(
    problems: Sequence[Problem] | None = None,
    *,
    methods: Sequence[Solver] | None = None,
    tolerances: Sequence[float] | None = None,
    effort: Effort = DEFAULT,
    progress: Progress | bool | None = None,
) -> list[WorkPrecision]:
    """Measure run time against error for each method on each problem.

    Args:
        problems: Problems; `scenes.BARS` if None.
        methods: Methods; SOLVERS if None.
        tolerances: Relative tolerances for methods with step control; default tolerances if None.
        effort: Time that the measurement may take.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each problem.
    Raises:
        IntegrationError: The reference solution of a problem cannot be computed.
    """
    problems = problems_named()[0] if problems is None else problems
    methods = SOLVERS if methods is None else methods
    run, results = run_name(), []
    with shown(progress, "accuracy") as bar:
        report_all = bar or quiet
        for k, problem in enumerate(problems):

            def report(fraction: float, k: int = k) -> None:
                report_all((k + fraction) / len(problems))

            results.append(
                bench_problem(problem, methods, tolerances, effort, run=run, progress=report)
            )
    return results


def bench_problem(
    problem: Problem,
    methods: Sequence[Solver],
    tolerances: Sequence[float] | None = None,
    effort: Effort = DEFAULT,
    *,
    run: str = "",
    progress: Progress = quiet,
) -> WorkPrecision:
    """Measure run time against error on one problem.

    Args:
        problem: The problem.
        methods: Methods to measure; those that cannot run here are listed as missing.
        tolerances: Relative tolerances for methods with step control; default tolerances if None.
        effort: Time that the measurement may take.
        run: Name of the run.
        progress: Called with the completed fraction.
    Returns:
        Points of all methods.
    Raises:
        IntegrationError: The reference solution cannot be computed.
    """
    missing = {method.name: method.missing(problem) for method in methods}
    available = [method for method in methods if not missing[method.name]]
    reference = reference_of(problem)
    progress(0.1)
    points: list[Point] = []
    runs: dict[int, Action] = {}  # by number of the point
    for k, method in enumerate(available):
        for point, run_once in _first_runs(problem, reference, method, tolerances, effort):
            if run_once is not None:
                runs[len(points)] = repeated(run_once)
            points.append(point)
        progress(0.1 + 0.4 * (k + 1) / len(available))
    times = alternating(
        [*runs.values()],
        rounds=effort.rounds,
        budget=effort.budget,
        progress=lambda fraction: progress(0.5 + 0.5 * fraction),
    )
    for k, walls in zip(runs, times.T, strict=True):
        points[k] = replace(points[k], wall=float(np.nanmedian(walls)))
    return WorkPrecision(
        problem=problem.name,
        description=problem.about,
        joints=problem.system.m,
        duration=problem.start.duration,
        reference_error=reference.error,
        reference=reference.about,
        about={method.name: method.about for method in available},
        points=tuple(points),
        missing={name: line for name, line in missing.items() if line},
        run=run,
    )


def _first_runs(
    problem: Problem,
    reference: Reference,
    method: Solver,
    tolerances: Sequence[float] | None,
    effort: Effort,
) -> Iterator[tuple[Point, Callable[[], Any] | None]]:
    """Run a method once at each tolerance; yield its errors, and its run for timing."""
    if tolerances is None or method.fixed:
        tolerances = method.tolerances[:: effort.every]
    else:
        tolerances = tuple(sorted(tolerances, reverse=True))
    slow = ""
    for tolerance in tolerances:
        point, run = Point(method.name, tolerance, failure=slow), None
        if not slow:
            try:
                prepared = method.prepare(problem, tolerance)
                result, wall = timed(prepared.run)
                if wall > effort.patience:  # may include time to compile or load code
                    result, wall = timed(prepared.run)
                errors = _errors(problem, reference, prepared.end(result))
                point, run = replace(point, build=prepared.build, **errors), prepared.run
                if wall > effort.patience:
                    slow = (
                        f"not run: a coarser tolerance took {wall:.2g} s, more than the limit of "
                        f"{effort.patience:g} s"
                    )
            except PinredError as error:
                point = replace(point, failure=str(error))
        yield point, run


def _errors(problem: Problem, reference: Reference, end: End) -> dict[str, Any]:
    """Compute the numbers of a Point that follow from the final state; it must be finite."""
    if not all(np.isfinite(numbers).all() for numbers in (end.x, end.q, end.v)):
        raise IntegrationError("the final state is not finite")
    distance = problem.full.distance(reference.end, end.motion)
    errors = {name: float(getattr(distance, name)[0]) for name in ("shape", "rotation", "position")}
    energy, momentum = compute_drift(problem, end.q, end.v)
    return {**errors, "energy": energy, "momentum": momentum, "evaluations": end.evaluations}


def continue_accuracy(
    problems: Sequence[Problem],
    methods: Sequence[Solver],
    tolerances: Sequence[float] | None,
    effort: Effort,
    folder: Path | None,
) -> list[WorkPrecision]:
    """Measure the results that a folder lacks; print and write all results.

    Args:
        problems: The scenes.
        methods: The methods.
        tolerances: Tolerances of the adaptive methods; by default those of each method.
        effort: Effort of the measurement.
        folder: Folder of the record and the tables; None to write nothing.
    Returns:
        The results, with the results of former runs in the folder.
    Raises:
        LoadError: The record of former runs cannot be read.
        InputError: The record was measured with other options.
    """
    settings = effort.name
    if tolerances is not None:
        settings += f", tolerances {' '.join(f'{t:g}' for t in tolerances)}"
    path = None if folder is None else folder / NAME
    results = read_record(path, settings) if path is not None and path.exists() else []
    run = run_name()
    for k, problem in enumerate(problems):
        before = [result for result in results if result.problem == problem.name]
        measured = {name for result in before for name in (*result.about, *result.missing)}
        remaining = [method for method in methods if method.name not in measured]
        if not remaining:
            print(f"{problem.name} is measured already, in run {before[-1].run}\n")
            continue
        if before and YARDSTICK not in [method.name for method in remaining]:
            # Times of different runs are not comparable, so this run measures pinred again.
            remaining = [*solvers_named([YARDSTICK]), *remaining]
        with ProgressBar(f"{problem.name} ({k + 1} of {len(problems)})") as bar:
            result = bench_problem(problem, remaining, tolerances, effort, run=run, progress=bar)
        print(result, end="\n\n", flush=True)
        results.append(result)
        if path is not None:
            write_record(path, settings, results)
    tables = overview(results)
    print(tables, end="\n\n")
    if path is not None and folder is not None:
        text = (tables + "\n").encode()
        write_atomic(folder / "overview.txt", lambda file: file.write(text))
        _write_equal_error(folder, results)
    return results


_EQUAL_ERROR = ("run", "problem", "error", "method", "wall", "times_pinred", "reference_error")


def _write_equal_error(folder: Path, results: Sequence[WorkPrecision]) -> None:
    """Write run times and their ratios at equal errors, interpolated between the points."""
    table_rows = (
        (
            *(result.run, result.problem, error, method, result.wall_at(method, error)),
            result.ratio_at(method, error) if YARDSTICK in result.about else "",
            result.reference_error,
        )
        for result in results
        for error in ERRORS
        for method in result.about
    )
    records = [dict(zip(_EQUAL_ERROR, columns, strict=True)) for columns in table_rows]
    write_table(folder / "equal_error.csv", _EQUAL_ERROR, records)


OVERVIEW_ERRORS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-13)
LOOSEST, TIGHTEST = 1e-4, 1e-13  # largest and smallest tolerance in the table of error / tolerance
FOLLOWING = (YARDSTICK, "pinred-dop853", "pinred-gauss")  # methods in the table of error/tolerance
_SIDE_BY_SIDE = 6  # largest number of scenes in one table


def overview(results: Sequence[WorkPrecision]) -> str:
    """Format tables of several results, with one column for each scene.

    The tables contain pinred's wall time at each error, and the ratios of other methods' times in
    the same run to it. The last table gives errors of pinred's methods relative to their
    tolerances.

    Args:
        results: Results of `bench_accuracy`.
    Returns:
        The text.
    """
    cells: dict[str, Callable[[WorkPrecision, str], str]] = {
        f"error {error:.0e}: {YARDSTICK} [ms], and how many times longer others take": partial(
            _time_cell, error
        )
        for error in OVERVIEW_ERRORS
    }
    title = f"error / tolerance, for tolerances of {LOOSEST:.0e} … {TIGHTEST:.0e}"
    cells[title] = _following_cell
    scenes = list(dict.fromkeys(result.problem for result in results))
    blocks = [scenes[k : k + _SIDE_BY_SIDE] for k in range(0, len(scenes), _SIDE_BY_SIDE)]
    texts = [_table(results, block, *cell) for block in blocks for cell in cells.items()]
    return "\n\n".join(filter(None, texts))


def _table(
    results: Sequence[WorkPrecision],
    scenes: list[str],
    title: str,
    format_cell: Callable[[WorkPrecision, str], str],
) -> str:
    """Format a table, in which every cell is from a run with pinred; "" if all cells are empty."""
    table_rows = []
    for name in dict.fromkeys(n for r in results if r.problem in scenes for n in r.about):
        cells = dict.fromkeys(scenes, "—")
        for run in reversed(results):  # the first run of a scene replaces later ones
            if run.problem in cells and {name, YARDSTICK} <= set(run.about):
                cells[run.problem] = format_cell(run, name)
        if set(cells.values()) != {"—"}:
            table_rows.append(SimpleNamespace(method=name, **cells))
    return str(Table("overview", tuple(table_rows), title=title)) if table_rows else ""


def _time_cell(error: float, result: WorkPrecision, name: str) -> str:
    """Format pinred's wall time [ms], or the ratio of another method's time to that time."""
    is_pinred = name == YARDSTICK
    number = 1e3 * result.wall_at(name, error) if is_pinred else result.ratio_at(name, error)
    return "—" if np.isnan(number) else f"{number:.3g}"


def _following_cell(result: WorkPrecision, method: str) -> str:
    """Format the range of error / tolerance over points with errors above the reference error."""
    ratios = [
        point.error / point.tolerance
        for point in result.of(method)
        if 0.99 * TIGHTEST < point.tolerance < 1.01 * LOOSEST
        and point.error > result.reference_error
    ]
    return f"{min(ratios):.2g} … {max(ratios):.2g}" if method in FOLLOWING and ratios else "—"


_QUAD = (1e-23, 1e-20)  # tolerances in quadruple precision
_EPS = float(np.finfo(float).eps)
CONFIRMED = 1e-9  # distance from ABA above which it counts as the error of the reference [rad | m]


@checks_arguments
@dataclass(frozen=True)
class Reference:
    """The final state of a problem.

    Attributes:
        end: The final state.
        error: Estimated error [rad | m]; smaller errors of methods cannot be resolved.
        independent: Distance from Pinocchio's ABA under DOP853 in double precision [rad | m].
        about: Description of the computation.
    """

    end: FullMotion
    error: float
    independent: float
    about: str


@checks_arguments
def reference_of(problem: Problem) -> Reference:
    """Compute the final state of a problem.

    Args:
        problem: The problem.
    Returns:
        The reference.
    Raises:
        IntegrationError: The motion cannot be integrated at the tightest tolerance.
    """
    y0, times = problem.full_start(), problem.times
    aba = problem.full.run(y0, times, *FINEST)
    if has_heyoka():
        return _quadruple(problem, aba)
    second = problem.full.run(y0, times, *FINEST, method="dopri5")
    error = problem.apart(aba, second)
    return Reference(
        aba, error, error, f"ABA on the full state, by DOP853 and DOPRI5 at {FINEST[0]:g}"
    )


def _quadruple(problem: Problem, aba: FullMotion) -> Reference:
    hy = import_module("heyoka")
    flow, duration = problem.flow, problem.start.duration
    expressions = taylor_expressions(reduced_graph(problem), flow.parameters.tolist())

    def end(y: Any) -> FullMotion:
        return problem.end(np.array([float(value) for value in y])).motion

    def integrator(tolerance: float) -> Any:
        y0 = [hy.real128(value) for value in flow.y0.tolist()]
        return hy.taylor_adaptive(
            expressions, y0, tol=hy.real128(tolerance), compact_mode=True, fp_type=hy.real128
        )

    def propagate(ta: Any, y0: Array) -> Any:
        ta.time = hy.real128(0.0)
        ta.state[:] = [hy.real128(value) for value in y0.tolist()]
        outcome, *_ = ta.propagate_until(hy.real128(duration))
        if outcome.name != "time_limit":
            raise IntegrationError(f"heyoka stopped with {outcome.name} at t = {float(ta.time):g}")
        return np.array(ta.state)

    if not flow.y0.size:  # a single body in pure translation has no reduced state
        return Reference(aba, _EPS, 0.0, "closed form")
    ends = [propagate(integrator(_QUAD[0]), flow.y0)]
    coarse = integrator(_QUAD[1])
    ends.append(propagate(coarse, flow.y0))
    rng = np.random.default_rng(0)
    perturbed = propagate(coarse, flow.y0 * (1.0 + _EPS * rng.choice([-1.0, 1.0], flow.y0.size)))
    converged = max(float(abs(a - b)) for a, b in zip(*ends, strict=True))
    truth = end(ends[0])
    # Even an exact integration has the round-off of the initial momenta and of the final state.
    rounding = max(problem.apart(truth, end(perturbed)), 4.0 * _EPS)
    independent = problem.apart(truth, aba)
    error = max(converged, rounding)
    about = (
        f"heyoka in quadruple precision (converged to {converged:.0e}; round-off of the initial "
        f"values changes it by {rounding:.0e}); ABA on the full state in double precision is "
        f"{independent:.0e} away"
    )
    return Reference(truth, error if independent < CONFIRMED else independent, independent, about)
