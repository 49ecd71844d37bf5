"""Members specified by arrays of the options and parameters that differ between them.

Prescribed joints have their planned values in the initial shapes.  With closed loops, each initial
state is moved to the nearest closed one, and members that pass singular shapes are rejected.
Members whose values are rejected become failures, and the others are simulated.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ...common.arrays import Array, as_floats, copied, dimensions, vectors
from ...common.errors import (
    InputError,
    IntegrationError,
    LoopWarning,
    PinredError,
    RejectedValuesError,
    RejectedWarning,
    ShapeError,
    SymmetryError,
)
from ...common.names import brief, listed
from ...common.parameter import Parameter, VectorParameter, by_name, refuse_entry, value_in
from ...forces.force_model import ForceModel
from ...integrators.methods import Method
from ...reduction.potential import acting_gravity, falling
from ...scene import parse_options
from ...scene.initial_state import GivenStates, order_by_joint, random_state, refuse_vague
from ...scene.scene import Scene
from ...scene.stop import (
    BallStop,
    Stop,
    bounds_of,
    changed_stops,
    is_number_of_stop,
    parse_stops,
    starts_beyond,
)
from ...system.coordinates import Indices
from ...system.model_parameters import GRAVITY, kinds_near, requested, size_of
from ...system.system import System, in_gravity, nominal
from ..closed_loops import may_pass_singular_shape
from ..plan import Group, MemberParameters, Members, members_plan
from ..robot_parameters import RobotColumns, with_own
from ..simulate import as_scene, trajectory_of
from .trajectories import Batch, Failure


def varying_parameters(
    values: Mapping[str, Any], robot: Mapping[str, int], base: System | Scene,
    members: Collection[str],
) -> dict[str, Array]:  # fmt: skip
    """Return the parameters with one value for each member.

    Args:
        values: Values of parameters by name.
        robot: Number of entries of each robot parameter among them.
        base: The System or Scene of the members; its forces tell which parameters are vectors.
        members: Names of parameters that must differ between members.
    Returns:
        Values by name, (N,) or (N, k).
    Raises:
        ShapeError: One of `members` is a vector, but has a single value.
    """
    parameters = force_parameters(base) if isinstance(base, Scene) else {}
    varying = {}
    for name, value in values.items():
        axes: tuple[int, ...] = (1, 2)
        if name in robot:
            axes = (2,) if robot[name] > 1 else (1,)
        elif isinstance(vector := parameters.get(name), VectorParameter):
            axes = (2,)
            if name in members and dimensions(value) != 2:
                raise ShapeError(
                    f"members['{name}'] must have shape (N, {len(vector)}), got {np.shape(value)}"
                )
        if dimensions(value) in axes:
            varying[name] = rows_of(value, name)
    return varying


def rows_of(value: Any, name: str) -> Array:
    """Return the values (N,), or (N, k), of a parameter.  Raises ShapeError."""
    numbers = as_floats(value, name)
    return vectors(numbers, numbers.shape[-1], f"parameters['{name}']")


def force_parameters(scene: Scene) -> dict[str, Parameter | VectorParameter]:
    """Return the parameters in forces and signals of a scene, by name."""
    return {} if scene.force_model is None else by_name(scene.force_model.parameters)


def member_numbers(
    model: ForceModel, end: float, varying: Mapping[str, Array], count: int
) -> Array:
    """Return the force parameters of each member, (N, p).

    Args:
        model: Forces of the scene of all members.
        end: End of the simulation [s].
        varying: Values of the parameters in forces that differ between members, (N,) or (N, k).
        count: Number N of members.
    """
    # Compute entry by entry, so that a member's results do not depend on the number of members.
    numbers = np.repeat(model.numbers_from(0.0, end)[None], count, axis=0)
    columns = {name: values.T for name, values in varying.items()}
    for k, parameter in enumerate(model.parameters):
        shifts = value_in(columns, parameter) - parameter.value
        numbers += np.broadcast_to(shifts, count)[:, None] * model.slopes[:, k]
    return numbers


def with_prescribed_joints(
    scene: Scene, x: Array, xdot: Array, numbers: Array | None
) -> tuple[Array, Array]:
    """Return initial shapes and rates, in which prescribed joints have their planned values.

    Args:
        scene: The scene of all members.
        x: Initial shapes, (N, nx) [rad | m | 1].
        xdot: Initial shape rates, (N, m) [rad/s | m/s].
        numbers: Force parameters of each member, (N, p), or None if all members share them.
    Returns:
        The shapes and rates.
    """
    model = scene.force_model
    if model is None or not model.joints or numbers is None:
        return scene.with_prescribed(x, xdot)
    x, xdot, joints = x.copy(), xdot.copy(), list(model.joints)
    coordinates = scene.system.space.coordinates_of_joints(joints)
    for k, numbers_of_member in enumerate(numbers):
        planned = model.prescribed(0.0, numbers_of_member)
        x[k, coordinates], xdot[k, joints] = planned.x, planned.xdot
    return x, xdot


def close_members(scene_of: Callable[[int], Scene], count: int) -> tuple[Array, Array]:
    """Return the initial shapes and rates of all members with closed loops, as in `simulate`.

    Args:
        scene_of: Function that returns the scene of a member, given its index.
        count: Number of members N.
    Returns:
        Shapes, (N, nx), and rates, (N, m).
    Raises:
        RejectedValuesError: The loops of some members do not close; it has the reason for each.
    """
    shapes, rates, reasons = [], [], dict[int, str]()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for member in range(count):
            try:
                closed = scene_of(member).given
            except InputError as error:
                reasons[member] = str(error)
                continue
            shapes.append(closed.x)
            rates.append(closed.xdot)
    if reasons:
        raise RejectedValuesError(reasons)
    _warn_once(caught, count)
    return np.concatenate(shapes), np.concatenate(rates)


def _warn_once(caught: list[warnings.WarningMessage], count: int) -> None:
    """Repeat the first warning about loops with the number of such members, and all others."""
    loops = [entry for entry in caught if issubclass(entry.category, LoopWarning)]
    for entry in caught:
        if entry not in loops:
            warnings.warn_explicit(entry.message, entry.category, entry.filename, entry.lineno)
    if loops:
        warnings.warn(
            f"{len(loops)} initial states of {count} members leave loops open. The first: "
            f"{loops[0].message}",
            LoopWarning,
            stacklevel=2,
        )


def reject_singular(batch: Batch, times: Array, scene_of: Callable[[int], Scene]) -> list[Failure]:
    """Return the failures of members that pass a singular shape, and remove their later states.

    Lanes store no steps.  So members whose reported shapes cannot exclude a singular shape are
    simulated alone, which finds it.

    Args:
        batch: Solutions of the members, whose states after a singular shape become NaN.
        times: Report times, (T,) [s].
        scene_of: Function that returns the scene of a member, given its index.
    Returns:
        The failures.
    """
    assert batch.flow is not None
    system, failures = batch.flow.kernel.system, []
    if system.closure is None:
        return []
    shapes = np.empty((len(batch.members), len(times), system.nx))
    batch.flow.fill_states(times, batch.y, np.arange(len(shapes)), {"x": shapes})
    failed = {failure.member for failure in batch.failures}
    for k, member in enumerate(batch.members.tolist()):
        if member in failed or not may_pass_singular_shape(system, shapes[k]):
            continue
        try:
            trajectory_of(scene_of(member))
        except IntegrationError as error:
            reached = getattr(error, "time", 0.0)
            batch.y[k, times > reached] = np.nan
            failures.append(Failure(member, reached, str(error)))
    return failures


STATES = ("x0", "xdot0", "xi0", "momentum", "pose0", "q0", "v0")
# Pairs (option, field of State) that q0 and v0 determine; then the fields that a seed determines.
_OF_Q = (("pose0", "pose"), ("x0", "x"))
_OF_V = (("xi0", "xi"), ("xdot0", "xdot"))
_OF_SEED = ("x", "xdot", "xi")
_OPTIONS = f"{', '.join(STATES)}, gravity, a number of a stop or a parameter"


class MemberOptions:
    """The options of N members: options that differ between members, and options that all share.

    Attributes:
        system: The robot as it was loaded.
        base: The System or Scene whose options all members share.
        seeds: Seeds of random initial states, (N,), or None.
        common: Options that all members share.
        states: Initial states by option, (N, …).
        by_name: {option: {joint: (N, …)}} of x0 and xdot0 if they name joints of loops.
        parameters: Values of parameters by name, (N,) or (N, k).
        gravity: Gravity in the world frame, (N, 3) [m/s²], or None.
        stops: Numbers of joint stops by name, (N,).
        robot: Number of entries of each robot parameter that the call states, by name.
        count: Number of members.
        prepared: Result of `template` of other members with the same options; None to compute it.
    """

    prepared: Scene | None = None

    def __init__(
        self,
        base: System | Scene,
        options: Mapping[str, Any],
        members: Mapping[str, Any] | None,
        seeds: Sequence[int] | None,
    ) -> None:
        """Separate the options that differ between members from the others.

        Args:
            base: A System, or a Scene whose options apply unless `options` replaces them.
            options: Options of Scene, some with a leading axis (N, …).
            members: Values of initial states, parameters and gravity by name, (N, …).
            seeds: Seeds of random initial states, (N,).
        Raises:
            InputError: A name is given twice, is unknown, or there are no members.
            ShapeError: A value has the wrong shape, or another number of members.
        """
        self.seeds = seeds
        scene_values = dict(base.parameters)
        self.system = system = nominal(base.system if isinstance(base, Scene) else base)
        self.base: System | Scene = system
        if isinstance(base, Scene):
            self.base = replace(base, system=system, parameters={})
        # Scenes of members are built later, so the caller may change the values in the meantime.
        self.common = copied(options)
        values = _parameter_values(system, self.common.pop("parameters", None), scene_values)
        for name, value in copied(_checked_members(members)).items():
            if name in (*self.common, *values):
                raise InputError(
                    f"'{name}' is given in members and also for all members. Omit one of them."
                )
            if name == "gravity" and vectors(value, 3, "gravity").ndim != 2:
                raise ShapeError(f"gravity must have shape (N, 3), got {np.shape(value)}")
            (self.common if name in STATES else values)[name] = value
        ordered: dict[str, Any] = {
            name: order_by_joint(self.common[name], system, name)
            for name in ("x0", "xdot0")
            if name in self.common
        }
        self.by_name = _named_rows(system, self.common, ordered)
        for name, value in ordered.items():
            # Joints of loops keep the values that are stated by name, so keep the names.
            if not (system.loops and dimensions(value) == 1):
                self.common[name] = value
        self.states = {
            name: as_floats(self.common.pop(name), name)
            for name in STATES
            if self.common.get(name) is not None and dimensions(self.common[name]) == 2
        }
        self.gravity = self._member_gravity(values, scene_values)
        self.stops = {
            name: _stop_rows(values.pop(name), name)
            for name in [*values]
            if is_number_of_stop(name, system)
        }
        sizes = {name: size_of(system, name) for name in values}
        self.robot = {name: size for name, size in sizes.items() if size is not None}
        self.parameters = varying_parameters(values, self.robot, base, members or {})
        if self.gravity is not None:
            scene_values = {
                name: value for name, value in scene_values.items() if name not in GRAVITY
            }
        fixed = {name: value for name, value in values.items() if name not in self.parameters}
        self.common["parameters"] = {
            n: v for n, v in scene_values.items() if n not in values
        } | fixed
        self.count = self._count()

    def _member_gravity(self, values: dict[str, Any], own: Mapping[str, Any]) -> Array | None:
        """Return the gravity of the members, (N, 3), and remove it from the values."""
        if "gravity" in values and dimensions(values["gravity"]) == 2:
            return vectors(values.pop("gravity"), 3, "gravity")
        if dimensions(values.get("gravity.strength", 0.0)) == 1:
            g = np.asarray(own.get("gravity", self.system.gravity))
            unit = g / np.linalg.norm(g) if g.any() else g
            return np.outer(rows_of(values.pop("gravity.strength"), "gravity.strength"), unit)
        return None

    def _count(self) -> int:
        sizes = {n: len(v) for n, v in (self.states | self.parameters).items()}
        sizes |= {name: len(numbers) for name, numbers in self.stops.items()}
        if self.gravity is not None:
            sizes["gravity"] = len(self.gravity)
        if self.seeds is not None:
            if "seed" in self.common:
                raise InputError("give seeds or seed, not both")
            both = [name for name in self.states if name != "pose0"]
            if both:
                raise InputError(f"seeds: they set the whole initial state; remove {both[0]}")
            sizes["seeds"] = len(self.seeds)
        if len(set(sizes.values())) != 1:
            lengths = ", ".join(f"{name}: {size}" for name, size in sizes.items()) or "none"
            shared = listed([str(name) for name in self.common["parameters"]])
            raise ShapeError(
                f"at least one of {_OPTIONS} must have shape (N, …), all with the same N; "
                f"the lengths are {lengths}" + (f", and one for all {shared}" if shared else "")
            )
        count = next(iter(sizes.values()))
        if not count:
            raise InputError("simulate_many needs at least one member")
        return count

    def scene(self, member: int, *, common_parameters: bool = False) -> Scene:
        """Return the scene of a member, optionally with only the parameters that all share."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LoopWarning)  # `close_members` emits one for all
            return self._scene(member, common_parameters=common_parameters)

    def _scene(self, member: int, *, common_parameters: bool = False) -> Scene:
        options: dict[str, Any] = {name: values[member] for name, values in self.states.items()}
        options |= {name: _row(self.by_name[name], member) for name in self.by_name}
        values_of_member = {name: values[member] for name, values in self.parameters.items()}
        options |= self.common
        if not common_parameters:
            options["parameters"] = {**self.common["parameters"], **values_of_member}
        if self.seeds is not None:
            options["seed"] = self.seeds[member]
        if self.stops:
            options["stops"] = self._stops_of(member)
        base = self.base
        if self.gravity is not None:
            system = in_gravity(self.system, self.gravity[member])
            base = replace(base, system=system) if isinstance(base, Scene) else system
        return as_scene(base, options, "simulate_many")

    def _stops_of(self, member: int) -> dict[str, Stop | BallStop]:
        """Return the stops of a member if their numbers vary.  Raises InputError."""
        stops = getattr(self.base, "stops", None)
        shared = parse_stops(self.common.get("stops", stops), self.system)
        return changed_stops(shared, {name: column[member] for name, column in self.stops.items()})

    def _refuse_starts_beyond_stops(self, scene: Scene, x: Array) -> None:
        """Raise RejectedValuesError if stops of members are not valid, or exclude their start."""
        reasons = {} if self.stops else starts_beyond(scene.bounds, x)
        for k in range(self.count if self.stops else 0):
            try:
                bounds = bounds_of(self.system, self._stops_of(k))
            except InputError as error:
                reasons[k] = str(error)
                continue
            for reason in starts_beyond(bounds, x[k : k + 1]).values():
                reasons[k] = reason
        if reasons:
            raise RejectedValuesError(reasons)

    def _scene_by(self, method: Method | str, member: int) -> Scene:
        """Return the scene of one member, with the integrator that members use."""
        scene = self.scene(member)
        return scene if scene.method == method else replace(scene, method=method)

    def select(self, members: Indices) -> MemberOptions:
        """Return the options of the selected members, (K,) sorted indices."""
        if len(members) == self.count:
            return self
        selected = copy(self)
        selected.states = _row(self.states, members)
        selected.by_name = {n: _row(values, members) for n, values in self.by_name.items()}
        selected.parameters = _row(self.parameters, members)
        selected.stops = _row(self.stops, members)
        selected.gravity = None if self.gravity is None else self.gravity[members]
        selected.seeds = None if self.seeds is None else [self.seeds[k] for k in members.tolist()]
        selected.count = len(members)
        return selected

    def template(self) -> Scene:
        """Return the scene of all members, in which the robot parameters of members vary.

        Raises:
            InputError: The scene of the first member is invalid, or a parameter cannot vary.
        """
        # Use common parameters only, so that results do not depend on member order.
        template = self.scene(0, common_parameters=True)
        if template.hold == "others" and (self.seeds is not None or {"x0", "q0"} & {*self.states}):
            raise InputError(
                "hold: members with different initial shapes cannot hold joints; give the scenes "
                "as a list, or name the joints in prescribed"
            )
        self._check_varying(template)
        varying = [name for name in self.robot if name in self.parameters]
        if varying:
            template = with_own(template, varying)
        elif self.gravity is not None:
            template = replace(template, system=self.system)
        return template

    def _check_varying(self, template: Scene) -> None:
        """Check that the parameters can vary in the scene of all members, and their shapes.

        Raises:
            InputError: A name is not that of a parameter.
            ShapeError: A value has the wrong shape.
        """
        parameters = force_parameters(template)
        for name, values in self.parameters.items():
            if name in self.robot:
                continue
            if name not in parameters:
                refuse_entry(name, parameters, "members")
                names = list(parameters)
                raise InputError(
                    f"members: {brief(name)} cannot vary in these scenes; "
                    f"{kinds_near(self.system, name, [*STATES, *names])}; these scenes accept "
                    f"{_OPTIONS}: {listed(names, 60) or 'none'}"
                )
            parameter = parameters[name]
            size = (len(parameter),) if isinstance(parameter, VectorParameter) else ()
            if values.shape[1:] != size:
                expected = ", ".join(["N", *map(str, size)]) + ("" if size else ",")
                hint = " For one value of all members, pass a Scene with it." if size else ""
                raise ShapeError(
                    f"parameters['{name}'] must have shape ({expected}) for N members, "
                    f"got {values.shape}.{hint}"
                )

    def members(self) -> Members:
        """Group the members by the kernel they share.  Raises InputError for invalid scenes."""
        template = self.template() if self.prepared is None else self.prepared
        numbers = self._numbers(template)
        varying = [name for name in self.robot if name in self.parameters]
        robot = self._robot_numbers(template) if varying else None
        first_scene = self._first_scene(template)
        states = self._given(template, numbers)
        parameters = MemberParameters(numbers, robot)
        plan = members_plan(first_scene)
        scene_of = partial(self._scene_by, plan.scene.method)
        if self.gravity is None:
            shared = plan if first_scene is template else members_plan(template)
            groups = [Group(np.arange(self.count), shared, states, parameters)]
        else:
            groups = self._by_gravity(template, states, parameters)
        return Members(self.count, groups, scene_of)

    def _first_scene(self, template: Scene) -> Scene:
        """Return a scene with the options that all members share, and validate these options."""
        if self.prepared is not None:
            return self.prepared
        if self.parameters or self.stops or self.gravity is not None:
            return self.scene(0)
        return template  # It is the scene of the first member.

    def _by_gravity(
        self, template: Scene, given: GivenStates, own: MemberParameters
    ) -> list[Group]:
        """Group members by the axes along which gravity acts."""
        assert self.gravity is not None
        gravities, which = np.unique(self.gravity, axis=0, return_inverse=True)
        which = which.reshape(-1)
        systems = [in_gravity(self.system, gravity) for gravity in gravities]
        acting = np.array([acting_gravity(system) for system in systems])
        fall = np.array([falling(system) for system in systems])
        groups = []
        for axes in np.unique(acting != 0.0, axis=0):
            kinds = np.flatnonzero(((acting != 0.0) == axes).all(axis=1))
            members = np.flatnonzero(np.isin(which, kinds))
            system = systems[kinds[0]]
            # Reuse the kernel of the robot's own gravity if that gravity acts along the same axes.
            with suppress(SymmetryError):
                if np.array_equal(acting_gravity(template.system) != 0.0, axes):
                    system = template.system
            plan = members_plan(replace(template, system=system))
            rows_of = which[members]
            parameters = replace(own[members], gravity=acting[rows_of], fall=fall[rows_of])
            groups.append(Group(members, plan, given[members], parameters))
        return groups

    def _numbers(self, template: Scene) -> Array | None:
        """Return the force parameters of each member, (N, p), or None if all members share them."""
        model = template.force_model
        if not self.parameters or model is None:
            return None
        varying = {n: values for n, values in self.parameters.items() if n not in self.robot}
        return member_numbers(model, template.end, varying, self.count)

    def _robot_numbers(self, template: Scene) -> Array:
        """Return the variable parameters of the bodies of each member, (N, s).

        Args:
            template: The scene of all members.
        Returns:
            The parameters.
        Raises:
            RejectedValuesError: Some robots are not physical; it has the reason for each.
        """
        layout = members_plan(template).layout(zero_momentum=False, generic=True)
        names = [name for name in self.robot if name in self.parameters]
        values = {name: self.parameters[name].reshape(self.count, -1) for name in names}
        numbers, reasons = RobotColumns(template, layout, 0).rows(values)
        if reasons:
            raise RejectedValuesError(reasons)
        return numbers

    def _given(self, scene: Scene, numbers: Array | None) -> GivenStates:
        """Return the initial states of all members; fields that do not differ are the scene's."""
        system, common_states = scene.system, scene.given
        states = dict(self.states)
        if self.seeds is not None:
            random = [random_state(system, seed) for seed in self.seeds]
            states |= {f"{n}0": np.array([getattr(s, n) for s in random]) for n in _OF_SEED}
        for option, read, fields in (
            ("q0", parse_options.parse_configuration, _OF_Q),
            ("v0", parse_options.parse_velocity, _OF_V),
        ):
            if option in states:
                converted = [read(entry, system) for entry in states.pop(option)]
                states |= {
                    n: np.array([getattr(state, field) for state in converted])
                    for n, field in fields
                }

        def rows(name: str, size: int, common: Array | None) -> Array | None:
            if name in states:
                return vectors(states[name], size, name)
            return None if common is None else np.repeat(common, self.count, axis=0)

        x = rows("x0", system.nx, common_states.x)
        xdot = rows("xdot0", system.m, common_states.xdot)
        assert x is not None
        assert xdot is not None
        x = system.space.normalized(x, "x0", near=False)
        pose = np.repeat(common_states.pose, self.count, axis=0)
        if "pose0" in states:
            pose = np.array([system.group.pose(entry) for entry in states["pose0"]])
        refuse_vague(np.abs(x).max(axis=0), system)
        if system.loops:
            x, xdot = close_members(self._scene, self.count)
        x, xdot = with_prescribed_joints(scene, x, xdot, numbers)
        self._refuse_starts_beyond_stops(scene, x)
        xi, momentum = (
            rows("xi0", system.r, common_states.xi),
            rows("momentum", system.r, common_states.mu),
        )
        return GivenStates(pose, x, xdot, xi, momentum)


def _parameter_values(system: System, parameters: Any, own: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of parameters= by name; a name without value has the scene's value."""
    if parameters is None or isinstance(parameters, Mapping):
        return dict(parameters or {})
    values, unknown = requested(system, parameters)
    if unknown:
        raise InputError(
            f"parameters: {brief(unknown[0])} is not a robot parameter, so it needs a value. "
            "Give {name: value}."
        )
    return values | {name: own[name] for name in values if name in own}


def _named_rows(
    system: System, options: Mapping[str, Any], ordered: Mapping[str, Any]
) -> dict[str, dict[str, Array]]:
    """Return {option: {joint: rows (N, …)}} of members that state joints of loops by name."""
    if not system.loops:
        return {}
    balls = {joint.name for joint in system.space.balls}
    named = {}
    for name, values in ordered.items():
        if not (isinstance(options[name], Mapping) and dimensions(values) == 2):
            continue
        columns = {joint: as_floats(entry, joint) for joint, entry in options[name].items()}
        named[name] = {
            joint: np.broadcast_to(
                column, (len(values), *column.shape[-1 if joint in balls else column.ndim :])
            )
            for joint, column in columns.items()
        }
    return named


def _stop_rows(value: Any, name: str) -> Array:
    """Return the values (N,) of a number of a stop.  Raises ShapeError."""
    if (shape := as_floats(value, name).shape)[1:] or not shape:
        raise ShapeError(
            f"members['{name}'] must have shape (N,), got {shape}. State numbers that all members "
            "share in stops"
        )
    return rows_of(value, name)


def _row(values: Mapping[str, Array], member: int | Indices) -> dict[str, Array]:
    return {joint: columns[member] for joint, columns in values.items()}


def _checked_members(members: Mapping[str, Any] | None) -> Mapping[str, Any]:
    if members is None:
        return {}
    if not (isinstance(members, Mapping) and all(isinstance(name, str) for name in members)):
        raise InputError(f"members must be {{name: (N, …) values}}, got {brief(members)}")
    return members


Invalid: TypeAlias = Literal["record", "raise"]
INVALID: tuple[Invalid, ...] = get_args(Invalid)


def separate_rejected(options: MemberOptions, invalid: Invalid) -> tuple[Members, list[Failure]]:
    """Return the members whose values are valid, and the failures of the others.

    Args:
        options: Options of all members.
        invalid: Whether to "record" rejected members as failures, or to "raise" an error.
    Returns:
        The valid members, with their indices among all members, and the failures.
    Raises:
        PinredError: No member is valid, or `invalid` is "raise" and a member is rejected.
    """
    try:
        return options.members(), []
    except PinredError as error:
        if _is_shared(options, error):
            raise
        reasons = _find_rejected(options, np.arange(options.count), error)
        if invalid == "raise" or len(reasons) == options.count:
            first = min(reasons)
            error_type = InputError if isinstance(error, RejectedValuesError) else type(error)
            raise error_type(f"member {first}: {reasons[first]}") from None
    return _without(options, reasons)


def separate_all_rejected(options: MemberOptions) -> tuple[Members, list[Failure]]:
    """Return the members whose values are valid, perhaps none, and the failures of the others.

    Args:
        options: Options of all members; the options that all share are valid.
    Returns:
        The valid members, with their indices among all members, and the failures.
    Raises:
        ShapeError: An array has a wrong shape.
    """
    try:
        return options.members(), []
    except ShapeError:
        raise
    except PinredError as error:
        reasons = _find_rejected(options, np.arange(options.count), error)
    return _without(options, reasons)


def _without(options: MemberOptions, reasons: dict[int, str]) -> tuple[Members, list[Failure]]:
    """Return the members that are not rejected, and the failures of the rejected ones."""
    failures = [Failure(k, 0.0, reason, rejected=True) for k, reason in sorted(reasons.items())]
    kept = np.setdiff1d(np.arange(options.count), list(reasons))
    if not kept.size:
        return Members(options.count, [], partial(options.scene, common_parameters=True)), failures
    resolved = options.select(kept).members()
    groups = [replace(group, members=kept[group.members]) for group in resolved.groups]
    return Members(options.count, groups, partial(_scene, resolved.scene_of, kept)), failures


def warn_of_rejected(failures: list[Failure], count: int) -> None:
    """Warn that some members were rejected, in one sentence for all."""
    if failures:
        first, reason = failures[0].member, failures[0].reason.rstrip(".")
        warnings.warn(
            f"{len(failures)} of {count} members are rejected and listed in `failures`; the first "
            f"is member {first}: {reason}. Pass invalid='raise' to get an error.",
            RejectedWarning,
            stacklevel=4,
        )


def _is_shared(options: MemberOptions, error: PinredError) -> bool:
    """Return whether an error comes from shapes, or from options that all members share."""
    if isinstance(error, (RejectedValuesError, ShapeError)):
        return isinstance(error, ShapeError)
    alone = [_try_members(options, np.array([k])) for k in {0, options.count - 1}]
    return all(str(error) in reasons.values() for reasons in alone)


def _find_rejected(options: MemberOptions, members: Indices, error: PinredError) -> dict[int, str]:
    """Return {member: reason} of the members that cause an error, found by halving.

    Args:
        options: Options of all members.
        members: Indices of the members that raise the error together.
        error: The error.
    """
    if isinstance(error, RejectedValuesError):
        reasons = {int(members[k]): reason for k, reason in error.reasons.items()}
        remaining = np.setdiff1d(members, list(reasons))
        return reasons | _try_members(options, remaining)
    if len(members) == 1:
        return {int(members[0]): str(error)}
    halves = np.array_split(members, 2)
    return _try_members(options, halves[0]) | _try_members(options, halves[1])


def _try_members(options: MemberOptions, members: Indices) -> dict[int, str]:
    if not members.size:
        return {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LoopWarning)  # the run of the valid members warns again
            options.select(members).members()
    except PinredError as error:
        return _find_rejected(options, members, error)
    return {}


def _scene(scene_of: Callable[[int], Scene], kept: Indices, member: int) -> Scene:
    """Return the scene of a member; that of the first valid member for rejected members."""
    k = int(np.searchsorted(kept, member))
    return scene_of(k if k < len(kept) and kept[k] == member else 0)
