"""relative_equilibria(): the steady motions of a robot at a momentum, with their stability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...forces.force import Force
from ...forces.signals import Signal
from ...reduction.inertia_split import mass_matrix
from ...scene.option_checks import check_seed
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...system.system import System, checked_system
from ..stability.linearised import linearised
from ..stability.second_variation import second_variation
from ..stability.verdict import Stability, judge
from .amended_energy import AmendedEnergy, Energies, Points
from .problem import Problem, finite, problem_of
from .relative_equilibrium import Equilibria, RelativeEquilibrium, pose_of
from .same_shape import Place, place_of
from .search import critical_points, minima, polished, residuals, starting_points

MANY_JOINTS = 6  # active ones, from which on all that is promised is the minimum
_STARTS = {True: 100, False: 1000}  # with many joints, and with few
_MINIMISATIONS = 24
_ROUND_OFF = 1e-14  # rad, and of a direction; less is none
_SAME_ENERGY = 1e-8  # of the size of the energies, within one family


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
    """Return the relative equilibria found at a momentum, least amended potential first.

    momentum: J = |J| in space [N·m·s], its signed value where there is one axis (ℝ: [N·s], SO(2),
    SE(2), ℝ × SE(2)), about the upward vertical where gravity turns a pivoted base.  Linear
    momentum is zero in the frame of the centre of mass.  cyclic: {joint: momentum} of cyclic joints
    (π, which is constant), the others zero.  starts: how many random and symmetric points Newton's
    method starts from (1000; 100 from six joints on); minimisations go with them.  seed: of them.
    springs, forces, prescribed, passive: as of Scene; forces must have a potential, and prescribed
    joints stand still, or turn at a constant rate where nothing depends on their angle.

    Each shape counts once, whatever its coordinates, and each family of equilibria too.  Where six
    joints and more move, only the minimum and the residuals are promised: found, not all.
    Raises InputError for what makes no sense, SymmetryError if gravity breaks the symmetry.
    """
    problem = problem_of(
        checked_system(system, "relative_equilibria"), cyclic=cyclic, springs=springs,
        forces=forces, prescribed=prescribed, passive=passive,
    )  # fmt: skip
    J = finite(momentum, "momentum")
    if problem.directional and J < 0.0:
        raise InputError(f"momentum is |J|, which is not negative, got {J:g}")
    if problem.kind == "free" and J == 0.0:
        problem = problem.at_rest()
    many = len(problem.active) >= MANY_JOINTS
    count = _STARTS[many] if starts is None else checked_starts(starts)
    points, arrived, tried = found_points(problem, J, count, check_seed(seed))
    entries = tuple(equilibrium_at(problem, points[k : k + 1], J) for k in range(len(points)))
    return Equilibria(problem.system, J, tried, arrived, _without_copies(entries))


def checked_starts(starts: int) -> int:
    """Return a number of starts.  Raises InputError unless it is a whole number from 1."""
    if isinstance(starts, bool) or not (isinstance(starts, (int, np.integer)) and starts > 0):
        raise InputError(f"starts must be a whole number from 1, got {starts!r}")
    return int(starts)


def found_points(problem: Problem, J: float, count: int, seed: int) -> tuple[Points, int, int]:
    """Return the critical points found, each once, how many starts arrived, and of how many.

    Raises InputError where every shape is an equilibrium.
    """
    energy, rng = AmendedEnergy(problem), np.random.default_rng(seed)
    first = starting_points(problem, count, rng)
    e = energy(first, J)
    if problem.unknowns and not (e.scale > 0.0).any():
        raise InputError(
            "without momentum and potential every shape is an equilibrium; give a momentum, or "
            "momenta of cyclic joints"
        )
    found = [critical_points(energy, first, J)]
    if problem.unknowns:
        last = first[-min(_MINIMISATIONS, len(first)) :]
        found.append(minima(energy, last, J))
    points = Points(*(np.concatenate([getattr(p, n) for p, _ in found]) for n in ("x", "n")))
    points, e = polished(energy, points, J)
    arrived = len(found[0][0]) + (len(found[1][0]) if len(found) > 1 else 0)
    tried = len(first) + (min(_MINIMISATIONS, len(first)) if len(found) > 1 else 0)
    points = _tidy(problem, points)
    kept = _distinct(problem, points, e)
    return points[kept], arrived, tried


def equilibrium_at(problem: Problem, point: Points, J: float) -> RelativeEquilibrium:
    """Return the relative equilibrium at a critical point, a Points of length one."""
    system, r = problem.system, problem.system.r
    energy = AmendedEnergy(problem)
    e = energy(point, J)
    x, eta = problem.shapes(point.x)[0], e.rates[0]
    heavy = problem.kind == "heavy"
    xi = eta[0] * point.n[0] if heavy else eta[:r]
    xdot = problem.rates(eta[1:] if heavy else eta[r:])
    H = mass_matrix(system, x)
    v = np.concatenate([xi, xdot])
    own = v.copy()
    own[r + np.array(problem.driven, dtype=np.intp)] = 0.0
    rest = v - own
    kinetic = 0.5 * float(v @ H @ v)
    amended = 0.5 * float(own @ H @ own - rest @ H @ rest)
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
    return judge(linear, second, flow.kernel.layout.active, problem.system.shape_names)


def flow_at(problem: Problem, point: Points, xdot: Array, xi: Array) -> CompiledFlow:
    """Return the compiled flow that begins at a point with these velocities."""
    from dataclasses import replace

    scene = replace(
        problem.scene, x0=problem.shapes(point.x)[0], xdot0=xdot, xi0=xi,
        pose0=pose_of(problem, point.n[0]),
    )  # fmt: skip
    return CompiledFlow.of_plan(plan_of(scene))


def _tidy(problem: Problem, points: Points) -> Points:
    """Return points with angles in (−π, π] where nothing but the inertia sees them."""
    touched = problem.forces.touched if problem.forces is not None else set()
    x = points.x.copy()
    for i, k in enumerate(problem.active):
        if problem.system.units[k] == "rad" and k not in touched and _periodic(problem, k):
            x[:, i] -= 2.0 * np.pi * np.ceil(x[:, i] / (2.0 * np.pi) - 0.5 - 1e-12)
            x[np.abs(x[:, i]) < _ROUND_OFF, i] = 0.0
    n = np.where(np.abs(points.n) < _ROUND_OFF, 0.0, points.n)
    return Points(x, n)


def _periodic(problem: Problem, k: int) -> bool:
    """Return whether a turn of an angle brings all bodies back: followers have their own ratios."""
    coupled = problem.system.coupled
    if coupled is None:
        return True
    ratios = coupled.ratio[coupled.of == k]
    return bool((ratios == np.round(ratios)).all())


def _distinct(problem: Problem, points: Points, e: Energies) -> list[int]:
    """Return the indices of points whose shapes differ, least energy first."""
    # Of copies, the one with the smallest angles stands for all.
    size = np.round(np.linalg.norm(points.x, axis=1), 9)
    levels = np.round(e.U / max(float(e.scale.max(initial=0.0)), 1e-300), 10)
    order = np.lexsort((residuals(e), size, levels))
    coordinates = np.round(np.concatenate([points.x, points.n], axis=1)[order], 6)
    _, first = np.unique(coordinates, axis=0, return_index=True)  # most are the same in these, too
    seen: list[tuple[float, Place]] = []
    kept: list[int] = []
    for k in order[np.sort(first)].tolist():
        place = place_of(problem, problem.shapes(points.x[k : k + 1])[0], points.n[k])
        near = _SAME_ENERGY * float(e.scale[k])
        if any(
            abs(U - e.U[k]) <= near and place.same(other, reversible=problem.reversible)
            for U, other in seen
        ):
            continue
        seen.append((float(e.U[k]), place))
        kept.append(k)
    return kept


def _without_copies(entries: tuple[RelativeEquilibrium, ...]) -> tuple[RelativeEquilibrium, ...]:
    """Return equilibria with one of each family: those of a family have energy and modes alike."""
    out: list[RelativeEquilibrium] = []
    for each in entries:
        if each.dimension and any(_one_family(each, other) for other in out):
            continue
        out.append(each)
    return tuple(out)


def _one_family(a: RelativeEquilibrium, b: RelativeEquilibrium) -> bool:
    if a.dimension != b.dimension or a.stability.index != b.stability.index:
        return False
    size = max(abs(a.energy), abs(a.amended_potential), 1e-300)
    return abs(a.amended_potential - b.amended_potential) <= _SAME_ENERGY * size
