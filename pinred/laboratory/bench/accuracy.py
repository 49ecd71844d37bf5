"""Run time against error: each method at each tolerance, in one run of alternating rounds."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

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

YARDSTICK = "pinred"  # measured in every run, so that each has ratios of its own


@dataclass(frozen=True)
class Effort:
    """The time that a measurement may take.

    rounds: of which the median counts.  patience: s; once a run of a method takes longer, it
    is not refined any more.  budget: s of timing for one point.  every: of the tolerances,
    which are measured.
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
    """Return a name for a run of this process, which no other has."""
    return f"{time.strftime('%Y%m%dT%H%M%S')}-{os.getpid()}"


def bench_accuracy(
    problems: Sequence[Problem] | None = None,
    *,
    methods: Sequence[Solver] | None = None,
    tolerances: Sequence[float] | None = None,
    effort: Effort = DEFAULT,
    progress: Progress | bool | None = None,
) -> list[WorkPrecision]:
    """Return what accuracy costs on each problem, by each method.

    problems: those of `scenes.BARS` if None.  methods: SOLVERS if None.
    tolerances: of the methods that have one; each method's own if None.  progress: as for
    `simulate`.
    """
    from .solvers import SOLVERS

    problems = problems_named()[0] if problems is None else problems
    methods = SOLVERS if methods is None else methods
    run, found = run_name(), []
    with shown(progress, "accuracy") as bar:
        done = bar or quiet
        for k, problem in enumerate(problems):

            def part(inner: float, k: int = k) -> None:
                done((k + inner) / len(problems))

            found.append(
                bench_problem(problem, methods, tolerances, effort, run=run, progress=part)
            )
    return found


def bench_problem(
    problem: Problem,
    methods: Sequence[Solver],
    tolerances: Sequence[float] | None = None,
    effort: Effort = DEFAULT,
    *,
    run: str = "",
    progress: Progress = quiet,
) -> WorkPrecision:
    """Return what accuracy costs on one problem.  Raises IntegrationError without a reference."""
    missing = {method.name: method.missing(problem) for method in methods}
    able = [method for method in methods if not missing[method.name]]
    truth = reference_of(problem)
    progress(0.1)
    points: list[Point] = []
    running: list[tuple[int, PreparedRun]] = []
    for k, method in enumerate(able):
        for point, prepared in _first_runs(problem, truth, method, tolerances, effort):
            if prepared is not None:
                running.append((len(points), prepared))
            points.append(point)
        progress(0.1 + 0.4 * (k + 1) / len(able))
    times = alternating(
        [repeated(prepared.run) for _, prepared in running],
        rounds=effort.rounds,
        budget=effort.budget,
        progress=lambda part: progress(0.5 + 0.5 * part),
    )
    for j, (k, _) in enumerate(running):
        points[k] = replace(points[k], wall=float(np.nanmedian(times[:, j])))
    return WorkPrecision(
        problem=problem.name,
        description=problem.about,
        joints=problem.system.m,
        duration=problem.start.duration,
        reference_error=truth.error,
        reference=truth.about,
        about={method.name: method.about for method in able},
        points=tuple(points),
        missing={name: line for name, line in missing.items() if line},
        run=run,
    )


def _first_runs(
    problem: Problem,
    truth: Reference,
    method: Solver,
    tolerances: Sequence[float] | None,
    effort: Effort,
) -> Iterator[tuple[Point, PreparedRun | None]]:
    """Yield the points of a method, judged but not timed, with what runs them again."""
    if tolerances is None or method.fixed:
        wanted = method.tolerances[:: effort.every]
    else:
        wanted = tuple(sorted(tolerances, reverse=True))
    slow = ""
    for tolerance in wanted:
        if slow:
            yield Point(method.name, tolerance, failure=slow), None
            continue
        try:
            prepared = method.prepare(problem, tolerance)
            found, took = _timed(prepared)
            if took > effort.patience:  # a first run may compile and load
                found, took = _timed(prepared)
            point = _judged(problem, truth, method.name, tolerance, prepared, found)
        except PinredError as error:
            yield Point(method.name, tolerance, failure=str(error)), None
            continue
        yield point, prepared
        if took > effort.patience:
            slow = f"not run: a coarser one took {took:.2g} s, and {effort.patience:g} s is all"


def _timed(prepared: PreparedRun) -> tuple[object, float]:
    began = time.perf_counter()
    found = prepared.run()
    return found, time.perf_counter() - began


def _judged(
    problem: Problem,
    truth: Reference,
    method: str,
    tolerance: float,
    prepared: PreparedRun,
    found: object,
) -> Point:
    """Return the point of a first run, without its time.  Raises IntegrationError."""
    end = prepared.end(found)
    if not all(np.isfinite(part).all() for part in (end.x, end.q, end.v)):
        raise IntegrationError("the end is not finite")
    apart = problem.full.distance(truth.end, FullMotion(x=end.x[None], q=end.q[None]))
    changed = compute_drift(problem, end.q, end.v)
    return Point(
        method=method,
        tolerance=tolerance,
        build=prepared.build,
        evaluations=end.evaluations,
        shape=float(apart.shape[0]),
        rotation=float(apart.rotation[0]),
        position=float(apart.position[0]),
        energy=changed.energy,
        momentum=changed.momentum,
    )
