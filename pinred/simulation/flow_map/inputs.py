"""The inputs of a flow map, the columns of numbers that they set, and the motion that they start.

With closed loops, the initial state is the nearest closed one.  A shape is moved to a closed one by
steps of least size, so near a closed shape its change is P = 1 − U (J U)⁺ J, with the units U of
the joints.  Rates are projected in the kinetic metric M:

    M ẋ' + Jᵀν = M ẋ,   J ẋ' = 0,   ẋ' = Π ẋ,   K = M⁻¹Jᵀ(J M⁻¹Jᵀ)⁻¹,
    δẋ' = Π (δẋ + M⁻¹(δM (ẋ − ẋ') − δJᵀν)) − K δJ ẋ'.

Prescribed joints have their planned values and do not move: the pseudo-inverse, M⁻¹ and K then
belong to the other joints, while J contains all columns.  If they determine the other joints, P is
exact at any distance.  Else its relative error is about the distance to the closed shape, as that
of x0 is.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from ...common.arrays import Array, entries_of, vector
from ...common.errors import InputError, ShapeError
from ...common.memo import once
from ...common.names import brief, listed, nearest
from ...common.parameter import VectorParameter, by_name, refuse_entry
from ...forces.force_model import ForceModel
from ...forces.force_numbers import Tables
from ...kernels.build import expect_code
from ...kernels.flow_functions import initial_conditions_of
from ...kernels.initial_conditions import TwistOrMomentum
from ...kernels.kernel import Kernel, call_value, evaluate
from ...reduction.pointwise_reduction import PointwiseReduction
from ...reduction.potential import falling
from ...reduction.tree.free_bodies import free_numbers
from ...scene.initial_state import HeldJoints, closed_rates, closed_shape, order_by_joint
from ...scene.scene import Scene
from ...scene.stop import stop_numbers
from ...system.loops.kinematics import loop_jacobian, loop_jacobian_rate
from ...system.loops.loop_assembly import loop_rates, rate_units
from ...system.system import System
from ..compiled.compiled_flow import CompiledFlow
from ..robot_parameters import RobotColumns, with_own

if TYPE_CHECKING:
    pass


class PlannedStart:
    """Positions and rates of prescribed joints at time zero.

    Attributes:
        joints: Indices of the rates of the prescribed joints.
    """

    def __init__(self, system: System, model: ForceModel | None) -> None:
        """Differentiate the motions of the prescribed joints; there may be none."""
        self._system, self._model = system, model
        self.joints: tuple[int, ...] = () if model is None else model.joints
        self._coordinates = list(system.space.coordinates_of_joints(list(self.joints)))

    def put(self, x: Array, xdot: Array, numbers: Array) -> None:
        """Write the planned values into a shape (nx,) and its rates (m,), for numbers (p,)."""
        if self._model is not None and self.joints:
            planned = self._model.prescribed(0.0, numbers)
            x[self._coordinates], xdot[list(self.joints)] = planned.x, planned.xdot

    def slopes(self, x: Array, numbers: Array) -> tuple[Array, Array]:
        """Return the derivatives of displacements and of rates by the numbers, (m, p) each.

        Args:
            x: Shape with the planned values, (nx,).
            numbers: Force parameters, (p,).
        """
        model, m = self._model, self._system.m
        displacements, rates = np.zeros((2, m, len(numbers)))
        if model is None or not self.joints:
            return displacements, rates

        def make() -> ca.Function:
            p = ca.SX.sym("p", len(numbers))
            position, rate, _ = model.prescribed_function(0.0, p)
            slopes = [ca.densify(ca.jacobian(value, p)) for value in (position, rate)]
            return ca.Function("planned_slopes", [p], slopes)

        by_position, by_rate = (np.array(a) for a in once(model, PlannedStart, make)(numbers))
        joints = list(self.joints)
        E = self._system.space.rate_map(x)[np.ix_(self._coordinates, joints)]
        displacements[joints], rates[joints] = np.linalg.pinv(E) @ by_position, by_rate
        return displacements, rates


_MOVED = 1e-9  # largest change of a shape whose projection has the derivative P [rad | m]
_RANK = 1e-9  # singular values below it count as zero [m | 1]
_OPEN = 1e-12  # relative change of rates by the projection, above which its derivative is complete


def close_inputs(
    system: System, x: Array, xdot: Array, values: Mapping[str, Any], driven: Sequence[int] = ()
) -> Array:
    """Return the closed shape and rates nearest to x (nx,) and ẋ (m,), one after the other.

    Args:
        system: The system, with loops.
        x: Shape of the inputs.
        xdot: Shape rate of the inputs.
        values: Values by name, of which x0 and xdot0 are reported if they leave loops open.
        driven: Indices of the rates of prescribed joints, which have their planned values.
    Returns:
        (nx + m,).
    Raises:
        InputError: The loops do not close, or planned positions leave the other joints undetermined
            and `values` has no x0.
    """
    held_joints = [_held(values, name) for name in ("x0", "xdot0")]
    start, x = x, closed_shape(system, x, held_joints[0], driven=driven, nearby=True)
    change = float(np.abs(system.space.difference(start, x)).max())
    if "x0" not in values and change > _MOVED and not _determined(system, x, driven):
        names = listed([system.space.names[k] for k in driven], 6)
        raise InputError(
            f"prescribed: the Parameters move {names} at time 0 away from the scene's shape, and "
            f"do not determine the other joints of the loops of '{system.name}'. Also give x0, a "
            "shape that closes the loops at these positions."
        )
    return np.concatenate([x, closed_rates(system, x, xdot, held_joints[1], driven=driven)])


def _determined(system: System, x: Array, driven: Sequence[int]) -> bool:
    """Return whether prescribed joints determine all other joints of the loops near x (nx,)."""
    moving = sorted(loop_rates(system) - {*driven})
    J = loop_jacobian(system, x)[:, moving]
    return int(np.linalg.matrix_rank(J, tol=_RANK)) == len(moving)


def _held(values: Mapping[str, Any], name: str) -> HeldJoints:
    value = values.get(name)
    names: Collection[Any] = value if isinstance(value, Mapping) else ()
    return HeldJoints(name in values, tuple(map(str, names)))


def closing_slopes(
    system: System, x: Array, xdot: Array, raw: Array, driven: Sequence[int] = ()
) -> tuple[Array, Array, Array]:
    """Return the derivatives of a closed shape and of its rates.

    Args:
        system: The system, with loops.
        x: Closed shape, (nx,).
        xdot: Rates that keep loops closed, (m,).
        raw: Rates before the projection, (m,).
        driven: Indices of the rates of prescribed joints, which have their planned values.
    Returns:
        Derivatives of x along the frame by displacements of the shape, of ẋ by displacements of the
        shape, and of ẋ by the rates before the projection, (m, m) each. Displacements and rates of
        prescribed joints are those of their plans.
    """
    closure = system.closure
    assert closure is not None
    equations, units = closure.rows, rate_units(system, closure.length)
    free = np.setdiff1d(np.arange(system.m), driven)
    J = loop_jacobian(system, x)[equations]
    P = np.eye(system.m)
    P[free] -= units[free, None] * np.linalg.lstsq((J * units)[:, free], J)[0]
    tree = system.open_tree()
    reduction = tree.workspace(PointwiseReduction, lambda: PointwiseReduction(tree))
    M = reduction.split(x).reduced_metric[np.ix_(free, free)]
    response = np.linalg.solve(M, J[:, free].T)
    mobility, K = J[:, free] @ response, np.zeros(J.T.shape)
    K[free] = np.linalg.solve(mobility, response.T).T
    Pi = np.eye(system.m) - K @ J
    rates = [loop_jacobian_rate(system, x, direction)[equations] for direction in P.T]
    by_x = np.column_stack([-K @ (rate @ xdot) for rate in rates])
    change = raw - xdot
    if np.abs(change).max() > _OPEN * np.abs(raw).max():
        nu = np.linalg.solve(mobility, J @ raw)
        dM = np.einsum("ijc,j->ic", reduction.at(x).dM, change) @ P
        loads = dM - np.column_stack([rate.T @ nu for rate in rates])
        by_x = by_x + Pi[:, free] @ np.linalg.solve(M, loads[free])
    return P, by_x, Pi


_NONE: Mapping[str, Array] = MappingProxyType({})
_NO_VALUES: Mapping[str, float | Array] = MappingProxyType({})
_NO_NUMBERS: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Given:
    """The values of all inputs as columns of numbers.

    Attributes:
        state: Pose, shape, shape rate, and body twist or momentum, one after another.
        constants: Parameters of the kernel from gravity on, then the acceleration of the centre
            of mass in free fall, and the numbers of joint stops, (k,).
        robot: Values of robot parameters that the call states, by name.
        forces: Values of parameters of forces that the call states, by name.
        stops: Numbers of joint stops that the call states, by name.
        rates: Shape rates before they are projected to keep loops closed, (m,); None without loops.
    """

    state: Array
    constants: Array
    robot: Mapping[str, Array] = field(default_factory=lambda: _NONE)
    forces: Mapping[str, float | Array] = field(default_factory=lambda: _NO_VALUES)
    stops: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)
    rates: Array | None = None


class Inputs:
    """The inputs of the flow of one scene with one kernel.

    Attributes:
        names: Names of the inputs with derivatives, in their order.
        sizes: Number of entries of each input; for a pose, of its tangent, and for a shape with
            balls, of displacements along its frame.
        known: Names of all inputs.
        own: Values of the inputs in the scene.
    """

    def __init__(self, scene: Scene, kernel: Kernel, gravity: Array, wrt: Sequence[str]) -> None:
        """Locate all inputs among the columns.

        Args:
            scene: The scene.
            kernel: Kernel of the scene.
            gravity: The part of gravity that acts on the shape or rotates the base, (3,) [m/s²].
            wrt: Names of the inputs with derivatives.
        Raises:
            InputError: A name is unknown or repeated, or two inputs have the same name.
        """
        self._system = system = scene.system
        model, layout, initial = scene.force_model, kernel.layout, scene.given
        twist = "xi0" if motion_of(scene) == "xi" else "momentum"
        initial_parts = {
            "pose0": initial.pose[0], "x0": initial.x[0], "xdot0": initial.xdot[0],
            twist: initial.motion[0],
        }  # fmt: skip
        self._places = _slices({name: len(values) for name, values in initial_parts.items()})
        self._parameters = {} if model is None else by_name(model.parameters)
        self._slopes = {} if model is None else _slopes_by_name(model)
        numbers = np.empty(0) if model is None else model.numbers
        bodies = free_numbers(system, layout.freed)
        self._stops = stop_numbers_of(scene)
        stops = np.array([*self._stops.values()])
        constants = [gravity[list(layout.gravity)], bodies, numbers, falling(system), stops]
        self.own = Given(np.concatenate([*initial_parts.values()]), np.concatenate(constants))
        first = len(layout.gravity) + len(bodies)
        self._numbers_at = slice(first, first + len(numbers))
        self._robot = None if scene.varied is None else RobotColumns(scene, layout, len(numbers))
        self._robot_values = {} if self._robot is None else self._robot.values
        self._values: dict[str, float | Array] = {
            name: scene.parameters.get(name, parameter.value)
            for name, parameter in self._parameters.items()
        }
        self._values |= self._stops
        self._stops_at = {
            name: k - len(self._stops) for k, name in enumerate(self._stops)
        }  # from the end of the constants
        for name in self._parameters:
            if name in self._places or name in self._robot_values or name in self._stops:
                raise InputError(
                    f"a Parameter of the forces has the name '{name}' of another input of the "
                    "flow. Rename the Parameter."
                )
        self.known = (*self._places, *self._parameters, *self._robot_values, *self._stops)
        self.names = tuple(self._check_names(wrt, self.known))
        sizes = {name: place.stop - place.start for name, place in self._places.items()}
        sizes |= {"pose0": system.r, "x0": system.m}
        sizes |= {n: len(v) for n, v in self._robot_values.items()}
        sizes |= {n: slope.shape[1] for n, slope in self._slopes.items()}
        sizes |= dict.fromkeys(self._stops, 1)
        self.sizes = {name: sizes[name] for name in self.names}
        self._spans = _slices(self.sizes)
        curved = ["pose0", *["x0"] * bool(system.space.balls or system.loops)]
        curved += ["xdot0"] * bool(system.loops)
        # The other joints of a loop follow the planned initial values of prescribed joints.
        self._planned = PlannedStart(system, model if system.loops else None)
        curved += [*self._slopes] * bool(self._planned.joints)
        self._curved = [name for name in curved if name in self.sizes]
        vectors = {name for name, value in self._values.items() if isinstance(value, np.ndarray)}
        self._scalars = {
            name
            for name, size in self.sizes.items()
            if size == 1 and name not in self._places and name not in vectors
        }
        self._last: tuple[Given, tuple[Array, Array]] | None = None  # cache of `basis`

    def value(self, name: str) -> Array:
        """Return the value of an input in the scene, (size,)."""
        if name in self._robot_values:
            return self._robot_values[name]
        if name in self._places:
            return self.own.state[self._places[name]]
        return np.atleast_1d(self._values[name])

    def given(self, values: Mapping[str, Any]) -> Given:
        """Return the columns for values by name; other inputs have their values in the scene.

        Args:
            values: Values of inputs by name.
        Returns:
            The columns.
        Raises:
            ShapeError: A value has the wrong shape or is not finite.
        """
        if not values:
            return self.own
        state, constants = self.own.state.copy(), self.own.constants.copy()
        changed = self._robot_values.keys() & values.keys() if self._robot_values else ()
        robot = _NONE
        if changed and self._robot is not None:
            robot_values = self._robot.now({name: values[name] for name in changed})
            self._robot.put(constants, robot_values, changed)
            robot = {name: robot_values[name] for name in changed}
        forces: dict[str, float | Array] = {}
        stops: dict[str, float] = {}
        for name, value in values.items():
            if name in changed:
                continue
            place = self._places.get(name)
            if name in self._stops_at:
                stops[name] = float(vector(np.ravel(value), 1, name)[0])
                constants[self._stops_at[name]] = stops[name]
                continue
            if place is None:
                if name not in self._parameters:
                    self._check_names([name], self.known)
                slopes, own_value = self._slopes[name], self._values[name]
                if isinstance(own_value, np.ndarray):
                    # Add entry by entry, so that a vector has the bits of scalar parameters.
                    entries = vector(value, len(own_value), name)
                    for k in range(len(own_value)):
                        constants[self._numbers_at] += slopes[:, k] * (entries[k] - own_value[k])
                    forces[name] = entries
                    continue
                number = value
                if type(value) is not float or not isfinite(value):
                    number = float(vector(np.ravel(value), 1, name)[0])
                constants[self._numbers_at] += slopes[:, 0] * (number - own_value)
                forces[name] = number
            elif name == "pose0":
                state[place] = self._system.group.pose(value)
            elif isinstance(value, Mapping):
                state[place] = order_by_joint(value, self._system, name)
            elif type(value) is np.ndarray and value.shape == (place.stop - place.start,):
                state[place] = value
            else:
                state[place] = vector(value, place.stop - place.start, name)
        if not np.isfinite(state).all():
            raise ShapeError(f"the inputs of a flow must be finite, got {brief(dict(values))}")
        if "x0" in values:
            place = self._places["x0"]
            state[place] = self._system.space.normalized(state[place], "x0", near=False)
        opening = {"x0", "xdot0", *(self._slopes if self._planned.joints else ())}
        if not (self._system.loops and opening & values.keys()):
            return Given(state, constants, robot, forces, stops)
        x, rates = state[self._places["x0"]], state[self._places["xdot0"]].copy()
        self._planned.put(x, rates, constants[self._numbers_at])
        state[self._shape_at] = close_inputs(self._system, x, rates, values, self._planned.joints)
        return Given(state, constants, robot, forces, stops, rates)

    @property
    def are_linear(self) -> bool:
        """Whether all inputs with derivatives are entries of columns, or added to them."""
        return not (
            self._curved
            or self._planned.joints
            or self.sizes.keys() & (self._robot_values.keys() | self._stops_at.keys())
        )

    def linear_columns(self, values: Mapping[str, Array], count: int) -> tuple[Array, Array]:
        """Return the columns of `count` inputs, with the bits of `given`; see `are_linear`.

        Args:
            values: Values of inputs by name, (N, size) or (1, size), finite.
            count: Number of inputs N.
        Returns:
            The states, (N, …), and the constants, (N, …).
        """
        state, constants = (
            np.repeat(a[None], count, 0) for a in (self.own.state, self.own.constants)
        )
        numbers = constants[:, self._numbers_at]
        for name, rows in values.items():
            if name in self._places:
                state[:, self._places[name]] = rows
                continue
            changes = rows - np.atleast_1d(self._values[name])
            for k in range(changes.shape[1]):
                numbers += self._slopes[name][:, k] * changes[:, k, None]
        return state, constants

    def _check_names(self, names: Sequence[str], known: Sequence[str]) -> list[str]:
        """Return the names as a list.  Raises InputError if a name is unknown or repeated."""
        entries = _as_list(names)
        for name in entries:
            if name not in known:
                refuse_entry(name, self._parameters, "the inputs of a flow")
                hint = nearest(name, list(known)) if isinstance(name, str) else ""
                raise InputError(
                    f"a flow of this scene has no input {brief(name)}; {hint}"
                    f"its inputs are {listed(list(known), 200)}"
                )
            if entries.count(name) > 1:
                raise InputError(f"the input '{name}' of a flow is named twice")
        return entries

    @property
    def _shape_at(self) -> slice:
        """Place of the shape and its rate, which follows it, among the columns."""
        return slice(self._places["x0"].start, self._places["xdot0"].stop)

    def directions(self, along: Mapping[str, Any], at: Given) -> tuple[Array, Array]:
        """Convert {input: direction} to directions (…, 1) of state and constants."""
        column = np.zeros((sum(self.sizes.values()), 1))
        for name, value in along.items():
            self._check_names([name], self.names)
            direction = vector(np.atleast_1d(value), self.sizes[name], f"the direction of {name}")
            column[self._spans[name], 0] = direction
        state, constants = self.basis(at)
        return state @ column, constants @ column

    def basis(self, at: Given) -> tuple[Array, Array]:
        """Return derivatives (…, N) of state and constants with respect to N input entries."""
        if self._last is not None and self._last[0] is at:
            return self._last[1]
        state, constants = self._scene_basis
        if self._curved and at is not self.own:
            state = state.copy()
            self._put_tangents(state, at)
        if at.robot:
            constants = constants.copy()
            self._put_robot(constants, {**self._robot_values, **at.robot}, at.robot)
        self._last = (at, (state, constants))
        return state, constants

    def by_name(self, rows: Array) -> dict[str, Array]:
        """Return {input: its columns} from rows (…, N) in the order of `basis`.

        There is no last axis for a parameter that is one number.
        """
        return {
            name: rows[..., span.start] if name in self._scalars else rows[..., span]
            for name, span in self._spans.items()
        }

    @cached_property
    def _scene_basis(self) -> tuple[Array, Array]:
        """The directions of `basis` at the values of the scene."""
        count = sum(self.sizes.values())
        state = np.zeros((len(self.own.state), count))
        constants = np.zeros((len(self.own.constants), count))
        for name, span in self._spans.items():
            if name in self._slopes:
                constants[self._numbers_at, span] = self._slopes[name]
            elif name in self._stops_at:
                constants[self._stops_at[name], span] = 1.0
            elif name in self._places and name not in self._curved:
                state[self._places[name], span] = np.eye(self.sizes[name])
        self._put_tangents(state, self.own)
        self._put_robot(constants, self._robot_values, self._robot_values)
        return state, constants

    def _put_tangents(self, state: Array, at: Given) -> None:
        """Write the directions of inputs whose tangents depend on their values."""
        system = self._system
        if system.loops:
            self._put_closing(state, at)
        for name in self._curved:
            if name != "pose0" and system.loops:
                continue
            place, span = self._places[name], self._spans[name]
            if name == "x0":
                state[place, span] = system.space.rate_map(at.state[place])
                continue
            group = system.group
            poses = np.broadcast_to(at.state[place], (group.dim, group.size))
            state[place, span] = group.rate(poses, np.eye(group.dim)).T

    def _put_closing(self, state: Array, at: Given) -> None:
        """Write the directions of shapes and rates that keep loops closed."""
        names = [name for name in self._curved if name != "pose0"]
        if not names:
            return
        system, planned = self._system, self._planned
        x, xdot = at.state[self._places["x0"]], at.state[self._places["xdot0"]]
        raw = xdot if at.rates is None else at.rates
        shape, by_shape, by_rates = closing_slopes(system, x, xdot, raw, planned.joints)
        by_numbers = planned.slopes(x, at.constants[self._numbers_at])
        free = np.eye(system.m)
        free[:, list(planned.joints)] = 0.0  # these entries of x0 and xdot0 are planned
        changes = {"x0": (free, np.zeros_like(free)), "xdot0": (np.zeros_like(free), free)}
        for name in names:
            span = self._spans[name]
            if name in self._slopes:
                changes[name] = (
                    by_numbers[0] @ self._slopes[name],
                    by_numbers[1] @ self._slopes[name],
                )
            displacements, rates = changes[name]
            directions = system.space.rate_map(x) @ shape @ displacements
            state[self._places["x0"], span] = directions
            state[self._places["xdot0"], span] = by_shape @ displacements + by_rates @ rates

    def _put_robot(
        self, constants: Array, now: Mapping[str, Array], changed: Collection[str]
    ) -> None:
        """Write derivatives with respect to robot parameters; `changed` differ from the scene."""
        if self._robot is None or not self._robot_values.keys() & self.sizes.keys():
            return
        for place, name, slope in self._robot.slopes(now, changed):
            if name in self._spans:
                constants[place, self._spans[name]] = slope


def with_varied(scene: Scene, names: Sequence[str]) -> Scene:
    """Return a scene in which the robot parameters among `names` are variable.

    An InputError is raised for bodies and joints that do not exist.
    """
    stops = stop_numbers_of(scene)
    return with_own(scene, [name for name in _as_list(names) if name not in stops])


def stop_numbers_of(scene: Scene) -> dict[str, float]:
    """Return the numbers of a scene's joint stops by name; see `stop_numbers`."""
    stops: Any = scene.stops
    return stop_numbers(stops) if scene.bounds else {}


def motion_of(scene: Scene) -> TwistOrMomentum:
    """Return "mu" if the scene states a momentum, "xi" if it states a body twist."""
    return "xi" if scene.given.mu is None else "mu"


def _slices(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return consecutive slices of the given sizes."""
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return dict(zip(sizes, map(slice, ends, ends[1:]), strict=True))


def _slopes_by_name(model: ForceModel) -> dict[str, Array]:
    """Return {parameter: ∂numbers/∂parameter, (p, its size)}; zero for unused entries."""
    columns = {parameter: model.slopes[:, [k]] for k, parameter in enumerate(model.parameters)}
    unused = np.zeros((len(model.slopes), 1))
    return {
        name: np.hstack([columns.get(entry, unused) for entry in parameter])
        if isinstance(parameter, VectorParameter)
        else columns[parameter]
        for name, parameter in by_name(model.parameters).items()
    }


def _as_list(names: Any) -> list[Any]:
    entries = [names] if isinstance(names, str) else entries_of(names)
    if entries is None:
        raise InputError(f"wrt must be a list of names of inputs, got {brief(names)}")
    return entries


class InitialMap:
    """The map from input columns to reduced state, parameters and centre-of-mass path.

    The input columns are the fields of Given: `state` and `constants`, which end with the free-fall
    acceleration of the centre of mass.  A reduced state without entries is replaced by one zero,
    because integrators need at least one entry.
    """

    def __init__(self, kernel: Kernel, motion: TwistOrMomentum, tables: Tables | None) -> None:
        """Prepare the map.

        Args:
            kernel: Kernel of the flow.
            motion: Whether inputs have a body twist ("xi") or a body momentum ("mu").
            tables: Tables in the forces; None without forces.
        """
        self._tables = tables
        layout, k = kernel.layout, kernel.system.group.linear
        self._kernel, self._function = kernel, initial_conditions_of(kernel, motion)
        self._address = self._function.value.address
        self._cuts = [layout.size, layout.size + layout.gravity_at]
        self._size, self._fall = self._cuts[1] + 2 * k, k
        self._hole, self._path = layout.com_path_at - layout.gravity_at, layout.com_path

    def __call__(self, given: Given, t: float = 0.0) -> CompiledFlow:
        """Return the flow that starts from inputs.

        Args:
            given: The inputs.
            t: Start time [s]; the centre-of-mass path is stated at time zero.
        Returns:
            The flow.
        Raises:
            InputError: The momentum or twist overflows.
        """
        constants, fall = self._split(given.constants)
        outputs = np.empty(self._size)
        call_value(self._address, given.state, self._with_path(constants, None), outputs)
        _refuse_overflow(outputs)
        y, parameters, path = self._assembled(outputs, constants, fall, t)
        return CompiledFlow(self._kernel, self._tables, y, parameters, path)

    def of_many(self, states: Array, constants: Array) -> CompiledFlow:
        """Return the flow of N inputs, rows of states and constants.  Raises InputError."""
        other_constants, falls = self._split(constants.T)
        kernel_constants = np.ascontiguousarray(self._with_path(other_constants, None).T)
        outputs = evaluate(self._address, kernel_constants, states, self._size)
        _refuse_overflow(outputs)
        columns = self._assembled(outputs.T, other_constants, falls)
        rows = (np.ascontiguousarray(column.T) for column in columns)
        return CompiledFlow(self._kernel, self._tables, *rows)

    def along_many(
        self, states: Array, constants: Array, directions: tuple[Array, Array]
    ) -> tuple[Array, Array, Array]:
        """Return derivatives of the flow of N inputs along D directions of each.

        Args:
            states: States of the inputs, (N, …).
            constants: Constants of the inputs, (N, …).
            directions: Directions of both, (N, …, D), or (1, …, D) for all inputs.
        Returns:
            Derivatives of the reduced states (N, n, D), the parameters (N, p, D) and the paths
            (N, 3k, D).
        """
        by_state, by_constants = directions
        known, falls = self._split(np.moveaxis(by_constants, 0, 1))  # the entries come first
        points = self._with_path(self._split(constants.T)[0], None).T
        derivatives = self._function.forward_many(
            states, points, by_state, np.moveaxis(self._with_path(known, None), 1, 0), self._size
        )
        shape = (len(states), by_state.shape[2])
        known, falls = (np.broadcast_to(a, (len(a), *shape)) for a in (known, falls))
        y, parameters, path = self._assembled(np.moveaxis(derivatives, 0, 1), known, falls)
        return np.moveaxis(y, 0, 1), np.moveaxis(parameters, 0, 1), np.moveaxis(path, 0, 1)

    def expect_along(self) -> None:
        """Let other threads generate the machine code of `along`."""
        expect_code(lambda: self._function.tangent)

    def expect_back(self) -> None:
        """Let other threads generate the machine code of `back`."""
        expect_code(lambda: self._function.adjoint)

    def along(
        self, given: Given, state: Array, constants: Array, t: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Return derivatives along N directions of the inputs.

        Args:
            given: The inputs.
            state: Directions of the inputs' state, (…, N).
            constants: Directions of the inputs' constants, (…, N).
            t: Start time [s].
        Returns:
            Derivatives of the reduced state (n, N), the parameters (p, N) and the path (3k, N).
        """
        constants, falls = self._split(constants)
        kernel_constants, directions = self._known(given), self._with_path(constants, None)
        derivatives = self._function.forward(
            given.state, kernel_constants, state, directions, self._size
        )
        return self._assembled(derivatives, constants, falls, t)

    def back(
        self, given: Given, by_y: Array, by_parameters: Array, by_path: Array
    ) -> tuple[Array, Array]:
        """Return the cotangents of the inputs' state and constants.

        Args:
            given: The inputs.
            by_y: Cotangent of the reduced state, (n,).
            by_parameters: Cotangent of the parameters, (p,).
            by_path: Cotangent of the path, (3k,).
        Returns:
            Cotangents of `state` and of `constants`.
        """
        size, head = self._cuts[0], self._cuts[1] - self._cuts[0]
        if self._path:
            first = head + self._hole
            by_path = by_path.copy()
            by_path[: self._path] += by_parameters[first : first + self._path]
        starts = len(by_path) - self._fall
        covector = np.concatenate([by_y[:size], by_parameters[:head], by_path[:starts]])
        state, constants = self._function.reverse(given.state, self._known(given), covector)
        constants += by_parameters[head:]
        if self._path:
            constants = np.delete(constants, np.s_[self._hole : self._hole + self._path])
        return state, np.concatenate([constants, by_path[starts:]])

    def _assembled(
        self, outputs: Array, constants: Array, fall: Array, t: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Assemble reduced state, parameters and path, or derivatives; entries come first."""
        y, head, start = np.split(outputs, self._cuts)
        path = _moved_back(t, np.concatenate([start, fall]), self._fall)
        parameters = np.concatenate([head, self._with_path(constants, path)])
        return y if len(y) else np.zeros((1, *outputs.shape[1:])), parameters, path

    def _known(self, given: Given) -> Array:
        return self._with_path(self._split(given.constants)[0], None)

    def _with_path(self, constants: Array, path: Array | None) -> Array:
        """Insert the path into the constants if forces depend on the path; None inserts zeros."""
        if not self._path:
            return constants
        if path is None:
            path = np.zeros((self._path, *constants.shape[1:]))
        return np.concatenate([constants[: self._hole], path, constants[self._hole :]])

    def _split(self, constants: Array) -> tuple[Array, Array]:
        """Split input constants into the kernel's constants and the free-fall acceleration."""
        at = len(constants) - self._fall
        return constants[:at], constants[at:]


def _refuse_overflow(out: Array) -> None:
    if not np.isfinite(out).all():
        raise InputError("the initial momentum or twist overflows; reduce rates or momentum")


def _moved_back(t: float, path: Array, k: int) -> Array:
    """Return the path (3k, …), stated at time zero, from its position and velocity at time t."""
    if t == 0.0:
        return path
    start, velocity, fall = path[:k], path[k : 2 * k], path[2 * k :]
    return np.concatenate([start - t * velocity + 0.5 * t**2 * fall, velocity - t * fall, fall])
