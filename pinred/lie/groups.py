"""The five symmetry groups ℝ, SO(2), SE(2), SO(3), SE(3), left-trivialised.

A pose g is a vector of coordinates, a twist ξ = g⁻¹ġ a body velocity:

    group   pose                        twist            root joint
    R       (s,)          m             (v,)             prismatic
    SO2     (θ,)          rad           (ω,)             revolute or continuous
    SE2     (x, y, θ)     m, m, rad     (v1, v2, ω)      planar
    SO3     (qx, qy, qz, qw)            (ω1, ω2, ω3)     spherical
    SE3     (x, y, z, qx, qy, qz, qw)   (v, ω)           free flyer

Twists and momenta are [linear; angular], quaternions end with the real part, both
as in Pinocchio.  Planar angles are not wrapped: a pose that has turned twice says
so, and `log` returns the principal value.  Every function takes leading axes:
poses (..., size) and twists (..., dim).

Source of the closed forms: J. Solà, J. Deray, D. Atchuthan, "A micro Lie theory for
state estimation in robotics", 2018, appendices; written here so that no formula
loses digits near the identity or near a half turn.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..common.arrays import Array, as_floats
from ..common.errors import InputError, ShapeError
from .rotations import (
    apply,
    conjugate,
    hat,
    homogeneous,
    plane_rotation,
    quaternion_exp,
    quaternion_log,
    quaternion_of,
    quaternion_product,
    rotation,
    sinc,
    turning_inverse,
    turning_matrix,
    wrap,
)


@dataclass(frozen=True)
class PoseError:
    """Distance of two poses: the norms of the two parts of log(g⁻¹ĝ).

    rotation: (...,) rad.  translation: (...,) m.  A part the group lacks is zero.
    """

    rotation: Array
    translation: Array


class Group(ABC):
    """A Lie group acting on the base: operations on poses, twists and momenta."""

    name: ClassVar[str]
    dim: ClassVar[int]  # r, length of a twist
    size: ClassVar[int]  # length of a pose
    linear: ClassVar[int]  # how many leading twist entries are translations

    def __repr__(self) -> str:
        return self.name

    @property
    def twist_names(self) -> tuple[str, ...]:
        """Names of a twist's entries: v of translations, ω of rotations, with their axes."""
        turns = self.dim - self.linear
        v, w = (("",) if k == 1 else "123"[:k] for k in (self.linear, turns))
        return (*(f"v{k}" for k in v), *(f"ω{k}" for k in w))

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
        """Return the homogeneous matrix of g (a rotation matrix for SO2 and SO3)."""

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
        elif array.shape == (self.size + 1,) and self.name in ("SO2", "SE2"):
            pose = np.append(array[:-2], np.arctan2(array[-1], array[-2]))
            array = np.append(array[:-2], np.hypot(array[-1], array[-2]))
            if abs(array[-1] - 1.0) > 1e-6:
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
        if self.name in ("SO3", "SE3") and abs(norm - 1.0) > 1e-6:
            raise InputError(
                f"the quaternion of a pose of {self.name} must have norm 1, got {norm:g}"
            )
        return self.normalize(pose)


class _Additive(Group):
    """One coordinate under addition: the base of ℝ and SO(2)."""

    dim = size = 1

    def identity(self) -> Array:
        return np.zeros(1)

    def compose(self, g: Array, h: Array) -> Array:
        return g + h

    def inverse(self, g: Array) -> Array:
        return -g

    def exp(self, xi: Array) -> Array:
        return np.array(xi)

    def log(self, g: Array) -> Array:
        return np.array(g)

    def Ad(self, g: Array) -> Array:
        return np.ones((*g.shape[:-1], 1, 1))

    def ad(self, xi: Array) -> Array:
        return np.zeros((*xi.shape[:-1], 1, 1))

    def rate(self, g: Array, xi: Array) -> Array:  # noqa: ARG002
        return np.array(xi)


class _R(_Additive):
    name, linear = "R", 1

    def matrix(self, g: Array) -> Array:
        return homogeneous(np.ones((1, 1)), g)

    def from_matrix(self, matrix: Array) -> Array:
        return np.array(matrix[..., :1, 1])


class _SO2(_Additive):
    name, linear = "SO2", 0

    def log(self, g: Array) -> Array:
        return wrap(g)

    def matrix(self, g: Array) -> Array:
        return plane_rotation(g[..., 0])

    def from_matrix(self, matrix: Array) -> Array:
        return np.arctan2(matrix[..., 1, :1], matrix[..., 0, :1])


class _SE2(Group):
    name, dim, size, linear = "SE2", 3, 3, 2

    def identity(self) -> Array:
        return np.zeros(3)

    def compose(self, g: Array, h: Array) -> Array:
        p = g[..., :2] + apply(plane_rotation(g[..., 2]), h[..., :2])
        return np.concatenate([p, g[..., 2:] + h[..., 2:]], axis=-1)

    def inverse(self, g: Array) -> Array:
        return np.concatenate(
            [-apply(plane_rotation(-g[..., 2]), g[..., :2]), -g[..., 2:]], axis=-1
        )

    def exp(self, xi: Array) -> Array:
        w = xi[..., 2:]
        a, b = sinc(w), 0.5 * w * sinc(0.5 * w) ** 2  # sin(ω)/ω and (1 − cos ω)/ω
        v1, v2 = xi[..., :1], xi[..., 1:2]
        return np.concatenate([a * v1 - b * v2, b * v1 + a * v2, w], axis=-1)

    def log(self, g: Array) -> Array:
        w = wrap(g[..., 2:])
        a, b = np.cos(0.5 * w) / sinc(0.5 * w), 0.5 * w
        x, y = g[..., :1], g[..., 1:2]
        return np.concatenate([a * x + b * y, a * y - b * x, w], axis=-1)

    def Ad(self, g: Array) -> Array:
        out = homogeneous(plane_rotation(g[..., 2]), g[..., :2])
        out[..., 0, 2], out[..., 1, 2] = g[..., 1], -g[..., 0]
        return out

    def ad(self, xi: Array) -> Array:
        out = np.zeros((*xi.shape[:-1], 3, 3))
        out[..., 0, 1], out[..., 1, 0] = -xi[..., 2], xi[..., 2]
        out[..., 0, 2], out[..., 1, 2] = xi[..., 1], -xi[..., 0]
        return out

    def rate(self, g: Array, xi: Array) -> Array:
        return np.concatenate([apply(plane_rotation(g[..., 2]), xi[..., :2]), xi[..., 2:]], axis=-1)

    def matrix(self, g: Array) -> Array:
        return homogeneous(plane_rotation(g[..., 2]), g[..., :2])

    def from_matrix(self, matrix: Array) -> Array:
        theta = np.arctan2(matrix[..., 1, :1], matrix[..., 0, :1])
        return np.concatenate([matrix[..., :2, 2], theta], axis=-1)


class _SO3(Group):
    name, dim, size, linear = "SO3", 3, 4, 0

    def identity(self) -> Array:
        return np.array([0.0, 0.0, 0.0, 1.0])

    def compose(self, g: Array, h: Array) -> Array:
        return quaternion_product(g, h)

    def inverse(self, g: Array) -> Array:
        return conjugate(g)

    def exp(self, xi: Array) -> Array:
        return quaternion_exp(xi)

    def log(self, g: Array) -> Array:
        return quaternion_log(g)

    def Ad(self, g: Array) -> Array:
        return rotation(g)

    def ad(self, xi: Array) -> Array:
        return hat(xi)

    def rate(self, g: Array, xi: Array) -> Array:
        zero = np.zeros((*xi.shape[:-1], 1))
        return 0.5 * quaternion_product(g, np.concatenate([xi, zero], axis=-1))

    def matrix(self, g: Array) -> Array:
        return rotation(g)

    def from_matrix(self, matrix: Array) -> Array:
        return quaternion_of(matrix)

    def normalize(self, g: Array) -> Array:
        return np.asarray(g / np.linalg.norm(g, axis=-1, keepdims=True))


class _SE3(Group):
    name, dim, size, linear = "SE3", 6, 7, 3

    def identity(self) -> Array:
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def compose(self, g: Array, h: Array) -> Array:
        p = g[..., :3] + apply(rotation(g[..., 3:]), h[..., :3])
        return np.concatenate([p, quaternion_product(g[..., 3:], h[..., 3:])], axis=-1)

    def inverse(self, g: Array) -> Array:
        q = conjugate(g[..., 3:])
        return np.concatenate([-apply(rotation(q), g[..., :3]), q], axis=-1)

    def exp(self, xi: Array) -> Array:
        w = xi[..., 3:]
        p = apply(turning_matrix(w), xi[..., :3])
        return np.concatenate([p, quaternion_exp(w)], axis=-1)

    def log(self, g: Array) -> Array:
        w = quaternion_log(g[..., 3:])
        return np.concatenate([apply(turning_inverse(w), g[..., :3]), w], axis=-1)

    def Ad(self, g: Array) -> Array:
        R = rotation(g[..., 3:])
        out = np.zeros((*g.shape[:-1], 6, 6))
        out[..., :3, :3] = out[..., 3:, 3:] = R
        out[..., :3, 3:] = hat(g[..., :3]) @ R
        return out

    def ad(self, xi: Array) -> Array:
        out = np.zeros((*xi.shape[:-1], 6, 6))
        out[..., :3, :3] = out[..., 3:, 3:] = hat(xi[..., 3:])
        out[..., :3, 3:] = hat(xi[..., :3])
        return out

    def rate(self, g: Array, xi: Array) -> Array:
        q = g[..., 3:]
        p = apply(rotation(q), xi[..., :3])
        return np.concatenate([p, SO3.rate(q, xi[..., 3:])], axis=-1)

    def matrix(self, g: Array) -> Array:
        return homogeneous(rotation(g[..., 3:]), g[..., :3])

    def from_matrix(self, matrix: Array) -> Array:
        return np.concatenate([matrix[..., :3, 3], quaternion_of(matrix[..., :3, :3])], axis=-1)

    def normalize(self, g: Array) -> Array:
        return np.concatenate([g[..., :3], SO3.normalize(g[..., 3:])], axis=-1)


R: Group = _R()
SO2: Group = _SO2()
SE2: Group = _SE2()
SO3: Group = _SO3()
SE3: Group = _SE3()

GROUPS: dict[str, Group] = {group.name: group for group in (R, SO2, SE2, SO3, SE3)}


def group_named(name: str) -> Group:
    """Return the group called `name`.  Raises InputError listing the valid names."""
    try:
        return GROUPS[name]
    except (KeyError, TypeError):
        raise InputError(f"unknown group {name!r}; the groups are {', '.join(GROUPS)}") from None
