"""System: a Pinocchio model read as symmetry group (base) times shape (joints)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..common.arrays import Array, as_floats
from ..common.errors import InputError, ModelError, ShapeError
from ..common.memo import once_a_thread
from ..lie.group import Group
from .admission import admit
from .contents import Contents, Coupling, Keyframe, LeftOut
from .coordinates import coordinate_maps, in_order
from .coupling import Coupled, coupled, following
from .force import Force
from .joints import joint_units
from .rerooting import depth_first

T = TypeVar("T")
Indices: TypeAlias = NDArray[np.intp]


@dataclass(frozen=True)
class InitialState:
    """A generic state to start from, with the time over which it is interesting.

    x: (m,) shape [rad | m].  xdot: (m,) its rate.  xi: (r,) body twist of the base
    [linear; angular].  duration: s.
    """

    x: Array
    xdot: Array
    xi: Array
    duration: float


@dataclass(frozen=True)
class Origin:
    """The origin of a system: the file or name it was loaded from.

    source: the robot's name, or the absolute path of its file.  lock: frozen joints and
    their values [rad | m].  root: the body of an MJCF file that was chosen, if one was.
    meshes: folders in which meshes are looked for, beside those above the file.
    """

    source: str
    lock: Mapping[str, float]
    root: str | None = None
    meshes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Configuration:
    """A point of Q = G × B: pose (..., size) of the base, shape x (..., m)."""

    pose: Array
    x: Array


@dataclass(frozen=True)
class Velocity:
    """A velocity: body twist xi (..., r) of the base, shape rate xdot (..., m)."""

    xi: Array
    xdot: Array


@dataclass(frozen=True, eq=False)
class System:
    """A multibody system with symmetry: the root joint is the group, the others the shape.

    Joints that follow others (`couplings`) are joints of the model, and of q and v, but no
    coordinates of the shape.

    name: the robot's.  model: the pin.Model, root joint first, in depth-first order, which is that
    of the shape; q and v are in the order of the model that was given.  initial: a generic
    initial state, if the robot comes with one.  origin: the name or file that was loaded, if it
    was one.  contents: what else stands in the file.  coupled: how its joints follow those of the
    shape, if some do.  doubts: sentences about what only no real robot has, or what makes the
    mass matrix singular at single shapes.
    """

    model: pin.Model
    name: str = ""
    initial: InitialState | None = None
    origin: Origin | None = None
    contents: Contents = field(default=Contents(), repr=False)
    group: Group = field(init=False)
    coupled: Coupled | None = field(init=False, repr=False)
    shape_names: tuple[str, ...] = field(init=False)
    doubts: tuple[str, ...] = field(init=False, repr=False)
    # Where the entries of q and v of the given model stand in those of `model`, if elsewhere.
    _given_q: Indices | None = field(init=False, repr=False)
    _given_v: Indices | None = field(init=False, repr=False)
    # Where the coordinates (pose, x) stand in Pinocchio's q: as they are, or as (cos, sin).
    _plain: Indices = field(init=False, repr=False)
    _plain_q: Indices = field(init=False, repr=False)
    _angle: Indices = field(init=False, repr=False)
    _angle_q: Indices = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.model.njoints < 2:
            raise ModelError(f"model '{self.model.name}' has no joint; load it with a group")
        order = depth_first(list(self.model.parents))
        derived: dict[str, Any] = {"_given_q": None, "_given_v": None}
        if order != sorted(order):
            derived = in_order(self.model, order)
            object.__setattr__(self, "model", derived["model"])
        names = tuple(self.model.names[i] for i in range(2, self.model.njoints))
        followed = coupled(names, self.couplings, self.model.names[1])
        admitted = admit(self.model, followed)
        group = admitted.group
        derived |= {
            "group": group,
            "coupled": followed,
            "doubts": admitted.doubts,
            "shape_names": names if followed is None else tuple(names[j] for j in followed.leads),
        }
        derived |= coordinate_maps(self.model, group)
        for key, value in derived.items():
            object.__setattr__(self, key, value)

    def __getstate__(self) -> dict[str, Any]:
        # What was made for this system in this process, as kernels are, is made anew elsewhere.
        return {name: value for name, value in vars(self).items() if name != "_once"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)

    def __repr__(self) -> str:
        return f"System({self.name!r}, group={self.group.name}, r={self.r}, m={self.m})"

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        rows = [
            (name, "prismatic" if unit == "m" else "revolute", unit)
            for name, unit in zip(self.shape_names, self.units, strict=True)
        ]
        about = (
            f"group {self.group.name} (r = {self.r}) on joint '{self.root_name}', shape of "
            f"{self.m} joints, {self.mass:g} kg, gravity "
            f"({', '.join(f'{g:g}' for g in self.gravity)}) m/s²"
        )
        if self.couplings:
            about += "; " + ", ".join(map(str, self.couplings))
        return card(self.name, about, table("shape", ["joint", "kind", "unit"], rows))

    @property
    def r(self) -> int:
        """Dimension of the group."""
        return self.group.dim

    @property
    def m(self) -> int:
        """Dimension of the shape space: the number of joints that follow no other."""
        return len(self.shape_names)

    @property
    def n(self) -> int:
        """Dimension of the configuration manifold, n = r + m."""
        return self.r + self.m

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices in the model, (m,), of the joints that are coordinates of the shape."""
        count = range(2, self.model.njoints)
        return tuple(count if self.coupled is None else (2 + self.coupled.leads).tolist())

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the shape coordinates: m of those that slide, rad of those that turn."""
        every = joint_units(self.model)
        return tuple(every[i - 2] for i in self.joints)

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """The couplings in the file, by which joints follow others."""
        return self.contents.couplings

    @property
    def followers(self) -> tuple[str, ...]:
        """Names of the joints that follow others, in the order of the couplings."""
        return tuple(each.follower for each in self.couplings)

    def joint_number(self, name: str) -> int:
        """Return which of all M joints of the model behind its root has a name."""
        return int(self.model.getJointId(name)) - 2

    def refuse_follower(self, name: str, what: str) -> None:
        """Raise InputError, naming `what`, if a joint follows another and is no coordinate."""
        if words := following(name, self.couplings):
            raise InputError(f"{what}: {words}; take the joint that it follows")

    @property
    def root_name(self) -> str:
        """Name of the root joint, whose motion is the symmetry."""
        return str(self.model.names[1])

    @property
    def mass(self) -> float:
        """Mass of all moving bodies [kg]."""
        return self.workspace("mass", self._mass)

    def _mass(self) -> float:
        return float(sum(self.model.inertias[i].mass for i in range(1, self.model.njoints)))

    @property
    def parameters(self) -> Mapping[str, float | Array]:
        """Numbers of the robot that it was given after loading, by name (see Scene.parameters)."""
        return MappingProxyType(vars(self).get("_parameters", {}))

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Actions in the file that are not simulated, kind by kind."""
        return self.contents.left_out

    @property
    def passive(self) -> tuple[Force, ...]:
        """Springs, dampers and dry friction at joints of the shape in the file.

        They are forces.Spring, Damper and Friction, and act in scenes with passive=True, the
        friction in those with a width for it.
        """
        return self.contents.passive

    @property
    def keyframes(self) -> Mapping[str, Keyframe]:
        """States that the file has names for."""
        return self.contents.keyframes

    @property
    def gravity(self) -> Array:
        """Gravity in the world frame, (3,) [m/s²], as the model has it."""
        return np.array(self.model.gravity.linear)

    @property
    def plain(self) -> list[tuple[int, int]]:
        """Indices, in (pose, x) and in q, of the coordinates that stand in q as they are."""
        return list(zip(self._plain.tolist(), self._plain_q.tolist(), strict=True))

    @property
    def angles(self) -> list[tuple[int, int]]:
        """Indices of the coordinates that q has as cosine and sine, and of each cosine in q."""
        return list(zip(self._angle.tolist(), self._angle_q.tolist(), strict=True))

    def q(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """Return Pinocchio's configuration (..., nq) of pose (..., size) and shape (..., m).

        For the model that was given, whose joints may stand in another order than `model`'s.
        Raises ShapeError if a length is wrong.
        """
        return self.given_q(self.model_q(pose, x))

    def v(self, xi: ArrayLike, xdot: ArrayLike) -> Array:
        """Return Pinocchio's velocity (..., nv) of body twist (..., r) and shape rate (..., m).

        For the model that was given, as q is.  Raises ShapeError if a length is wrong.
        """
        return self.given_v(self.model_v(xi, xdot))

    def configuration(self, q: ArrayLike) -> Configuration:
        """Return pose and shape of Pinocchio's q (..., nq); angles from (cos, sin) in (−π, π].

        Raises ShapeError if the length is wrong.
        """
        q = self.sorted_q(self._last(q, self.model.nq, "q"))
        y = np.empty((*q.shape[:-1], self.group.size + self.model.njoints - 2))
        y[..., self._plain] = q[..., self._plain_q]
        # −0.0 + 0.0 is 0.0, with which half a turn is π, not −π.
        y[..., self._angle] = np.arctan2(q[..., self._angle_q + 1] + 0.0, q[..., self._angle_q])
        x = y[..., self.group.size :]
        if self.coupled is not None:
            x = x[..., self.coupled.leads]
        return Configuration(pose=y[..., : self.group.size], x=x)

    def velocity(self, v: ArrayLike) -> Velocity:
        """Return body twist and shape rate of Pinocchio's v (..., nv).

        Raises ShapeError if the length is wrong.
        """
        v = self.sorted_v(self._last(v, self.model.nv, "v").copy())
        xdot = v[..., self.r :]
        if self.coupled is not None:
            xdot = xdot[..., self.coupled.leads]
        return Velocity(xi=v[..., : self.r], xdot=xdot)

    def joint_values(self, x: Array) -> Array:
        """Return the values (..., M) of all joints of the model behind its root, at shape x."""
        return x if self.coupled is None else self.coupled.values(x)

    def joint_rates(self, v: Array) -> Array:
        """Return the velocity (..., nv) of the model for v = (ξ, ẋ), (..., n)."""
        return v if self.coupled is None else self.coupled.rates(v, self.r)

    def on_shape(self, forces: Array) -> Array:
        """Return forces (..., n) on base and shape of those on the model's joints, (..., nv)."""
        return forces if self.coupled is None else self.coupled.forces(forces, self.r)

    def sizes_on_shape(self, sizes: Array) -> Array:
        """Return the magnitudes (..., n) of what `on_shape` adds up, for those of its argument."""
        return sizes if self.coupled is None else self.coupled.sizes(sizes, self.r)

    def coupled_matrix(self, matrix: Array) -> Array:
        """Return the matrix (..., n, n) in (ξ, ẋ) of one in the model's velocities, (..., nv, nv).

        Mass matrices and Coriolis matrices: GᵀHG.
        """
        return matrix if self.coupled is None else self.coupled.matrix(matrix, self.r)

    def model_q(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """Return q (..., nq) as `model` takes it; errors as of `q`."""
        pose = self._last(pose, self.group.size, "pose")
        x = self._last(x, self.m, "x")
        lead = _leading(pose, x, "pose", "x")
        x = self.joint_values(x)
        y = np.empty((*lead, self.group.size + x.shape[-1]))
        y[..., : self.group.size], y[..., self.group.size :] = pose, x
        q = np.empty((*lead, self.model.nq))
        q[..., self._plain_q] = y[..., self._plain]
        q[..., self._angle_q] = np.cos(y[..., self._angle])
        q[..., self._angle_q + 1] = np.sin(y[..., self._angle])
        return q

    def model_v(self, xi: ArrayLike, xdot: ArrayLike) -> Array:
        """Return v (..., nv) as `model` takes it; errors as of `v`."""
        xi, xdot = self._last(xi, self.r, "xi"), self._last(xdot, self.m, "xdot")
        lead = _leading(xi, xdot, "xi", "xdot")
        v = np.empty((*lead, self.n))
        v[..., : self.r], v[..., self.r :] = xi, xdot
        return self.joint_rates(v)

    def given_q(self, q: Array) -> Array:
        """Return q (..., nq) of `model` in the order of the model that was given."""
        return q if self._given_q is None else np.ascontiguousarray(q[..., self._given_q])

    def given_v(self, v: Array) -> Array:
        """Return v (..., n) of `model` in the order of the model that was given."""
        return v if self._given_v is None else np.ascontiguousarray(v[..., self._given_v])

    def sorted_q(self, q: Array) -> Array:
        """Return q (..., nq) of the model that was given as `model` takes it."""
        return q if self._given_q is None else _scattered(q, self._given_q)

    def sorted_v(self, v: Array) -> Array:
        """Return v (..., n) of the model that was given as `model` takes it."""
        return v if self._given_v is None else _scattered(v, self._given_v)

    @property
    def data(self) -> pin.Data:
        """Pinocchio's work space for `model` and its copies in other gravity, one for a thread.

        Every call overwrites it, so that what it holds is read at once; it is not made twice,
        since it grows with the cube of n.
        """
        return self.workspace("data", lambda: pin.Data(self.model))

    def workspace(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value that `make` gives, made once for this system, thread and key.

        For values that are costly to set up and own Pinocchio work space.  They rely on the
        model as it is; it is not changed after loading.
        """
        return once_a_thread(self, key, make)

    def _last(self, value: ArrayLike, size: int, what: str) -> Array:
        array = as_floats(value, what)
        if array.shape[-1:] != (size,):
            raise ShapeError(f"{what} of {self.name!r} must end in ({size},), got {array.shape}")
        return array


def checked_system(value: object, what: str) -> System:
    """Return `value` if it is a System.  Raises InputError that says how to get one."""
    if isinstance(value, System):
        return value
    shown = repr(value) if isinstance(value, str) else type(value).__name__
    raise InputError(f"{what} takes a System, got {shown}; pinred.load(…) makes one")


def _leading(a: Array, b: Array, what: str, other: str) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
    except ValueError:
        raise ShapeError(
            f"the leading axes of {what} {a.shape} and {other} {b.shape} do not match"
        ) from None


def _scattered(values: Array, to: Indices) -> Array:
    out = np.empty_like(values)
    out[..., to] = values
    return out
