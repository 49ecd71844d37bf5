"""Folds, pitchforks and crossings: where a curvature passes zero along a curve.

There ∂F/∂z has a null vector v.  If v·∂F/∂J ≠ 0 the curve turns back: a fold.  If it vanishes,
another curve crosses: a pitchfork where the third derivative along v vanishes, as it does on shapes
that v leaves by a mirror symmetry, else a crossing of two curves that both go on.  A fold solves
the extended system

    F(z, J) = 0,   ∂F/∂z v = 0,   |v| = 1

and is found again with steps of half the length; else it is none, but an artefact of long steps.
Source: R. Seydel, "Practical bifurcation and stability analysis", 2010, ch. 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...common.arrays import Array
from ..equilibria.amended_energy import Energies, Points
from .curve import Curve, CurvePoint

_TURNS = 1e-6  # of |∂F/∂J|, its part along the null vector from where on the curve turns back
_EVEN = 1e-4  # of the curvatures, the third derivative that counts as none
_SAME = 1e-7  # of the momentum, by which a fold may move when steps are halved
_STEP = 1e-3  # rad, of the differences along the null vector


@dataclass(frozen=True)
class Bifurcation:
    """A point of a curve at which a curvature is zero.

    null: (u,) the null vector.  residual: of the extended system, relative.
    """

    kind: Literal["fold", "pitchfork", "crossing"]
    at: CurvePoint
    null: Array
    residual: float


def bifurcations_between(curve: Curve, a: CurvePoint, b: CurvePoint, h: float) -> list[Bifurcation]:
    """Return the bifurcations between two points of a curve, a step h apart."""
    out = []
    for k in range(min(a.index, b.index), max(a.index, b.index)):
        at = located(curve, a, h, k)
        if at is None:
            continue
        found = classified(curve, at)
        if found is not None and (found.kind != "fold" or _again(curve, a, h, k, at)):
            out.append(found)
    return sorted(out, key=lambda each: float(np.linalg.norm(each.at.x - a.x)))


def located(curve: Curve, a: CurvePoint, h: float, k: int) -> CurvePoint | None:
    """Return the point within a step h from a at which the k-th curvature is zero."""
    low, high = 0.0, h
    there = curve.step(a, h)
    if there is None or a.values[k] * there.values[k] > 0.0:
        return None
    f_low, f_high = float(a.values[k]), float(there.values[k])
    best = there if abs(f_high) < abs(f_low) else a
    for n in range(80):
        # Illinois: the secant, and the middle now and then.
        s = 0.5 * (low + high) if n % 3 == 2 else (low * f_high - high * f_low) / (f_high - f_low)
        if not low < s < high:
            s = 0.5 * (low + high)
        point = curve.step(a, s)
        if point is None:
            return None
        value = float(point.values[k])
        if abs(value) <= abs(float(best.values[k])):
            best = point
        if value == 0.0 or high - low <= 1e-15 * max(h, 1.0):
            break
        if value * f_low < 0.0:
            high, f_high = s, value
        else:
            low, f_low = s, value
    return best


def classified(curve: Curve, at: CurvePoint) -> Bifurcation | None:
    """Return what a point with a zero curvature is; None if it has none."""
    v, by_J = curve.null_vector(at), curve.slope_by_momentum(at)
    e = curve.energy(at.points, at.J)
    size = _size(e)
    residual = max(float(np.abs(e.hessian[0] @ v).max()) / size, at.residual)
    if residual > 1e-7:
        return None
    # On symmetric shapes ∂F/∂J may vanish, so that it is compared with curvatures, too.
    if abs(v @ by_J) > _TURNS * max(float(np.linalg.norm(by_J)), size / curve.unit):
        return Bifurcation("fold", at, v, residual)
    curvatures = []
    for sign in (1.0, -1.0):
        moved = curve.energy(at.points.moved(sign * _STEP * v[None]), at.J)
        there = at.points.moved(sign * _STEP * v[None])
        along = _carried(curve, at, there, v)
        curvatures.append(float(along @ moved.hessian[0] @ along))
    third = (curvatures[0] - curvatures[1]) / (2.0 * _STEP)
    kind: Literal["pitchfork", "crossing"] = (
        "pitchfork" if abs(third) <= _EVEN * size else "crossing"
    )
    return Bifurcation(kind, at, v, residual)


def _size(e: Energies) -> float:
    """Return the size of curvatures, of which a single one may be zero."""
    return max(float(np.abs(e.hessian).max()), float(e.scale[0]), 1e-300)


def _carried(curve: Curve, at: CurvePoint, there: Points, v: Array) -> Array:
    """Return a direction at another point, in its own tangents."""
    ambient = curve.ambient(at, v)
    return curve.local(there.n, ambient)[:-1]


def _again(curve: Curve, a: CurvePoint, h: float, k: int, fold: CurvePoint) -> bool:
    """Return whether a fold solves the extended system, and is there with half the steps."""
    if not extended_residual(curve, fold) <= 1e-9:
        return False
    here: CurvePoint | None = a
    for _ in range(4):  # the curve bends: half steps cover less of it
        assert here is not None
        there = curve.step(here, 0.5 * h)
        if there is None:
            return False
        if here.values[k] * there.values[k] <= 0.0:
            at = located(curve, here, 0.5 * h, k)
            return at is not None and abs(at.J - fold.J) <= _SAME * max(abs(fold.J), curve.unit)
        here = there
    return False


def extended_residual(curve: Curve, fold: CurvePoint) -> float:
    """Return how far off the solution of the extended system that Newton's method finds is.

    It starts beside the fold; infinite if it does not arrive.  The relative distance in momentum.
    """
    from scipy.optimize import root

    energy, u = curve.energy, curve.energy.problem.unknowns
    v = curve.null_vector(fold)
    scale = _size(energy(fold.points, fold.J))

    def extended(unknown: Array) -> Array:
        step, J, w = unknown[:u], fold.J + unknown[u] * curve.unit, unknown[u + 1 :]
        point = fold.points.moved(step[None])
        e = energy(point, J)
        along = _carried(curve, fold, point, w)
        return np.concatenate([e.gradient[0] / scale, e.hessian[0] @ along / scale, [w @ w - 1.0]])

    first = np.concatenate([1e-3 * v, [1e-4], v])
    found = root(extended, first, method="hybr", options={"xtol": 1e-14, "maxfev": 400 * u})
    if not np.abs(found.fun).max() <= 1e-10 or not np.linalg.norm(found.x[:u]) <= 0.1:
        return np.inf
    return float(abs(found.x[u])) if abs(found.x[u]) > 1e-9 else float(np.abs(found.fun).max())
