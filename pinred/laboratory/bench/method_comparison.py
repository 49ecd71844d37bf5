"""Comparison of integration methods: evaluations for an error, and the choice of the method.

Methods of SciPy and, if installed, of extensisq run over the compiled vector field, called from
Python; only evaluations are counted, not time. AdaptiveGauss evaluates eight stages at once, so its
sequential sweeps are counted. A sweep costs 1.9 evaluations for a chain, and more where identical
branches already use the SIMD lanes (see choose_method.py). DOP853 is also run with other error
norms: without the pose of the base, or with one scale for each kind of number (shape, momenta,
pose), its largest value over the motion.

For the choice, each candidate integrates each scene with the scene's tolerance. The error is the
largest difference of the final reduced state from that of a method with a much smaller tolerance.
Among the scenes are random robots with springs, dampers and held joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from time import process_time
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only
from ...common.errors import InputError, IntegrationError, PinredError
from ...common.waiting import Progress, one_by_one
from ...forces.force import Force
from ...forces.kinds import PD, Damper, Spring
from ...integrators.methods import METHODS, AdaptiveGauss, Explicit, Method
from ...integrators.methods.method import ATOL as DEFAULT_ATOL
from ...integrators.methods.method import RTOL
from ...judge.reference_solution import FINEST
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.compiled.integrator import integrator
from ...simulation.plan import Plan, plan_of
from ...simulation.simulate import simulate
from ...system.system import System
from .problems import ATOL, SCENES, End, Link, Problem, build_tree, problems_named
from .timing import Table, alternating, repeated

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
        name: _by_pinred(problem, partial(_explicit, method))
        for name, method in METHODS.items()
        if issubclass(method, Explicit)
    }
    runs["AdaptiveGauss, sweeps"] = _by_pinred(
        problem, lambda tol: AdaptiveGauss(tol, ATOL * tol), AdaptiveGauss.stages
    )
    published: dict[str, Any] = dict(_SCIPY)
    notes = () if find_spec("extensisq") else (f"more methods: {INSTALL}",)
    if not notes:
        module = import_module("extensisq")
        published |= {name: getattr(module, method) for name, method in _EXTENSISQ.items()}
    runs |= {name: _by_scipy(problem, method) for name, method in published.items()}
    runs[_WITHOUT_BASE] = _by_scipy(problem, "DOP853", _without_base(problem))
    runs[_ONE_SCALE] = _by_scipy(problem, "DOP853", _norm_by_kind(problem))
    table_rows = []
    for name, run in runs.items():
        ends = [end for tolerance in _TOLERANCES if (end := run(tolerance)) is not None]
        points = [(problem.apart(truth, end.motion), end.evaluations) for end in ends]
        counts = {
            f"{target:.0e}": min((n for error, n in points if error <= target), default=np.nan)
            for target in ERRORS
        }
        table_rows.append(SimpleNamespace(method=name, **counts))
    title = f"{problem.name}: {problem.about}"
    shared = {"problem": problem.name}
    return Table("evaluations", tuple(table_rows), title=title, notes=notes, shared=shared)


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
    for entries in (slice(0, m), slice(m, 2 * m), slice(2 * m, None)):
        largest[entries] = largest[entries].max(initial=0.0)
    # The relative tolerance is the smallest that SciPy accepts without a warning.
    return lambda tol: (1e-13, tol * largest)


def _solve(problem: Problem, kind: Any, rtol: float, atol: float | Array) -> Any:
    flow = problem.flow

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        return flow.kernel.evaluate_rate(y, flow.parameters)

    return solve_ivp(rate, (0.0, problem.start.duration), flow.y0, kind, rtol=rtol, atol=atol)


CANDIDATES = ("DOP853", "Tsit5", "AdaptiveGauss", "Radau")  # methods that pinred may choose
GOOD, WORST = 1.3, 3.0  # requested ratio of most scenes, and of all scenes
HELD_ROBOTS = 200  # default number of random robots
_ROUNDS = 5
_SPAN = 2e-3  # least duration of a timed loop [s]
_PATIENCE = 3.0  # longest run of a method [s]
_TIGHTER = 1e-4  # tolerance of the reference divided by that of the scene


class _TooSlowError(Exception):
    """A method needs more time than _PATIENCE."""


@checks_arguments
def bench_methods(
    scenes: Sequence[str] | None = None,
    *,
    held: int = HELD_ROBOTS,
    progress: Progress | bool | None = None,
) -> Table:
    """Time all methods on bench scenes, bundled robots and random robots with held joints.

    Args:
        scenes: Names in SCENES; all scenes of up to 20 joints if None or empty.
        held: Number of random robots with springs, dampers and held joints.
        progress: As in `simulate`.
    Returns:
        A row for each scene with a reference: the method that pinred chooses; the ratio of its time
        to that of the fastest method that is at least as accurate; for each method, the CPU time of
        an integration [s], infinite if the method fails or is too slow, and the largest error of
        the final reduced state.
    """
    cases = list(_cases(scenes or None, held))
    comparisons = one_by_one(cases, lambda case: measure(*case), progress, "methods")
    rows = tuple(row for row in comparisons if row is not None)
    ratios = np.array([row.ratio for row in rows])
    share = 100.0 * float((ratios <= GOOD).mean())
    note = (
        f"{share:.1f} % of {len(ratios)} scenes within {GOOD:g} times the fastest method that "
        f"is at least as accurate; largest ratio {ratios.max():.2f} (bars: 95 %, {WORST:g})"
    )
    units = {f"{name} cpu": "s" for name in CANDIDATES}
    return Table("methods", rows, units, notes=(note,))


def _cases(names: Sequence[str] | None, held: int) -> Iterator[tuple[str, Scene]]:
    """Yield the names and scenes to measure."""
    problems, _ = problems_named(list(SCENES) if names is None else names)
    for problem in problems:
        if names is not None or problem.system.m <= 20:
            yield problem.name, problem.scene()
    for seed in range(held):
        yield f"held robot {seed}", held_robot(seed)


def measure(name: str, scene: Scene) -> SimpleNamespace | None:
    """Return times and errors of all methods for a scene; None without a reference.

    Args:
        name: Name of the scene in the table.
        scene: The scene, which requests no method.
    Returns:
        The row of the table.
    """
    plans = {method: plan_of(replace(scene, method=method)) for method in CANDIDATES}
    times: dict[str, float] = dict.fromkeys(CANDIDATES, np.inf)
    ends: dict[str, Array] = {}
    for method, plan in plans.items():
        try:
            ends[method], times[method] = _run(plan, _ROUNDS)
        except (PinredError, _TooSlowError):
            continue
    try:
        reference = _reference(scene, min(ends, key=lambda method: times[method]))
    except (PinredError, _TooSlowError, ValueError):
        return None
    errors = dict.fromkeys(CANDIDATES, np.inf)
    for method, end in ends.items():
        errors[method] = float(np.max(np.abs(end - reference) / (1.0 + np.abs(reference))))
    return choice_of(name, plan_of(scene).method.name, times, errors)


def choice_of(
    scene: str, chosen: str, cpu: Mapping[str, float], error: Mapping[str, float]
) -> SimpleNamespace:
    """Compare the chosen method with the fastest one that is at least as accurate.

    Args:
        scene: Name of the scene.
        chosen: Name of the chosen method.
        cpu: CPU time by method [s].
        error: Error by method.
    Returns:
        The row of the table.
    """
    best = min((name for name in cpu if error[name] <= error[chosen]), key=lambda name: cpu[name])
    numbers: dict[str, float] = {}
    for name in cpu:
        numbers |= {f"{name} cpu": cpu[name], f"{name} error": error[name]}
    return SimpleNamespace(scene=scene, chosen=chosen, ratio=cpu[chosen] / cpu[best], **numbers)


def _reference(scene: Scene, fastest: str) -> Array:
    """Return an accurate final state, by the method that is the fastest at the own tolerance."""
    rtol, atol = max(1e-13, _TIGHTER * RTOL), _TIGHTER * DEFAULT_ATOL
    return _run(plan_of(replace(scene, method=fastest, rtol=rtol, atol=atol)), 0)[0]


def _run(plan: Plan, rounds: int) -> tuple[Array, float]:
    """Return the final state, (k,), and the least CPU time of an integration [s]."""
    flow = CompiledFlow.of_plan(plan)
    parameters, began = read_only(flow.parameters.copy()), np.inf

    def watch(_: float) -> None:
        if process_time() - began > _PATIENCE:
            raise _TooSlowError

    once, end = integrator(flow, plan, watch), plan.scene.end
    once(0.0, 1e-9 * end, flow.y0, parameters)  # compiles the method and the kernel's derivative
    began = process_time()
    solution = once(0.0, end, flow.y0, parameters)
    first = process_time() - began
    run = partial(integrator(flow, plan, None), 0.0, end, flow.y0, parameters)
    if 0.0 < rounds * first < _PATIENCE:
        times = alternating([repeated(run)], rounds=rounds, span=_SPAN, clock=process_time)
        first = min(first, float(times.min()))
    return solution.at(np.array([end]))[0], first


_ROOTS = (pin.JointModelPlanar, pin.JointModelFreeFlyer)
_JOINTS = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
_MOST_JOINTS = 8
_DURATION = 2.0  # [s]
_STIFFNESS = (-1.0, 4.0)  # decimal exponents of stiffnesses [N·m/rad]
_RATIO = (-3.0, 0.5)  # decimal exponents of damping divided by stiffness [s]


def held_robot(seed: int) -> Scene:
    """Return a random robot from a random initial state, with forces at most of its joints.

    Args:
        seed: Seed of the robot, its forces and its initial state.
    Returns:
        The scene, which reports its end only.
    """
    rng = np.random.default_rng(seed)
    system = _tree(rng, seed)
    forces: list[Force] = []
    for name in system.shape_names:
        stiffness = float(10.0 ** rng.uniform(*_STIFFNESS))
        damping = stiffness * float(10.0 ** rng.uniform(*_RATIO))
        choice = rng.integers(4)
        if choice == 0:
            forces.append(Spring(name, stiffness, 0.1))
        elif choice == 1:
            forces.append(Damper(name, damping))
        elif choice == 2:
            forces.append(PD({name: float(rng.uniform(-0.5, 0.5))}, stiffness, damping))
    x0, xdot0 = rng.normal(scale=(0.3, 1.0), size=(system.m, 2)).T
    xi0 = rng.normal(scale=0.3, size=system.r)
    return Scene(system=system, x0=x0, xdot0=xdot0, xi0=xi0, times=[_DURATION], forces=forces)


def _tree(rng: np.random.Generator, seed: int) -> System:
    """Return a random tree of 1 to _MOST_JOINTS hinges on a free base."""
    planar = rng.random() < 0.3
    links: list[Link] = [(_ROOTS[not planar](), np.zeros(3), _body(rng, 5.0))]
    parents = [-1]
    for _ in range(int(rng.integers(1, _MOST_JOINTS + 1))):
        joint = _JOINTS[2 if planar else int(rng.integers(3))]()
        lever = rng.uniform(-0.4, 0.4, 3) * ([1.0, 1.0, 0.0] if planar else [1.0, 1.0, 1.0])
        last = len(links) - 1
        parents.append(last if rng.random() < 0.7 else int(rng.integers(len(links))))
        links.append((joint, lever, _body(rng, 1.0)))
    return build_tree(f"held{seed}", links, parents)


def _body(rng: np.random.Generator, scale: float) -> pin.Inertia:
    """Return a random box whose mass is about `scale` [kg]."""
    mass, sides = scale * float(rng.uniform(0.5, 2.0)), rng.uniform(0.1, 0.5, 3)
    moments = mass / 12.0 * (sides @ sides - sides**2)
    return pin.Inertia(mass, rng.uniform(-0.1, 0.1, 3) * [1.0, 1.0, 0.0], np.diag(moments))
