"""The mass matrix at one shape, split along the symmetry, and its singular directions.

H(x) = [[I, IA], [AᵀI, M̃]],   A = I⁻¹ H_bs,   M = H_ss − Aᵀ I A.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays, vector
from ..common.errors import SingularInertiaError
from ..common.names import quoted
from ..system.system import System

_SAMPLES = 20  # number of random shapes that determine typical inertias
# The mass matrix counts as singular if its least eigenvalue is below this multiple of its typical
# value.  The eigenvalue falls with the square of the distance from a singular shape.
_SINGULAR = 1e-6
# A coordinate belongs to a singular motion if its amplitude exceeds this fraction of the largest.
_SHARE = 0.1


@checks_arguments
@dataclass(frozen=True)
class InertiaSplit(FrozenArrays):
    """Blocks of the mass matrix at one shape, and their Schur complement; read-only arrays.

    Attributes:
        x: Shape, (nx,) [rad | m | 1].
        mass_matrix: Mass matrix H, (n, n), base rows first.
        locked_inertia: Locked inertia I, (r, r).
        local_connection: Local connection A, (r, m).
        reduced_metric: Reduced metric M, (m, m).
        com: Centre of mass in the root body's frame, (3,) [m].
    """

    x: Array
    mass_matrix: Array
    locked_inertia: Array
    local_connection: Array
    reduced_metric: Array
    com: Array

    @property
    def r(self) -> int:
        """Dimension of the group."""
        return len(self.locked_inertia)

    def kinetic_energy(self, xdot: ArrayLike, xi: ArrayLike) -> float:
        """Compute the kinetic energy ½ vᵀ H v, v = (ξ, ẋ).

        Args:
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            The energy [J].
        """
        v = self._velocity(xdot, xi)
        return 0.5 * float(v @ self.mass_matrix @ v)

    def body_momentum(self, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """Compute the body momentum μ = I ξ + I A ẋ.

        Args:
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            (r,), in the frame of the root body.
        """
        return np.asarray(self.mass_matrix[: self.r] @ self._velocity(xdot, xi))

    def locked_velocity(self, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """Compute the locked velocity Ω = ξ + A ẋ, the twist after all joints are locked.

        Args:
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            (r,); the body momentum is μ = I Ω.
        """
        v = self._velocity(xdot, xi)
        return np.asarray(v[: self.r] + self.local_connection @ v[self.r :])

    def locked_energy(self, mu: ArrayLike) -> float:
        """Compute the energy ½ μᵀ I⁻¹ μ with locked joints.

        Args:
            mu: Body momentum, (r,) [N s | N m s].
        Returns:
            The energy [J].
        """
        mu = vector(mu, self.r, "mu")
        return 0.5 * float(mu @ np.linalg.solve(self.locked_inertia, mu))

    def _velocity(self, xdot: ArrayLike, xi: ArrayLike) -> Array:
        m = len(self.reduced_metric)
        return np.concatenate([vector(xi, self.r, "xi"), vector(xdot, m, "xdot")])


def split_inertia(system: System, x: Array, H: Array, com: Array) -> InertiaSplit:
    """Split a mass matrix along the symmetry.

    Args:
        system: The system.
        x: Shape, (nx,) [rad | m | 1].
        H: Mass matrix, (n, n).
        com: Centre of mass in the root body's frame, (3,) [m].
    Returns:
        The split.  Raises SingularInertiaError, naming the direction without inertia, if H is not
        positive definite to working precision.
    """
    r, L = system.r, cholesky(H, system, x)
    return InertiaSplit(
        x=x,
        mass_matrix=H,
        locked_inertia=H[:r, :r].copy(),
        # The blocks of H = L Lᵀ give I = L₁₁L₁₁ᵀ, A = L₁₁⁻ᵀ L₂₁ᵀ, and M = L₂₂L₂₂ᵀ without
        # cancellation.
        # SciPy's triangular solver would start threads even for such small matrices.
        local_connection=np.asarray(np.linalg.solve(L[:r, :r].T, L[r:, :r].T)),
        reduced_metric=L[r:, r:] @ L[r:, r:].T,
        com=com,
    )


def cholesky(H: Array, system: System, x: Array) -> Array:
    """Factor H = L Lᵀ.

    Args:
        H: Mass matrix, (n, n).
        system: The system, to name its joints.
        x: Shape, (nx,) [rad | m | 1].
    Returns:
        L, (n, n), lower triangular.
    Raises:
        SingularInertiaError: H is not positive definite to working precision.
    """
    try:
        L = np.asarray(np.linalg.cholesky(H), dtype=float)
    except np.linalg.LinAlgError:
        eigenvalues, directions = np.linalg.eigh(H)
        i = int(np.argmax(np.abs(directions[:, 0])))
        reason = f"least eigenvalue {eigenvalues[0]:.3g}"
    else:
        # A squared pivot is the inertia of its coordinate when all earlier coordinates are free to
        # move.
        size = np.diag(H)
        if system.doubts:
            size = np.maximum(size, usual_inertias(system))
        independent = np.diag(L) ** 2 / size
        if (independent > len(H) * np.finfo(float).eps).all():
            return np.asarray(L)
        i = int(np.argmin(independent))
        reason = f"{independent[i]:.1e} of its inertia is its own"
    if i < system.r:
        who = f"direction {i} of the root joint '{system.root_name}'"
    else:
        who = f"joint '{system.shape_names[i - system.r]}'"
    raise SingularInertiaError(
        f"the mass matrix of '{system.name}' is singular to working precision at x = {x}: "
        f"{who} has no inertia of its own ({reason})"
    )


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


def usual_inertias(system: System) -> Array:
    """Return the largest diagonal entries of the mass matrix over some random shapes, (n,)."""
    return np.asarray(np.max([np.diag(H) for H in usual_mass_matrices(system)], axis=0))


def usual_mass_matrices(system: System) -> list[Array]:
    """Return the mass matrices (n, n) at some random shapes; the result is cached."""
    rng = np.random.default_rng(0)
    space = system.space
    shapes = space.integrate(space.neutral, rng.uniform(-np.pi, np.pi, (_SAMPLES, system.m)))
    return system.workspace(usual_mass_matrices, lambda: [mass_matrix(system, x) for x in shapes])


def mass_matrix(system: System, x: Array) -> Array:
    """Compute the mass matrix (n, n) at shape x (m,), even if it is singular."""
    data = system.workspace(mass_matrix, system.sorted_model.createData)
    return mass_matrix_at(system, system.sorted_model, data, system.group.identity(), x)


def mass_matrix_at(
    system: System, model: pin.Model, data: pin.Data, pose: Array, x: Array
) -> Array:
    """Compute the mass matrix of base and shape with CRBA.

    Args:
        system: The system.
        model: Model of the system, or a model that differs from it in gravity only.
        data: Pinocchio's work space, which keeps the results of CRBA.
        pose: Pose coordinates of the base.
        x: Shape, (nx,) [rad | m | 1].
    Returns:
        Mass matrix, (n, n).
    """
    upper = pin.crba(model, data, system.sorted_q(pose, x))
    return system.coupled_matrix(symmetric(upper))


def symmetric(upper: Array) -> Array:
    """Return symmetric matrices (..., n, n) with the upper triangles of H, which CRBA computes."""
    entries = np.where(_upper(upper.shape[-1]), upper, upper.swapaxes(-1, -2))
    return np.add(entries, 0.0, order="C")


@lru_cache(maxsize=64)
def _upper(n: int) -> NDArray[np.bool_]:
    """Return the mask of the upper triangle, (n, n)."""
    return ~np.tri(n, k=-1, dtype=bool)


def com_derivative(system: System, x: Array) -> Array:
    """Compute ∂c/∂x of the centre of mass in the root body's frame, (3, m)."""
    model, data = (
        system.sorted_model,
        system.workspace(com_derivative, system.sorted_model.createData),
    )
    q = system.sorted_q(system.group.identity(), x)
    # With one joint, Pinocchio returns a vector (3,).
    jacobian = pin.jacobianCenterOfMass(model, data, q).reshape(3, -1)
    in_world = system.on_shape(jacobian)[:, system.r :]
    return np.asarray(model.jointPlacements[1].rotation.T @ in_world)
