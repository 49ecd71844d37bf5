"""The reduction of a system: by Pinocchio at one shape, by compiled code at many shapes.

It also computes the Levi-Civita connections of the reduced metric and of left-invariant metrics.

For the reduced metric M(x) on shape space, with dM[a, b, c] = ∂_c M_ab:

    Γ_{d,ab} = ½ (∂_a M_db + ∂_b M_da − ∂_d M_ab),     Γ^c_ab = M⁻¹^{cd} Γ_{d,ab}
    R_abcd = ½ (∂_b∂_c M_ad + ∂_a∂_d M_bc − ∂_a∂_c M_bd − ∂_b∂_d M_ac)
             + Γ_{e,bc} M⁻¹^{ef} Γ_{f,ad} − Γ_{e,bd} M⁻¹^{ef} Γ_{f,ac}

so that R_abcd u^a v^b u^c v^d is positive on a sphere.  Motion at zero momentum without a
potential is a geodesic: ẍ^c = −Γ^c_ab ẋ^a ẋ^b.  By O'Neill's formula, sectional curvatures of the
base B = Q/G are at least those of horizontal planes in Q:

    R_B(u, v, u, v) = R_Q(u_h, v_h, u_h, v_h) + ¾ B(u, v)ᵀ I B(u, v).

With balls, ∂_a is the derivative e_a along the frame of the shape, [e_a, e_b] = c^d_ab e_d.  By
Koszul's formula (Γ_{c,ab} = M_cd Γ^d_ab, ∇_a e_b = Γ^c_ab e_c),

    2 Γ_{c,ab} = e_a M_bc + e_b M_ac − e_c M_ab + c^d_ab M_dc − c^d_ac M_db − c^d_bc M_da,
    R_abcd = e_c Γ_{a,db} − e_d Γ_{a,cb} − Γ_{f,ca} Γ^f_db + Γ_{f,da} Γ^f_cb − c^e_cd Γ_{a,eb},

so that Γ^d_ab − Γ^d_ba = c^d_ab, and geodesics obey σ̇^c = −Γ^c_ab σ^a σ^b in the rates σ.

For the left-invariant metric I on a group, in body twists:

    ∇_ξ η = ½ [ξ, η] − ½ I⁻¹ (ad*_ξ I η + ad*_η I ξ),     geodesics: ξ̇ = −∇_ξ ξ = I⁻¹ ad*_ξ I ξ.

Source: B. O'Neill, "The fundamental equations of a submersion", 1966; V. I. Arnold, "Mathematical
methods of classical mechanics", appendix 2; Misner, Thorne, Wheeler, "Gravitation", 1973, ch. 14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, vector, vectors
from ..common.errors import InputError
from ..lie.group import Group
from ..reduction.pointwise_reduction import PointwiseReduction
from ..system.coordinates import Velocity

if TYPE_CHECKING:
    from ..reduction.tree.second_derivatives import InertiaDerivatives
    from .connections.shape_field import ShapeField


def christoffel_symbols(M: Array, dM: Array, c: Array | None = None) -> Array:
    """Compute the Christoffel symbols of a metric.

    Args:
        M: Metric, (m, m).
        dM: Derivative of the metric, (m, m, m), derivative index last.
        c: Structure constants c^d_ab of the frame, (m, m, m), d first; None if they are zero.
    Returns:
        Γ^c_ab, (m, m, m), c first.
    """
    return _raised(M, _lowered(M, dM, c))


def riemann_tensor(M: Array, dM: Array, d2M: Array, c: Array | None = None) -> Array:
    """Compute the Riemann tensor with all indices down.

    Args:
        M: Metric, (m, m).
        dM: Derivative of the metric, (m, m, m), derivative index last.
        d2M: Second derivative of the metric, (m, m, m, m), d2M[..., a, b] = e_a e_b M.
        c: Structure constants c^d_ab of the frame, (m, m, m), d first; None if they are zero.
    Returns:
        R_abcd, (m, m, m, m).
    """
    if c is not None:
        return _riemann_in_frame(M, dM, d2M, c)
    lowered = _lowered(M, dM, c)
    R = 0.5 * (np.einsum("adbc->abcd", d2M) + np.einsum("bcad->abcd", d2M))
    R -= 0.5 * (np.einsum("bdac->abcd", d2M) + np.einsum("acbd->abcd", d2M))
    raised = _raised(M, lowered)
    product = np.einsum("ebc,ead->abcd", lowered, raised)
    return np.asarray(R + product - np.swapaxes(product, 2, 3))


def sectional(R: Array, M: Array, u: Array, v: Array) -> float:
    """Compute the sectional curvature of the plane of two vectors.

    Args:
        R: Riemann tensor with all indices down, (m, m, m, m).
        M: Metric, (m, m).
        u: First vector, (m,).
        v: Second vector, (m,).
    Returns:
        The curvature.
    Raises:
        InputError: The vectors are parallel.
    """
    uu, vv, uv = u @ M @ u, v @ M @ v, u @ M @ v
    area = uu * vv - uv**2
    if not area > 1e-14 * uu * vv:
        raise InputError("u and v must span a plane, but they are parallel in the reduced metric")
    return float(np.einsum("abcd,a,b,c,d", R, u, v, u, v) / area)


def reduced_metric_derivatives(d: InertiaDerivatives, r: int) -> tuple[Array, Array, Array]:
    """Differentiate M = H_ss − Aᵀ H_bs, with A = I⁻¹ H_bs, twice.

    Args:
        d: Derivatives of the mass matrix at one shape.
        r: Dimension of the group.
    Returns:
        M, ∂M and ∂∂M, derivative indices last.
    """
    H, dH, d2H = d.H[0], d.dH[0], d.d2H[0]
    I, Hbs, dI, dHbs = H[:r, :r], H[:r, r:], dH[:r, :r], dH[:r, r:]
    A = np.linalg.solve(I, Hbs)
    # The matrices W = I ∂A follow from the product rule: W = ∂(IA) − ∂I A, with I A = H_bs.
    W = dHbs - np.einsum("ijc,jb->ibc", dI, A)
    dA = np.linalg.solve(I, W.reshape(r, -1)).reshape(W.shape)
    dM = dH[r:, r:] - np.einsum("iac,ib->abc", dHbs, A)
    dM -= np.einsum("ia,ibc->abc", A, W)
    # ∂∂(H_bsᵀ I⁻¹ H_bs), A = I⁻¹ H_bs: second derivatives of H_bs and I, plus Wᵀ I⁻¹ W twice.
    mixed = np.einsum("iacd,ib->abcd", d2H[:r, r:], A)
    d2M = d2H[r:, r:] - mixed - np.swapaxes(mixed, 0, 1)
    d2M += np.einsum("ia,ijcd,jb->abcd", A, d2H[:r, :r], A)
    product = np.einsum("iac,ibd->abcd", W, dA)
    d2M -= product + np.swapaxes(product, 2, 3)
    return H[r:, r:] - A.T @ Hbs, dM, np.asarray(d2M)


def left_invariant_derivative(group: Group, inertia: Array, xi: Array, eta: Array) -> Array:
    """Compute ∇_ξ η of left-invariant fields.

    Args:
        group: The group.
        inertia: Metric on body twists, (r, r).
        xi: Body twist ξ, (r,).
        eta: Body twist η, (r,).
    Returns:
        (r,).
    """
    coadjoint = group.coadjoint(xi, inertia @ eta) + group.coadjoint(eta, inertia @ xi)
    return np.asarray(0.5 * group.bracket(xi, eta) - 0.5 * np.linalg.solve(inertia, coadjoint))


def _riemann_in_frame(M: Array, dM: Array, d2M: Array, c: Array) -> Array:
    """Return R_abcd in a frame with structure constants c."""
    lowered = _lowered(M, dM, c)
    slopes = np.stack(  # [a, d, b, c]: e_c Γ_{a,db}, linear in M and in its derivatives
        [_lowered(dM[..., k], d2M[..., k, :], c) for k in range(len(M))], axis=-1
    )
    product = np.einsum("fca,fdb->abcd", lowered, _raised(M, lowered))
    half: Array = np.einsum("adbc->abcd", slopes) - product
    return np.asarray(half - np.swapaxes(half, 2, 3) - np.einsum("ecd,aeb->abcd", c, lowered))


def _lowered(M: Array, dM: Array, c: Array | None) -> Array:
    """Return the Christoffel symbols of the first kind Γ_{d,ab}, d first."""
    by_a = np.swapaxes(dM, 1, 2)  # [d, a, b]: ∂_a M_db
    symmetric: Array = 0.5 * (by_a + dM - np.moveaxis(dM, 2, 0))
    if c is None:
        return symmetric
    brackets = np.einsum("de,eab->dab", M, c)  # ⟨e_d, [e_a, e_b]⟩
    transposed = np.einsum("bad->dab", brackets) + np.einsum("abd->dab", brackets)
    return np.asarray(symmetric + 0.5 * (brackets - transposed))


def _raised(M: Array, lowered: Array) -> Array:
    """Return M⁻¹^{cd} Γ_{d,ab}."""
    return np.asarray(np.linalg.solve(M, lowered.reshape(len(M), -1))).reshape(lowered.shape)


@dataclass(frozen=True)
class SplitVelocity:
    """The vertical and horizontal components of a velocity.

    Attributes:
        vertical: (Ω, 0), a rigid motion.
        horizontal: (−A ẋ, ẋ), a motion without momentum.
    """

    vertical: Velocity
    horizontal: Velocity


@checks_arguments
class Reduction(PointwiseReduction):
    """The reduction of one system, at any shape or over many shapes.

    Methods cache nothing between calls. A method raises ShapeError if a shape x (nx,)
    has the wrong length or is not finite. It raises SingularInertiaError if the mass matrix is
    numerically singular at this shape. For several quantities at one shape, call `at`, which
    computes them together. An instance owns Pinocchio work space, so use one per thread.

    Args:
        system: System to reduce.
        springs: Springs that are added to V(x), {joint: (stiffness [N·m/rad | N/m],
            rest [rad | m])}.
    """

    def amended_potential(self, x: ArrayLike, mu: ArrayLike) -> float:
        """Compute the amended potential V(x) + ½ μᵀ I⁻¹ μ.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            mu: Body momentum, (r,) [N s | N m s].
        Returns:
            The amended potential [J].
        Raises:
            SymmetryError: Gravity breaks the symmetry.
        """
        return self.potential(x) + self.split(x).locked_energy(mu)

    def kinetic_energy(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> float:
        """Compute the kinetic energy ½ vᵀ H v, v = (ξ, ẋ).

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            The energy [J].
        """
        return self.split(x).kinetic_energy(xdot, xi)

    def body_momentum(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """Compute the body momentum μ = H_bb ξ + H_bs ẋ.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            (r,) [linear; angular], in the frame of the root body.
        """
        return self.split(x).body_momentum(xdot, xi)

    def locked_velocity(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """Compute the locked velocity Ω = ξ + A ẋ, the twist after all joints are locked.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            (r,); the body momentum is μ = I Ω.
        """
        return self.split(x).locked_velocity(xdot, xi)

    def spatial_momentum(self, pose: ArrayLike, mu: ArrayLike) -> Array:
        """Compute the spatial momentum J = Ad*_{g⁻¹} μ.

        Args:
            pose: Pose coordinates of the base.
            mu: Body momentum, (r,) [N s | N m s].
        Returns:
            (r,), in the root joint's fixed frame, about its origin.
        """
        g = self.group.pose(pose)
        return self.group.spatial_momentum(g, vector(mu, self.system.r, "mu"))

    def connection_form(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """Compute the connection one-form 𝒜 = Ad_g (ξ + A ẋ) on velocities v = (ξ, ẋ).

        Its value is the spatial twist of the locked system, J = 𝕀 𝒜(v) (`spatial_momentum`,
        `locked_inertia_in_space`). On a rigid motion it is the spatial twist of that motion.

        Args:
            pose: Pose coordinates of the base.
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            Matrix of the one-form, (r, n).
        """
        Ad = self.group.Ad(self.group.pose(pose))
        return np.hstack([Ad, Ad @ self.local_connection(x)])

    def curvature_form(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """Compute the curvature two-form d𝒜 − [𝒜, 𝒜] = Ad_g B(ẋ, ẋ′) on v = (ξ, ẋ).

        Args:
            pose: Pose coordinates of the base.
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (r, n, n): a spatial twist, antisymmetric in the last two indices. It vanishes if
            either velocity is vertical.
        """
        r, n = self.system.r, self.system.n
        form = np.zeros((r, n, n))
        Ad = self.group.Ad(self.group.pose(pose))
        form[:, r:, r:] = np.einsum("ij,jab->iab", Ad, self.curvature(x))
        return form

    def locked_inertia_in_space(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """Compute the spatial locked inertia 𝕀 = Ad_{g⁻¹}ᵀ I Ad_{g⁻¹}.

        Args:
            pose: Pose coordinates of the base.
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (r, r), in the root joint's fixed frame, about its origin.
        """
        to_body = self.group.Ad(self.group.inverse(self.group.pose(pose)))
        return np.asarray(to_body.T @ self.locked_inertia(x) @ to_body)

    def horizontal_lift(self, x: ArrayLike, xdot: ArrayLike) -> Velocity:
        """Compute the horizontal lift (−A ẋ, ẋ) of a shape rate: the velocity without momentum.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
        Returns:
            The velocity.
        """
        xdot = vector(xdot, self.system.m, "xdot")
        return Velocity(xi=-self.local_connection(x) @ xdot, xdot=xdot)

    def split_velocity(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> SplitVelocity:
        """Split the velocity (ξ, ẋ) into (Ω, 0) and (−A ẋ, ẋ), which are orthogonal in H.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            The vertical and the horizontal velocity.
        """
        omega = self.locked_velocity(x, xdot, xi)
        horizontal = self.horizontal_lift(x, xdot)
        return SplitVelocity(Velocity(omega, np.zeros(self.system.m)), horizontal)

    def christoffel(self, x: ArrayLike) -> Array:
        """Compute the Christoffel symbols Γ^c_ab of the reduced metric.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (m, m, m), c first. Geodesics obey ẍ^c = −Γ^c_ab ẋ^a ẋ^b. With balls, the symbols refer
            to the frame of the shape, and Γ^d_ab − Γ^d_ba = c^d_ab are its structure constants.
        """
        M, dM, _ = self._metric_derivatives(x)
        return christoffel_symbols(M, dM, self._structure)

    def riemann(self, x: ArrayLike) -> Array:
        """Compute the Riemann tensor R_abcd of the reduced metric.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (m, m, m, m); R_abcd u^a v^b u^c v^d > 0 on a sphere.
        """
        return riemann_tensor(*self._metric_derivatives(x), self._structure)

    def sectional_curvature(self, x: ArrayLike, u: ArrayLike, v: ArrayLike) -> float:
        """Compute the sectional curvature R(u, v, u, v)/(|u|² |v|² − ⟨u, v⟩²) of M.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            u: Shape rate, (m,) [rad/s | m/s].
            v: Shape rate, (m,) [rad/s | m/s].
        Returns:
            The curvature.
        Raises:
            InputError: u and v are parallel.
        """
        u, v = vector(u, self.system.m, "u"), vector(v, self.system.m, "v")
        M, dM, d2M = self._metric_derivatives(x)
        return sectional(riemann_tensor(M, dM, d2M, self._structure), M, u, v)

    def covariant_acceleration(self, x: ArrayLike, xdot: ArrayLike, xddot: ArrayLike) -> Array:
        """Compute the covariant acceleration ẍ^c + Γ^c_ab ẋ^a ẋ^b in the reduced metric.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            xddot: Shape acceleration, (m,) [rad/s² | m/s²].
        Returns:
            (m,); zero on geodesics.
        """
        xdot = vector(xdot, self.system.m, "xdot")
        return vector(xddot, self.system.m, "xddot") + self.christoffel(x) @ xdot @ xdot

    def left_invariant_derivative(self, x: ArrayLike, xi: ArrayLike, eta: ArrayLike) -> Array:
        """Compute ∇_ξ η = ½[ξ, η] − ½ I⁻¹(ad*_ξ I η + ad*_η I ξ) in the metric I(x).

        Geodesics of the locked system obey ξ̇ = −∇_ξ ξ (Euler–Poincaré).

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xi: Body twist ξ, (r,).
            eta: Body twist η, (r,).
        Returns:
            (r,).
        """
        r = self.system.r
        xi, eta = vector(xi, r, "xi"), vector(eta, r, "eta")
        return left_invariant_derivative(self.group, self.locked_inertia(x), xi, eta)

    def grid(self, shapes: ArrayLike) -> ShapeField:
        """Return the quantities of the reduction at many shapes, as a field over the leading axes.

            a = np.linspace(-1.0, 1.0, 41)
            field = red.grid(np.stack(np.meshgrid(a, a, indexing="ij"), axis=-1))
            field.curvature[:, :, 2, 0, 1]  # (41, 41): the rotation part of B_01 on SE(2)

        Each quantity is computed at first use, by compiled code instead of Pinocchio.

        Args:
            shapes: Shapes, (..., nx) [rad | m], with unit quaternions for balls.
        Returns:
            The field.
        """
        from .connections.shape_field import ShapeField

        system, label = self.system, f"shapes of {self.system.name!r}"
        x = vectors(shapes, system.nx, label, system.x_names).copy()
        x = system.space.normalized(x, label)
        flat = x.reshape(math.prod(x.shape[:-1]), system.nx)
        moves = tuple(frame.moves(flat) for frame in self.frames)
        return ShapeField(system, x, self._potential, moves)

    @property
    def _structure(self) -> Array | None:
        """Structure constants of the frame of the shape, or None without balls."""
        space = self.system.space
        return space.structure if space.balls else None

    def _metric_derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the reduced metric M and its first and second derivatives."""
        shape = self.split(x).x  # raises SingularInertiaError
        from ..reduction.tree.second_derivatives import inertia_derivatives

        d = inertia_derivatives(self.system, shape[None])
        return reduced_metric_derivatives(d, self.system.r)
