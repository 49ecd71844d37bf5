"""Measure the choice of the integrator: `python tests/helpers/method_study.py [NUMBER]`.

Each candidate integrates each scene of the benchmarks with up to 20 joints, and NUMBER (by default
200) random robots with springs, dampers and held joints, with the scene's tolerance. The error is
the largest difference of the final reduced state from that of a method with a much smaller
tolerance.
A short form is part of the suite (tests/simulation/test_choose_method.py).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import process_time
from types import SimpleNamespace

import numpy as np
import pinocchio as pin

from pinred import Scene, System
from pinred.common.arrays import Array, read_only
from pinred.common.errors import PinredError
from pinred.common.waiting import one_by_one
from pinred.forces import PD, Damper, Force, Spring
from pinred.integrators.methods.method import ATOL as DEFAULT_ATOL
from pinred.integrators.methods.method import RTOL
from pinred.laboratory.bench.problems import SCENES, Link, build_tree, problems_named
from pinred.laboratory.bench.timing import Table, alternating, repeated
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.compiled.integrator import integrator
from pinred.simulation.plan import Plan, plan_of

CANDIDATES = ("DOP853", "Tsit5", "AdaptiveGauss", "Radau")  # methods that pinred may choose
GOOD, WORST = 1.3, 3.0  # requested ratio of most scenes, and of all scenes
_ROUNDS = 5
_SPAN = 2e-3  # least duration of a timed loop [s]
_PATIENCE = 3.0  # longest run of a method [s]
_TIGHTER = 1e-4  # tolerance of the reference divided by that of the scene


class _TooSlowError(Exception):
    """A method needs more time than _PATIENCE."""


def compare_methods(scenes: Sequence[str] | None, held: int) -> Table:
    """Time all methods on bench scenes, bundled robots and random robots with held joints.

    Args:
        scenes: Names in SCENES; all scenes of up to 20 joints if None.
        held: Number of random robots with springs, dampers and held joints.
    Returns:
        A row for each scene with a reference: the method that pinred chooses; the ratio of its time
        to that of the fastest method that is at least as accurate; for each method, the CPU time of
        an integration [s], infinite if the method fails or is too slow, and the largest error of
        the final reduced state.
    """
    cases = list(_cases(scenes, held))
    comparisons = one_by_one(cases, lambda case: measure(*case), True, "methods")
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


if __name__ == "__main__":
    print(compare_methods(None, int(sys.argv[1]) if len(sys.argv) > 1 else 200))
