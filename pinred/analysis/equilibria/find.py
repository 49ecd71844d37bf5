"""relative_equilibria(): find the steady motions of a robot at a momentum, and their stability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, whole
from ...common.errors import InputError
from ...forces.force import Force
from ...forces.signals import Signal
from ...reduction.inertia_split import mass_matrix
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...system.system import System, checked_system
from ..stability.linearisation import linearised
from ..stability.second_variation import second_variation
from ..stability.stability_verdict import Stability, assess_stability
from .amended_energy import AmendedEnergy, Energies, Points
from .equilibrium_problem import Problem, finite, problem_of
from .relative_equilibrium import Equilibria, RelativeEquilibrium, pose_of
from .same_shape import Place, place_of
from .search import critical_points, minima, polished, residuals, starting_points

MANY_JOINTS = 6  # number of active joints from which only the minimum is guaranteed
_STARTS = {True: 100, False: 1000}  # number of starts: {whether there are many joints: starts}
_MINIMISATIONS = 24  # number of starts from which the energy is also minimised
_ROUND_OFF = 1e-14  # angles [rad] and direction components below this are set to zero
_SAME_ENERGY = 1e-8  # largest relative difference of energies within one family


@checks_arguments
def relative_equilibria(
    system: System,
    *,
    momentum: float,
    cyclic: Mapping[str, float] | None = None,
    starts: int | None = None,
    seed: int = 0,
    springs: Mapping[str, tuple[float, float]] | None = None,
    forces: Sequence[Force] | Force = (),
    prescribed: Mapping[str, Signal | float | str] | None = None,
    passive: bool = False,
) -> Equilibria:
    """Search the relative equilibria at a momentum, sorted by amended potential.

    Shapes that differ only in their coordinates count once, and so does a family of equilibria. The
    search starts from random and symmetric points and can miss equilibria. With six or more moving
    joints, only the minimum and the residuals are guaranteed.

    Args:
        system: The system.
        momentum: J = |J| in space [N·m·s]; signed where there is one axis (ℝ: [N·s], SO(2), SE(2),
            ℝ × SE(2)); about the upward vertical where gravity rotates a pivoted base. The linear
            momentum is zero in the frame of the centre of mass.
        cyclic: Momenta π of cyclic joints by name; others are zero.
        starts: Number of starts of Newton's method; 1000, or 100 with six or more moving joints.
        seed: Seed of the starts.
        springs: Springs, as in Scene.
        forces: Forces with a potential.
        prescribed: Joints with a constant value, or cyclic joints with a constant rate.
        passive: Whether the springs in the robot's file act.
    Returns:
        The equilibria, with the number of starts and of converged starts.
    Raises:
        InputError: An argument is invalid, or every shape is an equilibrium.
        SymmetryError: Gravity breaks the symmetry.
    """
    problem = problem_of(
        checked_system(system, "relative_equilibria"), cyclic=cyclic, springs=springs,
        forces=forces, prescribed=prescribed, passive=passive,
    )  # fmt: skip
    J = finite(momentum, "momentum")
    if problem.directional and J < 0.0:
        raise InputError(f"momentum: expected a magnitude |J| of at least 0, got {J:g}")
    if problem.kind == "free" and J == 0.0:
        problem = problem.at_rest()
    many = len(problem.active) >= MANY_JOINTS
    count = _STARTS[many] if starts is None else whole(starts, "starts")
    points, converged, total = search_points(problem, J, count, whole(seed, "seed", 0))
    entries = tuple(equilibrium_at(problem, points[k : k + 1], J) for k in range(len(points)))
    return Equilibria(problem.system, J, total, converged, _without_copies(entries))


def search_points(problem: Problem, J: float, count: int, seed: int) -> tuple[Points, int, int]:
    """Search the critical points of a problem.

    Args:
        problem: The problem.
        J: Momentum.
        count: Number of starts of Newton's method.
        seed: Seed of the starts.
    Returns:
        The distinct critical points, the number of converged starts, and the number of starts.
    Raises:
        InputError: Every shape is an equilibrium.
    """
    energy, rng = AmendedEnergy(problem), np.random.default_rng(seed)
    initial = starting_points(problem, count, rng)
    e = energy(initial, J)
    if problem.unknowns and not (e.scale > 0.0).any():
        raise InputError(
            "without momentum and potential every shape is an equilibrium. Give a momentum, or "
            "momenta of cyclic joints"
        )
    searches = [critical_points(energy, initial, J)]
    if problem.unknowns:
        minimised = initial[-min(_MINIMISATIONS, len(initial)) :]
        searches.append(minima(energy, minimised, J))
    points = Points(*(np.concatenate([getattr(p, n) for p, _ in searches]) for n in ("x", "n")))
    points, e = polished(energy, points, J)
    converged = len(searches[0][0]) + (len(searches[1][0]) if len(searches) > 1 else 0)
    tried = len(initial) + (min(_MINIMISATIONS, len(initial)) if len(searches) > 1 else 0)
    points = _tidy(problem, points)
    distinct = _distinct(problem, points, e)
    return points[distinct], converged, tried


def equilibrium_at(problem: Problem, point: Points, J: float) -> RelativeEquilibrium:
    """Compute the relative equilibrium at a critical point.

    Args:
        problem: The problem.
        point: One critical point, of length one.
        J: Momentum.
    Returns:
        The equilibrium with its stability.
    """
    system, r = problem.system, problem.system.r
    energy = AmendedEnergy(problem)
    e = energy(point, J)
    x, eta = problem.shapes(point.x)[0], e.rates[0]
    heavy = problem.kind == "heavy"
    xi = eta[0] * point.n[0] if heavy else eta[:r]
    xdot = problem.rates(eta[1:] if heavy else eta[r:])
    H = mass_matrix(system, x)
    v = np.concatenate([xi, xdot])
    undriven = v.copy()
    undriven[r + np.array(problem.driven, dtype=np.intp)] = 0.0
    driven = v - undriven
    kinetic = 0.5 * float(v @ H @ v)
    amended = 0.5 * float(undriven @ H @ undriven - driven @ H @ driven)
    U = float(e.U[0])
    return RelativeEquilibrium(
        system=system,
        x=x,
        xdot=xdot,
        xi=xi.copy(),
        mu=H[:r] @ v,
        direction=point.n[0].copy(),
        momentum=J,
        amended_potential=U,
        energy=U - amended + kinetic,
        residual=float(residuals(e)[0]),
        stability=_stability(problem, energy, point, J, xdot, xi),
        problem=problem,
    )


def _stability(
    problem: Problem, energy: AmendedEnergy, point: Points, J: float, xdot: Array, xi: Array
) -> Stability:
    second = second_variation(energy, point, J)
    flow = flow_at(problem, point, xdot, xi)
    linear = linearised(flow, flow.y0)
    return assess_stability(linear, second, flow.kernel.layout.active, problem.system.shape_names)


def flow_at(problem: Problem, point: Points, xdot: Array, xi: Array) -> CompiledFlow:
    """Compile the flow that starts at a point with given velocities.

    Args:
        problem: The problem.
        point: One point, of length one.
        xdot: Shape rates, (m,).
        xi: Body twist, (r,).
    Returns:
        The flow.
    """
    from dataclasses import replace

    scene = replace(
        problem.scene, x0=problem.shapes(point.x)[0], xdot0=xdot, xi0=xi,
        pose0=pose_of(problem, point.n[0]),
    )  # fmt: skip
    return CompiledFlow.of_plan(plan_of(scene))


def _tidy(problem: Problem, points: Points) -> Points:
    """Wrap angles to (−π, π] if only the inertia depends on them, not a spring or force."""
    touched = problem.forces.touched if problem.forces is not None else set()
    x = points.x.copy()
    for i, k in enumerate(problem.active):
        if problem.system.units[k] == "rad" and k not in touched and _periodic(problem, k):
            x[:, i] -= 2.0 * np.pi * np.ceil(x[:, i] / (2.0 * np.pi) - 0.5 - 1e-12)
            x[np.abs(x[:, i]) < _ROUND_OFF, i] = 0.0
    n = np.where(np.abs(points.n) < _ROUND_OFF, 0.0, points.n)
    return Points(x, n)


def _periodic(problem: Problem, k: int) -> bool:
    """Return whether a full turn of a joint and its followers restores all body poses."""
    coupled = problem.system.coupled
    if coupled is None:
        return True
    ratios = coupled.G[:, k]
    return bool((ratios == np.round(ratios)).all())


def _distinct(problem: Problem, points: Points, e: Energies) -> list[int]:
    """Return the indices of points with distinct shapes, sorted by energy."""
    # Among equal shapes, keep the one with the smallest angles.
    size = np.round(np.linalg.norm(points.x, axis=1), 9)
    levels = np.round(e.U / max(float(e.scale.max(initial=0.0)), 1e-300), 10)
    order = np.lexsort((residuals(e), size, levels))
    coordinates = np.round(np.concatenate([points.x, points.n], axis=1)[order], 6)
    _, first = np.unique(
        coordinates, axis=0, return_index=True
    )  # equal shapes usually have equal coordinates
    places: list[tuple[float, Place]] = []
    distinct: list[int] = []
    for k in order[np.sort(first)].tolist():
        place = place_of(problem, problem.shapes(points.x[k : k + 1])[0], points.n[k])
        near = _SAME_ENERGY * float(e.scale[k])
        if any(
            abs(U - e.U[k]) <= near and place.same(other, reversible=problem.reversible)
            for U, other in places
        ):
            continue
        places.append((float(e.U[k]), place))
        distinct.append(k)
    return distinct


def _without_copies(entries: tuple[RelativeEquilibrium, ...]) -> tuple[RelativeEquilibrium, ...]:
    """Keep one equilibrium per family; members of a family have equal energy and index."""
    unique: list[RelativeEquilibrium] = []
    for entry in entries:
        if entry.dimension and any(_one_family(entry, other) for other in unique):
            continue
        unique.append(entry)
    return tuple(unique)


def _one_family(a: RelativeEquilibrium, b: RelativeEquilibrium) -> bool:
    if a.dimension != b.dimension or a.stability.index != b.stability.index:
        return False
    size = max(abs(a.energy), abs(a.amended_potential), 1e-300)
    return abs(a.amended_potential - b.amended_potential) <= _SAME_ENERGY * size
