"""Run time against error, for every method at every tolerance, timed in alternating rounds."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import IntegrationError, PinredError
from ...common.progress import Progress, quiet, shown
from ...judge.distances import FullMotion
from .conservation_drift import compute_drift
from .problems import Problem
from .reference import Reference, reference_of
from .scenes import problems_named
from .solver import PreparedRun, Solver
from .timing import alternating, repeated
from .work_precision import Point, WorkPrecision

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
    from .solvers import SOLVERS

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
    prepared_runs: list[tuple[int, PreparedRun]] = []
    for k, method in enumerate(available):
        for point, prepared in _first_runs(problem, reference, method, tolerances, effort):
            if prepared is not None:
                prepared_runs.append((len(points), prepared))
            points.append(point)
        progress(0.1 + 0.4 * (k + 1) / len(available))
    times = alternating(
        [repeated(prepared.run) for _, prepared in prepared_runs],
        rounds=effort.rounds,
        budget=effort.budget,
        progress=lambda fraction: progress(0.5 + 0.5 * fraction),
    )
    for j, (k, _) in enumerate(prepared_runs):
        points[k] = replace(points[k], wall=float(np.nanmedian(times[:, j])))
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
) -> Iterator[tuple[Point, PreparedRun | None]]:
    """Run a method once at each tolerance; yield its errors, and the prepared run for timing."""
    if tolerances is None or method.fixed:
        tolerances = method.tolerances[:: effort.every]
    else:
        tolerances = tuple(sorted(tolerances, reverse=True))
    slow = ""
    for tolerance in tolerances:
        if slow:
            yield Point(method.name, tolerance, failure=slow), None
            continue
        try:
            prepared = method.prepare(problem, tolerance)
            result, wall = _run_timed(prepared)
            if wall > effort.patience:  # may include time to compile or load code
                result, wall = _run_timed(prepared)
            point = _point(problem, reference, method.name, tolerance, prepared, result)
        except PinredError as error:
            yield Point(method.name, tolerance, failure=str(error)), None
            continue
        yield point, prepared
        if wall > effort.patience:
            slow = (
                f"not run: a coarser tolerance took {wall:.2g} s, more than the limit of "
                f"{effort.patience:g} s"
            )


def _run_timed(prepared: PreparedRun) -> tuple[object, float]:
    began = time.perf_counter()
    result = prepared.run()
    return result, time.perf_counter() - began


def _point(
    problem: Problem,
    reference: Reference,
    method: str,
    tolerance: float,
    prepared: PreparedRun,
    result: object,
) -> Point:
    """Return the errors of a first run; its time is measured later.

    Args:
        problem: Problem that was solved.
        reference: Reference solution.
        method: Name of the method.
        tolerance: Tolerance of the run.
        prepared: The prepared run.
        result: Result of the run.
    Returns:
        The point without wall time.
    Raises:
        IntegrationError: The final state is not finite.
    """
    end = prepared.end(result)
    if not all(np.isfinite(values).all() for values in (end.x, end.q, end.v)):
        raise IntegrationError("the final state is not finite")
    distance = problem.full.distance(reference.end, FullMotion(x=end.x[None], q=end.q[None]))
    drift = compute_drift(problem, end.q, end.v)
    return Point(
        method=method,
        tolerance=tolerance,
        build=prepared.build,
        evaluations=end.evaluations,
        shape=float(distance.shape[0]),
        rotation=float(distance.rotation[0]),
        position=float(distance.position[0]),
        energy=drift.energy,
        momentum=drift.momentum,
    )
