"""The reduction in another section: a base frame displaced by a shape-dependent h(x).

The pose of the new frame is g h(x).  With Θ = h⁻¹ ∂h, the body twists of h per unit joint rate,

    A′ = Ad_{h⁻¹} A − Θ,   B′ = Ad_{h⁻¹} B,   I′ = Ad_hᵀ I Ad_h,   M′ = M,   μ′ = Ad_hᵀ μ.

With balls, ∂ is the derivative along the frame of the shape, and B′ contains the frame's term: the
formula for B′ is the same, because Θ is flat, ∂_αΘ_β − ∂_βΘ_α + [Θ_α, Θ_β] = c^γ_αβ Θ_γ.

Source: Cendra, Marsden, Ratiu, "Lagrangian reduction by stages", 2001, ch. 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.argument_kinds import call_function
from ..common.arrays import Array, FrozenArrays, as_floats
from ..common.errors import InputError, ShapeError
from ..system.joints import axes_of
from ..system.system import System
from .inertia_split import InertiaSplit

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
        elements = [self._element(shape)[:2] for shape in x]
        places = [self._placement(g, shape) for (g, _), shape in zip(elements, x, strict=True)]
        system = self._system
        poses = np.array([g for g, _ in elements]).reshape(len(x), self._group.size)
        return Moves(
            Ad=self._group.Ad(poses),
            inverse=self._group.Ad(self._group.inverse(poses)),
            theta=np.array([theta for _, theta in elements]).reshape(-1, system.r, system.m),
            rotation=np.array([place.rotation for place in places]).reshape(-1, 3, 3),
            translation=np.array([place.translation for place in places]).reshape(-1, 3),
        )

    def _placement(self, pose: Array, x: Array) -> pin.SE3:
        """Return h in the root joint's fixed frame."""
        model, data = self._system.sorted_model, self._system.sorted_data
        pin.forwardKinematics(model, data, self._system.sorted_q(pose, x))
        return model.jointPlacements[1].actInv(data.oMi[1])

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
        inverse, space = self._group.inverse(pose), self._system.space
        for k, unit in enumerate(np.eye(self._system.m)):
            twist, change = np.zeros(self._system.r), np.zeros_like(theta)
            for n, weight in ((1, 0.75), (2, -0.15), (3, 1 / 60)):
                ahead, behind = (
                    self._element(space.integrate(x, s * n * _STEP * unit)) for s in (1.0, -1.0)
                )
                logs = [
                    self._group.log(self._group.compose(inverse, g)) for g, *_ in (ahead, behind)
                ]
                twist += weight / _STEP * (logs[0] - logs[1])
                change += weight / _STEP * (ahead[1] - behind[1])
            for name, value, expected in (
                ("Θ = h⁻¹ ∂h", theta[:, k], twist),
                ("∂Θ", change if dtheta is None else dtheta[:, :, k], change),
            ):
                error = np.abs(value - expected).max(initial=0.0)
                if not error <= _TOLERANCE * (1.0 + np.abs(expected).max()):
                    joint = self._system.shape_names[k]
                    raise InputError(
                        f"{name} of the section with respect to '{joint}' is {value} at x = {x}, "
                        f"but finite differences of h(x) are {expected}; Θ is the body twist of "
                        "h per unit rate of the joint"
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
