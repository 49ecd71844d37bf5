"""Group: what a symmetry group knows of itself, and the operations on poses, twists, momenta."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..common.arrays import Array, as_floats
from ..common.errors import InputError, ShapeError
from .rotations import apply, hat, plane_rotation, rotation

_UNIT = 1e-3  # by how much a quaternion may miss length one, as one of few decimals does


@dataclass(frozen=True)
class PoseError:
    """Distance of two poses: the norms of the two parts of log(g⁻¹ĝ).

    rotation: (...,) rad.  translation: (...,) m.  A part the group lacks is zero.
    """

    rotation: Array
    translation: Array


@dataclass(frozen=True, eq=False, repr=False)
class Group(ABC):
    """A Lie group that moves the base: a subgroup of SE(3), in the frame of its root joint.

    name: what it is called.  axes: where the entries of a twist stand among the six of space,
    (v1, v2, v3, ω1, ω2, ω3): translations first, and last of these the two that a single
    rotation turns into each other, in its sense.  Where there is but one, it may be any axis,
    and z stands for it.  pose_names: of the coordinates of a pose: lengths, then an angle or a
    quaternion.  root: its root joint, in words.  joints: Pinocchio's joints that move so,
    without "JointModel", the parts of a composite one joined by "+"; a body floats on the
    first.  conserved: the momentum that it keeps, in words.

    dim, linear, turns: how many entries a twist has, how many of them are translations, and
    how many rotations: 0, 1 or 3.  size: how many coordinates a pose has.  plane: which two
    translations a single rotation turns into each other, or none.  turns_about_com: whether
    the centre of mass is free to stay where it is in all rotations, as it translates across
    their axes.
    """

    name: str
    axes: tuple[int, ...]
    pose_names: tuple[str, ...]
    root: str
    joints: tuple[str, ...]
    conserved: str
    dim: int = field(init=False)
    linear: int = field(init=False)
    turns: int = field(init=False)
    size: int = field(init=False)
    plane: tuple[int, ...] = field(init=False)
    turns_about_com: bool = field(init=False)

    def __post_init__(self) -> None:
        linear = sum(axis < 3 for axis in self.axes)
        turns = len(self.axes) - linear
        plane = (linear - 2, linear - 1) if turns == 1 and linear >= 2 else ()
        derived = {
            "dim": len(self.axes),
            "linear": linear,
            "turns": turns,
            "size": linear + (4 if turns == 3 else turns),
            "plane": plane,
            "turns_about_com": bool(plane) or (turns == 3 and linear == 3),
        }
        for key, value in derived.items():
            object.__setattr__(self, key, value)
        ordered = all(axis < 3 for axis in self.axes[:linear])
        if not ordered or turns not in (0, 1, 3) or len(self.pose_names) != self.size:
            raise InputError(
                f"{self.name}: axes are translations, then 0, 1 or 3 rotations, got {self.axes}; "
                f"a pose has {self.size} coordinates, got {len(self.pose_names)} names"
            )

    def __repr__(self) -> str:
        return self.name

    @property
    def is_pivot(self) -> bool:
        """Whether a point of the base stays where it is, and the base turns about it freely."""
        return self.turns == 3 and not self.linear

    @property
    def twist_names(self) -> tuple[str, ...]:
        """Names of a twist's entries: v of translations, ω of rotations, with their axes."""
        v, w = self.axes[: self.linear], self.axes[self.linear :]
        return (
            *(f"v{axis + 1}" if len(v) > 1 else "v" for axis in v),
            *(f"ω{axis - 2}" if len(w) > 1 else "ω" for axis in w),
        )

    def turned(self, attitude: Array, v: Array) -> Array:
        """Return translations (..., linear) along the fixed axes from those along the body's.

        attitude: (..., size − linear), angle or unit quaternion.
        """
        if not self.turns_about_com:
            return v
        if self.turns == 3:
            return apply(rotation(attitude), v)
        turned = apply(plane_rotation(attitude[..., 0]), v[..., self.linear - 2 :])
        return turned if self.linear == 2 else np.concatenate([v[..., :-2], turned], axis=-1)

    def turned_back(self, attitude: Array, v: Array) -> Array:
        """Return translations (..., linear) along the body's axes from those along the fixed."""
        if self.turns < 3 or not self.linear:
            return self.turned(-attitude, v)
        return apply(np.swapaxes(rotation(attitude), -1, -2), v)

    def about(self, c: Array, mu: Array) -> Array:
        """Return the angular part about a point, N − c × F, (..., turns).

        c: (..., 3) in the frame of mu.  mu: (..., dim) a wrench or momentum (F, N).
        """
        F, N = mu[..., : self.linear], mu[..., self.linear :]
        if not self.turns_about_com:
            return N
        if self.turns == 3:
            return np.asarray(N - apply(hat(c), F))
        (i, j), (x, y) = self.plane, self.axes[-3:-1]
        arm = c[..., x, None] * F[..., j, None] - c[..., y, None] * F[..., i, None]
        return np.asarray(N - arm)

    @abstractmethod
    def identity(self) -> Array:
        """Return the pose of the identity, (size,)."""

    @abstractmethod
    def compose(self, g: Array, h: Array) -> Array:
        """Return the product g h."""

    @abstractmethod
    def inverse(self, g: Array) -> Array:
        """Return g⁻¹."""

    @abstractmethod
    def exp(self, xi: Array) -> Array:
        """Return the pose exp ξ, reached by moving with body twist ξ for unit time."""

    @abstractmethod
    def log(self, g: Array) -> Array:
        """Return the twist ξ with exp(ξ) = g and the smallest rotation (at most π)."""

    @abstractmethod
    def Ad(self, g: Array) -> Array:
        """Return Ad_g, (..., r, r): body twists at g to spatial twists."""

    @abstractmethod
    def ad(self, xi: Array) -> Array:
        """Return ad_ξ, (..., r, r): ad_ξ η = [ξ, η].

        On se(3), [(v,ω), (v',ω')] = (ω×v' − ω'×v, ω×ω').
        """

    @abstractmethod
    def rate(self, g: Array, xi: Array) -> Array:
        """Return ġ, the rate of the pose coordinates for body twist ξ: ġ = g ξ."""

    @abstractmethod
    def matrix(self, g: Array) -> Array:
        """Return the homogeneous matrix of g (a rotation matrix where nothing translates)."""

    @abstractmethod
    def from_matrix(self, matrix: Array) -> Array:
        """Return the pose whose homogeneous matrix is given."""

    def normalize(self, g: Array) -> Array:
        """Return g with round-off removed (unit quaternions)."""
        return g

    def bracket(self, xi: Array, eta: Array) -> Array:
        """Return the Lie bracket [ξ, η]."""
        return np.asarray(self.ad(xi) @ eta[..., None])[..., 0]

    def coadjoint(self, xi: Array, mu: Array) -> Array:
        """Return ad*_ξ μ = ad_ξᵀ μ; a free body's momentum obeys μ̇ = ad*_ξ μ."""
        return np.asarray(np.swapaxes(self.ad(xi), -1, -2) @ mu[..., None])[..., 0]

    def spatial_momentum(self, g: Array, mu: Array) -> Array:
        """Return J = Ad*_{g⁻¹} μ, the momentum in the fixed frame, about its origin."""
        Ad = self.Ad(self.inverse(g))
        return np.asarray(np.swapaxes(Ad, -1, -2) @ mu[..., None])[..., 0]

    def error(self, g: Array, h: Array) -> PoseError:
        """Return how far h is from g, ‖log(g⁻¹h)‖, rotation and translation apart."""
        xi = self.log(self.compose(self.inverse(g), h))
        return PoseError(
            rotation=np.linalg.norm(xi[..., self.linear :], axis=-1),
            translation=np.linalg.norm(xi[..., : self.linear], axis=-1),
        )

    def pose(self, value: Any) -> Array:
        """Return `value` as a pose of this group, (size,).

        Takes pose coordinates, Pinocchio's joint coordinates (cosine and sine in the
        place of a planar angle), a homogeneous matrix, or a pin.SE3 for SE3.
        Raises ShapeError for another shape or a number that is not finite,
        InputError if the value is not in the group.
        """
        array = as_floats(getattr(value, "homogeneous", value), f"a pose of {self.name}")
        if not np.isfinite(array).all():
            raise ShapeError(f"a pose of {self.name} must be finite, got {array}")
        pose: Array
        if array.shape == (self.size,):
            pose = array
        elif array.shape == (self.size + 1,) and self.turns == 1:
            pose = np.append(array[:-2], np.arctan2(array[-1], array[-2]))
            array = np.append(array[:-2], np.hypot(array[-1], array[-2]))
            if abs(array[-1] - 1.0) > _UNIT:
                raise InputError(f"cosine and sine in a pose of {self.name} must have norm 1")
        elif array.shape == self.matrix(self.identity()).shape:
            pose = self.from_matrix(array)
            if not np.allclose(self.matrix(pose), array, rtol=0.0, atol=1e-6):
                raise InputError(f"the matrix given as pose is not in {self.name}:\n{array}")
        else:
            raise ShapeError(
                f"a pose of {self.name} has shape ({self.size},) or is a homogeneous matrix, "
                f"got shape {array.shape}"
            )
        with np.errstate(over="ignore"):
            norm = float(np.linalg.norm(pose[-4:]))
        if self.turns == 3 and abs(norm - 1.0) > _UNIT:
            raise InputError(
                f"the quaternion of a pose of {self.name} must have norm 1, got {norm:g}"
            )
        return self.normalize(pose)
