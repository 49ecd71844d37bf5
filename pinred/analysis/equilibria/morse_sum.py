"""The Morse sum of the equilibria, and the Euler characteristic that it must equal.

The unreduced shape space is a torus of the periodic joints, times SO(3) for each ball, times a
sphere if a direction is unknown, times a line for each joint with a spring. If the amended
potential is smooth there, and grows without bound along the lines, the sum of (−1)^index over all
critical points is the Euler characteristic of the space. A critical point with one flat direction
counts by its degree: along the flat direction, the potential has a minimum (+1), a maximum (−1) or
neither (0) there. A closed family of odd dimension has the Euler characteristic zero, and adds
nothing.
Source: J. Milnor, "Topology from the differentiable viewpoint", 1965, §6.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...common.names import listed
from ...common.parameter import Parameter
from ...forces import BallSpring
from ...forces.force import Force
from ...forces.force_model import touched_by
from ...lie.rotations import left_jacobian
from ...system.singular_mass_matrix import singular_shapes
from .amended_energy import AmendedEnergy
from .distinct_points import FLAT, DistinctPoints, Orbit
from .equilibrium_problem import Problem
from .points import Points, tangents

_ASIDE = 0.01  # displacement along a flat direction that determines the degree [rad | m]
_ZERO = 1e-10  # derivative along a flat direction that counts as zero, relative to the energies
_STEPS = 20  # largest number of Newton steps across a flat direction


def euler_characteristic(problem: Problem) -> tuple[int | None, str]:
    """Return the Euler characteristic of the unreduced shape space.

    Args:
        problem: The problem.
    Returns:
        The Euler characteristic and "", or None and the reason why the Morse sum does not apply.
    """
    if problem.surface is not None:
        return None, "the topology of the closed shapes of loops is not known"
    names = problem.system.shape_names
    balls = problem.space.balls
    cut = [joint.name for joint in balls if not _is_smooth_at(problem, joint.name)]
    if cut:
        return None, f"a force on {listed(cut)} may be singular half a turn away from rest"
    compact = {*problem.turning, *problem.system.space.ball_v.tolist()}
    lines = [k for k in problem.active if k not in compact]
    unbounded = [k for k in lines if not _is_sprung(problem, k)]
    if unbounded:
        reason = f"{listed([names[k] for k in unbounded])} is not periodic and has no spring alone"
        return None, reason
    system = problem.system
    singular = system.workspace(
        "singular_shapes", lambda: singular_shapes(system.sorted_model, system.coupled)
    )
    if singular.isolated or singular.everywhere:
        return None, "the mass matrix is singular at some shapes"
    if problem.turning or balls:  # SO(3) has the Euler characteristic 0, as the circle has.
        return 0, ""
    return (2 if problem.directional else 1), ""


def _is_smooth_at(problem: Problem, ball: str) -> bool:
    """Return whether all forces on a ball are springs whose potential is smooth on SO(3)."""
    (joint,) = (joint for joint in problem.system.space.balls if joint.name == ball)
    if joint.v.start not in touched_by(problem.forces):
        return True
    forces = problem.scene.forces
    listed_forces = (forces,) if isinstance(forces, Force) else tuple(forces)
    return not problem.scene.passive and all(
        isinstance(force, BallSpring) and force.law in ("cosine", "trace")
        for force in listed_forces
    )


def _is_sprung(problem: Problem, k: int) -> bool:
    """Return whether a spring with positive stiffness, and no other force, acts on a joint."""
    scene = problem.scene
    stiffness, _ = scene.springs.get(problem.system.shape_names[k], (0.0, 0.0))
    is_alone = not scene.forces and not scene.passive and not problem.driven_rate.any()
    number = stiffness.value if isinstance(stiffness, Parameter) else stiffness
    return bool(number > 0.0 and is_alone)


def morse_sum(energy: AmendedEnergy, points: DistinctPoints, J: float) -> int | None:
    """Return the sum of (−1)^index over all images of all equilibria.

    Args:
        energy: The amended potential.
        points: The equilibria.
        J: Momentum.
    Returns:
        The sum, or None if the degree of an equilibrium is unknown.
    """
    if energy.problem.surface is not None:
        return None
    total = 0
    for orbit in points.orbits:
        degree = _degree(energy, orbit, J) if orbit.is_flat else 1 - 2 * (orbit.index % 2)
        if degree is None:
            return None
        total += degree * (1 if orbit.dimension else len(orbit.images))
    return total


def _degree(energy: AmendedEnergy, orbit: Orbit, J: float) -> int | None:
    """Return the degree of an equilibrium with flat directions, or None if it is unknown."""
    point = orbit.images[:1]
    values, vectors = np.linalg.eigh(energy(point, J).hessian[0])
    order = np.argsort(np.abs(values))
    flat = int((np.abs(values) <= FLAT * np.abs(values).max(initial=0.0)).sum())
    if orbit.dimension:
        return 0 if orbit.dimension % 2 and flat == orbit.dimension else None
    if flat != 1:
        return None
    v, across = vectors[:, order[0]], vectors[:, order[1:]]
    ahead, behind = (_slope(energy, point, J, sign * v, across) for sign in (1.0, -1.0))
    if ahead is None or behind is None or (ahead == behind == 0.0):
        return None
    sign = 1 if int((values[order[1:]] < 0.0).sum()) % 2 == 0 else -1
    return sign * int((ahead + behind) / 2.0)


def _slope(energy: AmendedEnergy, point: Points, J: float, v: Array, across: Array) -> float | None:
    """Return the sign of the slope of the amended potential beside a point, in direction v.

    Across v, the neighbour is a critical point.

    Args:
        energy: The amended potential.
        point: Equilibrium with one flat direction.
        J: Momentum.
        v: Flat direction, (u,), a unit vector.
        across: Orthonormal basis of the other directions, (u, u − 1).
    Returns:
        1, −1 or 0, or None if there is no such neighbour.
    """
    e = energy(point, J)
    curvature = across.T @ e.hessian[0] @ across
    step = _ASIDE * v
    for _ in range(_STEPS):
        gradient = _chart_gradient(energy, point, step, J)
        if not np.isfinite(gradient).all():
            return None
        change = across @ np.linalg.solve(curvature, across.T @ gradient)
        step = step - change
        if np.linalg.norm(change) <= 1e-3 * _ZERO:
            break
    else:
        return None
    slope = float(v @ _chart_gradient(energy, point, step, J))
    return 0.0 if abs(slope) <= _ZERO * float(e.scale[0]) else float(np.sign(slope))


def _chart_gradient(energy: AmendedEnergy, point: Points, step: Array, J: float) -> Array:
    """Return the derivative (u,) of U(point.moved(step)) with respect to the step."""
    neighbour = point.moved(step[None])
    gradient = energy(neighbour, J).gradient[0].copy()
    ma = point.dimension
    if point.space is not None:
        for joint in point.space.balls:  # ∂U(x exp(w))/∂w = J_r(w)ᵀ ∇U, with J_r(w) = J_l(−w)
            gradient[joint.v] = left_jacobian(-step[joint.v]).T @ gradient[joint.v]
    if point.n.size:
        basis = tangents(point.n)[0]
        size = float(np.linalg.norm(point.n[0] + basis @ step[ma:]))
        gradient[ma:] = basis.T @ tangents(neighbour.n)[0] @ gradient[ma:] / size
    return np.asarray(gradient)
