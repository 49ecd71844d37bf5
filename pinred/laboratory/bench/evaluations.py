"""Number of sequential evaluations that published methods need to reach a requested error.

Methods of SciPy and, if installed, of extensisq run over the compiled vector field, called from
Python; only evaluations are counted, not time. AdaptiveGauss evaluates eight stages at once, so its
sequential sweeps are counted. A sweep costs 1.9 evaluations for a chain, and more where identical
branches already use the SIMD lanes (see choose_method.py). DOP853 is also run with other error
norms: without the pose of the base, or with one scale for each kind of number (shape, momenta,
pose), its largest value over the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
from scipy.integrate import solve_ivp

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError
from ...common.waiting import Progress, one_by_one
from ...integrators.methods import METHODS, AdaptiveGauss, Explicit, Method
from ...judge.reference_solution import FINEST
from ...simulation.simulate import simulate
from .problems import Problem, problems_named
from .solver import ATOL, End
from .timing import Table

Norm: TypeAlias = Callable[[float], tuple[float, float | Array]]  # tolerance → rtol and atol
Run: TypeAlias = Callable[[float], End | None]  # tolerance → final state; None if the method fails

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
def bench_evaluations(
    scenes: Sequence[str] = FEW_SCENES, *, progress: Progress | bool | None = None
) -> list[Table]:
    """Count the evaluations that each method needs for each error, on each scene.

    Args:
        scenes: Names of scenes in SCENES; FEW_SCENES if empty.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A table for each scene, with a row for each method: the evaluations for each of ERRORS; NaN
        if it is not reached.
    Raises:
        InputError: Unknown scene.
    """
    problems, _ = problems_named(scenes or FEW_SCENES)
    return one_by_one(problems, _count_evaluations, progress, "evaluations")


def _count_evaluations(problem: Problem) -> Table:
    truth = problem.full.run(problem.full_start(), problem.times, *FINEST)
    runs: dict[str, Run] = {
        name: _by_pinred(problem, partial(_explicit, kind))
        for name, kind in METHODS.items()
        if issubclass(kind, Explicit)
    }
    runs["AdaptiveGauss, sweeps"] = _by_pinred(
        problem, lambda tol: AdaptiveGauss(tol, ATOL * tol), AdaptiveGauss.stages
    )
    published: dict[str, Any] = dict(_SCIPY)
    notes = () if find_spec("extensisq") else (f"more methods: {INSTALL}",)
    if not notes:
        module = import_module("extensisq")
        published |= {name: getattr(module, kind) for name, kind in _EXTENSISQ.items()}
    runs |= {name: _by_scipy(problem, kind) for name, kind in published.items()}
    runs[_WITHOUT_BASE] = _by_scipy(problem, "DOP853", _without_base(problem))
    runs[_ONE_SCALE] = _by_scipy(problem, "DOP853", _norm_by_kind(problem))
    rows = []
    for name, run in runs.items():
        ends = [end for tolerance in _TOLERANCES if (end := run(tolerance)) is not None]
        points = [(problem.apart(truth, end.motion), end.evaluations) for end in ends]
        counts = {
            f"{target:.0e}": min((n for error, n in points if error <= target), default=np.nan)
            for target in ERRORS
        }
        rows.append(SimpleNamespace(method=name, **counts))
    title = f"{problem.name}: {problem.about}"
    shared = {"problem": problem.name}
    return Table("evaluations", tuple(rows), title=title, notes=notes, shared=shared)


def _by_pinred(problem: Problem, make: Callable[[float], Method], stages: int = 1) -> Run:
    """Return runs of a method of pinred, whose stages are evaluated at once."""

    def run(tol: float) -> End:
        traj = simulate(problem.scene(method=make(tol)))
        return problem.end_of(traj.states, traj.run.evaluations / stages)

    return run


def _by_scipy(problem: Problem, kind: Any, norm: Norm | None = None) -> Run:
    """Return runs of a method of SciPy with an error norm."""

    def run(tol: float) -> End | None:
        try:
            solution = _solve(problem, kind, *(norm or _standard_norm)(tol))
        except (ValueError, InputError, IntegrationError):
            return None
        return problem.end(solution.y[:, -1], solution.nfev) if solution.success else None

    return run


def _explicit(kind: type[Explicit], tol: float) -> Explicit:
    return kind(*_standard_norm(tol))


def _standard_norm(tol: float) -> tuple[float, float]:
    return max(tol, 1e-13), ATOL * tol


def _without_base(problem: Problem) -> Norm:
    weights = np.ones(len(problem.flow.y0))
    weights[2 * problem.system.m :] = _IGNORED
    return lambda tol: (max(tol, 1e-13), ATOL * tol * weights)


def _norm_by_kind(problem: Problem) -> Norm:
    largest = np.abs(_solve(problem, "DOP853", 1e-6, 1e-8).y).max(axis=1)
    m = problem.system.m
    for kind in (slice(0, m), slice(m, 2 * m), slice(2 * m, None)):
        largest[kind] = largest[kind].max(initial=0.0)
    # The relative tolerance is the smallest that SciPy accepts without a warning.
    return lambda tol: (1e-13, tol * largest)


def _solve(problem: Problem, kind: Any, rtol: float, atol: float | Array) -> Any:
    flow = problem.flow

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        return flow.kernel.evaluate_rate(y, flow.parameters)

    return solve_ivp(rate, (0.0, problem.start.duration), flow.y0, kind, rtol=rtol, atol=atol)
