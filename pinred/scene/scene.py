"""Scene: an immutable description of a simulation, with validated options and initial state.

The option `parameters` states robot parameters together with force parameters.

A scene checks its options and builds its force model once for each structure, that is, for all
options except the numbers of the initial state.  A system keeps the structures that were used most
recently.  A scene with an option that may change in place, such as a controller, shares nothing.

`scene_of` copies the checked options of an earlier scene that differs only in the numbers of the
initial state, and checks the initial state only.  The key of a call contains the values of all
other options, so an option that was changed in place gets its own scene.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..common.argument_kinds import checks_arguments, is_given
from ..common.arrays import Array, copied, positive, read_only, vector, vector_or_zero, whole
from ..common.errors import InputError
from ..common.html import card, line, numbers, table
from ..common.memo import once, recent
from ..common.names import brief, one_of
from ..common.parameter import Parameter, by_name
from ..forces.controller import Controller
from ..forces.force import Force
from ..forces.force_model_cache import PLAIN, NotKeyedError, key_of, key_of_force
from ..forces.signals import Attitude, Constant
from ..forces.signals.attitude_signal import parse_attitude
from ..integrators.methods import DOP853_LEAST, AdaptiveGauss, ErrorControl, Method
from ..system.coordinates import InitialState
from ..system.model_parameters import ModelParameters
from ..system.robot_file_contents import Keyframe
from ..system.system import System, checked_system, nominal
from . import parse_options
from .event import Event, list_events, watched_of
from .initial_state import (
    GivenStates,
    HeldJoints,
    Start,
    closed_state,
    held_joints,
    order_by_joint,
    random_state,
    refuse_vague,
    start_of,
)
from .parse_options import (
    GivenParameters,
    acting_passive,
    actuation,
    actuators_left_out,
    check_keyframe,
    check_passive,
    check_span,
    compute_report_times,
    given_parameters,
    list_forces,
    passive_left_out,
)
from .scene_options import (
    ARRAYS_OF_STATE,
    HELD,
    OUTPUTS,
    SCENE_OPTIONS,
    SceneFields,
    describe_fields,
)
from .scene_options import ENGINES as ENGINES
from .scene_options import Engine as Engine
from .stop import Bound, bounds_of, parse_stops, starts_beyond

if TYPE_CHECKING:
    from ..forces.force import Watched
    from ..forces.force_model import ForceModel


_NUMBERS = frozenset({float, int})
MOST_STRUCTURES = 16  # largest number of structures that a system keeps
_STATE = tuple(name for name, option in SCENE_OPTIONS.items() if option.table == "start")
_OTHERS = tuple(name for name in SCENE_OPTIONS if name not in _STATE)


class Shared:
    """The checked options of all scenes of one structure.

    Plans store here what they compute for all of these scenes.

    Attributes:
        options: Fields of a scene that do not depend on the initial state.
    """

    def __init__(self, options: Mapping[str, Any]) -> None:
        """Store the checked options."""
        self.options = options


def structure_key(scene: SceneFields) -> Hashable:
    """Return the key of a scene whose options are not yet checked; None without a key."""
    options = vars(scene)
    if not is_empty_table(options["parameters"]):
        return None  # Robot parameters replace the system.
    if options["hold"] == "others":
        return None  # The initial state is that of the joints that are held.
    try:
        key = (
            tuple([_key_of_state(options[name]) for name in _STATE]),
            *[key_of_option(options[name]) for name in _OTHERS],
        )
        hash(key)
    except (NotKeyedError, TypeError):
        return None  # The checks of the scene report an invalid option.
    return key


def is_empty_table(value: Any) -> bool:
    """Return whether a value is a mapping without entries."""
    return type(value) in (dict, MappingProxyType) and not value


def _key_of_state(value: Any) -> Hashable:
    """Return whether an option of the initial state is stated; the name itself of a keyframe."""
    return value if type(value) is str else value is not None


def key_of_option(value: Any) -> Hashable:
    """Return the key of an option that does not belong to the initial state."""
    value_type = type(value)
    if value_type in PLAIN:
        return value_type, value
    if value_type in (dict, tuple) and not value:
        return value_type.__name__
    if value_type is np.ndarray:
        return key_of(value)
    if value_type is list and {*map(type, value)} <= _NUMBERS:
        return value_type, tuple(map(type, value)), tuple(value)
    if isinstance(value, Force):
        return key_of_force(value)
    if value_type in (list, tuple) and any(isinstance(entry, Force) for entry in value):
        return value_type, tuple(map(key_of_option, value))
    if isinstance(value, Method):
        # Equal methods may differ in whether the user stated their tolerances.
        return value_type, key_of(vars(value))
    if value_type is MappingProxyType:
        return key_of(dict(value))
    return key_of(value)


TIGHTEST = 1e-14  # smallest relative tolerance; below it, round-off determines the step size
# The integrated quantities are momenta, but users need accurate rates.  If a light joint is
# attached to heavy links, a relative error of a momentum causes a larger relative error of the
# light joint's rate.
MOMENTUM_MARGIN = 10.0


def check_tolerances(method: Method, rtol: float, atol: float) -> None:
    """Reject tolerances that both the scene and its method state.

    Args:
        method: Integrator of the scene.
        rtol: Relative tolerance of the scene.
        atol: Absolute tolerance of the scene.
    Raises:
        InputError: the scene and the method both have tolerances.
    """
    options = [name for name, value in (("rtol", rtol), ("atol", atol)) if is_given(value)]
    if options and _has_tolerances(method):
        raise InputError(
            f"{options[0]} conflicts with the tolerances of the method {method}. Give tolerances "
            f"either to the scene or to {method.name}."
        )


def with_tolerances(method: Method, rtol: float, atol: float) -> Method:
    """Return a method with the tolerances of its scene.

    Args:
        method: Integrator.  It stays unchanged if it has equal steps or its own tolerances.
        rtol: Relative tolerance; increased to the smallest tolerance that the method can satisfy.
        atol: Absolute tolerance.
    Returns:
        The method with tolerances.
    """
    if not isinstance(method, ErrorControl) or _has_tolerances(method):
        return method
    least = 0.0 if isinstance(method, AdaptiveGauss) else DOP853_LEAST
    return replace(method, rtol=max(rtol, least), atol=atol)


def _has_tolerances(method: Method) -> bool:
    return isinstance(method, ErrorControl) and (is_given(method.rtol) or is_given(method.atol))


@checks_arguments
@dataclass(frozen=True, kw_only=True, eq=False)
class Scene(SceneFields):
    """A system with its initial state, forces, duration and tolerances.

    Without an initial state, the scene starts from the robot's own initial state.  `compare` uses
    rtol and atol as its scale.  Methods with equal steps ignore both tolerances.

    The option `parameters` makes robot parameters inputs of the kernel.  For a link "hand", the
    names are "hand.mass", "hand.com", "hand.inertia" (xx, xy, xz, yy, yz, zz about the centre of
    mass) and "hand.log_cholesky", in the frame of the link, as in the file; "hand.body.mass" and
    so on for the body of all links that are fixed to it, in the frame of its joint; and
    "hand.payload.mass" with "hand.payload.at" for a point mass on the body.  For a joint "elbow",
    the names are "elbow.placement" (x, y, z, roll, pitch, yaw) and "elbow.translation"; for a
    locked joint, "elbow.lock".  The names for gravity are "gravity" (vector in the world frame)
    and "gravity.strength".  Names without values, or "all" for inertias and placements, keep the
    current values.  So do parameters of the system (System.parameters).

    The scene converts its options: joint values by name to arrays, motions of prescribed joints
    to Signals, and names of methods to methods.

    Raises:
        InputError: an option is not valid, or the options contradict each other.
        ShapeError: an array has the wrong shape.
    """

    def __post_init__(self) -> None:
        owner, key = checked_system(self.system, "a scene", loops=True), structure_key(self)
        self._keep("_held_plans", self._plans_that_hold())
        if key is None:
            shared = self._check_structure()
        else:
            shared = recent(owner, key, self._check_structure, MOST_STRUCTURES, Shared)
            forces = list_forces(self.forces)
            vars(self).update(shared.options)
            self._keep("forces", forces)
            self._keep("prescribed", dict(self.prescribed))
            # Scenes with a Controller share nothing, so these controls are a mapping.
            self._keep("controls", dict(self.controls))  # type: ignore[arg-type]
        self._keep("_shared", shared)
        if self.seed is not None:
            self._keep("seed", whole(self.seed, "seed", 0))
        self._keep("_held", held_joints(self.x0, self.xdot0))
        for name in ("x0", "xdot0"):
            value = order_by_joint(getattr(self, name), self.system, name)
            self._keep(name, value)
        self.resolve_state()

    def resolve_state(self) -> None:
        """Check and store the initial state that the options state.

        The scene has copies of arrays and lists, because a caller may change them afterwards.

        Raises:
            InputError: The state is not valid, or lies outside the stops.
        """
        values = vars(self)
        for name in ARRAYS_OF_STATE:
            if values[name] is not None:
                values[name] = copied(values[name])
        values["_given"] = initial = self._resolve()
        if self.bounds and (reasons := starts_beyond(self.bounds, initial.x)):
            raise InputError(reasons[0])

    def _check_structure(self) -> Shared:
        """Check all options except the numbers of the initial state; return these options."""
        unchecked = dict(vars(self))
        self._apply_robot_parameters()
        self._check_conflicts()
        if not one_of(self.outputs, OUTPUTS):
            raise InputError(
                f"outputs must be one of {', '.join(OUTPUTS)}, got {brief(self.outputs)}"
            )
        for name in ("rtol", "atol"):
            value = positive(getattr(self, name), name)
            if is_given(getattr(self, name)):
                self._keep(name, value)
        if self.rtol < TIGHTEST:
            raise InputError(f"rtol must be at least {TIGHTEST:g}, got {self.rtol:g}")
        method = parse_options.parse_method(self.method)
        if method != "auto":
            check_tolerances(method, self.rtol, self.atol)
        self._keep("method", method)
        if self.duration is not None:
            self._keep("duration", positive(self.duration, "duration"))
        times = compute_report_times(self.times, self.duration, self.system)
        self._keep("_times", read_only(times))
        self._check_forces()
        self._check_stops()
        checked = vars(self).items()
        return Shared({name: v for name, v in checked if v is not unchecked.get(name, unchecked)})

    def _check_conflicts(self) -> None:
        """Raise InputError if options of the initial state contradict each other."""
        stated = [name for name in SCENE_OPTIONS if getattr(self, name) is not None]
        for name in stated:
            option = SCENE_OPTIONS[name]
            both = [other for other in option.replaces if other in stated]
            if both and option.scope:
                raise InputError(f"{name} sets {option.scope}; do not combine it with {both[0]}")
            if both:
                raise InputError(f"pass {both[0]} or {name}, not both: each determines the other")
        if self.keyframe is not None:
            check_keyframe(self.system, self.keyframe)

    def __reduce__(self) -> tuple[Any, ...]:
        options = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        options |= {"system": nominal(self.system), "parameters": dict(self.parameters)}
        if isinstance(self.stops, Mapping):
            options["stops"] = dict(self.stops)
        return _scene_of, (options,)

    def _repr_html_(self) -> str:

        return scene_card(self)

    @cached_property
    def start(self) -> Start:
        """The complete initial state.  Raises SingularInertiaError or InputError."""
        return start_of(self.system, self.given)

    @property
    def shared(self) -> Shared:
        """The options that the scene shares with others, and what plans computed from them."""
        shared: Shared = vars(self)["_shared"]
        return shared

    @property
    def given(self) -> GivenStates:
        """The initial state as the options state it, with a leading axis of length one."""
        given: GivenStates = vars(self)["_given"]
        return given

    @property
    def report_times(self) -> Array:
        """The report times, (T,) [s]."""
        times: Array = vars(self)["_times"]
        return times

    @property
    def tolerance(self) -> tuple[float, float]:
        """The integrator's (rtol, atol), a tenth of the scene's (see MOMENTUM_MARGIN)."""
        return self.rtol / MOMENTUM_MARGIN, self.atol / MOMENTUM_MARGIN

    @property
    def integrator(self) -> Method | None:
        """The requested method with its tolerances; None if the method is "auto"."""
        method: Method | Literal["auto"] = vars(self)["method"]
        return None if method == "auto" else with_tolerances(method, *self.tolerance)

    @property
    def force_model(self) -> ForceModel | None:
        """The forces except gravity, and the prescribed joints; None if there are none."""
        model: ForceModel | None = vars(self)["_forces"]
        return model

    @property
    def varied(self) -> ModelParameters | None:
        """The robot parameters among the parameters; None if there are none."""
        parameters: GivenParameters = vars(self)["_parameters"]
        return parameters.varied

    @property
    def events_given(self) -> tuple[Event, ...]:
        """The events, in order."""
        events: tuple[Event, ...] = vars(self)["events"]
        return events

    @property
    def watched(self) -> Watched | None:
        """The expressions of the events; None if there are none."""
        watched: Watched | None = vars(self)["_watched"]
        return watched

    @property
    def bounds(self) -> tuple[Bound, ...]:
        """The bounds of independent joints by stops; empty without stops."""
        bounds: tuple[Bound, ...] = vars(self)["_bounds"]
        return bounds

    @property
    def own_forces(self) -> tuple[Force, ...]:
        """The springs, dampers and friction of the robot's file that act in the scene."""
        return acting_passive(self.system, passive=self.passive, friction=self.friction)

    @property
    def left_out(self) -> str:
        """Sentences about forces of the robot's file that do not act; empty if all of them act."""
        return once(self.shared, "left out", self._left_out)

    def _left_out(self) -> str:
        passive = passive_left_out(self.system, passive=self.passive, friction=self.friction)
        actuators = actuators_left_out(self.system, self.controls)
        return "; ".join(text for text in (passive, actuators) if text)

    @property
    def end(self) -> float:
        """The end of the simulation [s]; it starts at 0."""
        if self.duration is not None:
            return float(self.duration)
        return float(self.report_times[-1])

    def _keep(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _apply_robot_parameters(self) -> None:
        """Replace the system by a copy with the robot parameters of the scene."""
        parameters = given_parameters(self.system, self.parameters)
        self._keep("_parameters", parameters)
        self._keep("parameters", parameters.values)
        self._keep("system", parameters.system)

    def _check_forces(self) -> None:
        """Validate the forces, and build the force model if there are any."""
        if not isinstance(self.springs, Mapping):
            raise InputError(
                f"springs must be {{joint: (stiffness, rest)}}, got {brief(self.springs)}"
            )
        if not isinstance(self.prescribed, Mapping):
            raise InputError(
                "prescribed must be {joint: Signal, number or formula}, "
                f"got {brief(self.prescribed)}"
            )
        forces = list_forces(self.forces)
        passive, friction = check_passive(self.passive, self.friction)
        self._keep("friction", friction)
        file_forces = acting_passive(self.system, passive=passive, friction=friction)
        prescribed = {
            name: parse_options.parse_signal(value, f"prescribed['{name}']")
            for name, value in self.prescribed.items()
        }
        self._keep("forces", forces)
        self._keep("prescribed", prescribed)
        controls = parse_options.parse_controls(self.controls, self.system)
        self._keep("controls", controls)
        file_forces = (*file_forces, *actuation(self.system, controls))
        watched = self._check_events()
        constant_plans: Mapping[str, Constant | Attitude] = vars(self)["_held_plans"]
        if not (self.springs or forces or file_forces or prescribed or constant_plans):
            self._keep("_forces", None)
            self._check_parameters(watched)
            return
        from ..forces.force_model_cache import (
            cached_force_model,  # Imported here because it needs CasADi.
        )

        acting = (*forces, *file_forces)
        model = cached_force_model(
            self.system, self.springs, acting, {**prescribed, **constant_plans}, self.varied
        )
        self._check_parameters((*model.parameters, *watched))
        model = model.with_values(self.parameters)
        check_span(model, self.end, base=self.outputs == "all")
        self._keep("_forces", model)

    def _check_stops(self) -> None:
        """Validate and store the stops; those of the file may include prescribed joints."""
        from_file = isinstance(self.stops, str)
        stops = parse_stops(self.stops, self.system)
        bounds, driven = bounds_of(self.system, stops), set[int]()
        if self.force_model is not None:
            driven = {*self.force_model.joints}
        for bound in bounds:
            if driven & {*bound.rates} and not from_file:
                raise InputError(
                    f"stops: the motion of joint '{bound.joint}' is prescribed, so a stop cannot "
                    "change it. Omit its stop, or do not prescribe it"
                )
        if not from_file:
            self._keep("stops", MappingProxyType(stops) if stops else None)
        self._keep("_bounds", bounds)

    def _plans_that_hold(self) -> dict[str, Constant | Attitude]:
        """Return the motions of the joints that `hold` keeps at their initial positions.

        Raises:
            InputError: `hold` has another value, or loops determine the other joints.
        """
        if not (self.hold is None or one_of(self.hold, HELD)):
            raise InputError(f"hold must be one of {', '.join(HELD)}, got {brief(self.hold)}")
        if self.hold != "others":
            return {}
        if self.system.loops:
            raise InputError(
                f"hold: the loops of '{self.system.name}' determine some of the other joints; name "
                "the joints to hold in prescribed"
            )
        x = replace(self, hold="free").given.x[0]
        plans: dict[str, Constant | Attitude] = {}
        for joint in self.system.space.joints:
            if joint.name not in self.prescribed:
                value = x[joint.x].tolist()
                is_ball = joint.kind.is_ball
                plans[joint.name] = parse_attitude(value) if is_ball else Constant(value[0])
        return plans

    @property
    def free_joints(self) -> tuple[str, ...]:
        """Joints that move freely beside prescribed ones: nothing prescribes or drives them."""
        model = self.force_model
        if model is None or not self.prescribed:
            return ()
        busy = {*model.joints, *model.touched}
        joints = self.system.space.joints
        return tuple(j.name for j in joints if not busy & {*range(j.v.start, j.v.stop)})

    def _check_events(self) -> Sequence[Parameter]:
        """Validate and store the events; return the Parameters in them."""
        events = list_events(self.events)
        self._keep("events", events)
        watched = watched_of(self.system, events, base=self.outputs == "all")
        self._keep("_watched", watched)
        return () if watched is None else watched.parameters

    def _check_parameters(self, known: Sequence[Parameter]) -> None:
        """Store the parameters as numbers and arrays; raise InputError for an unknown name.

        `known` contains the Parameters in forces and events.
        """
        parameters: GivenParameters = vars(self)["_parameters"]
        self._keep("parameters", MappingProxyType(parameters.checked(by_name(known))))

    def _require_state(self) -> None:
        """Raise InputError if neither the options nor the robot state an initial state."""
        states = ("seed", "keyframe", *SCENE_OPTIONS["seed"].replaces)
        if self.system.initial is None and all(getattr(self, name) is None for name in states):
            raise InputError(
                f"'{self.system.name}' has no default initial state; "
                "pass x0, xdot0, xi0 or momentum, or seed= for a random state"
            )

    def _resolve(self) -> GivenStates:
        """Return the initial state that the options state."""
        system = self.system
        keyframe = None if self.keyframe is None else system.keyframes[self.keyframe]
        if self.pose0 is not None:
            pose = system.group.pose(self.pose0)
        elif keyframe is not None:
            pose = keyframe.pose
        else:
            pose = system.group.neutral
        x, xdot, xi = self._initial_shape(), np.zeros(system.m), np.zeros(system.r)
        if self.q0 is not None:
            configuration = parse_options.parse_configuration(self.q0, system)
            pose, x = configuration.pose, configuration.x
        default: Keyframe | InitialState | None = keyframe
        if all(getattr(self, name) is None for name in ("keyframe", "x0", "xdot0", "q0", "v0")):
            default = system.initial if self.seed is None else random_state(system, self.seed)
            self._require_state()
        if default is not None:
            x, xdot, xi = default.x, default.xdot, default.xi
        if self.v0 is not None:
            velocity = parse_options.parse_velocity(self.v0, system)
            xi, xdot = velocity.xi, velocity.xdot
        rates: Any = self.xdot0
        if rates is not None:
            xdot = vector(rates, system.m, "xdot0", system.shape_names)
        if self.xi0 is not None:
            xi = vector(self.xi0, system.r, "xi0", system.group.twist_names)
        refuse_vague(x, system)
        x, xdot = x[None], xdot[None]
        if self.force_model is not None:
            x, xdot = self.with_prescribed(x, xdot)
        if system.loops:
            closed = self._closed_state(x[0], xdot[0])
            x, xdot = (values[None] for values in closed)
        if self.momentum is None:
            return GivenStates(pose[None], x, xdot, xi[None], None)
        mu = vector_or_zero(self.momentum, system.r, "momentum", system.group.momentum_names)
        return GivenStates(pose[None], x, xdot, None, mu[None])

    def _closed_state(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Return the nearest state that closes all loops, and store it as x0 and xdot0."""
        held_joints: tuple[HeldJoints, HeldJoints] = vars(self)["_held"]
        report = self.q0 is not None, self.v0 is not None
        x, xdot = closed_state(self.system, x, xdot, held_joints, report, self.force_model)
        # A copy of the scene then starts at the same state, although it has no joint names.
        for name, values in (("x0", x), ("xdot0", xdot)):
            if getattr(self, name) is not None:
                self._keep(name, read_only(values))
        return x, xdot

    def _initial_shape(self) -> Array:
        """Return x0 with quaternions of length one; the shape at rest if it is not stated."""
        space = self.system.space
        x0: Any = self.x0
        if x0 is None:
            closure = self.system.closure
            return space.neutral if closure is None else closure.x
        x = vector(x0, space.nx, "x0", space.x_names)
        return space.normalized(x, "x0", near=False) if space.balls else x

    def with_prescribed(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Replace the entries of the prescribed joints by their values at time 0.

        Args:
            x: Initial shapes, (N, nx) [rad | m | 1].
            xdot: Initial shape rates, (N, m) [rad/s | m/s].
        Returns:
            Shapes, (N, nx), and rates, (N, m).
        """
        model = self.force_model
        if model is None or not model.joints:
            return x, xdot
        x, xdot, joints = x.copy(), xdot.copy(), list(model.joints)
        motion = model.prescribed(0.0, model.numbers_from(0.0, self.end))
        x[:, self.system.space.coordinates_of_joints(joints)] = motion.x
        xdot[:, joints] = motion.xdot
        return x, xdot


Scene.__doc__ = (Scene.__doc__ or "").replace(
    "    Raises:", f"{describe_fields(SCENE_OPTIONS)}\n\n    Raises:"
)


def _scene_of(options: dict[str, Any]) -> Scene:
    """Rebuild a pickled scene."""
    return Scene(**options)


def _controls(controls: Any) -> list[tuple[str, str]]:
    """Return a row for each control, or for the controller of all actuators."""
    if isinstance(controls, Controller):
        return [("controls", repr(controls.name))]
    return [(f"control {name}", repr(control)) for name, control in controls.items()]


def _stops(stops: Any) -> list[tuple[str, str]]:
    """Return a row for each joint with stops, or one for those of the file."""
    if isinstance(stops, str):
        return [("stops", repr(stops))]
    return [(f"stops {name}", repr(stop)) for name, stop in (stops or {}).items()]


def scene_card(scene: Any) -> str:
    """Return the initial state, the forces and the settings of a Scene as HTML."""
    system, start = scene.system, scene.start
    joints = [
        (joint.name, numbers(start.x[joint.x]), numbers(start.xdot[joint.v]))
        if joint.kind.is_ball
        else (joint.name, float(start.x[joint.x][0]), float(start.xdot[joint.v][0]))
        for joint in system.space.joints
    ]
    forces: tuple[Force, ...] = vars(scene)["forces"]
    acting = [
        *((f"spring {name}", str(spring)) for name, spring in scene.springs.items()),
        *((force.label, repr(force)) for force in forces),
        *((f"{force.label}, of the file", repr(force)) for force in scene.own_forces),
        *_controls(scene.controls),
        *((f"prescribed {name}", repr(plan)) for name, plan in scene.prescribed.items()),
        *_stops(scene.stops),
        *([("hold", scene.hold)] if scene.hold else []),
    ]
    method = scene.integrator or scene.method
    return card(
        f"Scene of {system.name}",
        f"{scene.end:g} s, {len(scene.report_times)} times, rtol {scene.rtol:g}, "
        f"atol {scene.atol:g}, {method}, outputs '{scene.outputs}'",
        table("start", ["joint", "x", "rate"], joints),
        line(f"twist of the base: {numbers(start.xi)}"),
        line(f"pose of the base: {numbers(start.pose)}"),
        table("acting", ["", ""], acting),
    )


_STATES = frozenset(ARRAYS_OF_STATE)
# Types of values of the initial state, which each scene checks.
_CHECKED = frozenset({np.ndarray, list, tuple, float, int})


class _Repeated:
    """The checked options of a scene, without its initial state."""

    def __init__(self, scene: Scene, options: Mapping[str, Any]) -> None:
        """Store the validated options of `scene`, which was built from `options`."""
        self.states = [name for name in options if name in _STATES]
        self.others = [name for name in options if name not in _STATES]
        stated = {*self.states, "_given", "_once", "start"}
        self.checked = {name: v for name, v in vars(scene).items() if name not in stated}
        # Validation returns these options unchanged, so each scene uses its own.
        self.kept = [n for n in self.others if n not in scene.shared.options]

    def with_state(self, options: Mapping[str, Any]) -> Scene:
        """Build a scene from options with the same key as those of the earlier scene."""
        scene = object.__new__(Scene)
        values = vars(scene)
        values.update(self.checked)
        for name in self.states:
            values[name] = options[name]
        for name in self.kept:
            values[name] = options[name]
        if "forces" in self.others:
            values["forces"] = list_forces(options["forces"])
        values["prescribed"] = dict(values["prescribed"])
        values["controls"] = dict(values["controls"])
        if "springs" not in self.others:
            values["springs"] = {}
        scene.resolve_state()
        return scene


def scene_of(system: System, options: Mapping[str, Any]) -> Scene:
    """Return Scene(system=system, **options), faster if only the initial state is new.

    Args:
        system: The system.
        options: Fields of Scene.
    Returns:
        The scene.
    Raises:
        InputError: An option is not valid, or the options contradict each other.
        ShapeError: An array has the wrong shape.
    """
    key = _key_of_call(options)
    if key is None:
        return Scene(system=system, **options)
    first: Scene | None = None

    def make() -> _Repeated:
        nonlocal first
        first = Scene(system=system, **options)
        return _Repeated(first, options)

    repeated = recent(system, key, make, MOST_STRUCTURES, _Repeated)
    return repeated.with_state(options) if first is None else first


def _key_of_call(options: Mapping[str, Any]) -> Hashable:
    """Return the key of a call; None if the initial state does not consist of arrays and lists."""
    try:
        key = tuple(
            [
                (name, (name in _STATES and type(value) in _CHECKED) or _key_of(name, value))
                for name, value in options.items()
            ]
        )
        hash(key)
    except (NotKeyedError, TypeError):
        return None  # Scene reports an invalid option.
    return key


def _key_of(name: str, value: Any) -> Hashable:
    if name in _STATES:
        if value is None:
            return False
        raise NotKeyedError
    if name == "seed" and value is not None:
        raise NotKeyedError  # The state is drawn for each scene.
    if name == "parameters" and not is_empty_table(value):
        raise NotKeyedError  # Robot parameters replace the system.
    if name == "hold" and value == "others":
        raise NotKeyedError  # The initial state is that of the joints that are held.
    return key_of_option(value)
