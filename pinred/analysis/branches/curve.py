"""The curve of critical points over the momentum, computed by pseudo-arclength continuation.

With F = ∂U/∂z at z = (x, n) and momentum J, a point of the curve and its unit tangent t solve

    F(z, J) = 0,     [∂F/∂z, ∂F/∂J] t = 0.

Newton's method computes the next point: the intersection of the curve with the plane normal to t
at distance h. Lengths are in radians; one unit of momentum counts as one radian.
Source: H. B. Keller, "Numerical solution of bifurcation and nonlinear eigenvalue problems", 1977.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, FrozenArrays
from ...system.coordinates import ShapeSpace
from ..equilibria.amended_energy import AmendedEnergy, Energies
from ..equilibria.points import Points, tangents
from ..equilibria.search import residuals
from ..stability.second_variation import weights

FLAT = 1e-7  # curvature below which a direction is flat, relative to the largest curvature
_MAX_ITERATIONS = 8  # largest number of Newton iterations
_CONVERGED = 1e-7  # largest Newton step at convergence; its square is below round-off


@dataclass(frozen=True)
class CurvePoint(FrozenArrays):
    """A point of the curve. Arrays are read-only.

    Attributes:
        x: Coordinates of the active joints, (k,) [rad | m | 1].
        n: Direction, (3,), or (0,) if there is none.
        J: Momentum.
        tangent: Unit tangent in (x, n, J), (ma + 4,) or (ma + 1,), along the frame of the shape and
            with J in the curve's unit.
        values: Curvatures as in SecondVariation, (u,) [1/s²], sorted.
        residual: Relative residual of F = 0.
        space: Manifold of the active joints; None if they are hinges and slides.
    """

    x: Array
    n: Array
    J: float
    tangent: Array
    values: Array
    residual: float
    space: ShapeSpace | None = None

    @property
    def points(self) -> Points:
        """The point as a Points of length one."""
        return Points(self.x[None], self.n[None], self.space)

    @property
    def index(self) -> int:
        """Number of negative curvatures."""
        return int((self.values < -FLAT * np.abs(self.values).max(initial=0.0)).sum())


class Curve:
    """Continuation of the curves of critical points of one problem.

    Attributes:
        energy: Amended potential U as a function of z = (x, n) and J.
        unit: Momentum that counts as 1 rad in arc lengths [N s | N m s].
    """

    def __init__(self, energy: AmendedEnergy, unit: float) -> None:
        """Store the amended potential and the unit of momentum."""
        self.energy, self.unit = energy, unit

    def start(self, point: Points, J: float, along: Array | None = None) -> CurvePoint:
        """Return the curve point at a critical point.

        Args:
            point: Critical point, a Points of length one.
            J: Momentum.
            along: Direction closest to the tangent, (k,); None: larger momentum.
        Returns:
            The point, with its tangent.
        """
        energies = self.energy(point, J)
        size = point.dimension + point.n.shape[1]
        if along is None:
            along = np.zeros(size + 1)
            along[-1] = 1.0
        return self._point(point, J, energies, along)

    def step(self, here: CurvePoint, h: float, plane: Array | None = None) -> CurvePoint | None:
        """Compute the next point of the curve.

        Args:
            here: Current point.
            h: Step [rad].
            plane: Direction of the step, (k,), instead of the tangent.
        Returns:
            The point, or None if Newton's method does not converge.
        """
        direction = here.tangent if plane is None else plane
        point = here.points.moved(h * self.local(here.n[None], direction)[None, :-1])
        J = here.J + h * direction[-1] * self.unit
        for _ in range(_MAX_ITERATIONS):
            energies = self.energy(point, J)
            if not np.isfinite(residuals(energies))[0]:
                return None
            normal = self.local(point.n, direction)
            defect = self._difference(here, point, J) @ direction - h
            matrix = np.vstack([self._derivative(energies), normal])
            residual = np.append(energies.gradient[0], defect)
            change = -np.linalg.lstsq(matrix, residual, rcond=1e-13)[0]
            point = point.moved(change[None, :-1])
            J += change[-1] * self.unit
            if np.linalg.norm(change) <= _CONVERGED:
                break
        energies = self.energy(point, J)
        if (
            not residuals(energies)[0] <= 1e-10
            or np.linalg.norm(self._difference(here, point, J)) > 2.0 * h
        ):
            return None
        return self._point(point, float(J), energies, direction)

    def slope_by_momentum(self, here: CurvePoint) -> Array:
        """Return the derivative of the gradient F with respect to the momentum, ∂F/∂J, (u,)."""
        return np.asarray(self.energy(here.points, here.J).by_momentum[0])

    def null_vector(self, here: CurvePoint) -> Array:
        """Return the unit direction (u,) of least absolute curvature."""
        hessian = self.energy(here.points, here.J).hessian[0]
        W = weights(self.energy.problem, here.points)
        values, vectors = np.linalg.eigh(W @ hessian @ W)
        v = W @ vectors[:, int(np.argmin(np.abs(values)))]
        return np.asarray(v / np.linalg.norm(v))

    def ambient(self, here: CurvePoint, local: Array) -> Array:
        """Convert a direction (u,) to the coordinates (k,) of tangents.

        Args:
            here: Point where the direction is defined.
            local: Direction in (x, tangent coordinates of the sphere), (u,).
        Returns:
            Direction in (x, n, J), (k,), with component zero along J.
        """
        ma = here.points.dimension
        n_direction = tangents(here.n[None])[0] @ local[ma:] if here.n.size else np.zeros(0)
        return np.concatenate([local[:ma], n_direction, [0.0]])

    def _point(self, point: Points, J: float, e: Energies, along: Array) -> CurvePoint:
        """Return the curve point at a solution, with the unit tangent closest to a direction.

        Args:
            point: Critical point, a Points of length one.
            J: Momentum.
            e: Energies at the point.
            along: Direction, (k,).
        Returns:
            The point.
        """
        W = weights(self.energy.problem, point)
        values = np.linalg.eigvalsh(W @ e.hessian[0] @ W)
        direction = self.local(point.n, along)
        _, _, vectors = np.linalg.svd(self._derivative(e))
        # In a family or at a crossing, several null directions exist; keep the previous tangent.
        rank = len(vectors) - 1
        singular = np.linalg.svd(self._derivative(e), compute_uv=False)
        if singular.size:
            rank = min(rank, int((singular > 1e-9 * singular[0]).sum()))
        null = vectors[rank:]
        t = null.T @ (null @ direction)
        length = float(np.linalg.norm(t))
        t = null[-1] if length < 1e-9 else t / length
        ma = point.dimension
        n_direction = tangents(point.n)[0] @ t[ma:-1] if point.n.size else np.zeros(0)
        tangent = np.concatenate([t[:ma], n_direction, t[-1:]])
        return CurvePoint(
            point.x[0].copy(), point.n[0].copy(), J, tangent, values, float(residuals(e)[0]),
            point.space,
        )  # fmt: skip

    def _derivative(self, e: Energies) -> Array:
        """Return the Jacobian [∂F/∂z, ∂F/∂J] of the curve's equations, (u, u + 1)."""
        return np.hstack([e.hessian[0], self.unit * e.by_momentum[0][:, None]])

    def local(self, n: Array, along: Array) -> Array:
        """Convert a direction (k,) to tangent coordinates (u + 1,) of the sphere at n (1, 3)."""
        if not n.size:
            return along
        T = tangents(n.reshape(1, 3))[0]
        return np.concatenate([along[:-4], T.T @ along[-4:-1], along[-1:]])

    def _difference(self, here: CurvePoint, point: Points, J: float) -> Array:
        """Return the difference in (x, n, J) of a point from a curve point, (k,).

        Args:
            here: Curve point.
            point: Other point, a Points of length one.
            J: Momentum of the other point.
        Returns:
            Difference in (x, n, J), with J in the curve's unit, (k,) [rad].
        """
        difference = here.points.difference(point)[0]
        return np.append(difference, (J - here.J) / self.unit)
