"""Number of sequential evaluations that published methods need to reach a requested error.

Methods of SciPy and, if installed, of extensisq run over the compiled vector field, called from
Python; only evaluations are counted, not time. AdaptiveGauss evaluates eight stages at once, so its
sequential sweeps are counted. A sweep costs 1.9 evaluations for a chain, and more where identical
branches already use the SIMD lanes (see choose_method.py). DOP853 is also run with other error
norms: without the pose of the base, or with one scale for each kind of number (shape, momenta,
pose), its largest value over the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeAlias

import numpy as np
from scipy.integrate import solve_ivp

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError
from ...common.waiting import Progress, one_by_one
from ...integrators.methods import METHODS, AdaptiveGauss, Explicit
from ...judge.distances import FullMotion
from ...judge.reference_solution import FINEST
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...system.state_fields import with_base
from .problems import Problem, problems_named
from .solver import ATOL
from .timing import Tables

Tolerances: TypeAlias = tuple[float, float | Array]  # rtol and atol in SciPy's form
Norm: TypeAlias = Callable[[float], Tolerances]

FEW_SCENES = ("planar5", "satellite", "solo12", "talos")
ERRORS = (1e-4, 1e-6, 1e-8, 1e-10)
INSTALL = "pip install extensisq"
_WITHOUT_BASE = "DOP853, base left out"
_ONE_SCALE = "DOP853, a scale a kind"
_IGNORED = 1e30  # weight of the absolute tolerance that removes an entry from the error norm
_TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(4, 27))
_SCIPY = {
    "Dormand–Prince 5(4)": "RK45",
    "LSODA": "LSODA",
}
_EXTENSISQ = {
    "Tsitouras 5(4)": "Ts5",
    "Bogacki–Shampine 5(4)": "BS5",
    "Prince 7(6)": "Pr7",
    "Prince 8(7)": "Pr8",
    "Prince 9(8)": "Pr9",
}


@checks_arguments
@dataclass(frozen=True)
class Evaluations:
    """Number of evaluations that each method needs for each error on one problem.

    Attributes:
        problem: Name and description of the problem.
        counts: Method → evaluations for each error of ERRORS; NaN if it is not reached.
        missing: How to install further methods; "" if all ran.
    """

    problem: str
    counts: Mapping[str, tuple[float, ...]]
    missing: str = ""

    def tables(self) -> Tables:
        """Return a row of the csv file for each method and error."""
        rows: list[dict[str, object]] = [
            {"problem": self.problem, "method": name, "error": error, "evaluations": count}
            for name, counts in self.counts.items()
            for error, count in zip(ERRORS, counts, strict=True)
        ]
        return {"evaluations": rows}

    def __str__(self) -> str:
        width = max(map(len, self.counts))
        head = f"{'error':<{width}}" + "".join(f"{error:>9.0e}" for error in ERRORS)
        rows = [
            f"{name:<{width}}" + "".join("        —" if np.isnan(n) else f"{n:>9.0f}" for n in row)
            for name, row in self.counts.items()
        ]
        return "\n".join([self.problem, head, *rows, *([self.missing] if self.missing else [])])


@checks_arguments
def bench_evaluations(
    scenes: Sequence[str] = FEW_SCENES, *, progress: Progress | bool | None = None
) -> list[Evaluations]:
    """Count the evaluations that each method needs for each error, on each scene.

    Args:
        scenes: Names of scenes in SCENES; FEW_SCENES if empty.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each scene.
    Raises:
        InputError: Unknown scene.
    """
    problems, _ = problems_named(scenes or FEW_SCENES)
    return one_by_one(problems, _count_evaluations, progress, "evaluations")


def _count_evaluations(problem: Problem) -> Evaluations:
    truth = problem.full.run(problem.full_start(), problem.times, *FINEST)
    runs: dict[str, Callable[[float], tuple[float, float]]] = {
        name: partial(_run_explicit, problem, truth, kind)
        for name, kind in METHODS.items()
        if issubclass(kind, Explicit)
    }
    runs["AdaptiveGauss, sweeps"] = lambda tol: _run_pinred(
        problem, truth, AdaptiveGauss(tol, ATOL * tol), AdaptiveGauss.stages
    )
    published: dict[str, Any] = dict(_SCIPY)
    missing = "" if find_spec("extensisq") else f"more methods: {INSTALL}"
    if not missing:
        module = import_module("extensisq")
        published |= {name: getattr(module, kind) for name, kind in _EXTENSISQ.items()}
    for name, kind in published.items():
        runs[name] = partial(_run_scipy, problem, truth, kind, _standard_norm)
    runs[_WITHOUT_BASE] = partial(_run_scipy, problem, truth, "DOP853", _without_base(problem))
    runs[_ONE_SCALE] = partial(_run_scipy, problem, truth, "DOP853", _norm_by_kind(problem))
    counts = {
        name: _at_errors([run(tolerance) for tolerance in _TOLERANCES])
        for name, run in runs.items()
    }
    return Evaluations(f"{problem.name}: {problem.about}", counts, missing)


def _at_errors(points: list[tuple[float, float]]) -> tuple[float, ...]:
    """Return the fewest evaluations for each of ERRORS, from points (error, evaluations)."""
    return tuple(
        min((count for error, count in points if error <= target), default=np.nan)
        for target in ERRORS
    )


def _run_pinred(
    problem: Problem, truth: FullMotion, method: Any, stages: int
) -> tuple[float, float]:
    """Return the error and the number of sequential evaluations of a method of pinred."""
    from ...simulation.simulate import simulate

    traj = simulate(problem.scene(method=method))
    end = FullMotion(x=traj.x, q=traj.q)
    return problem.apart(truth, end), traj.run.evaluations / stages


def _run_explicit(
    problem: Problem, truth: FullMotion, kind: type[Explicit], tol: float
) -> tuple[float, float]:
    return _run_pinred(problem, truth, kind(*_standard_norm(tol)), 1)


def _standard_norm(tol: float) -> tuple[float, float]:
    return max(tol, 1e-13), ATOL * tol


def _without_base(problem: Problem) -> Norm:
    weights = np.ones(len(CompiledFlow.of_plan(plan_of(problem.scene())).y0))
    weights[2 * problem.system.m :] = _IGNORED
    return lambda tol: (max(tol, 1e-13), ATOL * tol * weights)


def _norm_by_kind(problem: Problem) -> Norm:
    flow = CompiledFlow.of_plan(plan_of(problem.scene()))
    largest = np.abs(_solve(flow, problem, "DOP853", 1e-6, 1e-8).y).max(axis=1)
    m = problem.system.m
    for kind in (slice(0, m), slice(m, 2 * m), slice(2 * m, None)):
        largest[kind] = largest[kind].max(initial=0.0)
    # The relative tolerance is the smallest that SciPy accepts without a warning.
    return lambda tol: (1e-13, tol * largest)


def _solve(
    flow: CompiledFlow, problem: Problem, kind: Any, rtol: float, atol: float | Array
) -> Any:
    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        return flow.kernel.evaluate_rate(y, flow.parameters)

    return solve_ivp(rate, (0.0, problem.start.duration), flow.y0, kind, rtol=rtol, atol=atol)


def _run_scipy(
    problem: Problem, truth: FullMotion, kind: Any, norm: Norm, tol: float
) -> tuple[float, float]:
    """Return the error and number of evaluations of a SciPy method; (inf, NaN) if it fails."""
    scene = problem.scene()
    flow = CompiledFlow.of_plan(plan_of(scene))
    try:
        solution = _solve(flow, problem, kind, *norm(tol))
    except (ValueError, InputError, IntegrationError):
        return np.inf, np.nan
    if not solution.success:
        return np.inf, np.nan
    y = solution.y[:, -1:].T
    states = with_base(flow.states(scene.report_times, y), problem.name)
    return problem.apart(truth, FullMotion(x=states.x, q=states.q)), float(solution.nfev)
