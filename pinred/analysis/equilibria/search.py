"""Search for critical points of the amended potential: starts, minimisation, Newton's method.

All starts run together. Minimisation takes steps −|H|⁻¹ g in a trust region that shrinks where the
energy increases. Newton's method takes steps −H⁻¹ g and converges to critical points of any index.
Uniform starts miss symmetric shapes, so some starts have every angle at a multiple of a quarter
turn, and every ball in an attitude of a cube on the axes of its parent. Other attitudes of balls
are uniformly distributed. Half of all starts have their direction along a principal axis of the
locked inertia.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...lie.rotations import unit
from ...reduction.tree.second_derivatives import inertia_derivatives
from ...system.coordinates import ShapeSpace
from .amended_energy import AmendedEnergy, Energies
from .equilibrium_problem import Problem
from .points import Points, Which

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
    return iterated(energy, points, J, lambda e, _: -newton_step(e, absolute=False))


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
        step = clipped(-newton_step(e, absolute=True), radius[running])
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
        tried = points.moved(-newton_step(e, absolute=False))
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


def newton_step(e: Energies, *, absolute: bool) -> Array:
    """Return H⁻¹ g, or |H|⁻¹ g; directions of zero curvature are omitted.

    Args:
        e: Energies with gradient g and Hessian H.
        absolute: Whether to take the absolute values of the curvatures.
    Returns:
        (N, u).
    """
    if not e.gradient.shape[1]:
        return e.gradient
    values, vectors = np.linalg.eigh(e.hessian)
    components = (np.swapaxes(vectors, 1, 2) @ e.gradient[..., None])[..., 0]
    size = np.abs(values)
    floor = _FLAT * size.max(axis=1, keepdims=True)
    if absolute:
        components = components / np.maximum(size, np.where(floor > 0.0, floor, 1.0))
    else:
        flat = size <= floor
        components = np.where(flat, 0.0, components / np.where(flat, 1.0, values))
    return np.asarray((vectors @ components[..., None])[..., 0])


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
