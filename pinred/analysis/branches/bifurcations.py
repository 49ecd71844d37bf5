"""Bifurcations of relative equilibria: points of a curve where a Hessian eigenvalue vanishes.

F(z, J) = 0 is the equation of the curve, see `curve`; "curvatures" are the eigenvalues of ∂F/∂z.
At a bifurcation, ∂F/∂z has a null vector v. If v·∂F/∂J ≠ 0, the curve reverses in momentum: the
point is a fold. Otherwise a second curve crosses it. The crossing is a pitchfork if the third
derivative along v vanishes, as a mirror symmetry implies. A fold must solve the extended system

    F(z, J) = 0,   ∂F/∂z v = 0,   |v| = 1

and must appear again with half the step. Otherwise it is an artefact of long steps.
Source: R. Seydel, "Practical bifurcation and stability analysis", 2010, ch. 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...common.arrays import Array
from ..equilibria.amended_energy import Energies
from ..equilibria.points import Points
from .curve import Curve, CurvePoint

_FOLD = 1e-6  # least |v·∂F/∂J| that counts as a fold, relative to |∂F/∂J|
_EVEN = 1e-4  # largest third derivative of a pitchfork, relative to the curvatures
_SAME_FOLD = 1e-7  # largest relative change of a fold's momentum with half the step
_STEP = 1e-3  # step of the finite differences along the null vector [rad]


@dataclass(frozen=True)
class Bifurcation:
    """A point of a curve where a curvature (an eigenvalue of the Hessian) is zero.

    Attributes:
        kind: "fold", "pitchfork" or "crossing".
        at: Point of the curve.
        null: Null vector v of ∂F/∂z, (u,).
        residual: Relative residual of F = 0 and ∂F/∂z v = 0.
    """

    kind: Literal["fold", "pitchfork", "crossing"]
    at: CurvePoint
    null: Array
    residual: float


def bifurcations_between(curve: Curve, a: CurvePoint, b: CurvePoint, h: float) -> list[Bifurcation]:
    """Return the bifurcations between two points of a curve.

    Args:
        curve: The curve.
        a: Point before the step.
        b: Point after the step.
        h: Length of the step [rad].
    Returns:
        Bifurcations, sorted by distance from a.
    """
    bifurcations = []
    for k in range(min(a.index, b.index), max(a.index, b.index)):
        zero = locate_zero(curve, a, h, k)
        if zero is None:
            continue
        bifurcation = classify(curve, zero)
        if bifurcation is not None and (
            bifurcation.kind != "fold" or _is_confirmed(curve, a, h, k, zero)
        ):
            bifurcations.append(bifurcation)
    return sorted(bifurcations, key=lambda item: _distance(item.at, a))


def _distance(one: CurvePoint, other: CurvePoint) -> float:
    return float(np.linalg.norm(other.points.shape_difference(one.points)))


def locate_zero(curve: Curve, a: CurvePoint, h: float, k: int) -> CurvePoint | None:
    """Locate the zero of the k-th curvature within one step of the curve.

    Args:
        curve: The curve.
        a: Point before the step.
        h: Length of the step [rad].
        k: Index of the curvature.
    Returns:
        The point, or None if the curvature does not change sign or the curve cannot be followed.
    """
    low, high = 0.0, h
    end = curve.step(a, h)
    if end is None or a.values[k] * end.values[k] > 0.0:
        return None
    f_low, f_high = float(a.values[k]), float(end.values[k])
    best = end if abs(f_high) < abs(f_low) else a
    for n in range(80):
        # Take secant steps, with a bisection at every third iteration so that the bracket shrinks.
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


def classify(curve: Curve, at: CurvePoint) -> Bifurcation | None:
    """Classify a point with a zero curvature; return None if no curvature vanishes."""
    v, F_J = curve.null_vector(at), curve.slope_by_momentum(at)
    e = curve.energy(at.points, at.J)
    size = _size(e)
    residual = max(float(np.abs(e.hessian[0] @ v).max()) / size, at.residual)
    if residual > 1e-7:
        return None
    # On symmetric shapes ∂F/∂J may vanish, so the bound also scales with the curvatures.
    if abs(v @ F_J) > _FOLD * max(float(np.linalg.norm(F_J)), size / curve.unit):
        return Bifurcation("fold", at, v, residual)
    curvatures = []
    for sign in (1.0, -1.0):
        energies = curve.energy(at.points.moved(sign * _STEP * v[None]), at.J)
        neighbour = at.points.moved(sign * _STEP * v[None])
        direction = _transported(curve, at, neighbour, v)
        curvatures.append(float(direction @ energies.hessian[0] @ direction))
    third_derivative = (curvatures[0] - curvatures[1]) / (2.0 * _STEP)
    kind: Literal["pitchfork", "crossing"] = (
        "pitchfork" if abs(third_derivative) <= _EVEN * size else "crossing"
    )
    return Bifurcation(kind, at, v, residual)


def _size(e: Energies) -> float:
    """Return the magnitude of the curvatures, relative to which a curvature counts as zero."""
    return max(float(np.abs(e.hessian).max()), float(e.scale[0]), 1e-300)


def _transported(curve: Curve, at: CurvePoint, there: Points, v: Array) -> Array:
    """Convert a direction (u,) to the tangent coordinates at another point.

    Args:
        curve: The curve.
        at: Point where v is defined.
        there: The other point.
        v: Direction, (u,).
    Returns:
        The same direction in the tangent coordinates at the other point, (u,).
    """
    ambient = curve.ambient(at, v)
    return curve.local(there.n, ambient)[:-1]


def _is_confirmed(curve: Curve, a: CurvePoint, h: float, k: int, fold: CurvePoint) -> bool:
    """Return whether a fold solves the extended system and appears again with half the step.

    Args:
        curve: The curve.
        a: Point before the step that contains the fold.
        h: Length of the step [rad].
        k: Index of the curvature that vanishes.
        fold: The fold.
    Returns:
        False if the fold is an artefact of the step.
    """
    if not extended_residual(curve, fold) <= 1e-9:
        return False
    point: CurvePoint | None = a
    for _ in range(4):  # Two half steps may span less of a bent curve than one full step.
        assert point is not None
        next_point = curve.step(point, 0.5 * h)
        if next_point is None:
            return False
        if point.values[k] * next_point.values[k] <= 0.0:
            zero = locate_zero(curve, point, 0.5 * h, k)
            return zero is not None and abs(zero.J - fold.J) <= _SAME_FOLD * max(
                abs(fold.J), curve.unit
            )
        point = next_point
    return False


def extended_residual(curve: Curve, fold: CurvePoint) -> float:
    """Compute the distance between a fold and the solution of the extended system.

    Newton's method starts close to the fold.

    Args:
        curve: The curve.
        fold: The fold.
    Returns:
        Difference in momentum, relative to the curve's unit; infinite without convergence.
    """
    from scipy.optimize import root

    energy, u = curve.energy, curve.energy.problem.unknowns
    v = curve.null_vector(fold)
    scale = _size(energy(fold.points, fold.J))

    def extended(unknown: Array) -> Array:
        step, J, w = unknown[:u], fold.J + unknown[u] * curve.unit, unknown[u + 1 :]
        point = fold.points.moved(step[None])
        energies = energy(point, J)
        direction = _transported(curve, fold, point, w)
        return np.concatenate(
            [energies.gradient[0] / scale, energies.hessian[0] @ direction / scale, [w @ w - 1.0]]
        )

    start = np.concatenate([1e-3 * v, [1e-4], v])
    solution = root(extended, start, method="hybr", options={"xtol": 1e-14, "maxfev": 400 * u})
    if not np.abs(solution.fun).max() <= 1e-10 or not np.linalg.norm(solution.x[:u]) <= 0.1:
        return np.inf
    return (
        float(abs(solution.x[u]))
        if abs(solution.x[u]) > 1e-9
        else float(np.abs(solution.fun).max())
    )
