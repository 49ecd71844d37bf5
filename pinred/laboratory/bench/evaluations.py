"""Evaluations one after another that an error costs, by published methods of many kinds.

SciPy's and, if it is installed, extensisq's methods run over the compiled vector field, called
from Python; what counts is how often, not how long.  AdaptiveGauss evaluates eight stages at
once: what it needs one after another are sweeps, which cost 1.9 evaluations for a chain and
more where limbs are lanes already (see choose_method.py).  DOP853 is there with other
norms of the error, too: it leaves out the pose of the base, or gives each kind of number (shape,
momenta, pose) one scale, its largest over the motion.
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

from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError
from ...common.progress import Progress, one_by_one
from ...integrators.methods import METHODS, AdaptiveGauss, Explicit
from ...judge.distances import FullMotion
from ...judge.reference_solution import FINEST
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...system.state_fields import with_base
from .problems import Problem
from .scenes import problems_named
from .solver import ATOL

Tolerances: TypeAlias = tuple[float, float | Array]  # rtol and atol, as SciPy takes them
Norm: TypeAlias = Callable[[float], Tolerances]

FEW_SCENES = ("planar5", "satellite", "solo12", "talos")
ERRORS = (1e-4, 1e-6, 1e-8, 1e-10)
INSTALL = "pip install extensisq"
_OF_THE_BASE = "DOP853, base left out"
_OF_A_KIND = "DOP853, a scale a kind"
_NEVER = 1e30  # as a tolerance: what has it takes no part in the norm
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


@dataclass(frozen=True)
class Evaluations:
    """The cost of errors on one problem.  counts: method → evaluations for each of ERRORS."""

    problem: str
    counts: Mapping[str, tuple[float, ...]]
    missing: str = ""

    def __str__(self) -> str:
        width = max(map(len, self.counts))
        head = f"{'error':<{width}}" + "".join(f"{error:>9.0e}" for error in ERRORS)
        rows = [
            f"{name:<{width}}" + "".join("        —" if np.isnan(n) else f"{n:>9.0f}" for n in row)
            for name, row in self.counts.items()
        ]
        return "\n".join([self.problem, head, *rows, *([self.missing] if self.missing else [])])


def bench_evaluations(
    scenes: Sequence[str] = FEW_SCENES, *, progress: Progress | bool | None = None
) -> list[Evaluations]:
    """Return what errors cost on scenes, by their names.

    progress: as for `simulate`.  Raises InputError.
    """
    problems, _ = problems_named(scenes)
    return one_by_one(problems, _measured, progress, "evaluations")


def _measured(problem: Problem) -> Evaluations:
    truth = problem.full.run(problem.full_start(), problem.times, *FINEST)
    runs: dict[str, Callable[[float], tuple[float, float]]] = {
        name: partial(_explicit, problem, truth, kind)
        for name, kind in METHODS.items()
        if issubclass(kind, Explicit)
    }
    runs["AdaptiveGauss, sweeps"] = lambda tol: _own(
        problem, truth, AdaptiveGauss(tol, ATOL * tol), AdaptiveGauss.stages
    )
    others: dict[str, Any] = dict(_SCIPY)
    missing = "" if find_spec("extensisq") else f"more methods: {INSTALL}"
    if not missing:
        module = import_module("extensisq")
        others |= {name: getattr(module, kind) for name, kind in _EXTENSISQ.items()}
    for name, kind in others.items():
        runs[name] = partial(_other, problem, truth, kind, _own_norm)
    runs[_OF_THE_BASE] = partial(_other, problem, truth, "DOP853", _without_base(problem))
    runs[_OF_A_KIND] = partial(_other, problem, truth, "DOP853", _scale_a_kind(problem))
    counts = {
        name: _at_errors([run(tolerance) for tolerance in _TOLERANCES])
        for name, run in runs.items()
    }
    return Evaluations(f"{problem.name}: {problem.about}", counts, missing)


def _at_errors(points: list[tuple[float, float]]) -> tuple[float, ...]:
    """Return the evaluations at ERRORS of (error, evaluations), the least that reach each."""
    return tuple(
        min((count for error, count in points if error <= wanted), default=np.nan)
        for wanted in ERRORS
    )


def _own(problem: Problem, truth: FullMotion, method: Any, stages: int) -> tuple[float, float]:
    from ...simulation.simulate import simulate

    traj = simulate(problem.scene(method=method))
    end = FullMotion(x=traj.x, q=traj.q)
    return problem.apart(truth, end), traj.run.evaluations / stages


def _explicit(
    problem: Problem, truth: FullMotion, kind: type[Explicit], tol: float
) -> tuple[float, float]:
    return _own(problem, truth, kind(*_own_norm(tol)), 1)


def _own_norm(tol: float) -> tuple[float, float]:
    return max(tol, 1e-13), ATOL * tol


def _without_base(problem: Problem) -> Norm:
    weights = np.ones(len(CompiledFlow.of_plan(plan_of(problem.scene())).y0))
    weights[2 * problem.system.m :] = _NEVER
    return lambda tol: (max(tol, 1e-13), ATOL * tol * weights)


def _scale_a_kind(problem: Problem) -> Norm:
    flow = CompiledFlow.of_plan(plan_of(problem.scene()))
    largest = np.abs(_solve(flow, problem, "DOP853", 1e-6, 1e-8).y).max(axis=1)
    m = problem.system.m
    for kind in (slice(0, m), slice(m, 2 * m), slice(2 * m, None)):
        largest[kind] = largest[kind].max(initial=0.0)
    # The relative tolerance is as small as SciPy takes without a warning.
    return lambda tol: (1e-13, tol * largest)


def _solve(
    flow: CompiledFlow, problem: Problem, kind: Any, rtol: float, atol: float | Array
) -> Any:
    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        return flow.kernel.evaluate_rate(y, flow.parameters)

    return solve_ivp(rate, (0.0, problem.start.duration), flow.y0, kind, rtol=rtol, atol=atol)


def _other(
    problem: Problem, truth: FullMotion, kind: Any, norm: Norm, tol: float
) -> tuple[float, float]:
    scene = problem.scene()
    flow = CompiledFlow.of_plan(plan_of(scene))
    try:
        found = _solve(flow, problem, kind, *norm(tol))
    except (ValueError, InputError, IntegrationError):
        return np.inf, np.nan
    if not found.success:
        return np.inf, np.nan
    y = found.y[:, -1:].T
    states = with_base(flow.states(scene.report_times, y), problem.name)
    return problem.apart(truth, FullMotion(x=states.x, q=states.q)), float(found.nfev)
