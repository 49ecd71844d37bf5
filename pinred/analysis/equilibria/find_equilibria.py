"""relative_equilibria(): find the steady motions of a robot at a momentum, and their stability.

Walks from critical points to neighbours of the next lower and the next higher index.

Each critical point starts two walks along every principal direction of its Hessian. A walk along a
descending direction searches for a point with one negative curvature less, a walk along an
ascending direction for a point with one more. The steps are −Q |Λ|⁻¹ Qᵀ g, with the opposite sign
for the k lowest curvatures, so that critical points of index k attract. Walks reach points whose
basin random starts miss.
Source: J. Yin, L. Zhang, P. Zhang, "High-index optimization-based shrinking dimer method for
finding high-index saddle points", SIAM J. Sci. Comput. 41, 2019.

The equilibria have a Morse sum, which must equal the Euler characteristic.

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

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, whole
from ...common.errors import InputError
from ...common.names import listed
from ...common.parameter import Parameter
from ...common.waiting import Wait
from ...forces import BallSpring
from ...forces.force import Force
from ...forces.force_model import touched_by
from ...forces.signals import Signal
from ...lie.rotations import left_jacobian
from ...reduction.pointwise_reduction import mass_matrix
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...system.singular_mass_matrix import singular_shapes
from ...system.system import System, checked_system
from ..stability.linearised_flow import linearised, of_smooth_momenta
from ..stability.stability_verdict import Stability, assess_stability, second_variation
from .amended_potential import (
    AmendedEnergy,
    Energies,
    critical_points,
    descent_step,
    iterated,
    minima,
    polished,
    residuals,
    starting_points,
)
from .distinct_points import FLAT, DistinctPoints, Orbit, Symmetry
from .equilibrium_problem import Points, Problem, embedded, finite, joined, problem_of, tangents
from .relative_equilibrium import Census, Equilibria, RelativeEquilibrium, pose_of

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


_AWAY = 0.1  # first step of a walk [rad | m]
_SAME = 1e-9  # largest distance of equal starts


def walks_from(
    points: Points, e: Energies, symmetries: Sequence[Symmetry], angles: NDArray[np.bool_]
) -> tuple[Points, NDArray[np.intp]]:
    """Return starts next to critical points, and the index that the walk from each start targets.

    Args:
        points: Critical points.
        e: Their energies.
        symmetries: Symmetries; of two starts that are images of each other, one is omitted.
        angles: Which active joints are periodic, (ma,).
    Returns:
        The starts, and the target number of negative curvatures of each, (N,).
    """
    values, vectors = np.linalg.eigh(e.hessian)
    index = (values < 0.0).sum(axis=1)
    starts, aims = [], []
    for j in range(values.shape[1]):
        ahead = points.moved(_AWAY * vectors[:, :, j])
        behind = points.moved(-_AWAY * vectors[:, :, j])
        is_image = np.zeros(len(points), dtype=bool)
        for symmetry in symmetries:
            difference = embedded(symmetry(behind), angles) - embedded(ahead, angles)
            is_image |= np.abs(difference).max(axis=1, initial=0.0) <= _SAME
        starts += [ahead, behind[~is_image]]
        aim = index + np.where(values[:, j] < 0.0, -1, 1)
        aims += [aim, aim[~is_image]]
    return joined(starts), np.concatenate(aims).astype(np.intp)


def walk(
    energy: AmendedEnergy, starts: Points, indices: NDArray[np.intp], J: float
) -> tuple[Points, Energies]:
    """Walk to critical points with given numbers of negative curvatures.

    Args:
        energy: The amended potential.
        starts: Starting points.
        indices: Target number of negative curvatures, (N,).
        J: Momentum.
    Returns:
        The critical points to which walks converged, and their energies.
    """
    return iterated(energy, starts, J, lambda e, running: descent_step(e, indices[running, None]))


MANY_JOINTS = 6  # number of active joints from which fewer starts are the default
_STARTS = {True: 200, False: 300}  # number of random starts, with many and with few joints
ROUNDS = 10  # largest number of all starts, relative to the random starts of one round
_BATCH = 64  # number of equilibria from which walks run together
_MINIMISATIONS = 24  # number of starts from which the energy is also minimised


@checks_arguments
@Wait("searches relative equilibria")
def relative_equilibria(
    system: System,
    *,
    momentum: float,
    cyclic: Mapping[str, float] | None = None,
    starts: int | None = None,
    limit: int | None = None,
    seed: int = 0,
    springs: Mapping[str, tuple[float, float]] | None = None,
    forces: Sequence[Force] | Force = (),
    prescribed: Mapping[str, Signal | float | str] | None = None,
    passive: bool = False,
) -> Equilibria:
    """Search the relative equilibria at a momentum, sorted by amended potential.

    Shapes that differ only in their coordinates count once, and so does a family of equilibria. The
    search starts from random and symmetric points. From each equilibrium, walks lead to those of
    the next lower and higher index. Rounds with new starts follow until the Morse sum agrees with
    the Euler characteristic of the shape space. Equilibria can still be missing: see `Census`.

    Args:
        system: The system.
        momentum: J = |J| in space [N·m·s]; signed where there is one axis (ℝ: [N·s], SO(2), SE(2),
            ℝ × SE(2)); about the upward vertical where gravity rotates a pivoted base. The linear
            momentum is zero in the frame of the centre of mass.
        cyclic: Momenta π of cyclic joints by name; others are zero.
        starts: Number of random starts of Newton's method in each round; 300, or 200 with six or
            more moving joints.
        limit: Largest number of starts in all, walks included; ten times `starts`.
        seed: Seed of the starts.
        springs: Springs, as in Scene.
        forces: Forces with a potential.
        prescribed: Joints with a constant value, or cyclic joints with a constant rate.
        passive: Whether the springs in the robot's file act.
    Returns:
        The equilibria, with a census of the search.
    Raises:
        InputError: An argument is invalid, or every shape is an equilibrium.
        SymmetryError: Gravity breaks the symmetry.
    """
    problem = problem_of(
        checked_system(system, "relative_equilibria", loops=True), cyclic=cyclic, springs=springs,
        forces=forces, prescribed=prescribed, passive=passive,
    )  # fmt: skip
    J = finite(momentum, "momentum")
    if problem.directional and J < 0.0:
        raise InputError(f"momentum: expected a magnitude |J| of at least 0, got {J:g}")
    if problem.kind == "free" and J == 0.0:
        problem = problem.at_rest()
    many = len(problem.active) >= MANY_JOINTS
    count = _STARTS[many] if starts is None else whole(starts, "starts")
    most = ROUNDS * count if limit is None else whole(limit, "limit")
    search = Search(problem, J, count, whole(seed, "seed", 0), limit=most)
    points = search.points()
    entries = tuple(equilibrium_at(problem, points[k : k + 1], J) for k in range(len(points)))
    return Equilibria(problem.system, J, search.census(), entries)


class Search:
    """A search of the critical points of a problem, in rounds of random starts and walks."""

    def __init__(self, problem: Problem, J: float, count: int, seed: int, *, limit: int) -> None:
        """Search until the Morse sum agrees, or the limit is reached.

        Args:
            problem: The problem.
            J: Momentum.
            count: Number of random starts of each round.
            seed: Seed of the starts.
            limit: Largest number of starts; the first round is always completed.
        Raises:
            InputError: Every shape is an equilibrium.
        """
        self._energy, self._J = AmendedEnergy(problem), J
        self.starts = self.converged = 0
        self.expected, self.reason = euler_characteristic(problem)
        rng = np.random.default_rng(seed)
        self._check(starting_points(problem, 1, np.random.default_rng(seed)))
        self.found = DistinctPoints(self._energy, J)
        self._pending: list[int] = []
        self._begin(starting_points(problem, count if problem.unknowns else 1, rng))
        self.sum = self._walk(limit)
        while not self._is_complete and self.starts < limit:
            self._known = len(self.found.orbits)
            self._newton(starting_points(problem, min(count, limit - self.starts), rng))
            self.sum = self._walk(limit)

    def points(self) -> Points:
        """Return the distinct points, sorted by energy, then by index."""
        points = self.found.entries
        e = self._energy(points, self._J)
        levels = np.round(e.U / max(float(e.scale.max(initial=0.0)), 1e-300), 10)
        values = points.from_rest
        size = np.round(np.linalg.norm(values, axis=1), 9)
        keys = np.round(np.concatenate([values, points.n], axis=1), 6).T
        curvatures = np.linalg.eigvalsh(e.hessian)
        largest = np.abs(curvatures).max(axis=1, initial=0.0)
        index = (curvatures < -FLAT * largest[:, None]).sum(axis=1)
        return points[np.lexsort((*keys, size, index, levels))]

    def census(self) -> Census:
        """Return the count, and the evidence for its completeness."""
        orbits = self.found.orbits
        hits = np.concatenate(
            [np.full(orbit.entries, orbit.hits) for orbit in orbits] or [np.zeros(0)]
        )
        counts = [int((hits == k).sum()) for k in range(3)]
        pending = sum(orbits[k].entries for k in self._pending)
        reason = self.reason
        if self.sum is None and not reason:
            reason = "an equilibrium is degenerate, so that its index is undefined"
        return Census(
            count=len(hits),
            families=sum(orbit.dimension > 0 for orbit in orbits),
            starts=self.starts,
            converged=self.converged,
            seen_once=counts[1],
            seen_twice=counts[2],
            not_seen=counts[0],
            pending=pending,
            morse_sum=None if self.expected is None else self.sum,
            expected=None if self.sum is None else self.expected,
            reason=reason,
        )

    @property
    def _is_complete(self) -> bool:
        """Whether the sum agrees; if it does not apply, whether the last round found nothing."""
        if self.expected is None or self.sum is None:
            return len(self.found.orbits) == self._known
        return self.sum == self.expected

    def _check(self, points: Points) -> None:
        e = self._energy(points, self._J)
        if self._energy.problem.unknowns and not (e.scale > 0.0).any():
            raise InputError(
                "without momentum and potential every shape is an equilibrium. Give a momentum, "
                "or momenta of cyclic joints"
            )

    def _begin(self, starts: Points) -> None:
        """Run the first round of random starts, and minimise from some of them."""
        self._known = 0
        self._newton(starts)
        if self._energy.problem.unknowns:
            minimised = starts[-min(_MINIMISATIONS, len(starts)) :]
            self._add(minimised, minima(self._energy, minimised, self._J), is_random=False)

    def _newton(self, starts: Points) -> None:
        self._add(starts, critical_points(self._energy, starts, self._J), is_random=True)

    def _add(self, starts: Points, result: tuple[Points, Energies], *, is_random: bool) -> None:
        points, e = polished(self._energy, result[0], self._J)
        self.starts += len(starts)
        self.converged += len(points)
        self._pending += self.found.add(points, e, is_random=is_random)

    def _walk(self, limit: int) -> int | None:
        """Walk from equilibria until no new one appears, and return the Morse sum."""
        most = max(1, 2 * self._energy.problem.unknowns)
        while self._pending and self._energy.problem.unknowns:
            batch = min(len(self._pending), _BATCH, (limit - self.starts) // most)
            if batch <= 0:
                break
            numbers, self._pending = self._pending[:batch], self._pending[batch:]
            base = self.found.representatives(numbers)
            e = self._energy(base, self._J)
            starts, aims = walks_from(base, e, self.found.symmetries, self.found.angles)
            result = walk(self._energy, starts, aims, self._J)
            self._add(starts, result, is_random=False)
        return morse_sum(self._energy, self.found, self._J)


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
    return assess_stability(linear, second, flow.kernel.layout, problem.system.space)


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
    return CompiledFlow.of_plan(plan_of(of_smooth_momenta(scene)), all_momenta=True)
