"""The amended potential with exact derivatives, and the search for its critical points.

K is the inertia matrix of the base and the cyclic joints. H_d couples it to the driven joints,
which move at rates ν and have the inertia matrix H_dd. The momenta are s = (μ, π_cyclic). Then

    U = V + ½ σᵀ K⁻¹ σ − ½ νᵀ H_dd ν,     σ = s − H_d ν,

which is minus Routh's function at rest. In free space μ = (0, J n): zero linear momentum in the
frame of the centre of mass, and a direction n in the body. If gravity rotates a pivoted base, only
the angular momentum J about the vertical is conserved. The base then rotates about the upward
direction e in the body, K and σ refer to that rotation (E = [e]), and V = m |g| e·c.

Derivatives with respect to θ = (x, n), with η = K⁻¹ σ and ρ_θ = ∂σ − ∂K η, so that ∂η = K⁻¹ρ:

    ∂U = ηᵀ∂σ − ½ ηᵀ∂K η + ∂V,     ∂∂U = ρᵀK⁻¹ρ + ηᵀ∂∂σ − ½ ηᵀ∂∂K η + ∂∂V.

Derivatives with respect to x are along the frame of the shape. The second derivatives along the
three axes of a ball do not commute, so the Hessian is their symmetric part. It is the Hessian of
w → U(x exp(w)) at w = 0, and at a critical point the parts are equal.

Source: J. C. Simo, D. Lewis, J. E. Marsden, "Stability of relative equilibria. Part I: The reduced
energy–momentum method", 1991.

Search: all starts run together. Minimisation takes steps −|H|⁻¹ g in a trust region that shrinks
where the energy increases. Newton's method takes steps −H⁻¹ g and converges to critical points of
any index. Uniform starts miss symmetric shapes, so some starts have every angle at a multiple of a
quarter turn, and every ball in an attitude of a cube on the axes of its parent. Other attitudes of
balls are uniformly distributed. Half of all starts have their direction along a principal axis of
the locked inertia.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...lie.rotations import unit
from ...reduction.base_parts import root_of
from ...reduction.tree.second_derivatives import InertiaDerivatives, inertia_derivatives
from ...system.coordinates import ShapeSpace
from .equilibrium_problem import Points, Problem, Which, displaced_shape, tangents

_SINGULAR = 1e13  # condition number above which a mass matrix counts as singular


@dataclass(frozen=True)
class Energies:
    """The amended potential and its derivatives at N points.

    Attributes:
        U: Amended potential, (N,) [J].
        gradient: Derivative with respect to the u unknowns (x, tangent of the sphere), (N, u).
        hessian: Second derivative, (N, u, u).
        rates: Rates η, (N, k): twist of the base (or its rate about the vertical), then the rates
            of the cyclic joints.
        by_momentum: Derivative of the gradient with respect to J, (N, u).
        scale: Sum of the magnitudes of the terms of U, (N,) [J], the scale of round-off.
    """

    U: Array
    gradient: Array
    hessian: Array
    rates: Array
    by_momentum: Array
    scale: Array


class AmendedEnergy:
    """The amended potential of a problem, evaluated at many points at once."""

    def __init__(self, problem: Problem) -> None:
        """Prepare the quantities that do not depend on the point."""
        self.problem = problem
        system, plan = problem.system, problem.plan
        self._rows = [*range(system.r), *(system.r + k for k in problem.cyclic)]
        self._active = list(problem.active)
        self._driven = [system.r + k for k in problem.driven]
        gravity = np.zeros(3) if plan.gravity is None else np.array(plan.gravity)
        self._gravity = system.mass * gravity
        self._origin = -float(self._gravity @ root_of(system).origin)

    def __call__(self, points: Points, J: float | Array) -> Energies:
        """Evaluate the amended potential and its derivatives.

        Args:
            points: Values of the unknowns.
            J: Momentum, one number or (N,).
        Returns:
            Energies and derivatives. They are NaN where the mass matrix is singular.
        """
        problem, N = self.problem, len(points)
        J = np.broadcast_to(np.asarray(J, dtype=float), (N,))
        x = problem.shapes(points.x)
        # U depends only on the blocks of base, cyclic and driven joints, so differentiate only
        # these.
        d = inertia_derivatives(problem.system, x, of={*problem.cyclic, *problem.driven})
        if problem.system.space.balls:
            d = _symmetrised(d)
        K, K1, K2, s, s1, s2, sJ, sJ1 = self._terms(d, points, J)
        # A point mass on its joint axis makes the mass matrix singular.
        regular = np.linalg.cond(d.H) < _SINGULAR
        K = np.where(regular[:, None, None], K, np.eye(K.shape[1]))
        eta = np.where(regular[:, None], np.linalg.solve(K, s[..., None])[..., 0], np.nan)
        rho = s1 - (K1 @ eta[:, None, :, None])[..., 0]
        across = np.linalg.solve(K, np.swapaxes(rho, 1, 2))
        U = 0.5 * np.einsum("ni,ni->n", s, eta)
        g = np.einsum("nti,ni->nt", s1, eta)
        g -= 0.5 * np.einsum("ntij,ni,nj->nt", K1, eta, eta)
        Hs = rho @ across + np.einsum("ntui,ni->ntu", s2, eta)
        Hs -= 0.5 * np.einsum("ntuij,ni,nj->ntu", K2, eta, eta)
        gJ = np.einsum("nit,ni->nt", across, sJ) + np.einsum("nti,ni->nt", sJ1, eta)
        scale = 0.5 * np.einsum("ni,ni->n", np.abs(s), np.abs(eta))
        self._add_driven(d, U, g, Hs)
        scale = scale + self._add_potential(d, x, points, U, g, Hs)
        return self._on_sphere(points, Energies(U, g, Hs, eta, gJ, scale))

    def _terms(self, d: InertiaDerivatives, points: Points, J: Array) -> tuple[Array, ...]:
        """Return K, σ and ∂σ/∂J, with their derivatives with respect to θ."""
        problem, N, a, rows = self.problem, len(points), self._active, self._rows
        ma, r, size = len(a), problem.system.r, len(rows)
        T = ma + 3 * problem.directional
        block = np.ix_(range(N), rows, rows)
        full, full1, full2 = d.H[block], d.dH[block][..., a], d.d2H[block][..., a, :][..., a]
        side = np.ix_(range(N), rows, self._driven)
        rate = problem.driven_rate
        h = d.H[side] @ rate
        h1 = np.einsum("nida,d->nai", d.dH[side][..., a], rate)
        h2 = np.einsum("nidab,d->nabi", d.d2H[side][..., a, :][..., a], rate)
        full1, full2 = np.moveaxis(full1, -1, 1), np.moveaxis(full2, (-2, -1), (1, 2))
        if problem.kind != "heavy":
            s, sJ, sJ1 = np.zeros((N, size)), np.zeros((N, size)), np.zeros((N, T, size))
            s1, s2 = np.zeros((N, T, size)), np.zeros((N, T, T, size))
            K1, K2 = np.zeros((N, T, size, size)), np.zeros((N, T, T, size, size))
            K1[:, :ma], K2[:, :ma, :ma] = full1, full2
            if problem.directional:
                sJ[:, r - 3 : r] = points.n
                sJ1[:, ma:, r - 3 : r] = np.eye(3)
                s1[:, ma:, r - 3 : r] = J[:, None, None] * np.eye(3)
            else:
                sJ[:, r - 1] = 1.0
            s[:] = J[:, None] * sJ
            s[:, r:] += problem.cyclic_momenta
            s -= h
            s1[:, :ma] -= h1
            s2[:, :ma, :ma] -= h2
            return full, K1, K2, s, s1, s2, sJ, sJ1
        k = 1 + len(problem.cyclic)
        E = np.zeros((N, size, k))
        E[:, :3, 0] = points.n
        E[:, 3:, 1:] = np.eye(k - 1)
        Ei = np.zeros((3, size, k))
        Ei[[0, 1, 2], [0, 1, 2], 0] = 1.0
        Et, Eit = np.swapaxes(E, 1, 2), np.swapaxes(Ei, 1, 2)
        K1, K2 = np.zeros((N, T, k, k)), np.zeros((N, T, T, k, k))
        K1[:, :ma] = Et[:, None] @ full1 @ E[:, None]
        K2[:, :ma, :ma] = Et[:, None, None] @ full2 @ E[:, None, None]
        K1[:, ma:] = _symmetric(Eit @ (full @ E)[:, None])
        mixed = _symmetric(Eit @ (full1 @ E[:, None])[:, :, None])
        K2[:, :ma, ma:], K2[:, ma:, :ma] = mixed, np.swapaxes(mixed, 1, 2)
        K2[:, ma:, ma:] = _symmetric(Eit[:, None] @ full[:, None, None] @ Ei)
        s = np.zeros((N, k))
        s[:, 0], s[:, 1:] = J, problem.cyclic_momenta
        s -= (Et @ h[..., None])[..., 0]
        s1, s2 = np.zeros((N, T, k)), np.zeros((N, T, T, k))
        s1[:, :ma] = -h1 @ E
        s1[:, ma:] = -(Eit @ h[:, None, :, None])[..., 0]
        s2[:, :ma, :ma] = -h2 @ E[:, None]
        mixed_momentum = -np.einsum("nai,eik->naek", h1, Ei)
        s2[:, :ma, ma:], s2[:, ma:, :ma] = mixed_momentum, np.swapaxes(mixed_momentum, 1, 2)
        sJ = np.zeros((N, k))
        sJ[:, 0] = 1.0
        return Et @ full @ E, K1, K2, s, s1, s2, sJ, np.zeros((N, T, k))

    def _add_driven(self, d: InertiaDerivatives, U: Array, g: Array, Hs: Array) -> None:
        """Subtract the energy ½ νᵀ H_dd ν of the driven joints from U, g and Hs in place."""
        if not self._driven:
            return
        block = np.ix_(range(len(U)), self._driven, self._driven)
        a, ma, v = self._active, len(self._active), self.problem.driven_rate
        U -= 0.5 * np.einsum("nij,i,j->n", d.H[block], v, v)
        g[:, :ma] -= 0.5 * np.einsum("nija,i,j->na", d.dH[block][..., a], v, v)
        twice = d.d2H[block][..., a, :][..., a]
        Hs[:, :ma, :ma] -= 0.5 * np.einsum("nijab,i,j->nab", twice, v, v)

    def _add_potential(
        self, d: InertiaDerivatives, x: Array, points: Points, U: Array, g: Array, Hs: Array
    ) -> Array:
        """Add the potential V to U and its derivatives; return the magnitude of its terms, (N,)."""
        a, ma = self._active, len(self._active)
        scale = np.zeros(len(U))
        weight = self._gravity
        if weight.any():
            dcom, d2com = d.dcom[..., a], d.d2com[..., a, :][..., a]
            if self.problem.kind == "heavy":
                size = float(np.linalg.norm(weight))
                pull = -size * points.n  # gravity force in body axes
                g[:, ma:] += size * d.com
                Hs[:, ma:, :ma] += size * dcom
                Hs[:, :ma, ma:] += size * np.swapaxes(dcom, 1, 2)
            else:
                pull = np.broadcast_to(weight, d.com.shape)
            U += self._origin - np.einsum("ni,ni->n", pull, d.com)
            g[:, :ma] -= np.einsum("ni,nia->na", pull, dcom)
            Hs[:, :ma, :ma] -= np.einsum("ni,niab->nab", pull, d2com)
            scale += np.linalg.norm(weight) * np.linalg.norm(d.com, axis=1)
        if self.problem.forces is not None:
            V, V1, V2 = (np.array(term) for term in self._springs(x.T))
            m = self.problem.system.m
            U += V[0]
            g[:, :ma] += V1.T[:, a]
            Hs[:, :ma, :ma] += V2.T.reshape(-1, m, m)[:, a][:, :, a]
            scale += np.abs(V[0])
        return scale

    @cached_property
    def _springs(self) -> ca.Function:
        """CasADi function of the forces' potential, its gradient and its Hessian."""
        forces, space = self.problem.forces, self.problem.system.space
        assert forces is not None
        x = ca.SX.sym("x", space.nx)
        if not space.balls:
            V = forces.potential_function(x, ca.DM(forces.numbers))
            H, g = ca.hessian(V, x)
            return ca.Function("springs", [x], [ca.densify(term) for term in (V, g, H)])
        w = ca.SX.sym("w", space.m)
        V = forces.potential_function(displaced_shape(space, x, w), ca.DM(forces.numbers))
        derivatives = [V, *ca.hessian(V, w)[::-1]]
        at_x = [ca.substitute(term, w, ca.SX.zeros(space.m)) for term in derivatives]
        return ca.Function("springs", [x], [ca.densify(term) for term in at_x])

    def _on_sphere(self, points: Points, e: Energies) -> Energies:
        """Project derivatives with respect to n onto the tangent plane of the sphere."""
        if not self.problem.directional:
            return self._on_loops(points, e)
        ma = points.dimension
        B = np.zeros((len(points), ma + 3, ma + 2))
        B[:, :ma, :ma] = np.eye(ma)
        B[:, ma:, ma:] = tangents(points.n)
        Bt = np.swapaxes(B, 1, 2)
        hessian = Bt @ e.hessian @ B
        radial = np.einsum("ni,ni->n", e.gradient[:, ma:], points.n)
        hessian[:, ma:, ma:] -= radial[:, None, None] * np.eye(2)
        g, gJ = ((Bt @ gradient[..., None])[..., 0] for gradient in (e.gradient, e.by_momentum))
        return self._on_loops(points, Energies(e.U, g, hessian, e.rates, gJ, e.scale))

    def _on_loops(self, points: Points, e: Energies) -> Energies:
        """Project derivatives with respect to x onto the closed shapes of loops, if any."""
        surface = points.surface
        if surface is None:
            return e
        ma, momentum_size = points.dimension, 2 * self.problem.directional
        tangents, is_regular = surface.tangents(points.x)
        B = np.zeros((len(points), ma + momentum_size, tangents.shape[2] + momentum_size))
        B[:, :ma, : tangents.shape[2]] = tangents
        B[:, ma:, tangents.shape[2] :] = np.eye(momentum_size)
        hessian, Bt = e.hessian.copy(), np.swapaxes(B, 1, 2)
        hessian[:, :ma, :ma] -= surface.curvature(points.x, e.gradient[:, :ma])
        hessian[~is_regular] = np.nan  # so that no shape where equations depend is critical
        g, gJ = ((Bt @ gradient[..., None])[..., 0] for gradient in (e.gradient, e.by_momentum))
        return Energies(e.U, g, Bt @ hessian @ B, e.rates, gJ, e.scale)


def _symmetrised(d: InertiaDerivatives) -> InertiaDerivatives:
    """Return the derivatives with the symmetric part of the second ones."""
    halves = [0.5 * (second + np.swapaxes(second, -1, -2)) for second in (d.d2H, d.d2com)]
    return replace(d, d2H=halves[0], d2com=halves[1])


def _symmetric(matrix: Array) -> Array:
    return matrix + np.swapaxes(matrix, -1, -2)


NEWTON, DESCENT = 60, 200  # largest number of Newton and of descent steps
FOUND = 1e-9  # largest residual of a critical point
LONGEST = 0.5  # longest step [rad | m]
_FLAT = 1e-9  # curvatures below this fraction of the largest count as zero
_CUBE = 24  # number of rotations of a cube
_SLIDE = 1.0  # range of a prismatic joint without limits [m]


def residuals(e: Energies) -> Array:
    """Return the largest gradient entry relative to the energies, (N,); NaN becomes infinity."""
    size = np.where(e.scale > 0.0, e.scale, 1.0)
    largest = np.abs(e.gradient).max(axis=1, initial=0.0) / size
    return np.where(np.isfinite(e.hessian).all(axis=(1, 2)), largest, np.inf)


def starting_points(problem: Problem, count: int, rng: np.random.Generator) -> Points:
    """Return random and symmetric starting points.

    Args:
        problem: The problem.
        count: Number of points.
        rng: Random generator.
    Returns:
        The points.
    """
    space = problem.space
    low, high, turns = _reach(problem)
    scalars = rng.uniform(low, high, (count, len(space.scalar_x)))
    hinges = int(turns.sum())
    quarters = _quarters(hinges, len(space.balls), count // 4, rng)
    symmetric = min(len(quarters), count)
    scalars[:symmetric, turns] = 0.5 * np.pi * (quarters[:symmetric, :hinges] - 1)
    x = _with_attitudes(space, scalars, quarters[:symmetric, hinges:], rng)
    if problem.surface is not None:
        x = problem.surface.random(x, rng)
    if not problem.directional:
        return problem.points(x, np.zeros((count, 0)))
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    if (
        symmetric and 3 * symmetric <= count
    ):  # combine each symmetric shape with each of its principal axes
        x = np.concatenate([np.repeat(x[:symmetric], 3, axis=0), x[symmetric:]])[
            : max(count, 3 * symmetric)
        ]
        n = np.concatenate([np.zeros((2 * symmetric, 3)), n])[: len(x)]
        aligned = np.r_[: 3 * symmetric, 3 * symmetric : len(x) : 2]
        axes = np.r_[
            np.tile([0, 1, 2], symmetric), rng.integers(3, size=len(aligned) - 3 * symmetric)
        ]
    else:
        aligned = np.arange(0, len(x), 2)
        axes = rng.integers(3, size=len(aligned))
    n[aligned] = _principal_axes(problem, x[aligned])[np.arange(len(aligned)), :, axes]
    return problem.points(x, n)


def _with_attitudes(
    space: ShapeSpace, scalars: Array, quarters: NDArray[np.int_], rng: np.random.Generator
) -> Array:
    """Return shapes (N, k) with uniformly distributed attitudes of balls.

    Args:
        space: Manifold of the active joints.
        scalars: Values of hinges and slides, (N, s).
        quarters: Numbers of the rotations by quarter turns in the first shapes, (k, balls).
        rng: Random generator.
    Returns:
        The shapes.
    """
    if not space.balls:
        return scalars
    x = np.empty((len(scalars), space.nx))
    x[:, space.scalar_x] = scalars
    for k, joint in enumerate(space.balls):
        q = rng.normal(size=(len(scalars), 4))
        q[: len(quarters)] = _quarter_turns()[quarters[:, k]]
        x[:, joint.x] = unit(q)
    return x


def _quarter_turns() -> Array:
    """Return the 24 rotations of a cube as quaternions, (24, 4)."""
    halves = np.array(list(product((1.0, -1.0), repeat=4)))
    edges = [
        np.eye(4)[a] + sign * np.eye(4)[b] for a, b in combinations(range(4), 2) for sign in (1, -1)
    ]
    return unit(np.concatenate([np.eye(4), halves[halves[:, 3] > 0.0], edges]))


def _quarters(turns: int, balls: int, most: int, rng: np.random.Generator) -> NDArray[np.int_]:
    """Return numbers of quarter turns, (k, turns + balls): all combinations or a selection.

    Args:
        turns: Number of angles, each with 4 quarter turns.
        balls: Number of balls, each with the 24 rotations of a cube.
        most: Largest number of combinations.
        rng: Random generator.
    Returns:
        The combinations.
    """
    count = 4**turns * _CUBE**balls
    if count <= most:
        choices = [range(4)] * turns + [range(_CUBE)] * balls
        return np.array(list(product(*choices)), dtype=int).reshape(count, turns + balls)
    quarters = rng.integers(4, size=(most, turns))
    return np.hstack([quarters, rng.integers(_CUBE, size=(most, balls))]) if balls else quarters


def critical_points(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    """Run Newton's method from all points.

    Args:
        energy: The amended potential.
        points: Starting points.
        J: Momentum.
    Returns:
        The points that converged to critical points, and their energies.
    """
    return iterated(energy, points, J, lambda e, _: newton_step(e))


def iterated(
    energy: AmendedEnergy,
    points: Points,
    J: float,
    step: Callable[[Energies, NDArray[np.intp]], Array],
) -> tuple[Points, Energies]:
    """Repeat steps from all points until they converge.

    Args:
        energy: The amended potential.
        points: Starting points.
        J: Momentum.
        step: Returns the steps, (K, u), from the energies at K points and their numbers, (K,).
    Returns:
        The points that converged to critical points, and their energies.
    """
    current = points.at(points.x.copy(), points.n.copy())
    running = np.arange(len(points))
    for _ in range(NEWTON):
        if not running.size:
            break
        e = energy(current[running], J)
        active = np.isfinite(residuals(e)) & (residuals(e) > 1e-14)
        running, e = running[active], some(e, active)
        moves = step(e, running)
        stepped = current[running].moved(clipped(moves, LONGEST))
        current.x[running], current.n[running] = stepped.x, stepped.n
        running = running[np.linalg.norm(moves, axis=1) > 1e-13]
    return converged(energy, current, J)


def minima(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    """Minimise the amended potential from all points.

    Args:
        energy: The amended potential.
        points: Starting points.
        J: Momentum.
    Returns:
        The minima to which the descent converged, and their energies.
    """
    current = points.at(points.x.copy(), points.n.copy())
    running, radius = np.arange(len(points)), np.full(len(points), LONGEST)
    e = energy(current, J)
    running, e = running[np.isfinite(residuals(e))], some(e, np.isfinite(residuals(e)))
    for _ in range(DESCENT if running.size else 0):
        step = clipped(descent_step(e), radius[running])
        tried = current[running].moved(step)
        new = energy(tried, J)
        lower = np.isfinite(residuals(new)) & (e.U + 1e-15 * e.scale >= new.U)
        current.x[running[lower]], current.n[running[lower]] = tried.x[lower], tried.n[lower]
        radius[running] = np.where(
            lower, np.minimum(2.0 * radius[running], LONGEST), 0.25 * radius[running]
        )
        e = _chosen(lower, new, e)
        active = (residuals(e) > 1e-12) & (radius[running] > 1e-12)
        running, e = running[active], some(e, active)
        if not running.size:
            break
    return critical_points(energy, current, J)


def polished(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    """Improve points by a few Newton steps, each accepted only if it reduces the residual.

    Args:
        energy: The amended potential.
        points: Critical points.
        J: Momentum.
    Returns:
        The improved points and their energies.
    """
    e = energy(points, J)
    for _ in range(4 if len(points) else 0):
        tried = points.moved(newton_step(e))
        new = energy(tried, J)
        better = residuals(new) < residuals(e)
        points = points.at(
            np.where(better[:, None], tried.x, points.x),
            np.where(better[:, None], tried.n, points.n),
        )
        e = _chosen(better, new, e)
        if not better.any():
            break
    return points, e


def converged(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    """Return the points that are critical points, and their energies.

    Args:
        energy: The amended potential.
        points: Points at which an iteration ended.
        J: Momentum.
    Returns:
        The points with residuals up to `FOUND`, and their energies.
    """
    e = energy(points, J)
    good = residuals(e) <= FOUND
    return points[good], some(e, good)


def newton_step(e: Energies) -> Array:
    """Compute the steps −H⁻¹ g; directions of zero curvature are omitted.

    Args:
        e: Energies with gradient g and Hessian H.
    Returns:
        (N, u).
    """
    curvatures, vectors, components, floor = _principal_gradients(e)
    flat = np.abs(curvatures) <= floor
    components = np.where(flat, 0.0, components / np.where(flat, 1.0, curvatures))
    return np.asarray(-(vectors @ components[..., None])[..., 0])


def descent_step(e: Energies, ascending: NDArray[np.intp] | int = 0) -> Array:
    """Compute the steps −|H|⁻¹ g, with the opposite sign along the lowest curvatures.

    Args:
        e: Energies with gradient g and Hessian H.
        ascending: Number of the lowest curvatures along which steps ascend, one number or (N, 1).
    Returns:
        (N, u).
    """
    curvatures, vectors, components, floor = _principal_gradients(e)
    components = components / np.maximum(np.abs(curvatures), np.where(floor > 0.0, floor, 1.0))
    ascends = np.arange(curvatures.shape[1]) < ascending
    components = np.where(ascends, components, -components)
    return np.asarray((vectors @ components[..., None])[..., 0])


def _principal_gradients(e: Energies) -> tuple[Array, Array, Array, Array]:
    """Return curvatures, their directions, components of g along them, and the least curvature."""
    curvatures, vectors = np.linalg.eigh(e.hessian)
    components = (np.swapaxes(vectors, 1, 2) @ e.gradient[..., None])[..., 0]
    floor = _FLAT * np.abs(curvatures).max(axis=1, keepdims=True, initial=0.0)
    return curvatures, vectors, components, floor


def clipped(step: Array, longest: float | Array) -> Array:
    """Shorten steps.

    Args:
        step: Steps, (N, u).
        longest: Longest step, one number or (N,) [rad | m].
    Returns:
        The steps in their directions, (N, u).
    """
    size = np.linalg.norm(step, axis=1)
    return np.asarray(step * np.minimum(1.0, longest / np.maximum(size, 1e-300))[:, None])


def some(e: Energies, which: Which) -> Energies:
    """Return the energies at some of the points.

    Args:
        e: Energies at all points.
        which: Indices or mask of the points.
    Returns:
        The selected entries of every array.
    """
    return Energies(**{name: getattr(e, name)[which] for name in e.__dataclass_fields__})


def _chosen(which: NDArray[np.bool_], one: Energies, other: Energies) -> Energies:
    """Return the entries of `one` where `which` is true, else the entries of `other`."""
    fields = {}
    for name in one.__dataclass_fields__:
        a, b = getattr(one, name), getattr(other, name)
        fields[name] = np.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b)
    return Energies(**fields)


def _reach(problem: Problem) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return smallest and largest values of active hinges and slides, and which are angles."""
    system, of_balls = problem.system, set(problem.system.space.ball_v.tolist())
    active = [k for k in problem.active if k not in of_balls]
    turns = np.array([system.units[k] == "rad" for k in active], dtype=bool)
    low, high = (sign * np.where(turns, np.pi, _SLIDE) for sign in (-1.0, 1.0))
    model = system.model
    for i, k in enumerate(active):
        joint = model.joints[system.joints[k]]
        if not turns[i]:
            ends = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            if np.isfinite(ends).all() and ends[0] < ends[1] and max(map(abs, ends)) < 1e3:
                low[i], high[i] = ends
    return low, high, turns


def _principal_axes(problem: Problem, active: Array) -> Array:
    """Return principal axes (N, 3, 3), in columns, of the locked inertia about the pivot or CoM."""
    d, r = inertia_derivatives(problem.system, problem.shapes(active), of=()), problem.system.r
    I = d.H[:, r - 3 : r, r - 3 : r]
    if problem.system.group.turns_about_com:
        coupling = d.H[:, r - 3 : r, : r - 3]
        I = I - coupling @ np.linalg.solve(d.H[:, : r - 3, : r - 3], np.swapaxes(coupling, 1, 2))
    return np.asarray(np.linalg.eigh(I)[1])
