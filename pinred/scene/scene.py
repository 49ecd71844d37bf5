"""Scene: a frozen description of what to simulate, and the initial state it resolves to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, dimensions, positive, read_only, vector
from ..common.defaults import Default, is_given
from ..common.errors import InputError
from ..common.plain_names import brief, one_of
from ..forces.force import Force
from ..forces.signals import Signal
from ..integrators.methods import Method
from ..system.model_parameters import ModelParameters
from ..system.system import System, checked_system
from ..system.variants import nominal
from . import forms
from .angles import refuse_vague
from .checked import checked_keyframe, checked_seed, listed_forces
from .controls import check_span
from .event import Event, checked_events, watched_of
from .initial_state import GivenStates, Start, start_of
from .parameters import GivenParameters, given_parameters
from .passive import acting_passive, checked_passive, passive_left_out
from .random_state import random_state
from .report_times import EVEN_TIMES as EVEN_TIMES
from .report_times import report_times
from .tolerances import check_tolerances, with_tolerances

if TYPE_CHECKING:
    from ..common.parameter import Parameter
    from ..forces.force_model import ForceModel
    from ..forces.watched import Watched

Engine: TypeAlias = Literal["compiled", "pinocchio"]
WantedOutputs: TypeAlias = Literal["all", "shape"]
ENGINES: tuple[Engine, ...] = get_args(Engine)
OUTPUTS: tuple[WantedOutputs, ...] = get_args(WantedOutputs)
TIGHTEST = 1e-14  # relative tolerance; below it round-off decides the step
# Momenta are integrated, and rates are wanted: where a light joint sits beside heavy ones, a
# small part of a large momentum is a ten times larger part of the light joint's rate.
MOMENTUM_MARGIN = 10.0
_STATE = ("x0", "xdot0", "xi0", "momentum", "q0", "v0")
_STAND_FOR = {  # an option: what it is, and those that it stands for
    "seed": ("a whole random state", _STATE),
    "keyframe": ("a whole state", (*_STATE, "seed")),
    "q0": ("shape and pose", ("x0", "pose0")),
    "v0": ("shape rate and body twist", ("xdot0", "xi0", "momentum")),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A system, its initial state, and how long and how accurately to follow it.

    x0, xdot0: shape and rate, (m,) or {joint: value} with zero for the others; if only one is
    given, the other is zero; if neither, they are those the robot comes with.  Either xi0, (r,)
    body twist of the base, or momentum, (r,) body momentum μ (or just 0); if neither, the
    robot's own with its own shape, else zero twist.  seed: a generic random state instead of
    all these.  keyframe: the name of a state in the robot's file (System.keyframes), with its
    pose, instead.  pose0: pose of the base (identity).  q0: Pinocchio's configuration, (nq,),
    instead of x0 and pose0, with angles in (−π, π].  v0: its velocity, (n,), instead of xdot0,
    xi0 and momentum.
    duration: s; else up to the last of `times`, else what the robot comes with, else 2 s.
    times: where to report, increasing (201 even ones).  rtol, atol: local error per step,
    relative and absolute, and what compare judges by.
    springs: {joint: (stiffness [N·m/rad | N/m], rest [rad | m])}, short for forces.Spring.
    forces: what else acts (see pinred.forces).  prescribed: {joint: Signal, number or formula
    in t such as "0.4*sin(t)"}, joints that follow a plan (see pinred.signals); their entries in
    x0 and xdot0 are not read, and torques on them only relieve their drives.
    passive: whether springs and dampers in the robot's file act (System.passive).  friction: the
    rate [rad/s | m/s] within which dry friction in the file turns round, τ = −most·tanh(ẋ/width);
    None leaves it out.
    parameters: {name: value} of Parameters in forces and signals that are to have another, and of
    the robot: by a link or joint "hand.mass", "hand.com", "hand.inertia" (xx, xy, xz, yy, yz, zz
    about the centre), "hand.payload.mass" and "hand.payload.at", a point mass on it, or
    "hand.log_cholesky"; by a joint "elbow.placement" (x, y, z, roll, pitch, yaw), or
    "elbow.translation" of it; of a locked one "elbow.lock"; "gravity" in the world frame, or
    "gravity.strength".  These numbers are inputs of the kernel.  A list of such names, or "all" for
    inertias and placements, makes inputs of them at the values that they have.  What the system
    has of them (System.parameters) stays where nothing else is given.
    events: moments to find (see Event); a terminal one ends the motion, and so the scene of the
    Trajectory.
    outputs: "all", or "shape" to leave out the base.
    method: an integrator of pinred.integrators, or as text: "DOP853", "RKMK4(0.01)".  One with
    step control works to rtol and atol, or to its own tolerances if it has them: not both.
    With one of equal steps, rtol and atol only say what compare judges by.  "auto" takes one
    that suits the scene (simulate(explain=True) says which and why).

    The fields hold arrays for joints by name, Signals for plans, methods for their names.
    Raises InputError or ShapeError when it describes something that cannot be simulated.
    """

    system: System
    x0: ArrayLike | Mapping[str, ArrayLike] | None = None
    xdot0: ArrayLike | Mapping[str, ArrayLike] | None = None
    xi0: ArrayLike | None = None
    momentum: ArrayLike | None = None
    seed: int | None = None
    keyframe: str | None = None
    pose0: Any = None
    q0: ArrayLike | None = None
    v0: ArrayLike | None = None
    duration: float | None = None
    times: ArrayLike | None = None
    rtol: float = Default(1e-10)
    atol: float = Default(1e-12)
    springs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    forces: Sequence[Force] | Force = ()
    prescribed: Mapping[str, Signal | float | str] = field(default_factory=dict)
    passive: bool = False
    friction: float | None = None
    parameters: Any = field(default_factory=dict)  # {name: value}, or names
    events: Sequence[Event] | Event = ()
    outputs: WantedOutputs = "all"
    method: Method | str = "auto"

    def __post_init__(self) -> None:
        checked_system(self.system, "a scene")
        self._vary_robot()
        given = [name for name in _STATE if getattr(self, name) is not None]
        for name, (what, others) in _STAND_FOR.items():
            if getattr(self, name) is None:
                continue
            both = [other for other in others if getattr(self, other) is not None]
            if both:
                raise InputError(f"{name} stands for {what}; do not give {both[0]} with it")
        if self.xi0 is not None and self.momentum is not None:
            raise InputError("give xi0 or momentum, not both: each fixes the other")
        if self.keyframe is not None:
            given.append(checked_keyframe(self.system, self.keyframe))
        if self.seed is None and not given and self.system.initial is None:
            raise InputError(
                f"'{self.system.name}' comes with no initial state; "
                "give x0, xdot0, xi0 or momentum, or seed= for a random one"
            )
        if self.seed is not None:
            checked_seed(self.seed)
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
        method = forms.method(self.method)
        if method != "auto":
            check_tolerances(method, self.rtol, self.atol)
        self._keep("method", method)
        for name in ("x0", "xdot0"):
            self._keep(name, forms.in_order(getattr(self, name), self.system, name))
        if self.duration is not None:
            self._keep("duration", positive(self.duration, "duration"))
        self._keep("_times", read_only(report_times(self.times, self.duration, self.system)))
        self._check_forces()
        self._keep("_given", self._resolve())

    def __reduce__(self) -> tuple[Any, ...]:
        options = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        options |= {"system": nominal(self.system), "parameters": dict(self.parameters)}
        return _scene_of, (options,)

    def _repr_html_(self) -> str:
        from ..common.html import card, line, numbers, table

        system, start = self.system, self.start
        rows = zip(system.shape_names, start.x.tolist(), start.xdot.tolist(), strict=True)
        forces: tuple[Force, ...] = vars(self)["forces"]
        acting = [
            *((f"spring {name}", str(spring)) for name, spring in self.springs.items()),
            *((force.label, repr(force)) for force in forces),
            *((f"{force.label}, of the file", repr(force)) for force in self.own_forces),
            *((f"prescribed {name}", repr(plan)) for name, plan in self.prescribed.items()),
        ]
        method = self.integrator or self.method
        return card(
            f"Scene of {system.name}",
            f"{self.end:g} s, {len(self.report_times)} times, rtol {self.rtol:g}, "
            f"atol {self.atol:g}, {method}, outputs '{self.outputs}'",
            table("start", ["joint", "x", "rate"], rows),
            line(f"twist of the base: {numbers(start.xi)}"),
            line(f"pose of the base: {numbers(start.pose)}"),
            table("acting", ["", ""], acting),
        )

    @cached_property
    def start(self) -> Start:
        """The initial state, complete.  Raises SingularInertiaError or InputError."""
        return start_of(self.system, self.given)

    @property
    def given(self) -> GivenStates:
        """The initial state as it is given, with a leading axis of length one."""
        given: GivenStates = vars(self)["_given"]
        return given

    @property
    def report_times(self) -> Array:
        """The times to report, (T,) [s]."""
        times: Array = vars(self)["_times"]
        return times

    @property
    def tolerance(self) -> tuple[float, float]:
        """The integrator's (rtol, atol): a tenth of those asked for, as it integrates momenta."""
        return self.rtol / MOMENTUM_MARGIN, self.atol / MOMENTUM_MARGIN

    @property
    def integrator(self) -> Method | None:
        """The method asked for, with the tolerances that it works to; None if it is "auto"."""
        method: Method | Literal["auto"] = vars(self)["method"]
        return None if method == "auto" else with_tolerances(method, *self.tolerance)

    @property
    def force_model(self) -> ForceModel | None:
        """The forces besides gravity, and the prescribed joints; None if there are none."""
        model: ForceModel | None = vars(self)["_forces"]
        return model

    @property
    def varied(self) -> ModelParameters | None:
        """The numbers of the robot that are among the parameters; None if there are none."""
        given: GivenParameters = vars(self)["_parameters"]
        return given.varied

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
    def own_forces(self) -> tuple[Force, ...]:
        """What acts of the springs, dampers and friction in the robot's file."""
        return acting_passive(self.system, passive=self.passive, friction=self.friction)

    @property
    def left_out(self) -> str:
        """A sentence on springs, dampers and friction in the file that do not act; or nothing."""
        return passive_left_out(self.system, passive=self.passive, friction=self.friction)

    @property
    def end(self) -> float:
        """The time at which the simulation ends [s]; it starts at 0."""
        if self.duration is not None:
            return float(self.duration)
        return float(self.report_times[-1])

    def _keep(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _vary_robot(self) -> None:
        """Give the robot the numbers among the parameters; the system is then one that has them."""
        given = given_parameters(self.system, self.parameters)
        self._keep("_parameters", given)
        self._keep("parameters", given.values)
        self._keep("system", given.system)

    def _check_forces(self) -> None:
        """Write the forces down, if there are any."""
        if not isinstance(self.springs, Mapping):
            raise InputError(
                f"springs must be {{joint: (stiffness, rest)}}, got {brief(self.springs)}"
            )
        if not isinstance(self.prescribed, Mapping):
            raise InputError(
                "prescribed must be {joint: Signal, number or formula}, "
                f"got {brief(self.prescribed)}"
            )
        forces = listed_forces(self.forces)
        passive, friction = checked_passive(self.passive, self.friction)
        self._keep("friction", friction)
        own = acting_passive(self.system, passive=passive, friction=friction)
        prescribed = {
            name: forms.signal(value, f"prescribed['{name}']")
            for name, value in self.prescribed.items()
        }
        self._keep("forces", forces)
        self._keep("prescribed", prescribed)
        watched = self._check_events()
        if not (self.springs or forces or own or prescribed):
            self._keep("_forces", None)
            self._check_parameters([each.name for each in watched])
            return
        from ..forces.remembered import remembered_model  # needs CasADi

        every = (*forces, *own)
        model = remembered_model(self.system, self.springs, every, prescribed, self.varied)
        self._check_parameters([each.name for each in (*model.parameters, *watched)])
        model = model.with_values(self.parameters)
        check_span(model, self.end, base=self.outputs == "all")
        self._keep("_forces", model)

    def _check_events(self) -> Sequence[Parameter]:
        """Write the events down, if there are any; return the Parameters in them."""
        events = checked_events(self.events)
        self._keep("events", events)
        watched = watched_of(self.system, events, base=self.outputs == "all")
        self._keep("_watched", watched)
        return () if watched is None else watched.parameters

    def _check_parameters(self, known: Sequence[str]) -> None:
        """Keep the parameters as numbers.  Raises InputError for names that nothing has."""
        given: GivenParameters = vars(self)["_parameters"]
        self._keep("parameters", MappingProxyType(given.checked(known)))

    def _resolve(self) -> GivenStates:
        system = self.system
        key = None if self.keyframe is None else system.keyframes[self.keyframe]
        pose = system.group.identity() if key is None else key.pose
        if self.pose0 is not None:
            pose = system.group.pose(self.pose0)
        x = _or_zero(self.x0, system.m, "x0", system.shape_names)
        xdot = _or_zero(self.xdot0, system.m, "xdot0", system.shape_names)
        xi = _or_zero(self.xi0, system.r, "xi0")
        if self.q0 is not None:
            place = forms.configuration(self.q0, system)
            pose, x = place.pose, place.x
        if self.v0 is not None:
            motion = forms.velocity(self.v0, system)
            xi, xdot = motion.xi, motion.xdot
        ready = key or (system.initial if self.seed is None else random_state(system, self.seed))
        own = all(getattr(self, name) is None for name in ("x0", "xdot0", "q0", "v0"))
        if ready is not None and own:
            x, xdot = ready.x, ready.xdot
            xi = ready.xi if self.xi0 is None else xi
        refuse_vague(x, system)
        x, xdot = self.with_prescribed(x[None], xdot[None])
        if self.momentum is None:
            return GivenStates(pose[None], x, xdot, xi[None], None)
        # A plain 0 is short for the zero momentum of any group.
        zero = dimensions(self.momentum) == 0 and self.momentum == 0
        mu = np.zeros(system.r) if zero else vector(self.momentum, system.r, "momentum")
        return GivenStates(pose[None], x, xdot, None, mu[None])

    def with_prescribed(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Return initial shapes and rates (N, m) with those of the prescribed joints in them."""
        model = self.force_model
        if model is None or not model.joints:
            return x, xdot
        x, xdot, joints = x.copy(), xdot.copy(), list(model.joints)
        given = model.prescribed(0.0, model.numbers_from(0.0, self.end))
        x[:, joints], xdot[:, joints] = given.x, given.xdot
        return x, xdot


def _scene_of(options: dict[str, Any]) -> Scene:
    """Return a scene that was pickled."""
    return Scene(**options)


def _or_zero(value: Any, size: int, what: str, labels: Any = ()) -> Array:
    return np.zeros(size) if value is None else vector(value, size, what, labels)
