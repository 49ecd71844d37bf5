"""Reduction: locked inertia, connection, reduced metric and curvature at a shape.

Pinocchio's CRBA gives the mass matrix that is split.  Its derivatives come from
Pinocchio's RNEA derivatives: with v = 0, no gravity and a = e_k, ∂τ/∂q is ∂(H e_k)/∂q,
exactly.  Source: Marsden, Montgomery, Ratiu, "Reduction,
symmetry and phases in mechanics", 1990; Cendra, Marsden, Ratiu, "Lagrangian reduction
by stages", 2001.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, vector
from ..common.errors import InputError, SymmetryError
from ..lie.group import Group
from ..system.coordinates import Velocity
from ..system.system import System, checked_system
from .inertia_split import InertiaSplit, mass_matrix_at, split_inertia
from .levi_civita import (
    christoffel_symbols,
    left_invariant_derivative,
    reduced_metric_derivatives,
    riemann_tensor,
    sectional,
)
from .potential import Potential, Springs, pivot_weight
from .section import MovedFrame, Section
from .tree.second_derivatives import inertia_derivatives


@dataclass(frozen=True)
class ReducedShape(InertiaSplit):
    """The reduction at one shape x; arrays are read-only.

    Besides the split: curvature: (r, m, m), B[:, α, β] = B_αβ.  dI: (r, r, m), dA:
    (r, m, m), dM: (m, m, m), the derivative ∂_α last.
    """

    curvature: Array
    dI: Array
    dM: Array
    _dA: Array | InputError
    _potential: float | SymmetryError

    @property
    def dA(self) -> Array:
        """∂A, (r, m, m).  Raises InputError in a section that gives no ∂Θ."""
        if isinstance(self._dA, InputError):
            raise self._dA
        return self._dA

    @property
    def potential(self) -> float:
        """V(x) [J].  Raises SymmetryError if gravity breaks the symmetry."""
        if isinstance(self._potential, SymmetryError):
            raise self._potential
        return self._potential

    def amended_potential(self, mu: ArrayLike) -> float:
        """V(x) + ½ μᵀ I⁻¹ μ [J] for body momentum mu (r,).  Raises SymmetryError, ShapeError."""
        return self.potential + self.locked_energy(mu)

    def _repr_html_(self) -> str:
        from ..common.html import card, line, matrix, number, numbers

        r, m = self.local_connection.shape
        twist, joints = ([str(k) for k in range(size)] for size in (r, m))
        known = self._potential
        V = "gravity breaks the symmetry" if isinstance(known, SymmetryError) else number(known)
        return card(
            "Reduction",
            f"at x = {numbers(self.x)}",
            matrix("locked inertia I", self.locked_inertia, twist, twist),
            matrix("local connection A", self.local_connection, twist, joints),
            matrix("reduced metric M", self.reduced_metric, joints, joints),
            line(f"norm of the curvature B: {number(float(np.linalg.norm(self.curvature)))}"),
            line(f"potential V [J]: {V}"),
        )


@dataclass(frozen=True)
class SplitVelocity:
    """A velocity as a sum.  vertical: (Ω, 0), a rigid motion.  horizontal: without momentum."""

    vertical: Velocity
    horizontal: Velocity


class PointwiseReduction:
    """The split of one system's mass matrix, at any shape.

    Every method computes afresh from x: (m,) shape [rad | m], and raises ShapeError if x
    has the wrong length or is not finite, SingularInertiaError if the mass matrix is
    numerically singular there.  For several quantities at one shape, `at` computes them
    together.  An instance owns Pinocchio work space: use one per thread.
    """

    def __init__(self, system: System, *, springs: Springs | None = None) -> None:
        """Prepare the reduction of `system`.

        springs: {joint: (stiffness [N·m/rad | N/m], rest [rad | m])}, added to V(x).
        """
        self.system = checked_system(system, "Reduction")
        self._model = system.model.copy()
        self._model.gravity.setZero()
        self._data = self.system.data
        self._identity = system.group.identity()
        self.frames: tuple[MovedFrame, ...] = ()
        # Gravity that breaks the symmetry leaves I, A, M and B defined; only V is not.
        self._potential: Potential | SymmetryError
        self._springs: Potential | None = None
        try:
            self._potential = Potential(system, springs)
        except SymmetryError as error:
            self._potential = error
            if pivot_weight(system).any():
                self._springs = Potential(system, springs, weight=False)

    def __repr__(self) -> str:
        return f"Reduction({self.system!r})"

    @property
    def group(self) -> Group:
        """The symmetry group."""
        return self.system.group

    def mass_matrix(self, x: ArrayLike) -> Array:
        """H(x), (n, n): Pinocchio's CRBA with armature, base rows first, both triangles."""
        return self.split(x).mass_matrix

    def locked_inertia(self, x: ArrayLike) -> Array:
        """I(x) = H_bb, (r, r), SPD: the inertia of the system with its joints frozen."""
        return self.split(x).locked_inertia

    def local_connection(self, x: ArrayLike) -> Array:
        """Local form A(x) of the mechanical connection, A = I⁻¹ H_bs.

        Returns (r, m): columns are body twists [linear; angular] per unit joint rate;
        horizontal motion is ξ = −A ẋ.
        """
        return self.split(x).local_connection

    def reduced_metric(self, x: ArrayLike) -> Array:
        """M(x) = H_ss − Aᵀ I A, (m, m), SPD: the inertia of the shape at zero momentum."""
        return self.split(x).reduced_metric

    def curvature(self, x: ArrayLike) -> Array:
        """B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β], (r, m, m), body form of the curvature.

        B[:, α, β] is antisymmetric in α, β.  The bracket is that of body twists.
        """
        B = self._in_file.at(x).curvature if self.frames else self.at(x).curvature
        for frame in self.frames:
            B = frame.curvature(self._shape(x), B)
        return B

    def potential(self, x: ArrayLike) -> float:
        """V(x) [J], springs and gravity.  Raises SymmetryError if gravity breaks the symmetry."""
        return self.checked_potential().value(self._shape(x))

    def potential_gradient(self, x: ArrayLike) -> Array:
        """∂V/∂x, (m,).  Raises SymmetryError if gravity breaks the symmetry."""
        return self.checked_potential().gradient(self._shape(x))

    def amended_potential(self, x: ArrayLike, mu: ArrayLike) -> float:
        """V(x) + ½ μᵀ I⁻¹ μ [J] for body momentum mu (r,)."""
        return self.potential(x) + self.split(x).locked_energy(mu)

    def kinetic_energy(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> float:
        """½ vᵀ H v [J] for shape rate xdot (m,) and body twist xi (r,)."""
        return self.split(x).kinetic_energy(xdot, xi)

    def body_momentum(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """μ = H_bb ξ + H_bs ẋ, (r,) [linear; angular], in the frame of the root body."""
        return self.split(x).body_momentum(xdot, xi)

    def locked_velocity(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """Ω = ξ + A ẋ, (r,): the twist the system would have if its joints froze; μ = I Ω."""
        return self.split(x).locked_velocity(xdot, xi)

    def spatial_momentum(self, pose: ArrayLike, mu: ArrayLike) -> Array:
        """J = Ad*_{g⁻¹} μ, (r,): momentum in the root joint's fixed frame, about its origin."""
        g = self.group.pose(pose)
        return self.group.spatial_momentum(g, vector(mu, self.system.r, "mu"))

    def connection_form(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """The connection one-form 𝒜 = Ad_g (ξ + A ẋ), (r, n), on velocities v = (ξ, ẋ).

        Its value is a spatial twist: that of the locked system, J = 𝕀 𝒜(v) (`spatial_momentum`,
        `locked_inertia_in_space`).  𝒜 of a rigid motion is its own spatial twist.
        """
        Ad = self.group.Ad(self.group.pose(pose))
        return np.hstack([Ad, Ad @ self.local_connection(x)])

    def curvature_form(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """The curvature two-form d𝒜 − [𝒜, 𝒜] = Ad_g B(ẋ, ẋ′), (r, n, n), on v = (ξ, ẋ).

        A spatial twist, antisymmetric in the last two; zero where either velocity is vertical.
        """
        r, n = self.system.r, self.system.n
        out = np.zeros((r, n, n))
        Ad = self.group.Ad(self.group.pose(pose))
        out[:, r:, r:] = np.einsum("ij,jab->iab", Ad, self.curvature(x))
        return out

    def locked_inertia_in_space(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """𝕀 = Ad_{g⁻¹}ᵀ I Ad_{g⁻¹}, (r, r): in the root joint's fixed frame, about its origin."""
        back = self.group.Ad(self.group.inverse(self.group.pose(pose)))
        return np.asarray(back.T @ self.locked_inertia(x) @ back)

    def horizontal_lift(self, x: ArrayLike, xdot: ArrayLike) -> Velocity:
        """The velocity (−A ẋ, ẋ) above a shape rate (m,) that has no momentum."""
        xdot = vector(xdot, self.system.m, "xdot")
        return Velocity(xi=-self.local_connection(x) @ xdot, xdot=xdot)

    def split_velocity(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> SplitVelocity:
        """The velocity (ξ, ẋ) as (Ω, 0) along the group plus (−A ẋ, ẋ), orthogonal in H."""
        omega = self.locked_velocity(x, xdot, xi)
        horizontal = self.horizontal_lift(x, xdot)
        return SplitVelocity(Velocity(omega, np.zeros(self.system.m)), horizontal)

    def christoffel(self, x: ArrayLike) -> Array:
        """Γ^c_ab of the reduced metric, (m, m, m), c first: geodesics are ẍ^c = −Γ^c_ab ẋ^a ẋ^b."""
        d = self._metric_derivatives(x)
        return christoffel_symbols(d[0], d[1])

    def riemann(self, x: ArrayLike) -> Array:
        """R_abcd of the reduced metric, (m, m, m, m); R_abcd u^a v^b u^c v^d > 0 on a sphere."""
        return riemann_tensor(*self._metric_derivatives(x))

    def sectional_curvature(self, x: ArrayLike, u: ArrayLike, v: ArrayLike) -> float:
        """R(u, v, u, v)/(|u|² |v|² − ⟨u, v⟩²) of the reduced metric, for shape rates u, v (m,).

        Raises InputError if they are parallel.
        """
        u, v = vector(u, self.system.m, "u"), vector(v, self.system.m, "v")
        M, dM, d2M = self._metric_derivatives(x)
        return sectional(riemann_tensor(M, dM, d2M), M, u, v)

    def covariant_acceleration(self, x: ArrayLike, xdot: ArrayLike, xddot: ArrayLike) -> Array:
        """ẍ^c + Γ^c_ab ẋ^a ẋ^b, (m,); zero on geodesics of the reduced metric."""
        xdot = vector(xdot, self.system.m, "xdot")
        return vector(xddot, self.system.m, "xddot") + self.christoffel(x) @ xdot @ xdot

    def left_invariant_derivative(self, x: ArrayLike, xi: ArrayLike, eta: ArrayLike) -> Array:
        """∇_ξ η = ½[ξ, η] − ½ I⁻¹(ad*_ξ I η + ad*_η I ξ), (r,), of the frozen system's metric I(x).

        For body twists ξ, η (r,); its geodesics obey ξ̇ = −∇_ξ ξ (Euler–Poincaré).
        """
        r = self.system.r
        xi, eta = vector(xi, r, "xi"), vector(eta, r, "eta")
        return left_invariant_derivative(self.group, self.locked_inertia(x), xi, eta)

    def change_section(self, h: Section) -> Self:
        """Return the reduction whose base frame is g h(x), moved along with the shape.

        h: from a shape (m,) to (group element, Θ), where Θ = h⁻¹ ∂h, (r, m), holds the body twist
        of h per unit rate of each joint.  What needs ∂A (`at(x).dA`, the accelerations of
        Lagrange–Poincaré) also needs ∂Θ, (r, m, m), ∂ last, as a third value.
        Then A′ = Ad_{h⁻¹} A − Θ, B′ = Ad_{h⁻¹} B, I′ = Ad_hᵀ I Ad_h, M′ = M, μ′ = Ad_hᵀ μ.
        Raises InputError if Θ or ∂Θ is not the derivative.
        """
        moved = copy(self)
        moved.frames = (*self.frames, MovedFrame(self.system, h))
        return moved

    def same_section(self, other: PointwiseReduction) -> bool:
        """Whether another reduction is of this system in this section."""
        sections = [[frame.section for frame in red.frames] for red in (self, other)]
        return self.system is other.system and sections[0] == sections[1]

    def at(self, x: ArrayLike) -> ReducedShape:
        """Everything at one shape, computed once: 1 + n Pinocchio calls, or 1 without joints."""
        x = self._shape(x).copy()
        split = self._split_in_file(x)
        system, r, n, m = self.system, self.system.r, self.system.n, self.system.m
        q = system.model_q(self._identity, x)
        zero, units, dH = np.zeros(self._model.nv), np.eye(n), np.empty((n, n, m))
        for k in range(n if m else 0):
            e_k = system.joint_rates(units[k])
            dtau_dq = pin.computeRNEADerivatives(self._model, self._data, q, zero, e_k)[0]
            dH[:, k, :] = system.coupled_matrix(dtau_dq)[:, r:]
        I, A = split.locked_inertia, split.local_connection
        # A = I⁻¹ (IA) and M = M̃ − Aᵀ (IA), differentiated.
        dI, dIA = dH[:r, :r], dH[:r, r:]
        dA = np.linalg.solve(I, (dIA - np.einsum("ijc,jb->ibc", dI, A)).reshape(r, -1))
        dA = dA.reshape(r, m, m)
        dAtIA = np.einsum("iac,ib->abc", dA, I @ A) + np.einsum("ia,ibc->abc", A, dIA)
        bracket = np.einsum("aij,jb->iab", self.group.ad(A.T), A)
        curvature, com = np.swapaxes(dA, 1, 2) - dA - bracket, split.com
        slope: Array | InputError = dA
        for frame in self.frames:
            split, curvature = frame.split(split), frame.curvature(x, curvature)
            dI, slope = frame.inertia_slope(split, dI), frame.connection_slope(split, slope)
        known = self._potential
        return ReducedShape(
            **vars(split),
            curvature=curvature,
            dI=dI.copy(),
            dM=dH[r:, r:] - dAtIA,
            _dA=slope,
            _potential=(known if isinstance(known, SymmetryError) else known.value_at(x, com)),
        )

    def checked_potential(self) -> Potential:
        """Return the potential.  Raises SymmetryError if gravity breaks the symmetry."""
        if isinstance(self._potential, SymmetryError):
            raise self._potential
        return self._potential

    def shape_potential(self) -> Potential:
        """Return the potential; of a base that gravity turns about a pivot, what is left of it.

        Raises SymmetryError if gravity breaks the symmetry otherwise.
        """
        return self._springs if self._springs is not None else self.checked_potential()

    def com_slope(self, x: ArrayLike) -> Array:
        """∂c/∂x of the centre of mass in the root body's frame, (3, m)."""
        split = self._split_in_file(self._shape(x))
        slope: Array = inertia_derivatives(self.system, split.x[None], of=()).dcom[0]
        for frame in self.frames:
            split = frame.split(split)
            slope = frame.com_slope(split, slope)
        return slope

    def _shape(self, x: ArrayLike) -> Array:
        return vector(x, self.system.m, f"shape x of {self.system.name!r}", self.system.shape_names)

    def split(self, x: ArrayLike) -> InertiaSplit:
        """I, A, M, H and the centre of mass at one shape, without derivatives: one CRBA."""
        return self._split(self._shape(x))

    def _metric_derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return M and its first and second derivatives."""
        x = self._shape(x)
        self._split(x)  # raises SingularInertiaError
        return reduced_metric_derivatives(inertia_derivatives(self.system, x[None]), self.system.r)

    def _split(self, x: Array) -> InertiaSplit:
        split = self._split_in_file(x)
        for frame in self.frames:
            split = frame.split(split)
        return split

    @property
    def _in_file(self) -> Self:
        """The reduction in the section of the robot's file."""
        first = copy(self)
        first.frames = ()
        return first

    def _split_in_file(self, x: Array) -> InertiaSplit:
        H = mass_matrix_at(self.system, self._model, self._data, self._identity, x)
        return split_inertia(self.system, x, H, np.array(self._data.Ycrb[1].lever))
