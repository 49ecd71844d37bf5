"""The reduction in another section: the base frame moved by h(x) along with the shape.

The pose of the new frame is g h(x).  With Θ = h⁻¹ ∂h, the body twists of h per unit joint rate,

    A′ = Ad_{h⁻¹} A − Θ,   B′ = Ad_{h⁻¹} B,   I′ = Ad_hᵀ I Ad_h,   M′ = M,   μ′ = Ad_hᵀ μ.

Source: Cendra, Marsden, Ratiu, "Lagrangian reduction by stages", 2001, ch. 2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, as_floats, freeze
from ..common.errors import InputError, ShapeError
from ..system.joints import axes_of
from ..system.system import System
from .inertia_split import InertiaSplit

Section: TypeAlias = Callable[[Array], tuple[Any, ...]]

_STEP = 1e-3  # rad | m, of the differences that try a derivative
_AGREE = 1e-6  # of the largest entry; what they are good for


@dataclass(frozen=True)
class Moves:
    """Changes of frame at N shapes; arrays are read-only.

    Ad, back: (N, r, r) Ad_h and Ad_{h⁻¹}.  theta: (N, r, m).  rotation: (N, 3, 3), translation:
    (N, 3) of h in space, in the root joint's fixed frame.
    """

    Ad: Array
    back: Array
    theta: Array
    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        freeze(self)

    def mass_matrix(self, H: Array) -> Array:
        """Return H′ (N, n, n): the same energy of the velocities (ξ′, ẋ)."""
        r = self.Ad.shape[-1]
        T = np.zeros_like(H)
        T[:, :r, :r], T[:, :r, r:] = self.Ad, -self.Ad @ self.theta
        T[:, r:, r:] = np.eye(H.shape[-1] - r)
        return np.asarray(np.swapaxes(T, 1, 2) @ H @ T)

    def local_connection(self, A: Array) -> Array:
        """Return A′, (N, r, m)."""
        return np.asarray(self.back @ A - self.theta)

    def curvature(self, B: Array) -> Array:
        """Return B′, (N, r, m, m)."""
        return np.asarray(np.einsum("nij,njab->niab", self.back, B))

    def com(self, com: Array) -> Array:
        """Return the centre of mass in the new frame, (N, 3)."""
        return np.asarray(np.einsum("nji,nj->ni", self.rotation, com - self.translation))


class MovedFrame:
    """A base frame g h(x) of one system: what it makes of the reduction at a shape."""

    def __init__(self, system: System, h: Section) -> None:
        """Take the section.  Raises InputError if its derivative is wrong."""
        self._system, self._group, self.section = system, system.group, h
        rng = np.random.default_rng(0)
        for x in rng.uniform(-1.0, 1.0, (2, system.m)):
            self._try(x)

    def split(self, old: InertiaSplit) -> InertiaSplit:
        """Return the split of the mass matrix in this frame."""
        pose, theta, _ = self._element(old.x)
        Ad, r = self._group.Ad(pose), old.r
        I = Ad.T @ old.locked_inertia @ Ad
        A = self._group.Ad(self._group.inverse(pose)) @ old.local_connection - theta
        H = np.empty_like(old.mass_matrix)
        H[:r, :r], H[:r, r:] = I, I @ A
        H[r:, :r], H[r:, r:] = H[:r, r:].T, old.reduced_metric + A.T @ I @ A
        com = self._placement(pose, old.x).actInv(old.com)
        return InertiaSplit(old.x, H, I, A, old.reduced_metric, com)

    def com_slope(self, new: InertiaSplit, slope: Array) -> Array:
        """Return ∂c′, (3, m), of the centre of mass c′ = h⁻¹ c, from ∂c."""
        pose, theta, _ = self._element(new.x)
        twists = axes_of(self._system.model.joints[1]) @ theta
        moved = twists[:3] + np.cross(twists[3:].T, new.com).T
        return np.asarray(self._placement(pose, new.x).rotation.T @ slope - moved)

    def _placement(self, pose: Array, x: Array) -> pin.SE3:
        """Return h in space, in the root joint's fixed frame."""
        model, data = self._system.model, self._system.data
        pin.forwardKinematics(model, data, self._system.model_q(pose, x))
        return model.jointPlacements[1].actInv(data.oMi[1])

    def curvature(self, x: Array, B: Array) -> Array:
        """Return B′ = Ad_{h⁻¹} B, (r, m, m)."""
        pose, _, _ = self._element(x)
        return np.asarray(np.einsum("ij,jab->iab", self._group.Ad(self._group.inverse(pose)), B))

    def inertia_slope(self, new: InertiaSplit, dI: Array) -> Array:
        """Return ∂I′, (r, r, m), ∂ last, from ∂I."""
        pose, theta, _ = self._element(new.x)
        Ad, ad = self._group.Ad(pose), self._group.ad(theta.T)
        half = np.einsum("ij,cjk->ikc", new.locked_inertia, ad)  # ∂ Ad_h = Ad_h ad_Θ
        moved = np.einsum("ji,jkc,kl->ilc", Ad, dI, Ad)
        return np.asarray(moved + half + np.swapaxes(half, 0, 1))

    def connection_slope(self, new: InertiaSplit, dA: Array | InputError) -> Array | InputError:
        """Return ∂A′, (r, m, m), ∂ last, from ∂A; why not, if h does not give ∂Θ."""
        pose, theta, slope = self._element(new.x)
        if isinstance(dA, InputError):
            return dA
        if slope is None:
            return InputError(
                "dA of this section needs the derivative of Θ = h⁻¹ ∂h: let h(x) return it as a "
                "third value, (r, m, m), ∂ last"
            )
        back, ad = self._group.Ad(self._group.inverse(pose)), self._group.ad(theta.T)
        turned = np.einsum("cij,jb->ibc", ad, new.local_connection + theta)
        return np.asarray(np.einsum("ij,jbc->ibc", back, dA) - turned - slope)

    def moves(self, x: Array) -> Moves:
        """Return the change of frame at shapes x (N, m)."""
        elements = [self._element(one)[:2] for one in x]
        placed = [self._placement(pose, one) for (pose, _), one in zip(elements, x, strict=True)]
        system = self._system
        pose = np.array([g for g, _ in elements]).reshape(len(x), self._group.size)
        return Moves(
            Ad=self._group.Ad(pose),
            back=self._group.Ad(self._group.inverse(pose)),
            theta=np.array([theta for _, theta in elements]).reshape(-1, system.r, system.m),
            rotation=np.array([at.rotation for at in placed]).reshape(-1, 3, 3),
            translation=np.array([at.translation for at in placed]).reshape(-1, 3),
        )

    def _element(self, x: Array) -> tuple[Array, Array, Array | None]:
        given = self.section(x.copy())
        if not isinstance(given, tuple) or len(given) not in (2, 3):
            raise InputError(
                "h(x) must return (group element, Θ), Θ = h⁻¹ ∂h with shape (r, m), and may return "
                "∂Θ (r, m, m) as a third"
            )
        r, m = self._system.r, self._system.m
        theta = _sized(given[1], (r, m), "Θ = h⁻¹ ∂h")
        slope = _sized(given[2], (r, m, m), "∂Θ") if len(given) == 3 else None
        return self._group.pose(given[0]), theta, slope

    def _try(self, x: Array) -> None:
        """Raise InputError if differences of h say that Θ, or ∂Θ, is another derivative."""
        pose, theta, slope = self._element(x)
        back = self._group.inverse(pose)
        for k, e in enumerate(np.eye(self._system.m)):
            turned, changed = np.zeros(self._system.r), np.zeros_like(theta)
            for n, weight in ((1, 0.75), (2, -0.15), (3, 1 / 60)):
                ahead, behind = (self._element(x + s * n * _STEP * e) for s in (1.0, -1.0))
                logs = [self._group.log(self._group.compose(back, g[0])) for g in (ahead, behind)]
                turned += weight / _STEP * (logs[0] - logs[1])
                changed += weight / _STEP * (ahead[1] - behind[1])
            for what, found, own in (
                ("Θ = h⁻¹ ∂h", theta[:, k], turned),
                ("∂Θ", changed if slope is None else slope[:, :, k], changed),
            ):
                if not np.abs(found - own).max(initial=0.0) <= _AGREE * (1.0 + np.abs(own).max()):
                    name = self._system.shape_names[k]
                    raise InputError(
                        f"{what} of the section by '{name}' is {found} at x = {x}, but h(x) "
                        f"changes by {own}; Θ is the body twist of h per unit rate of the joint"
                    )


def _sized(value: Any, shape: tuple[int, ...], what: str) -> Array:
    array = as_floats(value, what)
    if array.shape != shape or not np.isfinite(array).all():
        raise ShapeError(f"{what} must be finite and have shape {shape}, got {array.shape}")
    return array
