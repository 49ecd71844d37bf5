"""The base class of all symmetry groups: operations on poses, twists and momenta."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import Any, Literal, TypeAlias

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats, read_only
from ..common.errors import InputError, ShapeError
from .rotations import apply, hat, plane_rotation, rotation

_FLOAT = np.dtype(float)
# Length of the last axis in a group, by the name of the argument.
_LENGTHS: dict[str, Callable[[Any], int]] = {
    **dict.fromkeys(("g", "h"), lambda group: group.size),
    **dict.fromkeys(("xi", "eta", "mu"), lambda group: group.dim),
    "attitude": lambda group: group.size - group.linear,
    "v": lambda group: group.linear,
    "c": lambda _: 3,
}


def convert_arguments(group: type) -> None:
    """Let the operations of a class of groups accept lists and arrays of any numbers.

    Arguments that are not numbers, or of another length, raise an error that names them.

    Args:
        group: The class, whose methods are changed in place.
    """
    for name, member in list(vars(group).items()):
        if inspect.isfunction(member) and not getattr(member, "__isabstractmethod__", False):
            parameters = list(inspect.signature(member).parameters)[1:]
            if parameters and set(parameters) <= {*_LENGTHS, "matrix"}:
                setattr(group, name, _on_arrays(member, parameters))
    checks_arguments(group)


def _on_arrays(method: Callable[..., Any], names: list[str]) -> Callable[..., Any]:
    @wraps(method)
    def call(group: Any, *values: Any) -> Any:
        return method(group, *(_array(group, *pair) for pair in zip(names, values, strict=True)))

    return call


def _array(group: Any, name: str, value: Any) -> Any:
    """Return an argument as an array of floats, and check the length of its last axes."""
    if not isinstance(value, np.ndarray) or value.dtype != _FLOAT:
        value = as_floats(value, name)
    length = _LENGTHS.get(name)
    shape = group.matrix(group.identity()).shape if length is None else (length(group),)
    if value.shape[-len(shape) :] != shape:
        expected = ", ".join(map(str, ("...", *shape)))
        raise ShapeError(f"{name} must have shape ({expected}), got {value.shape}")
    return value


# Allowed deviation of a quaternion's norm from 1, so that quaternions with few decimals pass.
_NORM_TOLERANCE = 1e-3


@checks_arguments
@dataclass(frozen=True)
class PoseError:
    """Distance between two poses g and h: the norms of the two parts of log(g⁻¹h).

    A part that the group lacks is zero.

    Attributes:
        rotation: Norm of the angular part, (...,) [rad].
        translation: Norm of the linear part, (...,) [m].
    """

    rotation: Array
    translation: Array


Quantity: TypeAlias = Literal["twist", "pose", "momentum"]


@dataclass(frozen=True, eq=False, repr=False)
class Group(ABC):
    """A Lie group of base motions: a subgroup of SE(3), in the frame of the root joint.

    Twists are body twists ξ = g⁻¹ġ, and momenta are body momenta μ.  Both are ordered
    [linear; angular], as in Pinocchio.  Every method accepts leading axes: poses have shape
    (..., size), twists and momenta (..., dim).

    Attributes:
        name: Name of the group, as in `GROUPS`.
        axes: Index of each twist entry in (v1, v2, v3, ω1, ω2, ω3).  Translations come first.  In
            a group with a single rotation, the last two translations are the axes that the
            positive rotation maps into each other.  In a group with a single axis, this axis is
            called z in any direction.
        pose_names: Names of the pose coordinates: lengths, then an angle or a quaternion.
        root: Description of the root joint, for messages.
        joints: Pinocchio's joint types that have this motion, without the prefix "JointModel".
            Parts of a composite joint are joined by "+".  A floating body is given the first type.
        conserved: Description of the conserved momentum, for messages.
        dim: Dimension r of the group: the number of twist entries.
        linear: Number of translations.
        turns: Number of rotations: 0, 1 or 3.
        size: Number of pose coordinates.
        plane: Indices of the two translations that a single rotation rotates into each other,
            or empty.
        turns_about_com: Whether the group can rotate about any axis with the centre of mass at
            rest.  This requires translations in all directions perpendicular to the rotation axes.
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

    def __init_subclass__(cls) -> None:
        """Convert and check the arguments of all operations, also in groups of users."""
        super().__init_subclass__()
        convert_arguments(cls)

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
        """Whether the group consists of all rotations about one fixed point of the base."""
        return self.turns == 3 and not self.linear

    @property
    def twist_names(self) -> tuple[str, ...]:
        """Names of the twist entries: v for translations, ω for rotations, with axis numbers."""
        v, w = self.axes[: self.linear], self.axes[self.linear :]
        return (
            *(f"v{axis + 1}" if len(v) > 1 else "v" for axis in v),
            *(f"ω{axis - 2}" if len(w) > 1 else "ω" for axis in w),
        )

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """Names of the twist entries in plain letters: v for translations, w for rotations."""
        return tuple(name.replace("p", "v", 1).replace("L", "w", 1) for name in self.momentum_names)

    @cached_property
    def neutral(self) -> Array:
        """The pose of the identity, (size,); read-only."""
        return read_only(self.identity())

    @cached_property
    def momentum_names(self) -> tuple[str, ...]:
        """Names of the momentum entries: p for translations, L for rotations, with axes."""
        p, L = self.axes[: self.linear], self.axes[self.linear :]
        return (
            *(f"p{'xyz'[axis]}" if len(p) > 1 else "p" for axis in p),
            *(f"L{'xyz'[axis - 3]}" if len(L) > 1 else "L" for axis in L),
        )

    def components(self, quantity: Quantity) -> dict[str, int]:
        """Return the index of each entry of a twist, pose or momentum, by all accepted names.

        The names of poses and twists are accepted for both, so a component of SE2 is x, y, θ,
        theta or turn, and v1, v2, ω, omega or w, for all three.  The components of a quaternion
        have only their own names.

        Args:
            quantity: "twist", "pose" or "momentum".
        Returns:
            {name: index}; the names in `twist_names`, `pose_names` or `momentum_names` come first.
        Raises:
            InputError: The quantity is unknown.
        """
        by_quantity = {
            "twist": self.twist_names, "pose": self.pose_names, "momentum": self.momentum_names,
        }  # fmt: skip
        if quantity not in by_quantity:
            raise InputError(f"quantity: expected {' or '.join(by_quantity)}, got {quantity!r}")
        names = by_quantity[quantity]
        numbers = {name: k for k, name in enumerate(names)}
        for k, axis in enumerate(self.axes):
            if axis < 3:
                aliases = [self.pose_names[k], self.twist_names[k], f"v{axis + 1}"]
                aliases += [self.velocity_names[k]]
                aliases += [self.momentum_names[k], f"p{axis + 1}"] * (quantity == "momentum")
            elif quantity == "pose" and self.turns > 1:
                continue
            else:
                aliases = ["θ", "theta", "turn", "ω", "w", "omega"] if self.turns == 1 else []
                aliases += [f"{letter}{axis - 2}" for letter in ("ω", "w", "omega")]
                aliases += [self.velocity_names[k]]
                aliases += [self.momentum_names[k], f"L{axis - 2}"] * (quantity == "momentum")
            for name in aliases:
                numbers.setdefault(name, k)
        return numbers

    def turned(self, attitude: Array, v: Array) -> Array:
        """Rotate linear components from body axes to fixed axes.

        Args:
            attitude: Angle [rad] or unit quaternion, (..., size − linear).
            v: Linear components along the body axes, (..., linear).
        Returns:
            (..., linear): the components along the fixed axes.
        """
        if not self.turns_about_com:
            return v
        if self.turns == 3:
            return apply(rotation(attitude), v)
        planar = apply(plane_rotation(attitude[..., 0]), v[..., self.linear - 2 :])
        return planar if self.linear == 2 else np.concatenate([v[..., :-2], planar], axis=-1)

    def turned_back(self, attitude: Array, v: Array) -> Array:
        """Rotate linear components from fixed axes to body axes, the inverse of `turned`.

        Args:
            attitude: Angle [rad] or unit quaternion, (..., size − linear).
            v: Linear components along the fixed axes, (..., linear).
        Returns:
            (..., linear): the components along the body axes.
        """
        if self.turns < 3 or not self.linear:
            return self.turned(-attitude, v)
        return apply(np.swapaxes(rotation(attitude), -1, -2), v)

    def about(self, c: Array, mu: Array) -> Array:
        """Compute the angular part of a wrench or momentum about a point, N − c × F.

        Args:
            c: The point, (..., 3) [m], in the frame of mu.
            mu: Wrench or momentum [F; N] about the origin, (..., dim).
        Returns:
            (..., turns): the angular part about c.
        """
        F, N = mu[..., : self.linear], mu[..., self.linear :]
        if not self.turns_about_com:
            return N
        if self.turns == 3:
            return np.asarray(N - apply(hat(c), F))
        (i, j), (x, y) = self.plane, self.axes[-3:-1]
        moment = c[..., x, None] * F[..., j, None] - c[..., y, None] * F[..., i, None]
        return np.asarray(N - moment)

    @abstractmethod
    def identity(self) -> Array:
        """Return the pose of the identity, (size,)."""

    @abstractmethod
    def compose(self, g: Array, h: Array) -> Array:
        """Compute the product g h.

        Args:
            g: Pose, (..., size).
            h: Pose, (..., size).
        Returns:
            (..., size): the pose g h.
        """

    @abstractmethod
    def inverse(self, g: Array) -> Array:
        """Compute the inverse g⁻¹.

        Args:
            g: Pose, (..., size).
        Returns:
            (..., size): the pose g⁻¹.
        """

    @abstractmethod
    def exp(self, xi: Array) -> Array:
        """Compute the pose exp ξ, reached in unit time with constant body twist ξ.

        Args:
            xi: Body twist, (..., dim).
        Returns:
            (..., size): the pose.
        """

    @abstractmethod
    def log(self, g: Array) -> Array:
        """Compute the twist ξ with exp ξ = g and the smallest rotation, at most π.

        Args:
            g: Pose, (..., size).
        Returns:
            (..., dim): the twist.
        """

    @abstractmethod
    def Ad(self, g: Array) -> Array:
        """Compute Ad_g, the matrix that maps body twists to spatial twists.

        Args:
            g: Pose, (..., size).
        Returns:
            (..., dim, dim): the matrix.
        """

    @abstractmethod
    def ad(self, xi: Array) -> Array:
        """Compute the matrix ad_ξ of the Lie bracket: ad_ξ η = [ξ, η].

        On se(3), [(v, ω), (v', ω')] = (ω × v' − ω' × v, ω × ω').

        Args:
            xi: Twist, (..., dim).
        Returns:
            (..., dim, dim): the matrix.
        """

    @abstractmethod
    def rate(self, g: Array, xi: Array) -> Array:
        """Compute the rate ġ = g ξ of the pose coordinates for a body twist ξ.

        Args:
            g: Pose, (..., size).
            xi: Body twist, (..., dim).
        Returns:
            (..., size): the rate.
        """

    @abstractmethod
    def matrix(self, g: Array) -> Array:
        """Compute the homogeneous matrix of a pose.

        Args:
            g: Pose, (..., size).
        Returns:
            The homogeneous matrix; for a group without translations, the rotation matrix.
        """

    @abstractmethod
    def from_matrix(self, matrix: Array) -> Array:
        """Compute the pose of a matrix, the inverse of `matrix`.

        Args:
            matrix: Matrix of an element of the group, with the shape that `matrix` returns.
        Returns:
            (..., size): the pose.
        """

    def normalize(self, g: Array) -> Array:
        """Scale the quaternion of a pose to unit norm.

        Args:
            g: Pose, (..., size).
        Returns:
            (..., size): the normalised pose.
        """
        return g

    def bracket(self, xi: Array, eta: Array) -> Array:
        """Compute the Lie bracket [ξ, η].

        Args:
            xi: Twist, (..., dim).
            eta: Twist, (..., dim).
        Returns:
            (..., dim): the bracket.
        """
        return np.asarray(self.ad(xi) @ eta[..., None])[..., 0]

    def coadjoint(self, xi: Array, mu: Array) -> Array:
        """Compute ad*_ξ μ = ad_ξᵀ μ.  The momentum of a free body obeys μ̇ = ad*_ξ μ.

        Args:
            xi: Body twist, (..., dim).
            mu: Body momentum, (..., dim).
        Returns:
            (..., dim): ad*_ξ μ.
        """
        return np.asarray(np.swapaxes(self.ad(xi), -1, -2) @ mu[..., None])[..., 0]

    def spatial_momentum(self, g: Array, mu: Array) -> Array:
        """Compute the spatial momentum J = Ad*_{g⁻¹} μ.

        Args:
            g: Pose, (..., size).
            mu: Body momentum, (..., dim).
        Returns:
            (..., dim): the momentum in the fixed frame, about its origin.
        """
        Ad = self.Ad(self.inverse(g))
        return np.asarray(np.swapaxes(Ad, -1, -2) @ mu[..., None])[..., 0]

    def error(self, g: Array, h: Array) -> PoseError:
        """Compute the distance between two poses, the norms of the parts of log(g⁻¹h).

        Args:
            g: Pose, (..., size).
            h: Pose, (..., size).
        Returns:
            The rotational and the translational distance.
        """
        xi = self.log(self.compose(self.inverse(g), h))
        return PoseError(
            rotation=np.linalg.norm(xi[..., self.linear :], axis=-1),
            translation=np.linalg.norm(xi[..., : self.linear], axis=-1),
        )

    def pose(self, value: Any) -> Array:
        """Convert a value to a pose of this group.

        Args:
            value: Pose coordinates (size,), Pinocchio's joint coordinates (cosine and sine
                instead of a planar angle), a homogeneous matrix, or a pin.SE3 for SE3.
        Returns:
            (size,): the pose, with a unit quaternion.
        Raises:
            ShapeError: The value has another shape, or an entry is not finite.
            InputError: The value is not an element of the group.
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
            if abs(array[-1] - 1.0) > _NORM_TOLERANCE:
                raise InputError(f"cosine and sine in a pose of {self.name} must have norm 1")
        elif array.shape == self.matrix(self.identity()).shape:
            pose = self.from_matrix(array)
            if not np.allclose(self.matrix(pose), array, rtol=0.0, atol=1e-6):
                raise InputError(f"the matrix passed as a pose is not in {self.name}:\n{array}")
        else:
            raise ShapeError(
                f"a pose of {self.name} has shape ({self.size},) or is a homogeneous matrix, "
                f"got shape {array.shape}"
            )
        with np.errstate(over="ignore"):
            norm = float(np.linalg.norm(pose[-4:]))
        if self.turns == 3 and abs(norm - 1.0) > _NORM_TOLERANCE:
            raise InputError(
                f"the quaternion of a pose of {self.name} must have norm 1, got {norm:g}"
            )
        return self.normalize(pose)


convert_arguments(Group)
