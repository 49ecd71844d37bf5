"""The inputs of a flow map, and the columns of numbers that they set."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ...common.arrays import Array, entries_of, vector
from ...common.errors import InputError, ShapeError
from ...common.names import brief, listed, nearest
from ...common.parameter import VectorParameter, by_name, refuse_entry
from ...forces.force_model import ForceModel
from ...reduction.potential import falling
from ...reduction.tree.free_bodies import free_numbers
from ...scene.initial_state import order_by_joint
from ...scene.scene import Scene
from ...scene.stop import stop_numbers
from ..robot_columns import RobotColumns, with_own
from .closed_inputs import close_inputs, closing_slopes
from .planned_start import PlannedStart

if TYPE_CHECKING:
    from ...kernels.initial_conditions import TwistOrMomentum
    from ...kernels.kernel import Kernel

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
                slopes, own = self._slopes[name], self._values[name]
                if isinstance(own, np.ndarray):
                    # Add entry by entry, so that a vector has the bits of scalar parameters.
                    entries = vector(value, len(own), name)
                    for k in range(len(own)):
                        constants[self._numbers_at] += slopes[:, k] * (entries[k] - own[k])
                    forces[name] = entries
                    continue
                number = value
                if type(value) is not float or not isfinite(value):
                    number = float(vector(np.ravel(value), 1, name)[0])
                constants[self._numbers_at] += slopes[:, 0] * (number - own)
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
        own = np.eye(system.m)
        own[:, list(planned.joints)] = 0.0  # these entries of x0 and xdot0 are planned
        changes = {"x0": (own, np.zeros_like(own)), "xdot0": (np.zeros_like(own), own)}
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
