"""Reduction at one shape: locked inertia, connection, reduced metric, curvature, potential.

Pinocchio's CRBA computes the mass matrix, and its RNEA derivatives yield ∂H: with v = 0, no
gravity and a = e_k, ∂τ/∂q is exactly ∂(H e_k)/∂q.  Source: Marsden, Montgomery, Ratiu,
"Reduction, symmetry and phases in mechanics", 1990; Cendra, Marsden, Ratiu, "Lagrangian reduction
by stages", 2001.

The curvature of the mechanical connection in body form is

    B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ

∂_α is the derivative along the frame of the shape, and c are the frame's structure constants.
Without balls they are zero, and ∂_α = ∂/∂x_α. Two further routes compute it, and the tests compare
them with this one: CasADi expressions (`_curvature` in reduction/tree/casadi_reduction.py), and
machine code for many shapes (`ConnectionCode.curvature` in kernels/connection/connection_code.py).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, vector
from ..common.errors import InputError, SingularInertiaError, SymmetryError
from ..lie.group import Group
from ..system.system import System, checked_system
from .inertia_split import InertiaSplit, com_derivative, mass_matrix_at, split_inertia
from .potential import Potential, Springs, pivot_weight
from .section import MovedFrame, Section


def compute_curvature(system: System, A: Array, dA: Array) -> Array:
    """Compute the curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ.

    Args:
        system: The system.
        A: Local connection, (r, m).
        dA: Derivative ∂A along the frame of the shape, (r, m, m), with the derivative index last.
    Returns:
        (r, m, m), antisymmetric in α, β, with B[:, α, β] = B_αβ.
    """
    B: Array = np.swapaxes(dA, 1, 2) - dA - bracket_term(system.group, A)
    return B - frame_term(system, A) if system.space.balls else B


def frame_term(system: System, A: Array) -> Array:
    """Compute the term c^γ_αβ A_γ of the curvature, (r, m, m)."""
    return np.asarray(np.einsum("ig,gab->iab", A, system.space.structure))


def bracket_term(group: Group, A: Array) -> Array:
    """Compute the term [A_α, A_β] of the curvature, (r, m, m)."""
    brackets: Array = np.einsum("aij,jb->iab", group.ad(A.T), A)
    return brackets


@checks_arguments
@dataclass(frozen=True)
class ReducedShape(InertiaSplit):
    """The reduction at one shape; arrays are read-only.

    Attributes:
        x: Shape, (nx,) [rad | m | 1].
        mass_matrix: Mass matrix H, (n, n), base rows first.
        locked_inertia: Locked inertia I, (r, r).
        local_connection: Local connection A, (r, m).
        reduced_metric: Reduced metric M, (m, m).
        com: Centre of mass in the root body's frame, (3,) [m].
        curvature: Curvature B, (r, m, m), with B[:, α, β] = B_αβ.
        dI: Derivative ∂I, (r, r, m), with the derivative index last.
        dM: Derivative ∂M, (m, m, m), with the derivative index last.
    """

    curvature: Array
    dI: Array
    dM: Array
    _dA: Array | InputError
    _potential: float | SymmetryError

    @property
    def dA(self) -> Array:
        """Derivative ∂A, (r, m, m), index last.  Raises InputError if the section has no ∂Θ."""
        if isinstance(self._dA, InputError):
            raise self._dA
        return self._dA

    @property
    def potential(self) -> float:
        """Potential V [J].  Raises SymmetryError if gravity breaks the symmetry."""
        if isinstance(self._potential, SymmetryError):
            raise self._potential
        return self._potential

    def amended_potential(self, mu: ArrayLike) -> float:
        """Compute the amended potential V + ½ μᵀ I⁻¹ μ.

        Args:
            mu: Body momentum, (r,) [N s | N m s].
        Returns:
            The amended potential [J].
        """
        return self.potential + self.locked_energy(mu)

    def _repr_html_(self) -> str:
        from ..common.html import card, line, matrix, number, numbers

        r, m = self.local_connection.shape
        twist, joints = ([str(k) for k in range(size)] for size in (r, m))
        V = self._potential
        shown = "gravity breaks the symmetry" if isinstance(V, SymmetryError) else number(V)
        return card(
            "Reduction",
            f"at x = {numbers(self.x)}",
            matrix("locked inertia I", self.locked_inertia, twist, twist),
            matrix("local connection A", self.local_connection, twist, joints),
            matrix("reduced metric M", self.reduced_metric, joints, joints),
            line(f"norm of the curvature B: {number(float(np.linalg.norm(self.curvature)))}"),
            line(f"potential V [J]: {shown}"),
        )


@checks_arguments
class PointwiseReduction:
    """The reduction of one system, evaluated by Pinocchio at one shape at a time.

    It is the base class of `Reduction`, which adds fields over many shapes and further geometry.
    Every method raises ShapeError if the shape has the wrong length or is not finite, and
    SingularInertiaError if the mass matrix is numerically singular at this shape.
    """

    def __init__(self, system: System, *, springs: Springs | None = None) -> None:
        """Prepare the reduction.

        Args:
            system: System to reduce.
            springs: Springs that are added to V(x), {joint: (stiffness [N·m/rad | N/m],
                rest [rad | m])}.
        """
        self.system = checked_system(system, "Reduction", remedy="Use LoopReduction.")
        self.frames: tuple[MovedFrame, ...] = ()
        self._model = system.sorted_model.copy()
        self._model.gravity.setZero()
        self._data = self.system.sorted_data
        self._identity = system.group.neutral
        # Gravity that breaks the symmetry leaves I, A, M and B defined, so only V raises.
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

    def _repr_html_(self) -> str:
        from ..common.html import card, line

        system = self.system
        try:
            at_rest = self.at(system.space.neutral)._repr_html_()
        except SingularInertiaError:
            at_rest = line("the mass matrix is singular at rest")
        about = f"{system.group.name} (r = {system.r}), shape of {system.space.size_in_words}"
        return card(f"Reduction of {system.name}", about, at_rest)

    @property
    def group(self) -> Group:
        """The symmetry group."""
        return self.system.group

    def mass_matrix(self, x: ArrayLike) -> Array:
        """Compute the mass matrix H(x), including armature, with Pinocchio's CRBA.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            Symmetric mass matrix, (n, n), base rows first.
        """
        return self.split(x).mass_matrix

    def locked_inertia(self, x: ArrayLike) -> Array:
        """Compute the locked inertia I(x) = H_bb, the inertia with locked joints.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (r, r), symmetric and positive definite.
        """
        return self.split(x).locked_inertia

    def local_connection(self, x: ArrayLike) -> Array:
        """Compute the local form A(x) of the mechanical connection, A = I⁻¹ H_bs.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (r, m): body twists [linear; angular] per unit joint rate.  Horizontal motion is
            ξ = −A ẋ.
        """
        return self.split(x).local_connection

    def reduced_metric(self, x: ArrayLike) -> Array:
        """Compute the reduced metric M(x) = H_ss − Aᵀ I A, the shape inertia at zero momentum.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (m, m), symmetric and positive definite.
        """
        return self.split(x).reduced_metric

    def curvature(self, x: ArrayLike) -> Array:
        """Compute the curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] in body form.

        With balls, ∂_α are derivatives along the frame of the shape, and the curvature has the
        additional term −c^γ_αβ A_γ (see the formula at the head of this module).

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (r, m, m), antisymmetric in α, β.  The bracket is the Lie bracket of body twists.
        """
        B = self._in_file.at(x).curvature if self.frames else self.at(x).curvature
        for frame in self.frames:
            B = frame.curvature(self._shape(x), B)
        return B

    def potential(self, x: ArrayLike) -> float:
        """Compute the potential V(x) of springs and gravity.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            V [J].  Raises SymmetryError if gravity breaks the symmetry.
        """
        return self.checked_potential().value(self._shape(x))

    def potential_gradient(self, x: ArrayLike) -> Array:
        """Compute the gradient of the potential.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            ∂V along the frame of the shape, (m,) [N m | N].  Raises SymmetryError if gravity breaks
            the symmetry.
        """
        return self.checked_potential().gradient(self._shape(x))

    def change_section(self, h: Section) -> Self:
        """Return the reduction in another section: its base frame is g h(x).

        Then A′ = Ad_{h⁻¹} A − Θ, B′ = Ad_{h⁻¹} B, I′ = Ad_hᵀ I Ad_h, M′ = M, μ′ = Ad_hᵀ μ.

        Args:
            h: Function of a shape (nx,) that returns (group element, Θ).  Θ = h⁻¹ ∂h, (r, m), is
                the body twist of h per unit rate of each joint.  To compute quantities that need
                ∂A (`at(x).dA`, the accelerations of Lagrange–Poincaré), it must return ∂Θ,
                (r, m, m), derivative index last, as a third value.  With balls, ∂ is the
                derivative along the frame of the shape, and h(x) must not depend on the sign of a
                quaternion.
        Returns:
            A copy in the new section.  Raises InputError if Θ or ∂Θ is not the derivative, or if h
            depends on the sign of a quaternion.
        """
        reduction = copy(self)
        reduction.frames = (*self.frames, MovedFrame(self.system, h))
        return reduction

    def same_section(self, other: PointwiseReduction) -> bool:
        """Return whether another reduction has the same system and section."""
        sections = [[frame.section for frame in red.frames] for red in (self, other)]
        return self.system is other.system and sections[0] == sections[1]

    def at(self, x: ArrayLike) -> ReducedShape:
        """Compute all quantities at one shape together, in 1 + n Pinocchio calls.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            The quantities.
        """
        x = self._shape(x).copy()
        split = self._split_in_file(x)
        r, m = self.system.r, self.system.m
        dH = self._mass_matrix_derivative(x)
        I, A = split.locked_inertia, split.local_connection
        # Differentiate A = I⁻¹ (IA) and M = M̃ − Aᵀ (IA).
        dI, dIA = dH[:r, :r], dH[:r, r:]
        dA_in_file = np.linalg.solve(I, (dIA - np.einsum("ijc,jb->ibc", dI, A)).reshape(r, -1))
        dA_in_file = dA_in_file.reshape(r, m, m)
        dAtIA = np.einsum("iac,ib->abc", dA_in_file, I @ A) + np.einsum("ia,ibc->abc", A, dIA)
        curvature, com = compute_curvature(self.system, A, dA_in_file), split.com
        dA: Array | InputError = dA_in_file
        for frame in self.frames:
            split, curvature = frame.split(split), frame.curvature(x, curvature)
            dI, dA = frame.inertia_derivative(split, dI), frame.connection_derivative(split, dA)
        V = self._potential
        return ReducedShape(
            **vars(split),
            curvature=curvature,
            dI=dI.copy(),
            dM=dH[r:, r:] - dAtIA,
            _dA=dA,
            _potential=(V if isinstance(V, SymmetryError) else V.value_at(x, com)),
        )

    def split(self, x: ArrayLike) -> InertiaSplit:
        """Compute I, A, M, H and the centre of mass at one shape with a single CRBA call.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            The quantities without derivatives.
        """
        split = self._split_in_file(self._shape(x))
        for frame in self.frames:
            split = frame.split(split)
        return split

    def checked_potential(self) -> Potential:
        """Return the potential.  Raises SymmetryError if gravity breaks the symmetry."""
        if isinstance(self._potential, SymmetryError):
            raise self._potential
        return self._potential

    def shape_potential(self) -> Potential:
        """Return the potential V(x); gravity is omitted if it rotates the base about a pivot.

        Raises SymmetryError if gravity breaks the symmetry otherwise.
        """
        return self._springs if self._springs is not None else self.checked_potential()

    def com_slope(self, x: ArrayLike) -> Array:
        """Compute ∂c/∂x of the centre of mass in the root body's frame, (3, m)."""
        x = self._shape(x)
        split, derivative = self._split_in_file(x), com_derivative(self.system, x)
        for frame in self.frames:
            split = frame.split(split)
            derivative = frame.com_derivative(split, derivative)
        return derivative

    def _shape(self, x: ArrayLike) -> Array:
        what, space = f"shape x of {self.system.name!r}", self.system.space
        return space.normalized(vector(x, space.nx, what, space.x_names), what)

    @property
    def _in_file(self) -> Self:
        """The reduction with respect to the base frame of the robot file."""
        first = copy(self)
        first.frames = ()
        return first

    def _split_in_file(self, x: Array) -> InertiaSplit:
        H = mass_matrix_at(self.system, self._model, self._data, self._identity, x)
        return split_inertia(self.system, x, H, np.array(self._data.Ycrb[1].lever))

    def _mass_matrix_derivative(self, x: Array) -> Array:
        """Return ∂H, (n, n, m), from Pinocchio's RNEA derivatives."""
        system, r, n, m = self.system, self.system.r, self.system.n, self.system.m
        q = system.sorted_q(self._identity, x)
        zero, dH = np.zeros(self._model.nv), np.empty((n, n, m))
        for k, unit in enumerate(np.eye(n) if m else ()):
            acceleration = system.joint_rates(unit)
            terms = pin.computeRNEADerivatives(self._model, self._data, q, zero, acceleration)
            dH[:, k, :] = system.coupled_matrix(terms[0])[:, r:]
        return dH
