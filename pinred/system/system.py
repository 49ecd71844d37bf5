"""System: a Pinocchio model as symmetry group (base) times shape (joints).

Copies of a system can have different gravity, inertias and placements.  Its scales are the masses
that joints move, radii of gyration, and extreme values.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats, vector
from ..common.errors import InputError, ModelError, ShapeError, UnsupportedOperationError
from ..common.memo import once_a_thread, recent
from ..common.names import listed
from ..lie.group import Group
from .admission import admit, check_joints
from .coordinates import (
    Configuration,
    CoordinateMap,
    InitialState,
    JointOrder,
    ShapeSpace,
    Velocity,
    coordinate_map,
    reordered,
    tree_space,
)
from .copy_model import depth_first
from .coupling import Coupled, coupled, following
from .force_interface import Force
from .joints import axes_of
from .loops.kinematics import Closure
from .loops.loop import Constraint
from .loops.loop_assembly import close_loops
from .robot_file_contents import Actuator, Contents, Coupling, Keyframe, LeftOut, Origin

T = TypeVar("T")
_MOST_SURFACES = 128  # Largest number of copies with joints on surfaces that a system keeps.


@checks_arguments
@dataclass(frozen=True, eq=False)
class System:
    """A multibody system with symmetry: the root joint is the group, the others the shape.

    Follower joints (`couplings`) are joints of the model and have entries in q and v, but they
    are not shape coordinates.

    Attributes:
        model: Pinocchio model, root joint first.  q and v have its joint order everywhere, in
            trajectories, recordings and options: the order of the pin.Model that was loaded, or
            the order in which Pinocchio, Drake or MuJoCo read the file.  The parts of a split joint
            take its place, a merged ball takes the place of its last hinge, and locked joints are
            left out.
        sorted_model: `model` in depth-first order, for pinred's own computations; the same object
            if `model` has this order.  Pinocchio's kinematics, RNEA, ABA and momenta take any
            order, but its crba, Minverse, Coriolis matrix, derivatives and constraint dynamics
            return wrong values without an error in another order.
        name: Name of the robot.
        initial: Generic initial state, if the robot has one.
        origin: Name or file from which the robot was loaded, if any.
        contents: Contents of the file other than bodies and joints.
        group: Symmetry group, the motion of the root joint.
        space: Manifold of the shape: coordinates, rates, labels and units of the shape joints.
        tree: Manifold of all joints except the root, followers included.
        coupled: Dependence of follower joints on the shape; None without followers.
        closure: A closed shape and the independent equations of the loops; None without loops.
        doubts: Warnings, one sentence each, about inertias that no real body has and about
            isolated shapes at which the mass matrix is singular.
    """

    model: pin.Model
    name: str = ""
    initial: InitialState | None = None
    origin: Origin | None = None
    contents: Contents = field(default=Contents(), repr=False)
    sorted_model: pin.Model = field(init=False, repr=False)
    group: Group = field(init=False)
    space: ShapeSpace = field(init=False, repr=False)
    tree: ShapeSpace = field(init=False, repr=False)
    coupled: Coupled | None = field(init=False, repr=False)
    closure: Closure | None = field(init=False, repr=False, default=None)
    doubts: tuple[str, ...] = field(init=False, repr=False)
    _order: JointOrder | None = field(init=False, repr=False)
    _map: CoordinateMap = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.model.njoints < 2:
            raise ModelError(f"model '{self.model.name}' has no joint; load it with a group")
        order = depth_first(list(self.model.parents))
        model, joint_order = self.model, None
        if order != sorted(order):
            model, joint_order = reordered(model, order)
        check_joints(model)
        tree = tree_space(model)
        couplings = coupled(tree, self.couplings, model.names[1])
        derivation = None if self.origin is None else self.origin.derivation
        known = None if derivation is None else derivation.doubts
        group, doubts = admit(model, couplings, known)
        vars(self).update(
            sorted_model=model,
            group=group,
            space=tree if couplings is None else couplings.space,
            coupled=couplings,
            doubts=doubts,
            tree=tree,
            _order=joint_order,
            _map=coordinate_map(model, group, tree),
        )
        if self.loops:
            vars(self)["closure"] = close_loops(self)

    def __getstate__(self) -> dict[str, Any]:
        # Work spaces and kernels belong to this process; other processes create their own.
        return {name: value for name, value in vars(self).items() if name != "_once"}

    def __repr__(self) -> str:
        return f"System({self.name!r}, group={self.group.name}, r={self.r}, m={self.m})"

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        rows = [(joint.name, joint.kind.motion, joint.kind.units[0]) for joint in self.space.joints]
        summary = (
            f"group {self.group.name} (r = {self.r}) on joint '{self.root_name}', shape of "
            f"{self.space.size_in_words}, {self.mass:g} kg, gravity "
            f"({', '.join(f'{g:g}' for g in self.gravity)}) m/s²"
        )
        if self.couplings:
            summary += "; " + ", ".join(map(str, self.couplings))
        return card(self.name, summary, table("shape", ["joint", "kind", "unit"], rows))

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """Couplings of follower joints to their leaders, from the file."""
        return self.contents.couplings

    @property
    def followers(self) -> tuple[str, ...]:
        """Names of the follower joints, in the order of the couplings."""
        return tuple(coupling.follower for coupling in self.couplings)

    @property
    def loops(self) -> tuple[Constraint, ...]:
        """Constraints that close kinematic loops."""
        return self.contents.loops

    def refuse_loops(self, what: str, remedy: str = "") -> None:
        """Reject closed loops where only trees are supported.

        Args:
            what: Beginning of the error message.
            remedy: Sentence that says what to do instead; empty: remove the loops.
        Raises:
            UnsupportedOperationError: The robot has closed loops.
        """
        if self.loops:
            names = listed([loop.name for loop in self.loops], 6)
            raise UnsupportedOperationError(
                f"{what}: closed loops are not supported here, and '{self.name}' has the loops "
                f"{names}. {remedy or 'Remove them, or lock the joints between them.'}"
            )

    def refuse_follower(self, name: str, what: str) -> None:
        """Reject a follower joint, which is not a shape coordinate.

        Args:
            name: Name of the joint.
            what: Beginning of the error message.
        Raises:
            InputError: The joint is a follower.
        """
        if words := following(name, self.couplings):
            raise InputError(f"{what}: {words}; use the joint that it follows")

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Actions in the file that are not simulated, by kind."""
        return self.contents.left_out

    @property
    def passive(self) -> tuple[Force, ...]:
        """Springs, dampers and dry friction at shape joints, from the file.

        The types are forces.Spring, Damper and Friction.  Springs and dampers act in scenes with
        passive=True.  Friction acts only if the scene sets its width.
        """
        return self.contents.passive

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Actuators of the file whose forces are linear in control and state.

        They act in scenes that state their controls.
        """
        return self.contents.actuators

    @property
    def keyframes(self) -> Mapping[str, Keyframe]:
        """Named states in the file."""
        return self.contents.keyframes

    @property
    def r(self) -> int:
        """Dimension of the group."""
        return self.group.dim

    @property
    def m(self) -> int:
        """Dimension of the shape space: the number of rates of independent joints."""
        return self.space.m

    @property
    def nx(self) -> int:
        """Number of shape coordinates: m, plus one for each ball."""
        return self.space.nx

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Labels of the shape rates, (m,): names of joints, "neck.x" for an axis of a ball."""
        return self.space.names

    @property
    def x_names(self) -> tuple[str, ...]:
        """Labels of the shape coordinates, (nx,): "neck.qx" … "neck.qw" for a ball "neck"."""
        return self.space.x_names

    @property
    def n(self) -> int:
        """Dimension of the configuration manifold, n = r + m."""
        return self.r + self.m

    @property
    def joints(self) -> tuple[int, ...]:
        """Index in `model` of the joint of each shape rate, (m,)."""
        return self._joints_in(self.model)

    @property
    def sorted_joints(self) -> tuple[int, ...]:
        """Index in `sorted_model` of the joint of each shape rate, (m,)."""
        return self._joints_in(self.sorted_model)

    def _joints_in(self, model: pin.Model) -> tuple[int, ...]:
        numbers = {str(name): i for i, name in enumerate(model.names)}
        return tuple(numbers[joint.name] for joint in self.space.joints for _ in joint.kind.rates)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of displacements along the frame of the shape, (m,): "rad" or "m"."""
        return self.space.units

    @property
    def shape_dim(self) -> int:
        """Dimension of the manifold of closed shapes: m, less the rank of the loops."""
        return self.m if self.closure is None else self.m - self.closure.rank

    def open_tree(self) -> System:
        """Return the same tree without its loops; the system itself without loops."""
        if not self.loops:
            return self

        def make() -> System:
            tree = copy(self)
            contents = replace(self.contents, loops=())
            vars(tree).update(contents=contents, closure=None)
            return tree

        return self.workspace("open tree", make)

    def on_surfaces(self, surfaces: tuple[Constraint, ...]) -> System:
        """Return the system as it was loaded, with further constraints of its shape.

        Args:
            surfaces: Independent constraints.
        """
        loaded = nominal(self)

        def make() -> System:
            held = copy(loaded)
            contents = replace(loaded.contents, loops=(*loaded.loops, *surfaces))
            vars(held).update(contents=contents, closure=None)
            vars(held)["closure"] = close_loops(held)
            vars(held)["_loops"] = loaded.loops, loaded.closure
            return held

        return recent(loaded, surfaces, make, _MOST_SURFACES, "surfaces")

    def off_surfaces(self) -> System:
        """Return the system without the constraints that `on_surfaces` added."""
        loops, closure = vars(self).get("_loops", (None, None))
        if loops is None:
            return self
        other = copy(self)
        vars(other).update(contents=replace(self.contents, loops=loops), closure=closure)
        return other

    @property
    def root_name(self) -> str:
        """Name of the root joint, whose motion is the symmetry."""
        return str(self.model.names[1])

    @property
    def mass(self) -> float:
        """Mass of all moving bodies [kg]."""
        return self.workspace("mass", lambda: float(sum(I.mass for I in self.model.inertias[1:])))

    @property
    def parameters(self) -> Mapping[str, float | Array]:
        """Robot parameters that were set after loading, by name (see Scene.parameters)."""
        return MappingProxyType(vars(self).get("_parameters", {}))

    @property
    def gravity(self) -> Array:
        """Gravity in the world frame, (3,) [m/s²]."""
        return np.array(self.model.gravity.linear)

    @property
    def plain(self) -> list[tuple[int, int]]:
        """Pairs of indices, in (pose, x) and in q, of the coordinates that q stores unchanged."""
        return list(zip(self._map.plain.tolist(), self._map.plain_q.tolist(), strict=True))

    @property
    def angles(self) -> list[tuple[int, int]]:
        """Pairs of indices: of an angle in (pose, x), and of its cosine in q."""
        return list(zip(self._map.angle.tolist(), self._map.angle_q.tolist(), strict=True))

    def q(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """Compute Pinocchio's configuration q, in the joint order of `model`.

        Args:
            pose: Pose of the base, (..., size).
            x: Shape, (..., nx) [rad | m | 1].
        Returns:
            (..., nq): configuration.
        Raises:
            ShapeError: A length is wrong.
        """
        return self.given_q(self.sorted_q(pose, x))

    def v(self, xi: ArrayLike, xdot: ArrayLike) -> Array:
        """Compute Pinocchio's velocity v, in the joint order of `model`.

        Args:
            xi: Body twist of the base [linear; angular], (..., r).
            xdot: Shape rate, (..., m) [rad/s | m/s].
        Returns:
            (..., nv): velocity.
        Raises:
            ShapeError: A length is wrong.
        """
        return self.given_v(self.sorted_v(xi, xdot))

    def configuration(self, q: ArrayLike) -> Configuration:
        """Return pose and shape for Pinocchio's q.

        Args:
            q: Configuration, (..., nq), in the joint order of `model`.
        Returns:
            Pose and shape.  Angles that q stores as cosine and sine are in (−π, π].
        Raises:
            ShapeError: The length is wrong.
        """
        y = self._map.from_q(self.sort_q(self._last(q, self.model.nq, "q")))
        x = y[..., self.group.size :]
        if self.coupled is not None:
            x = x[..., self.coupled.leads_x]
        return Configuration(pose=y[..., : self.group.size], x=x)

    def velocity(self, v: ArrayLike) -> Velocity:
        """Return body twist and shape rate for Pinocchio's v.

        Args:
            v: Velocity, (..., nv), in the joint order of `model`.
        Returns:
            Body twist and shape rate.
        Raises:
            ShapeError: The length is wrong.
        """
        v = self.sort_v(self._last(v, self.model.nv, "v").copy())
        xdot = v[..., self.r :]
        if self.coupled is not None:
            xdot = xdot[..., self.coupled.leads]
        return Velocity(xi=v[..., : self.r], xdot=xdot)

    def joint_values(self, x: Array) -> Array:
        """Return the coordinates of all joints except the root at shape x (..., nx)."""
        return x if self.coupled is None else self.coupled.values(x)

    def joint_rates(self, v: Array) -> Array:
        """Return v (..., nv) of `sorted_model` for a velocity (..., n), (ξ, ẋ)."""
        return v if self.coupled is None else self.coupled.rates(v, self.r)

    def on_shape(self, forces: Array) -> Array:
        """Map forces (..., nv) in the order of `sorted_model` to base and shape, (..., n)."""
        return forces if self.coupled is None else self.coupled.forces(forces, self.r)

    def sizes_on_shape(self, sizes: Array) -> Array:
        """Bound the entries of `on_shape`, (..., n), for forces of magnitudes sizes (..., nv)."""
        return sizes if self.coupled is None else self.coupled.sizes(sizes, self.r)

    def coupled_matrix(self, matrix: Array) -> Array:
        """Return GᵀHG (..., n, n) in (ξ, ẋ) for H, a mass or Coriolis matrix (..., nv, nv)."""
        return matrix if self.coupled is None else self.coupled.matrix(matrix, self.r)

    def sorted_q(self, pose: ArrayLike, x: ArrayLike) -> Array:
        """Compute q (..., nq) of `sorted_model` for pose (..., size) and x (..., nx)."""
        pose, x = self._pair(pose, x, (self.group.size, self.nx), ("pose", "x"))
        return self._map.to_q(np.concatenate([pose, self.joint_values(x)], axis=-1))

    def sorted_v(self, xi: ArrayLike, xdot: ArrayLike) -> Array:
        """Compute v (..., nv) of `sorted_model` for xi (..., r) and xdot (..., m)."""
        xi, xdot = self._pair(xi, xdot, (self.r, self.m), ("xi", "xdot"))
        return self.joint_rates(np.concatenate([xi, xdot], axis=-1))

    def given_q(self, q: Array) -> Array:
        """Reorder q (..., nq) from `sorted_model` to `model`."""
        return q if self._order is None else np.take(q, self._order.q, axis=-1)

    def given_v(self, v: Array) -> Array:
        """Reorder v (..., nv) from `sorted_model` to `model`."""
        return v if self._order is None else np.take(v, self._order.v, axis=-1)

    def sort_q(self, q: Array) -> Array:
        """Reorder q (..., nq) from `model` to `sorted_model`."""
        return q if self._order is None else np.take(q, np.argsort(self._order.q), axis=-1)

    def sort_v(self, v: Array) -> Array:
        """Reorder v (..., nv) from `model` to `sorted_model`."""
        return v if self._order is None else np.take(v, np.argsort(self._order.v), axis=-1)

    @property
    def data(self) -> pin.Data:
        """Work space (pin.Data) of `model`, one per thread, also for copies with other gravity.

        Every Pinocchio call overwrites the work space, so copy results at once.  Its memory grows
        with the cube of n, so there is only one per thread.
        """
        return self.workspace("data", lambda: pin.Data(self.model))

    @property
    def sorted_data(self) -> pin.Data:
        """Work space of `sorted_model`; `data` if `model` has the same order."""
        if self._order is None:
            return self.data
        return self.workspace("sorted data", lambda: pin.Data(self.sorted_model))

    def workspace(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return a value that is cached per system, thread and key.

        Use it for values that are costly to create and own Pinocchio work space.  Such values stay
        valid because the model does not change after loading.

        Args:
            key: Key of the value.
            make: Function that creates the value at the first call.
        Returns:
            The value.
        """
        return once_a_thread(self, key, make)

    def _last(self, value: ArrayLike, size: int, what: str) -> Array:
        """Convert a value to an array whose last axis has length `size`.  Raises ShapeError."""
        array = as_floats(value, what)
        if array.shape[-1:] != (size,):
            raise ShapeError(
                f"{what} of {self.name!r} must have shape (..., {size}), got {array.shape}"
            )
        return array

    def _pair(
        self,
        first: ArrayLike,
        second: ArrayLike,
        sizes: tuple[int, int],
        names: tuple[str, str],
    ) -> tuple[Array, Array]:
        """Convert two values to arrays with the same leading axes.  Raises ShapeError."""
        a, b = self._last(first, sizes[0], names[0]), self._last(second, sizes[1], names[1])
        if a.shape[:-1] == b.shape[:-1]:  # usually; broadcasting takes longer than all the rest
            return a, b
        try:
            lead = np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
        except ValueError:
            raise ShapeError(
                f"the leading axes of {names[0]} {a.shape} and {names[1]} {b.shape} do not match"
            ) from None
        return np.broadcast_to(a, (*lead, sizes[0])), np.broadcast_to(b, (*lead, sizes[1]))


def checked_system(value: object, what: str, *, loops: bool = False, remedy: str = "") -> System:
    """Return `value` if it is a System; otherwise raise InputError, which explains `load`.

    Args:
        value: The system.
        what: Name of the caller in messages.
        loops: Whether the caller supports closed loops.
        remedy: Sentence for robots with closed loops that says what to do instead.
    Returns:
        The system.
    Raises:
        InputError: The value is not a System.
        UnsupportedOperationError: The system has closed loops that the caller does not support.
    """
    if isinstance(value, System):
        if not loops:
            value.refuse_loops(what, remedy)
        return value
    shown = repr(value) if isinstance(value, str) else type(value).__name__
    raise InputError(f"{what} takes a System, got {shown}; pinred.load(…) returns one")


_HUGE = 1e100  # largest accepted gravity, because products of larger numbers overflow [m/s²]


def nominal(system: System) -> System:
    """Return the system as it was loaded, before any parameters were changed."""
    loaded: System = vars(system).get("_nominal", system)
    return loaded


def in_gravity(system: System, gravity: Array) -> System:
    """Return a copy of a system with different gravity, (3,) in the world frame [m/s²]."""
    other = _copy(system)
    for model in (other.model, other.sorted_model):
        model.gravity.linear = gravity
    return other


def checked_gravity(value: ArrayLike) -> Array:
    """Return gravity as a vector, (3,) [m/s²].  Raises ShapeError, or InputError if it is huge."""
    gravity = vector(value, 3, "gravity")
    if np.abs(gravity).max() > _HUGE:
        raise InputError(f"gravity must be below {_HUGE:g} m/s², got {gravity}")
    return gravity


def with_numbers(
    system: System,
    inertias: Mapping[int, pin.Inertia],
    placements: Mapping[int, pin.SE3] | None = None,
    frames: Mapping[int, pin.SE3] | None = None,
) -> System:
    """Return a copy of a system with different inertias and placements.

    Args:
        system: System to copy.
        inertias: New inertias of bodies, {joint of `sorted_model` that moves the body: inertia}.
        placements: New joint placements, {joint index in `sorted_model`: placement}.
        frames: New placements of links on their bodies, {frame index in both models: placement}.
    """
    other = _copy(system)
    vars(other)["_nominal"] = nominal(system)
    names = system.sorted_model.names
    for model in (other.model, other.sorted_model):
        for joint, inertia in inertias.items():
            model.inertias[model.getJointId(names[joint])] = inertia
        for joint, placement in (placements or {}).items():
            model.jointPlacements[model.getJointId(names[joint])] = placement
        for frame, placement in (frames or {}).items():
            model.frames[frame].placement = placement
    return other


def _copy(system: System) -> System:
    """Return a copy with separate models, without the work spaces of the original."""
    other = copy(system)
    model = sorted_model = system.model.copy()
    if system.sorted_model is not system.model:
        sorted_model = system.sorted_model.copy()
    vars(other).update(model=model, sorted_model=sorted_model)
    return other


# Masses [kg] and lengths [m] outside the range from 1/limit to limit count as extreme.
_MASS, _LENGTH = 1e12, 1e5


def ill_scaled(system: System) -> str:
    """Return a warning about extreme masses or lengths of a system, with a remedy, or ""."""
    model = system.sorted_model
    bodies = [body for body in model.inertias[1:] if body.mass > 0.0]
    steps = [float(np.linalg.norm(place.translation)) for place in model.jointPlacements[2:]]
    reaches = [float(np.hypot(np.linalg.norm(b.lever), radius_of_gyration(b))) for b in bodies]
    ranges = []
    for what, unit, most, sizes in (
        ("masses", "kg", _MASS, [body.mass for body in bodies]),
        ("lengths", "m", _LENGTH, [*reaches, *steps]),
    ):
        sizes = [size for size in sizes if size > 0.0]
        if sizes and (max(sizes) > most or min(sizes) < 1.0 / most):
            ranges.append(f"{what} from {min(sizes):.1e} to {max(sizes):.1e} {unit}")
    if not ranges:
        return ""
    return (
        f"'{system.name}' is ill-scaled: it has {' and '.join(ranges)}, so round-off hides small "
        "terms; write it in units in which masses and lengths are near 1 (gravity and forces with "
        "them)"
    )


def moved_masses(model: pin.Model, data: pin.Data, q: Array) -> tuple[NDArray[np.bool_], Array]:
    """Compute the mass that each velocity moves.

    Args:
        model: Model.
        data: Work space of the model; it is overwritten.
        q: Configuration, (nq,).
    Returns:
        Whether each velocity is a rotation, (nv,); and the mass that each velocity moves, (nv,)
        [kg].
    """
    pin.crba(model, data, q)
    angular, mass = np.ones(model.nv, dtype=bool), np.empty(model.nv)
    for i in range(1, model.njoints):
        joint = model.joints[i]
        entries = slice(joint.idx_v, joint.idx_v + joint.nv)
        angular[entries] = np.abs(axes_of(joint)[3:]).sum(axis=0) > 0.0
        mass[entries] = data.Ycrb[i].mass
    return angular, mass


def radius_of_gyration(body: pin.Inertia) -> float:
    """Compute √(tr I / m) of a body about its centre of mass [m]; 0 without mass."""
    if not body.mass > 0.0:
        return 0.0
    return float(np.sqrt(max(0.0, np.trace(body.inertia)) / body.mass))
