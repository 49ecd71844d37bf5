"""The curve of critical points over the momentum, by pseudo-arclength.

With F = ∂U/∂z at z = (x, n) and momentum J, a point of the curve and its unit tangent t solve

    F(z, J) = 0,     [∂F/∂z, ∂F/∂J] t = 0,

and the next point is where the plane across t, a step h further, meets the curve (Newton).  Lengths
are in radians; the momentum counts by a unit of its own.  Source: H. B. Keller, "Numerical solution
of bifurcation and nonlinear eigenvalue problems", 1977.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ..equilibria.amended_energy import AmendedEnergy, Energies, Points, tangents
from ..equilibria.search import residuals
from ..stability.second_variation import weights

FLAT = 1e-7  # of the largest curvature; below it a direction is flat
_NEWTON = 8
_NEAR = 1e-7


@dataclass(frozen=True)
class CurvePoint:
    """A point of the curve; arrays are read-only.

    x: (ma,), n: (3,) or (0,), J: the momentum.  tangent: (ma + 3 or ma, and J's last), unit length
    where J counts by its unit.  values: (u,) curvatures, as of SecondVariation, sorted.
    """

    x: Array
    n: Array
    J: float
    tangent: Array
    values: Array
    residual: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def points(self) -> Points:
        """The point alone, as a Points of length one."""
        return Points(self.x[None], self.n[None])

    @property
    def index(self) -> int:
        """Number of negative curvatures."""
        return int((self.values < -FLAT * np.abs(self.values).max(initial=0.0)).sum())


class Curve:
    """The curves of one problem.  unit: of the momentum, that counts as 1 rad."""

    def __init__(self, energy: AmendedEnergy, unit: float) -> None:
        """Take the amended potential."""
        self.energy, self.unit = energy, unit

    def start(self, point: Points, J: float, along: Array | None = None) -> CurvePoint:
        """Return the point of the curve at a critical point.

        along: (k,) a tangent to begin with, else towards larger momentum.
        """
        e = self.energy(point, J)
        size = point.x.shape[1] + point.n.shape[1]
        if along is None:
            along = np.zeros(size + 1)
            along[-1] = 1.0
        return self._point(point, J, e, along)

    def step(self, here: CurvePoint, h: float, plane: Array | None = None) -> CurvePoint | None:
        """Return the point a step h further, or None where Newton's method does not arrive.

        plane: (k,) what to go along, instead of the tangent.
        """
        along = here.tangent if plane is None else plane
        point = here.points.moved(h * self.local(here.n[None], along)[None, :-1])
        J = here.J + h * along[-1] * self.unit
        for _ in range(_NEWTON):
            e = self.energy(point, J)
            if not np.isfinite(residuals(e))[0]:
                return None
            t = self.local(point.n, along)
            gone = self._gone(here, point, J) @ along - h
            matrix = np.vstack([self._slope(e), t])
            right = np.append(e.gradient[0], gone)
            change = -np.linalg.lstsq(matrix, right, rcond=1e-13)[0]
            point = point.moved(change[None, :-1])
            J += change[-1] * self.unit
            if np.linalg.norm(change) <= _NEAR:  # whose square is round-off
                break
        e = self.energy(point, J)
        if not residuals(e)[0] <= 1e-10 or np.linalg.norm(self._gone(here, point, J)) > 2.0 * h:
            return None
        return self._point(point, float(J), e, along)

    def slope_by_momentum(self, here: CurvePoint) -> Array:
        """Return ∂F/∂J, (u,)."""
        return np.asarray(self.energy(here.points, here.J).by_momentum[0])

    def null_vector(self, here: CurvePoint) -> Array:
        """Return the direction (u,) of least curvature, of unit length."""
        hessian = self.energy(here.points, here.J).hessian[0]
        W = weights(self.energy.problem, here.points)
        values, vectors = np.linalg.eigh(W @ hessian @ W)
        v = W @ vectors[:, int(np.argmin(np.abs(values)))]
        return np.asarray(v / np.linalg.norm(v))

    def ambient(self, here: CurvePoint, local: Array, momentum: float = 0.0) -> Array:
        """Return a direction (k,) in the coordinates of tangents from one in (u,)."""
        ma = len(here.x)
        turned = tangents(here.n[None])[0] @ local[ma:] if here.n.size else np.zeros(0)
        return np.concatenate([local[:ma], turned, [momentum]])

    def _point(self, point: Points, J: float, e: Energies, along: Array) -> CurvePoint:
        W = weights(self.energy.problem, point)
        values = np.linalg.eigvalsh(W @ e.hessian[0] @ W)
        before = self.local(point.n, along)
        _, _, rows = np.linalg.svd(self._slope(e))
        # Of all null directions (of a family, or at a crossing), the one that goes on as before.
        rank = len(rows) - 1
        singular = np.linalg.svd(self._slope(e), compute_uv=False)
        if singular.size:
            rank = min(rank, int((singular > 1e-9 * singular[0]).sum()))
        null = rows[rank:]
        t = null.T @ (null @ before)
        size = float(np.linalg.norm(t))
        t = null[-1] if size < 1e-9 else t / size
        ma = point.x.shape[1]
        turned = tangents(point.n)[0] @ t[ma:-1] if point.n.size else np.zeros(0)
        tangent = np.concatenate([t[:ma], turned, t[-1:]])
        return CurvePoint(
            point.x[0].copy(), point.n[0].copy(), J, tangent, values, float(residuals(e)[0])
        )

    def _slope(self, e: Energies) -> Array:
        """Return [∂F/∂z, ∂F/∂J], (u, u + 1)."""
        return np.hstack([e.hessian[0], self.unit * e.by_momentum[0][:, None]])

    def local(self, n: Array, along: Array) -> Array:
        """Return a direction (u + 1,) on the sphere at n (1, 3) from one in its space."""
        if not n.size:
            return along
        T = tangents(n.reshape(1, 3))[0]
        return np.concatenate([along[:-4], T.T @ along[-4:-1], along[-1:]])

    def _gone(self, here: CurvePoint, point: Points, J: float) -> Array:
        """Return how far a point is from another, (k,)."""
        return np.concatenate(
            [point.x[0] - here.x, point.n[0] - here.n, [(J - here.J) / self.unit]]
        )
