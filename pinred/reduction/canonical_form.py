"""The reduced equations in canonical form, without the equation of the body momentum.

Both engines integrate this form.  Here Pinocchio evaluates it, for the engine in
simulation/pinocchio_engine.py, which also computes the rate of the body momentum.

In the variables shape x, canonical momentum π = ∂L/∂ẋ and body momentum μ, the equations have no
curvature term:

    H(x) [ξ; ẋ] = [μ; π]
    π̇_α = ½ vᵀ ∂_αH v − ∂_αV,   v = (ξ, ẋ)

Pinocchio's Coriolis matrix C satisfies Ḣ = C + Cᵀ, so ½ vᵀ ∂_αH v are the shape rows of Cᵀ v.  An
evaluation takes one CRBA, one linear solve and one Coriolis matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import SingularInertiaError
from ..common.names import quoted
from ..system.loops.kinematics import loop_jacobian, loop_jacobian_rate
from ..system.system import System
from .pointwise_reduction import (
    com_derivative,
    mass_matrix,
    symmetric,
    usual_inertias,
    usual_mass_matrices,
)
from .potential import Potential
from .tree.loop_constraints import GAUGE_RATE

# The mass matrix counts as singular if its least eigenvalue is below this multiple of its typical
# value.  The eigenvalue falls with the square of the distance from a singular shape.
_SINGULAR = 1e-6
# A coordinate belongs to a singular motion if its amplitude exceeds this fraction of the largest.
_SHARE = 0.1


class CanonicalForm:
    """Velocities and shape forces of one system in canonical variables.  Not thread-safe."""

    def __init__(self, system: System, potential: Potential) -> None:
        """Prepare Pinocchio's work space, and import LAPACK."""
        from scipy.linalg.lapack import dposv

        self._dposv = dposv
        self._system = system
        self._model = system.sorted_model
        # `com` reads the results of the last CRBA, so this work space must not be shared.
        self._data = pin.Data(system.sorted_model)
        self._identity = system.group.identity()
        self._r = system.r
        self._least = np.finfo(float).eps * usual_inertias(system).min() if system.doubts else 0.0
        self._gradient = None if potential.is_zero else potential.gradient

    def mass_matrix(self, x: Array) -> Array:
        """Compute the mass matrix and the centre of mass with one CRBA call.

        Args:
            x: Shape, (m,).
        Returns:
            H(x), (n, n), of which only the upper triangle is guaranteed.
        """
        upper = pin.crba(self._model, self._data, self._system.sorted_q(self._identity, x))
        if self._system.coupled is None:
            return np.asarray(upper)
        return self._system.coupled_matrix(symmetric(upper))

    def com(self) -> Array:
        """Return the centre of mass in the root body's frame at the last shape, (3,) [m]."""
        return np.array(self._data.Ycrb[1].lever)

    def com_slope(self, x: Array) -> Array:
        """Return ∂c/∂x of the centre of mass in the root body's frame, (3, m)."""
        return com_derivative(self._system, x)

    def velocity(self, x: Array, momentum: Array) -> Array:
        """Solve H v = (μ, π) for v = (ξ, ẋ).

        Args:
            x: Shape, (m,).
            momentum: (μ, π), (n,); with closed loops, π is an impetus.
        Returns:
            Velocity v, (n,), which keeps loops closed.
        Raises:
            SingularInertiaError: The mass matrix is singular.
        """
        if self._system.closure is not None:
            return self._closed_velocity(x, momentum)[0]
        return self._solve(self.mass_matrix(x), momentum, x)

    def loop_terms(
        self, x: Array, xdot: Array, momentum: Array, driven: Sequence[int] = ()
    ) -> Array:
        """Return J̇ᵀν − γ Jᵀν, (m,): terms of the rate of the impetus, see LoopTerms.

        Args:
            x: Shape, (m,).
            xdot: Shape rate at this momentum, (m,).
            momentum: (μ, p), (n,), with the impetus p.
            driven: Indices of the prescribed shape joints.
        Returns:
            The terms; zeros without loops.
        """
        if self._system.closure is None:
            return np.zeros(len(xdot))
        rows = self._system.closure.rows
        _, nu = self._closed_velocity(x, momentum, driven, xdot[list(driven)])
        J = loop_jacobian(self._system, x)[rows]
        rate = loop_jacobian_rate(self._system, x, xdot)[rows]
        return np.asarray(nu @ rate - GAUGE_RATE * nu @ J)

    def _closed_velocity(
        self, x: Array, momentum: Array, driven: Sequence[int] = (), rates: Array | None = None
    ) -> tuple[Array, Array]:
        """Solve [H Jᵀ; J 0] [v; ν] = [(μ, p); 0], with given rates of prescribed joints."""
        assert self._system.closure is not None
        n, v = len(momentum), np.zeros(len(momentum))
        J = np.zeros((self._system.closure.rank, n))
        J[:, self._r :] = loop_jacobian(self._system, x)[self._system.closure.rows]
        H, momentum = self.mass_matrix(x), momentum.copy()
        free = np.setdiff1d(np.arange(n), self._r + np.array(driven, dtype=np.intp))
        if len(free) < n:
            H, fixed = symmetric(H), np.setdiff1d(np.arange(n), free)
            v[fixed] = rates
            momentum = momentum - H @ v
            H = H[np.ix_(free, free)]
        solved = self._solve(H, np.column_stack([momentum[free], J[:, free].T]), x)
        open_rates, response = solved[:, 0], solved[:, 1:]
        nu = np.linalg.solve(J[:, free] @ response, J[:, free] @ open_rates + J @ v)
        v[free] = open_rates - response @ nu
        return v, np.asarray(nu)

    def driven_velocity(
        self, x: Array, momentum: Array, driven: Sequence[int], rates: Array
    ) -> Array:
        """Solve H v = (μ, π) for v = (ξ, ẋ) where the rates of some shape joints are prescribed.

        Args:
            x: Shape, (m,).
            momentum: (μ, π), (n,); the momenta of prescribed joints are not read.
            driven: Indices of the prescribed shape joints.
            rates: Rates of these joints.
        Returns:
            Velocity v, (n,).
        """
        if self._system.closure is not None:
            return self._closed_velocity(x, momentum, driven, rates)[0]
        H = symmetric(self.mass_matrix(x))
        fixed = self._r + np.array(driven, dtype=np.intp)
        is_free = np.ones(len(momentum), bool)
        is_free[fixed] = False
        free = np.flatnonzero(is_free)
        v = np.empty(len(momentum))
        v[fixed] = rates
        momentum_of_free = momentum[free] - H[np.ix_(free, fixed)] @ rates
        v[free] = self._solve(H[np.ix_(free, free)], momentum_of_free, x)
        return v

    def force(self, x: Array, v: Array) -> Array:
        """Return the rate of the canonical momentum, π̇ = ½ vᵀ ∂H v − ∂V, (m,)."""
        q = self._system.sorted_q(self._identity, x)
        v = self._system.joint_rates(v)
        C = pin.computeCoriolisMatrix(self._model, self._data, q, v)
        if self._system.coupled is None:
            force = np.asarray(v @ C[:, self._r :])
        else:
            force = self._system.on_shape(v @ C)[self._r :]
        return force if self._gradient is None else force - self._gradient(x)

    def _solve(self, H: Array, momentum: Array, x: Array) -> Array:
        factor, v, info = self._dposv(H, momentum)
        # If the matrix may become singular, its pivots must exceed round-off.
        if info or (self._least and not factor.diagonal().min() ** 2 > self._least):
            raise SingularInertiaError(
                f"the mass matrix of '{self._system.name}' is not positive definite at x = {x}"
                f"{lost_inertia(self._system, x)}"
            )
        return np.asarray(v)


def lost_inertia(system: System, x: Array) -> str:
    """Describe the joint that moves almost no mass, for the end of an error message.

    Args:
        system: The system.
        x: Shape, (m,).
    Returns:
        The description. It is empty if the least eigenvalue of the mass matrix, scaled by typical
        inertias, is not far below its value at random shapes.
    """
    if not np.isfinite(x).all():
        return ""
    size, usual_matrices = np.sqrt(usual_inertias(system)), usual_mass_matrices(system)
    if not (size > 0.0).all():
        return ""
    scale = np.outer(size, size)
    usual = float(np.median([np.linalg.eigvalsh(H / scale)[0] for H in usual_matrices]))
    eigenvalues, directions = np.linalg.eigh(mass_matrix(system, x) / scale)
    if not eigenvalues[0] < _SINGULAR * usual:
        return ""
    share = np.abs(directions[:, 0])
    i = int(np.argmax(share > _SHARE * share.max()))
    who = (
        f"the root joint {quoted(system.root_name)}"
        if i < system.r
        else f"joint {quoted(system.shape_names[i - system.r])}"
    )
    return f"; the mass matrix is singular there or nearby, where {who} moves no mass"
