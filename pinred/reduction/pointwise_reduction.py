"""Reduction at one shape: locked inertia, connection, reduced metric, curvature, potential.

    H(x) = [[I, IA], [AᵀI, M̃]],   A = I⁻¹ H_bs,   M = H_ss − Aᵀ I A

Pinocchio's CRBA computes the mass matrix, and its RNEA derivatives yield ∂H: with v = 0, no
gravity and a = e_k, ∂τ/∂q is exactly ∂(H e_k)/∂q.  Source: Marsden, Montgomery, Ratiu,
"Reduction, symmetry and phases in mechanics", 1990; Cendra, Marsden, Ratiu, "Lagrangian reduction
by stages", 2001.

The curvature of the mechanical connection in body form is

    B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ

∂_α is the derivative along the frame of the shape, and c are the frame's structure constants.
Without balls they are zero, and ∂_α = ∂/∂x_α. Two further routes compute it, and the tests compare
them with this one: CasADi expressions (`casadi_reduction`), and machine code for many shapes
(`ConnectionCode.curvature`).

In another section, the pose of the base frame is g h(x).  With the body twists Θ = h⁻¹ ∂h,

    A′ = Ad_{h⁻¹} A − Θ,   B′ = Ad_{h⁻¹} B,   I′ = Ad_hᵀ I Ad_h,   M′ = M,   μ′ = Ad_hᵀ μ.

With balls, ∂ is the derivative along the frame of the shape, and B′ contains the frame's term: the
formula for B′ is the same, because Θ is flat, ∂_αΘ_β − ∂_βΘ_α + [Θ_α, Θ_β] = c^γ_αβ Θ_γ.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Self, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..common.argument_kinds import call_function, checks_arguments
from ..common.arrays import Array, FrozenArrays, as_floats, central_differences, vector
from ..common.errors import InputError, ShapeError, SingularInertiaError, SymmetryError
from ..lie.group import Group
from ..system.joints import axes_of
from ..system.system import System, checked_system
from .potential import Potential, Springs, pivot_weight

_SAMPLES = 20  # number of random shapes that determine typical inertias


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


def usual_inertias(system: System) -> Array:
    """Return the largest diagonal entries of the mass matrix over some random shapes, (n,)."""
    return np.asarray(np.max([np.diag(H) for H in usual_mass_matrices(system)], axis=0))


def usual_mass_matrices(system: System) -> list[Array]:
    """Return the mass matrices (n, n) at some random shapes; the result is cached."""

    def make() -> list[Array]:
        displacements = np.random.default_rng(0).uniform(-np.pi, np.pi, (_SAMPLES, system.m))
        shapes = system.space.integrate(system.space.neutral, displacements)
        return [mass_matrix(system, x) for x in shapes]

    return system.workspace(usual_mass_matrices, make)


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
    model = system.sorted_model
    data = system.workspace(com_derivative, model.createData)
    q = system.sorted_q(system.group.identity(), x)
    # With one joint, Pinocchio returns a vector (3,).
    jacobian = pin.jacobianCenterOfMass(model, data, q).reshape(3, -1)
    in_world = system.on_shape(jacobian)[:, system.r :]
    return np.asarray(model.jointPlacements[1].rotation.T @ in_world)


Section: TypeAlias = Callable[[Array], tuple[Any, ...]]

_STEP = 1e-3  # step of the finite differences along the frame that check a derivative [rad | m]
_TOLERANCE = 1e-6  # tolerance of the derivative check, relative to the largest entry


@dataclass(frozen=True)
class Moves(FrozenArrays):
    """Changes of the base frame at N shapes; arrays are read-only.

    Attributes:
        Ad: Adjoint Ad_h, (N, r, r).
        inverse: Inverse adjoint Ad_{h⁻¹}, (N, r, r).
        theta: Body twists Θ = h⁻¹ ∂h per unit joint rate, (N, r, m).
        rotation: Rotation of h in the root joint's fixed frame, (N, 3, 3).
        translation: Translation of h in the root joint's fixed frame, (N, 3) [m].
    """

    Ad: Array
    inverse: Array
    theta: Array
    rotation: Array
    translation: Array

    def mass_matrix(self, H: Array) -> Array:
        """Return the mass matrix H′, (N, n, n), for velocities (ξ′, ẋ) in the new frame."""
        r = self.Ad.shape[-1]
        T = np.zeros_like(H)
        T[:, :r, :r], T[:, :r, r:] = self.Ad, -self.Ad @ self.theta
        T[:, r:, r:] = np.eye(H.shape[-1] - r)
        return np.asarray(np.swapaxes(T, 1, 2) @ H @ T)

    def local_connection(self, A: Array) -> Array:
        """Return the local connection A′ in the new frame, (N, r, m)."""
        return np.asarray(self.inverse @ A - self.theta)

    def curvature(self, B: Array) -> Array:
        """Return the curvature B′ in the new frame, (N, r, m, m)."""
        return np.asarray(np.einsum("nij,njab->niab", self.inverse, B))

    def com(self, com: Array) -> Array:
        """Return the centre of mass in the new frame, (N, 3)."""
        return np.asarray(np.einsum("nji,nj->ni", self.rotation, com - self.translation))


class MovedFrame:
    """A base frame g h(x) of one system, which transforms the terms of the reduction."""

    def __init__(self, system: System, h: Section) -> None:
        """Check and store the section.  Raises InputError if its derivative is wrong."""
        self._system, self._group, self.section = system, system.group, h
        rng = np.random.default_rng(0)
        for _ in range(2):
            x = system.space.random(rng, 1.0)
            self._check_derivatives(x)
            self._check_signs(x)

    def split(self, old: InertiaSplit) -> InertiaSplit:
        """Return the split of the mass matrix in this frame."""
        move, r = self.moves(old.x[None]), old.r
        I = move.Ad[0].T @ old.locked_inertia @ move.Ad[0]
        A = move.local_connection(old.local_connection[None])[0]
        H = np.empty_like(old.mass_matrix)
        H[:r, :r], H[:r, r:] = I, I @ A
        H[r:, :r], H[r:, r:] = H[:r, r:].T, old.reduced_metric + A.T @ I @ A
        return InertiaSplit(old.x, H, I, A, old.reduced_metric, move.com(old.com[None])[0])

    def com_derivative(self, new: InertiaSplit, derivative: Array) -> Array:
        """Transform the derivative of the centre of mass to this frame, c′ = h⁻¹ c.

        Args:
            new: Split of the mass matrix in this frame.
            derivative: Derivative ∂c/∂x in the old frame, (3, m).
        Returns:
            Derivative ∂c′/∂x, (3, m).
        """
        move = self.moves(new.x[None])
        twists = axes_of(self._system.model.joints[1]) @ move.theta[0]
        carried = twists[:3] + np.cross(twists[3:].T, new.com).T
        return np.asarray(move.rotation[0].T @ derivative - carried)

    def curvature(self, x: Array, B: Array) -> Array:
        """Return B′ = Ad_{h⁻¹} B, (r, m, m), at shape x (nx,)."""
        return np.asarray(self.moves(x[None]).curvature(B[None])[0])

    def inertia_derivative(self, new: InertiaSplit, dI: Array) -> Array:
        """Transform the derivative of the locked inertia to this frame.

        Args:
            new: Split of the mass matrix in this frame.
            dI: Derivative ∂I in the old frame, (r, r, m), derivative index last.
        Returns:
            Derivative ∂I′, (r, r, m).
        """
        pose, theta, _ = self._element(new.x)
        Ad, ad = self._group.Ad(pose), self._group.ad(theta.T)
        half = np.einsum("ij,cjk->ikc", new.locked_inertia, ad)  # ∂ Ad_h = Ad_h ad_Θ
        transformed = np.einsum("ji,jkc,kl->ilc", Ad, dI, Ad)
        return np.asarray(transformed + half + np.swapaxes(half, 0, 1))

    def connection_derivative(
        self, new: InertiaSplit, dA: Array | InputError
    ) -> Array | InputError:
        """Transform the derivative of the local connection to this frame.

        Args:
            new: Split of the mass matrix in this frame.
            dA: Derivative ∂A in the old frame, (r, m, m), derivative index last, or the error that
                explains why ∂A is not available.
        Returns:
            Derivative ∂A′, or the error that h does not return ∂Θ.
        """
        pose, theta, dtheta = self._element(new.x)
        if isinstance(dA, InputError):
            return dA
        if dtheta is None:
            return InputError(
                "dA of this section needs the derivative of Θ = h⁻¹ ∂h: let h(x) return it as a "
                "third value, (r, m, m), ∂ last"
            )
        inverse, ad = self._group.Ad(self._group.inverse(pose)), self._group.ad(theta.T)
        brackets = np.einsum("cij,jb->ibc", ad, new.local_connection + theta)
        return np.asarray(np.einsum("ij,jbc->ibc", inverse, dA) - brackets - dtheta)

    def moves(self, x: Array) -> Moves:
        """Return the changes of frame at shapes x (N, nx)."""
        elements, system = [self._element(shape)[:2] for shape in x], self._system
        model, data, places = system.sorted_model, system.sorted_data, []
        for (pose, _), shape in zip(elements, x, strict=True):
            pin.forwardKinematics(model, data, system.sorted_q(pose, shape))
            places.append(model.jointPlacements[1].actInv(data.oMi[1]))
        poses = np.array([g for g, _ in elements]).reshape(len(x), self._group.size)
        return Moves(
            Ad=self._group.Ad(poses),
            inverse=self._group.Ad(self._group.inverse(poses)),
            theta=np.array([theta for _, theta in elements]).reshape(-1, system.r, system.m),
            rotation=np.array([place.rotation for place in places]).reshape(-1, 3, 3),
            translation=np.array([place.translation for place in places]).reshape(-1, 3),
        )

    def _element(self, x: Array) -> tuple[Array, Array, Array | None]:
        """Evaluate h: return its pose, Θ, and ∂Θ or None.  Raises InputError for other values."""
        value = call_function(self.section, "h", x.copy())
        if not isinstance(value, tuple) or len(value) not in (2, 3):
            raise InputError(
                "h(x) must return (group element, Θ), Θ = h⁻¹ ∂h with shape (r, m), and may return "
                "∂Θ (r, m, m) as a third"
            )
        r, m = self._system.r, self._system.m
        theta = _checked_array(value[1], (r, m), "Θ = h⁻¹ ∂h")
        dtheta = _checked_array(value[2], (r, m, m), "∂Θ") if len(value) == 3 else None
        return self._group.pose(value[0]), theta, dtheta

    def _check_derivatives(self, x: Array) -> None:
        """Raise InputError if Θ or ∂Θ differs from finite differences of h at shape x (nx,)."""
        pose, theta, dtheta = self._element(x)
        inverse, r, m = self._group.inverse(pose), self._system.r, self._system.m

        def values(displacement: Array) -> Array:
            g, twists, _ = self._element(self._system.space.integrate(x, displacement))
            return np.append(self._group.log(self._group.compose(inverse, g)), twists)

        slopes = central_differences(values, np.zeros(m), _STEP)
        checks = [("Θ = h⁻¹ ∂h", theta, slopes[:r])]
        if dtheta is not None:
            checks.append(("∂Θ", dtheta, slopes[r:].reshape(r, m, m)))
        for name, stated, expected in checks:
            errors = np.abs(stated - expected).reshape(-1, m).max(axis=0)
            sizes = np.abs(expected).reshape(-1, m).max(axis=0)
            for k, joint in enumerate(self._system.shape_names):
                if not errors[k] <= _TOLERANCE * (1.0 + sizes[k]):
                    raise InputError(
                        f"{name} of the section with respect to '{joint}' is {stated[..., k]} at "
                        f"x = {x}, but finite differences of h(x) are {expected[..., k]}; Θ is the "
                        "body twist of h per unit rate of the joint"
                    )

    def _check_signs(self, x: Array) -> None:
        """Raise InputError if h(x) differs between the quaternions q and −q of a ball."""
        pose, theta, _ = self._element(x)
        inverse = self._group.inverse(pose)
        for ball in self._system.space.balls:
            opposite = x.copy()
            opposite[ball.x] *= -1.0
            other, other_theta, _ = self._element(opposite)
            distance = np.abs(self._group.log(self._group.compose(inverse, other))).max(initial=0.0)
            change = np.abs(theta - other_theta).max(initial=0.0)
            if not max(distance, change) <= _TOLERANCE * (1.0 + np.abs(theta).max(initial=0.0)):
                raise InputError(
                    f"h(x) of the section depends on the sign of the quaternion of ball joint "
                    f"'{ball.name}' at x = {x}; q and −q are the same attitude, so use its "
                    "rotation matrix or its rotation vector"
                )


def _checked_array(value: Any, shape: tuple[int, ...], name: str) -> Array:
    array = as_floats(value, name)
    if array.shape != shape or not np.isfinite(array).all():
        raise ShapeError(f"{name} must be finite and have shape {shape}, got {array.shape}")
    return array


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
    if not system.space.balls:
        return B
    return np.asarray(B - np.einsum("ig,gab->iab", A, system.space.structure))


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
        self._springs = dict(springs or {})
        if springs:
            _ = self._potential  # raises InputError

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
        split = self._split_in_file(self._shape(x))
        _, dA = self._derivatives(split)
        B = compute_curvature(self.system, split.local_connection, dA)
        for frame in self.frames:
            B = frame.curvature(split.x, B)
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
        r, A = self.system.r, split.local_connection
        dH, dA_in_file = self._derivatives(split)
        dI, dIA = dH[:r, :r], dH[:r, r:]
        IA = split.locked_inertia @ A
        dAtIA = np.einsum("iac,ib->abc", dA_in_file, IA) + np.einsum("ia,ibc->abc", A, dIA)
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
        return self.checked_potential() if self._without_weight is None else self._without_weight

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

    @cached_property
    def _potential(self) -> Potential | SymmetryError:
        """The potential, or the error if gravity breaks the symmetry: only V then raises it."""
        try:
            return Potential(self.system, self._springs)
        except SymmetryError as error:
            return error

    @cached_property
    def _without_weight(self) -> Potential | None:
        """The potential of the springs, if gravity rotates the base about a pivot."""
        if not (isinstance(self._potential, SymmetryError) and pivot_weight(self.system).any()):
            return None
        return Potential(self.system, self._springs, weight=False)

    def _split_in_file(self, x: Array) -> InertiaSplit:
        H = mass_matrix_at(self.system, self._model, self._data, self._identity, x)
        return split_inertia(self.system, x, H, np.array(self._data.Ycrb[1].lever))

    def _derivatives(self, split: InertiaSplit) -> tuple[Array, Array]:
        """Return ∂H, (n, n, m), and ∂A of A = I⁻¹ (IA), (r, m, m), in the frame of the file."""
        r, dH = self.system.r, self._mass_matrix_derivative(split.x)
        dIA = dH[:r, r:] - np.einsum("ijc,jb->ibc", dH[:r, :r], split.local_connection)
        dA = np.linalg.solve(split.locked_inertia, dIA.reshape(r, -1))
        return dH, dA.reshape(dIA.shape)

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
