"""The search for critical points of the amended potential: starts, minimisation, Newton's method.

All starts go along together.  Minimisation takes steps −|H|⁻¹ g within a region of trust that
shrinks where the energy grows; Newton's method takes −H⁻¹ g and finds critical points of any index.
Uniform starts miss symmetric shapes, so some have every angle at a multiple of a quarter turn, and
half of all have their direction along a principal axis of the locked inertia.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...reduction.tree.second_derivatives import inertia_derivatives
from .amended_energy import AmendedEnergy, Energies, Points, Which
from .problem import Problem

NEWTON, DESCENT = 60, 200  # steps at most
FOUND = 1e-9  # residual of a critical point
_LONGEST = 0.5  # rad | m, of one step
_FLAT = 1e-9  # of the largest curvature, what counts as none
_SLIDE = 1.0  # m, the reach of a prismatic joint without limits


def residuals(e: Energies) -> Array:
    """Return the largest gradient over the size of the energies, (N,); infinite where it is NaN."""
    size = np.where(e.scale > 0.0, e.scale, 1.0)
    found = np.abs(e.gradient).max(axis=1, initial=0.0) / size
    return np.where(np.isfinite(e.hessian).all(axis=(1, 2)), found, np.inf)


def starting_points(problem: Problem, count: int, rng: np.random.Generator) -> Points:
    """Return random and symmetric points."""
    ma = len(problem.active)
    low, high, turns = _reach(problem)
    x = rng.uniform(low, high, (count, ma))
    quarters = _quarters(int(turns.sum()), count // 4, rng)
    few = min(len(quarters), count)
    x[:few, turns] = 0.5 * np.pi * (quarters[:few] - 1)
    if not problem.directional:
        return Points(x, np.zeros((count, 0)))
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    if few and 3 * few <= count:  # each symmetric shape about each of its principal axes
        x = np.concatenate([np.repeat(x[:few], 3, axis=0), x[few:]])[: max(count, 3 * few)]
        n = np.concatenate([np.zeros((2 * few, 3)), n])[: len(x)]
        along = np.r_[: 3 * few, 3 * few : len(x) : 2]
        which = np.r_[np.tile([0, 1, 2], few), rng.integers(3, size=len(along) - 3 * few)]
    else:
        along = np.arange(0, len(x), 2)
        which = rng.integers(3, size=len(along))
    n[along] = _principal_axes(problem, x[along])[np.arange(len(along)), :, which]
    return Points(x, n)


def _quarters(turns: int, most: int, rng: np.random.Generator) -> NDArray[np.int_]:
    """Return quarter turns (k, turns) of so many angles, each from 0 to 3: all, or at most some."""
    if 4**turns <= most:
        return np.array(list(product(range(4), repeat=turns)), dtype=int).reshape(4**turns, turns)
    return rng.integers(4, size=(most, turns))


def critical_points(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    """Return the critical points that Newton's method reaches from points."""
    found = Points(points.x.copy(), points.n.copy())
    left = np.arange(len(points))
    for _ in range(NEWTON):
        if not left.size:
            break
        e = energy(found[left], J)
        going = np.isfinite(residuals(e)) & (residuals(e) > 1e-14)
        left, e = left[going], _some(e, going)
        step = -_solved(e, absolute=False)
        moved = found[left].moved(_clipped(step, _LONGEST))
        found.x[left], found.n[left] = moved.x, moved.n
        left = left[np.linalg.norm(step, axis=1) > 1e-13]
    return _converged(energy, found, J)


def minima(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    """Return the minima below points."""
    found = Points(points.x.copy(), points.n.copy())
    left, radius = np.arange(len(points)), np.full(len(points), _LONGEST)
    e = energy(found, J)
    left, e = left[np.isfinite(residuals(e))], _some(e, np.isfinite(residuals(e)))
    for _ in range(DESCENT if left.size else 0):
        step = _clipped(-_solved(e, absolute=True), radius[left])
        tried = found[left].moved(step)
        new = energy(tried, J)
        lower = np.isfinite(residuals(new)) & (e.U + 1e-15 * e.scale >= new.U)
        found.x[left[lower]], found.n[left[lower]] = tried.x[lower], tried.n[lower]
        radius[left] = np.where(
            lower, np.minimum(2.0 * radius[left], _LONGEST), 0.25 * radius[left]
        )
        e = _chosen(lower, new, e)
        going = (residuals(e) > 1e-12) & (radius[left] > 1e-12)
        left, e = left[going], _some(e, going)
        if not left.size:
            break
    return critical_points(energy, found, J)


def polished(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    """Return points after a few Newton steps, each only where it lowers the residual."""
    e = energy(points, J)
    for _ in range(4 if len(points) else 0):
        tried = points.moved(-_solved(e, absolute=False))
        new = energy(tried, J)
        better = residuals(new) < residuals(e)
        points = Points(
            np.where(better[:, None], tried.x, points.x),
            np.where(better[:, None], tried.n, points.n),
        )
        e = _chosen(better, new, e)
        if not better.any():
            break
    return points, e


def _converged(energy: AmendedEnergy, points: Points, J: float) -> tuple[Points, Energies]:
    e = energy(points, J)
    good = residuals(e) <= FOUND
    return points[good], _some(e, good)


def _solved(e: Energies, *, absolute: bool) -> Array:
    """Return H⁻¹ g, (N, u), or |H|⁻¹ g, without the directions in which H is flat."""
    if not e.gradient.shape[1]:
        return e.gradient
    values, vectors = np.linalg.eigh(e.hessian)
    parts = (np.swapaxes(vectors, 1, 2) @ e.gradient[..., None])[..., 0]
    size = np.abs(values)
    floor = _FLAT * size.max(axis=1, keepdims=True)
    if absolute:
        parts = parts / np.maximum(size, np.where(floor > 0.0, floor, 1.0))
    else:
        flat = size <= floor
        parts = np.where(flat, 0.0, parts / np.where(flat, 1.0, values))
    return np.asarray((vectors @ parts[..., None])[..., 0])


def _clipped(step: Array, longest: float | Array) -> Array:
    size = np.linalg.norm(step, axis=1)
    return np.asarray(step * np.minimum(1.0, longest / np.maximum(size, 1e-300))[:, None])


def _some(e: Energies, which: Which) -> Energies:
    return Energies(**{name: getattr(e, name)[which] for name in e.__dataclass_fields__})


def _chosen(which: NDArray[np.bool_], one: Energies, other: Energies) -> Energies:
    """Return the entries of one where `which` says so, else of the other."""
    out = {}
    for name in one.__dataclass_fields__:
        a, b = getattr(one, name), getattr(other, name)
        out[name] = np.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b)
    return Energies(**out)


def _reach(problem: Problem) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return least and greatest values of the active joints, and which of them turn."""
    system, active = problem.system, list(problem.active)
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
        across = d.H[:, r - 3 : r, : r - 3]
        I = I - across @ np.linalg.solve(d.H[:, : r - 3, : r - 3], np.swapaxes(across, 1, 2))
    return np.asarray(np.linalg.eigh(I)[1])
