"""The symmetry groups by name, with their coordinates.

A pose g is a vector of coordinates, and a twist ξ = g⁻¹ġ is a body velocity:

    group   pose                        twist               root joint
    R       (s,)          m             (v,)                prismatic
    SO2     (θ,)          rad           (ω,)                revolute or continuous
    SE2     (x, y, θ)     m, m, rad     (v1, v2, ω)         planar
    SO3     (qx, qy, qz, qw)            (ω1, ω2, ω3)        spherical
    SE3     (x, y, z, qx, qy, qz, qw)   (v, ω)              free flyer
    RxSE2   (z, x, y, θ)  m, m, m, rad  (v3, v1, v2, ω)     prismatic with planar across it

Twists and momenta are ordered [linear; angular], and quaternions end with the real part, as in
Pinocchio.  Planar angles are not wrapped, so a pose keeps its number of full turns; `log`
returns the principal value.  All functions accept leading axes: poses (..., size) and twists
(..., dim).

A `Group` instance in a new module of this folder is registered automatically.  The closed forms
follow J. Solà, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics",
2018, appendices.  They are rearranged so that no formula loses digits near the identity or near
half a turn.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..common.errors import InputError
from .group import Group
from .rotations import (
    apply,
    conjugate,
    hat,
    homogeneous,
    left_jacobian,
    left_jacobian_inverse,
    plane_rotation,
    quaternion_exp,
    quaternion_from_matrix,
    quaternion_log,
    quaternion_product,
    rotation,
    sinc,
    unit,
    wrap,
)


class _Additive(Group):
    """A group with one coordinate; composition adds coordinates."""

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
    """ℝ: translations along one axis.

    Pose: displacement (s,) [m].  Twist: speed (v,) [m/s].  Momentum: linear momentum along the
    axis, (1,) [kg·m/s].  The group is commutative, so body and spatial quantities are equal.
    """

    def matrix(self, g: Array) -> Array:
        return homogeneous(np.ones((1, 1)), g)

    def from_matrix(self, matrix: Array) -> Array:
        return np.array(matrix[..., :1, 1])


class _SO2(_Additive):
    """SO(2): rotations about one fixed axis.

    Pose: unwrapped angle (θ,) [rad].  Twist: angular rate (ω,) [rad/s].  Momentum: angular
    momentum about the axis, (1,) [kg·m²/s].  The group is commutative, so body and spatial
    quantities are equal.
    """

    def log(self, g: Array) -> Array:
        return wrap(g)

    def matrix(self, g: Array) -> Array:
        return plane_rotation(g[..., 0])

    def from_matrix(self, matrix: Array) -> Array:
        return np.arctan2(matrix[..., 1, :1], matrix[..., 0, :1])


R = _R(
    name="R",
    axes=(2,),
    pose_names=("s",),
    root="prismatic",
    joints=("PX", "PY", "PZ", "PrismaticUnaligned"),
    conserved="momentum along the root's axis",
)

# "RUB" is Pinocchio's revolute joint without limits, whose coordinates are (cos, sin).
SO2 = _SO2(
    name="SO2",
    axes=(5,),
    pose_names=("θ",),
    root="revolute",
    joints=(
        *("RZ", "RX", "RY", "RevoluteUnaligned"),
        *("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned"),
    ),
    conserved="angular momentum about the root's axis",
)


class _SE2(Group):
    """SE(2): translations in a plane and rotations about its normal.

    Pose: (x, y, θ) [m, m, rad], θ unwrapped.  Twist: (v1, v2, ω) in the body frame
    [m/s, m/s, rad/s].  Momentum: (p1, p2, L) in the body frame, L about its origin
    [kg·m/s, kg·m/s, kg·m²/s].
    """

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
        matrix = homogeneous(plane_rotation(g[..., 2]), g[..., :2])
        matrix[..., 0, 2], matrix[..., 1, 2] = g[..., 1], -g[..., 0]
        return matrix

    def ad(self, xi: Array) -> Array:
        matrix = np.zeros((*xi.shape[:-1], 3, 3))
        matrix[..., 0, 1], matrix[..., 1, 0] = -xi[..., 2], xi[..., 2]
        matrix[..., 0, 2], matrix[..., 1, 2] = xi[..., 1], -xi[..., 0]
        return matrix

    def rate(self, g: Array, xi: Array) -> Array:
        return np.concatenate([apply(plane_rotation(g[..., 2]), xi[..., :2]), xi[..., 2:]], axis=-1)

    def matrix(self, g: Array) -> Array:
        return homogeneous(plane_rotation(g[..., 2]), g[..., :2])

    def from_matrix(self, matrix: Array) -> Array:
        theta = np.arctan2(matrix[..., 1, :1], matrix[..., 0, :1])
        return np.concatenate([matrix[..., :2, 2], theta], axis=-1)


SE2 = _SE2(
    name="SE2",
    axes=(0, 1, 5),
    pose_names=("x", "y", "θ"),
    root="planar",
    joints=("Planar",),
    conserved="momentum in the plane and angular momentum about the centre of mass",
)


class _SO3(Group):
    """SO(3): rotations about a fixed point of the base.

    Pose: unit quaternion (qx, qy, qz, qw) from body to fixed axes, real part last.
    Twist: angular velocity (ω1, ω2, ω3) in the body frame [rad/s].  Momentum: angular momentum
    about the fixed point, (3,) in the body frame [kg·m²/s].
    """

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
        return quaternion_from_matrix(matrix)

    def normalize(self, g: Array) -> Array:
        return unit(g)


SO3 = _SO3(
    name="SO3",
    axes=(3, 4, 5),
    pose_names=("qx", "qy", "qz", "qw"),
    root="spherical",
    joints=("Spherical",),
    conserved="angular momentum about the pivot",
)


class _SE3(Group):
    """SE(3): translations and rotations of space.

    Pose: (x, y, z, qx, qy, qz, qw), position [m] and unit quaternion from body to fixed axes,
    real part last.  Twist: (v, ω) in the body frame [m/s, rad/s].  Momentum: (p, L) in the body
    frame, L about its origin [kg·m/s, kg·m²/s].
    """

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
        p = apply(left_jacobian(w), xi[..., :3])
        return np.concatenate([p, quaternion_exp(w)], axis=-1)

    def log(self, g: Array) -> Array:
        w = quaternion_log(g[..., 3:])
        return np.concatenate([apply(left_jacobian_inverse(w), g[..., :3]), w], axis=-1)

    def Ad(self, g: Array) -> Array:
        R = rotation(g[..., 3:])
        matrix = np.zeros((*g.shape[:-1], 6, 6))
        matrix[..., :3, :3] = matrix[..., 3:, 3:] = R
        matrix[..., :3, 3:] = hat(g[..., :3]) @ R
        return matrix

    def ad(self, xi: Array) -> Array:
        matrix = np.zeros((*xi.shape[:-1], 6, 6))
        matrix[..., :3, :3] = matrix[..., 3:, 3:] = hat(xi[..., 3:])
        matrix[..., :3, 3:] = hat(xi[..., :3])
        return matrix

    def rate(self, g: Array, xi: Array) -> Array:
        q = g[..., 3:]
        p = apply(rotation(q), xi[..., :3])
        return np.concatenate([p, SO3.rate(q, xi[..., 3:])], axis=-1)

    def matrix(self, g: Array) -> Array:
        return homogeneous(rotation(g[..., 3:]), g[..., :3])

    def from_matrix(self, matrix: Array) -> Array:
        return np.concatenate(
            [matrix[..., :3, 3], quaternion_from_matrix(matrix[..., :3, :3])], axis=-1
        )

    def normalize(self, g: Array) -> Array:
        return np.concatenate([g[..., :3], unit(g[..., 3:])], axis=-1)


SE3 = _SE3(
    name="SE3",
    axes=(0, 1, 2, 3, 4, 5),
    pose_names=("x", "y", "z", *SO3.pose_names),
    root="free flyer",
    joints=("FreeFlyer",),
    conserved="momentum and angular momentum about the centre of mass",
)


def _join(vertical: Array, planar: Array) -> Array:
    return np.concatenate([vertical, planar], axis=-1)


class _RxSE2(Group):
    """ℝ × SE(2): translations in space and rotations about the z-axis.

    Pose: (z, x, y, θ) [m, m, m, rad], θ unwrapped.  Twist: (v3, v1, v2, ω) in the body frame
    [m/s, rad/s].  Momentum: (p3, p1, p2, L) in the body frame, L about its origin
    [kg·m/s, kg·m²/s].  The vertical entry is first, as in the product ℝ × SE(2).  In
    Pinocchio, the entries v1, v2, ω of a planar joint are adjacent, so only this order puts all
    translations first.
    """

    def identity(self) -> Array:
        return np.zeros(4)

    def compose(self, g: Array, h: Array) -> Array:
        return _join(g[..., :1] + h[..., :1], SE2.compose(g[..., 1:], h[..., 1:]))

    def inverse(self, g: Array) -> Array:
        return _join(-g[..., :1], SE2.inverse(g[..., 1:]))

    def exp(self, xi: Array) -> Array:
        return _join(xi[..., :1], SE2.exp(xi[..., 1:]))

    def log(self, g: Array) -> Array:
        return _join(g[..., :1], SE2.log(g[..., 1:]))

    def Ad(self, g: Array) -> Array:
        matrix = np.zeros((*g.shape[:-1], 4, 4))
        matrix[..., 0, 0], matrix[..., 1:, 1:] = 1.0, SE2.Ad(g[..., 1:])
        return matrix

    def ad(self, xi: Array) -> Array:
        matrix = np.zeros((*xi.shape[:-1], 4, 4))
        matrix[..., 1:, 1:] = SE2.ad(xi[..., 1:])
        return matrix

    def rate(self, g: Array, xi: Array) -> Array:
        return _join(xi[..., :1], SE2.rate(g[..., 1:], xi[..., 1:]))

    def matrix(self, g: Array) -> Array:
        """Compute the homogeneous matrix, (..., 4, 4), with axes in the order x, y, z."""
        planar = SE2.matrix(g[..., 1:])
        matrix = np.zeros((*g.shape[:-1], 4, 4))
        matrix[..., :2, :2], matrix[..., :2, 3] = planar[..., :2, :2], planar[..., :2, 2]
        matrix[..., 2, 2], matrix[..., 2, 3], matrix[..., 3, 3] = 1.0, g[..., 0], 1.0
        return matrix

    def from_matrix(self, matrix: Array) -> Array:
        planar = np.delete(np.delete(matrix, 2, axis=-1), 2, axis=-2)
        return _join(matrix[..., 2, 3:], SE2.from_matrix(planar))


RxSE2 = _RxSE2(
    name="RxSE2",
    axes=(2, 0, 1, 5),
    pose_names=("z", "x", "y", "θ"),
    root="prismatic with planar across it",
    joints=("PZ+Planar",),
    conserved="momentum and angular momentum about the centre of mass",
)


def _groups() -> dict[str, Group]:
    """Return the groups defined in this folder, by name, in order of dimension."""
    groups: list[Group] = []
    for module in iter_modules([str(Path(__file__).parent)]):
        contents = vars(import_module(f"{__package__}.{module.name}"))
        groups += [value for value in contents.values() if isinstance(value, Group)]
    return {group.name: group for group in sorted(groups, key=lambda g: (g.dim, g.name))}


GROUPS = _groups()


@checks_arguments
def group_named(name: str) -> Group:
    """Return the group with a name.

    Args:
        name: Name of the group; upper and lower case are equivalent.
    Returns:
        The group.
    Raises:
        InputError: No group has this name.  The message lists the valid names.
    """
    if isinstance(name, str):
        for group_name, group in GROUPS.items():
            if group_name.lower() == name.lower():
                return group
    raise InputError(f"unknown group {name!r}; the groups are {', '.join(GROUPS)}")
