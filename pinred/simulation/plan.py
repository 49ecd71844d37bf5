"""The plan of a scene: all quantities that can be computed before integration.

A plan is built once for a scene and used everywhere.  It does not determine whether the angular
momentum of the base is zero, because that depends on the initial state, in which the members of one
plan may differ.  `Plan.structure` returns the structure of
the equations in either case.

Members that share a plan form a Group, with the initial states and parameters in which they differ.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError, SymmetryError
from ..common.memo import once
from ..common.names import brief
from ..forces.force_model import ForceModel, touched_by
from ..forces.force_numbers import SpanNumbers, tables_of_runs
from ..forces.switch_times import ROUND_OFF
from ..integrators.methods import (
    DOP853_LEAST,
    AdaptiveGauss,
    EqualSteps,
    ErrorControl,
    Method,
    Radau,
)
from ..kernels.kernel import Layout, Structure, layout_of
from ..reduction.cyclic_joints import (
    SymmetricBall,
    always_symmetric,
    axial_among,
    cyclic_of,
    rotors_among,
    symmetric_balls_of,
)
from ..reduction.potential import acting_gravity, falling, pivot_weight
from ..reduction.tree.free_bodies import NOTHING, Freed, free_numbers, freed_of
from ..scene.initial_state import GivenStates
from ..scene.scene import Scene
from ..system.coordinates import Indices
from ..system.system import System, nominal
from .choose_method import LANES_GAIN, RADAU_GAIN, Choice, choose, radau_gain
from .longest_steps import step_limits

_NONE = read_only(np.empty(0))
# Error of the integrals of functions of time by equal steps that is reported, relative to their
# ranges.
_MISSED = 1e-3


@dataclass(frozen=True)
class MemberParameters:
    """Parameters of each member that replace the plan's; None where the plan's values apply.

    Attributes:
        numbers: Force parameters, (N, p).
        robot: Variable parameters of the bodies, (N, s).
        gravity: The part of gravity that acts on the shape or rotates the base, (N, 3) [m/s²].
        fall: Acceleration of the centre of mass in free fall, (N, k) [m/s²].
        tables: Tables in the forces.
    """

    numbers: Array | None = None
    robot: Array | None = None
    gravity: Array | None = None
    fall: Array | None = None
    tables: SpanNumbers | None = None

    def __getitem__(self, members: Any) -> MemberParameters:
        """Return the parameters of the selected member or members."""
        columns: Any = vars(self).values()
        return MemberParameters(*(None if a is None else a[members] for a in columns))


NO_DIFFERENCES = MemberParameters()


@dataclass(frozen=True)
class Span:
    """The time between two stops.

    Attributes:
        start: Start time [s].
        stop: End time [s].
        rows: Indices of the report times in the span.
        times: These report times, counted from the start of the span, (T,) [s].
    """

    start: float
    stop: float
    rows: slice
    times: Array


@dataclass(frozen=True, eq=False)
class Plan:
    """All quantities of a scene that are computed before integration; arrays are read-only.

    Attributes:
        scene: The scene.
        stops: Times at which integration stops, with the end of the scene as last, (S,) [s].
        numbers: Initial force parameters, (p,).
        weight: Gravity force m g in the root joint's fixed frame if it rotates a pivoted base, else
            zero, (3,) [N].
        gravity: The part of gravity that acts on the shape or rotates the base, in that frame,
            (3,) [m/s²].
        momentum_changes: Whether a force changes the angular momentum of the base.
        cyclic: Indices of the joints whose momentum is constant.
        symmetric_balls: Balls whose momentum about an axis of symmetry is constant.
        driven: Indices of the prescribed joints.
        free: Indices of all other joints.
        longest: Longest step of methods with step control [s].
    """

    scene: Scene
    stops: Array
    numbers: Array
    weight: Array
    gravity: Array
    momentum_changes: bool
    cyclic: tuple[int, ...]
    symmetric_balls: tuple[SymmetricBall, ...]
    driven: tuple[int, ...]
    free: tuple[int, ...]
    longest: float = np.inf

    @property
    def system(self) -> System:
        """The system of the scene."""
        return self.scene.system

    @cached_property
    def forces(self) -> ForceModel | None:
        """Forces besides gravity and prescribed joints; None if there are none."""
        return self.scene.force_model

    @property
    def wrench(self) -> bool:
        """Whether a force acts on the base itself."""
        return self.forces is not None and self.forces.has_wrench

    @property
    def turned(self) -> bool:
        """Whether gravity rotates a pivoted base."""
        return bool(self.weight.any())

    @property
    def wanted(self) -> bool:
        """Whether the scene requests the base."""
        return self.scene.outputs == "all"

    @cached_property
    def spans(self) -> list[Span]:
        """The time spans between stops; a report time at a stop belongs to the span before it."""
        return spans_between(self.stops, self.scene.report_times)

    @cached_property
    def stops_vary(self) -> bool:
        """Whether the stops depend on Parameters, through conditions on time."""
        return self.forces is not None and bool(
            self.forces.slopes[self.forces.switching.used].any()
        )

    def stops_of_runs(self, numbers: Array, tables: SpanNumbers | None = None) -> list[Array]:
        """Return the stops of N runs, (S,) each [s].

        Args:
            numbers: Force parameters, (N, p).
            tables: Tables of the runs; None for those of the plan.
        Returns:
            The stops; the last one of each run is the end of the scene.
        Raises:
            InputError: There are too many stops, or a condition on time cannot be decided.
        """
        if self.forces is None or not self.stops_vary:
            return [self.stops] * len(numbers)
        end = self.scene.end
        times = self.forces.switching.find(end, numbers, tables)
        run = np.concatenate([times.run, np.arange(len(numbers))])
        time = np.concatenate([times.time, np.full(len(numbers), end)])
        order = np.lexsort((time, run))
        run, time = run[order], time[order]
        distinct = np.append((np.diff(time) > ROUND_OFF * end) | (np.diff(run) > 0), True)
        run, time = run[distinct], read_only(time[distinct])
        return np.split(time, np.flatnonzero(np.diff(run)) + 1)

    @cached_property
    def choice(self) -> Choice:
        """The method of the compiled engine, with the reason for it."""
        shared, changes = self.scene.shared, self.momentum_changes
        make = partial(choose, self.scene, self.stops, self.cyclic, momentum_changes=changes)
        is_first = self.stops is vars(once(shared, Plan, lambda: self))["stops"]
        return once(shared, Choice, make) if is_first else make()

    @cached_property
    def method(self) -> Method:
        """The method of the compiled engine."""
        method = self.choice.method
        if isinstance(method, ErrorControl) and self.longest < method.max_step:
            return replace(method, max_step=self.longest)
        return method

    @cached_property
    def method_name(self) -> str:
        """Name of the method."""
        return self.method.name

    @cached_property
    def divisions(self) -> int:
        """Number of parts into which a step is divided for its users.

        Balances fit polynomials of degree 7 between knots, so steps of eight stages are split.
        """
        method = self.method
        return max(1, method.order // 4) if method.lanes > 1 else 1

    def limited(self, longest: float, stops: Array) -> Plan:
        """Return a plan with a longest step [s] and further stops, (U,) [s]."""
        return replace(self, longest=longest, stops=joined_stops(self.stops, stops))

    @cached_property
    def is_observed(self) -> bool:
        """Whether controllers or events observe the run."""
        return bool(self.scene.events_given or (self.forces is not None and self.forces.held))

    @cached_property
    def has_time_functions(self) -> bool:
        """Whether forces contain functions of time."""
        forces = self.forces
        return forces is not None and forces.needs_time and forces.time_functions.count > 0

    @cached_property
    def notices(self) -> tuple[str, ...]:
        """Sentences on errors that the method does not control; empty if there are none."""
        forces, method = self.forces, self.scene.integrator  # "auto" avoids such methods
        notices = self.notices_of_equal_steps(self.numbers)
        if forces is None or method is None or not (method.needs_smooth and forces.has_kinks):
            return notices
        return (
            f"method: {method.name} loses its order where a force of '{self.system.name}' has a "
            "kink (abs, sign, limits, conditions on the state), so errors exceed the tolerance "
            "there. Use DOP853, or smooth forces",
            *notices,
        )

    def notices_of_equal_steps(
        self, numbers: Array, tables: SpanNumbers | None = None
    ) -> tuple[str, ...]:
        """Return sentences on functions of time that steps of equal length miss, if any.

        Args:
            numbers: Force parameters, (p,).
            tables: Tables of the run; None for those of the plan.
        Returns:
            One sentence, or none.
        """
        method, forces = self.scene.integrator, self.forces
        if not isinstance(method, EqualSteps) or forces is None or not self.has_time_functions:
            return ()
        arguments = forces, self.scene.end, numbers, _MISSED, method.order
        limits = step_limits(*arguments, tables)
        error = limits.error_of_equal_steps(method.step, method.order)
        if error <= _MISSED:
            return ()
        return (
            f"method: steps of {method.step:g} s with {method.name} integrate a function of time "
            f"of '{self.system.name}' with an error of about {error:.0e} of its range. Use shorter "
            "steps, or a method with step control",
        )

    def structure(
        self, *, zero_momentum: bool, generic: bool = False, all_momenta: bool = False
    ) -> Structure:
        """Return the structure of the equations with or without angular momentum, cached.

        Args:
            zero_momentum: Whether the initial angular momentum of the base is exactly zero.
            generic: Whether variable parameters of the robot may take any value.
            all_momenta: Whether constant momenta of symmetric balls are integrated, too.
        Returns:
            The structure.
        """
        varied = self.scene.varied
        zero = zero_momentum and not self.momentum_changes
        # With symplectic methods, a quaternion is integrated to rotate the constant angular
        # momentum into the body frame.
        constant = self.system.group.turns == 3 and not (zero or self.momentum_changes)
        lifted = self.method.symplectic and constant
        lifted_balls = self.method.symplectic and bool(self.system.space.balls)
        any_gravity = generic and varied is not None and varied.gravity_name() == "gravity"
        variables = self.freed(generic=generic)
        # Lifted balls have conjugate momenta, none of which is constant.
        symmetric = () if lifted_balls or all_momenta else self.symmetric_balls

        def make() -> Structure:
            axes = tuple(np.flatnonzero(self.gravity).tolist())
            return Structure(
                zero_momentum=zero,
                cyclic=self.cyclic,
                rotors=rotors_among(symmetric),
                axial=axial_among(symmetric),
                gravity=(0, 1, 2) if axes and any_gravity else axes,
                base=self.wanted,
                lifted=lifted,
                lifted_balls=lifted_balls,
                freed=variables,
            )

        key = zero, self.wanted, lifted, lifted_balls, variables, any_gravity, all_momenta
        return once(*_owner(self.scene, Structure, *key), make)

    def layout(self, *, zero_momentum: bool, generic: bool = False) -> Layout:
        """Return the indices of integrated variables and of parameters, cached; see `structure`."""
        structure = self.structure(zero_momentum=zero_momentum, generic=generic)
        return once(structure, Layout, lambda: layout_of(self.system, structure, self.forces))

    def freed(self, *, generic: bool = False) -> Freed:
        """Return the parameters of the robot that are inputs of the kernel; see `structure`."""
        varied, forces = self.scene.varied, self.forces
        if varied is None:
            return NOTHING
        links = () if forces is None else forces.freed.links
        bodies = varied.free, varied.placed, varied.turned
        return freed_of(self.system, *bodies, links, generic=generic)


def refuse_with_stops(plan: Plan, *, checkpoint: bool) -> None:
    """Reject options of a simulation that do not act together with joint stops.

    Args:
        plan: The plan of a scene; one without stops passes.
        checkpoint: Whether a checkpoint is written.
    Raises:
        InputError: An option does not act together with stops; the message has the remedy.
    """
    if not plan.scene.bounds:
        return
    method = plan.method
    if not isinstance(method, ErrorControl) or method.symplectic:
        raise InputError(
            f"stops: expected none with method {method.name}, whose steps do not end at impacts. "
            "Use DOP853, Tsit5, Radau or auto, or omit stops"
        )
    if checkpoint and plan.forces is not None and plan.forces.held:
        raise InputError(
            "checkpoint: expected no controllers in a scene with stops, because the impacts are "
            "repeated from the start. Omit checkpoint, or use forces instead of controllers"
        )


def spans_between(stops: Array, reports: Array) -> list[Span]:
    """Return the spans between stops; a report time at a stop belongs to the span before it.

    Args:
        stops: Sorted times at which integration stops, (S,) [s].
        reports: Sorted report times, (T,) [s].
    Returns:
        The spans.
    """
    spans, first, start = [], 0, 0.0
    for stop in stops.tolist():
        last = int(np.searchsorted(reports, stop, side="right"))
        indices = slice(first, last)
        spans.append(Span(start, stop, indices, read_only(reports[indices] - start)))
        first, start = last, stop
    return spans


def joined_stops(stops: Array, times: Array) -> Array:
    """Return the union of stops, (S,) with the end as last, and times, (U,); read-only [s]."""
    if not times.size:
        return stops
    union = np.union1d(stops, times)
    distinct = np.append(np.diff(union) > ROUND_OFF * stops[-1], True)
    return read_only(union[distinct])


def stops_of(scene: Scene) -> Array:
    """Return the times at which integration stops, (S,) [s]; the last one ends the scene."""
    forces, end = scene.force_model, scene.end
    if forces is None:
        return np.array([end])
    times = [forces.breaks(end), np.array([end])]
    for controller, _ in forces.held:
        times.append(controller.period * np.arange(1, int(end / controller.period) + 1))
    stops = np.unique(np.concatenate(times))
    stops = stops[stops <= end]
    # Merge times that differ by round-off, but keep the end of the scene.
    distinct = np.append(np.diff(stops) > ROUND_OFF * end, True)
    return np.asarray(stops[distinct])


def plan_of(scene: Scene) -> Plan:
    """Return the plan of a scene; its numbers are computed once for scenes of one structure.

    Args:
        scene: The scene.
    Returns:
        The plan.
    Raises:
        SymmetryError: Gravity breaks the symmetry.
    """

    def make() -> Plan:
        forces = scene.force_model
        symmetries = once(*_owner(scene, _find_symmetries), lambda: _find_symmetries(scene))
        numbers = _NONE if forces is None else read_only(forces.numbers_from(0.0, scene.end))
        return Plan(scene, read_only(stops_of(scene)), numbers, **symmetries)

    # The plan refers to its scene, so a scene that kept its plan would not be freed at once.
    first = once(scene.shared, Plan, make)
    if first.scene is scene:
        return first
    plan = object.__new__(Plan)
    vars(plan).update(vars(first), scene=scene)  # all cached properties belong to the structure
    return plan


def _owner(scene: Scene, *key: Hashable) -> tuple[object, Hashable]:
    """Return the owner of what scenes with one force model and variable parameters share; a key."""
    # A force model belongs to one system.
    owner = scene.system if scene.force_model is None else scene.force_model
    return owner, (*key, None if scene.varied is None else scene.varied.names)


def _find_symmetries(scene: Scene) -> dict[str, Any]:
    """Return the fields of a plan that follow from the system, its forces and its parameters."""
    system, forces, varied = scene.system, scene.force_model, scene.varied
    weight, gravity = pivot_weight(system), acting_gravity(system)
    weighed = forces is not None and forces.weighed
    driven = forces.joints if forces is not None else ()
    pushed = forces is not None and forces.has_wrench
    touched = touched_by(forces)
    cyclic = cyclic_of(system, touched, pushed=pushed)
    balls = symmetric_balls_of(system, touched)
    if varied is not None:
        # Symmetries and balanced pivots must remain for all values of variable parameters.
        perturbed_system = varied.system(varied.perturbed(np.random.default_rng(0)))
        if not weight.any() and pivot_weight(perturbed_system).any():
            gravity = system.model.jointPlacements[1].rotation.T @ system.gravity
            weight = system.mass * gravity
        always = cyclic_of(perturbed_system, touched, pushed=pushed)
        cyclic = tuple(k for k in cyclic if k in always)
        balls = always_symmetric(balls, symmetric_balls_of(perturbed_system, touched))
    if weighed and weight.any():
        raise SymmetryError(
            f"gravity rotates the base of '{system.name}', so its accelerations depend on more "
            "than shape and momentum; use PD control, or gravity=(0, 0, 0)"
        )
    return {
        "weight": weight,
        "gravity": gravity,
        "momentum_changes": bool(weight.any()) or pushed,
        "cyclic": cyclic,
        "symmetric_balls": balls,
        "driven": driven,
        "free": tuple(k for k in range(system.m) if k not in driven),
    }


@dataclass(frozen=True)
class Group:
    """Members that share a plan.

    Attributes:
        members: Sorted indices of the members, (N,).
        plan: Plan that the members share.
        given: Initial states of the members, (N, …).
        own: Parameters in which the members differ from the plan.
    """

    members: Indices
    plan: Plan
    given: GivenStates
    own: MemberParameters = NO_DIFFERENCES

    @property
    def one_by_one(self) -> str:
        """The reason to simulate these members one by one; "" if they can run together."""
        plan = self.plan
        if plan.scene.events_given:
            return "events are detected"
        if plan.scene.bounds:
            return "joints come to rest at their stops at different times"
        if plan.forces is not None and plan.forces.held:
            controller, _ = plan.forces.held[0]
            return f"{controller.name} is called every {controller.period:g} s"
        if (len(plan.stops) > 1 or plan.stops_vary) and plan.driven:
            return f"a plan of a joint is not smooth at t = {plan.stops[0]:g} s"
        return ""


@dataclass(frozen=True)
class Members:
    """All members of a call of simulate_many.

    Attributes:
        count: Number of members.
        groups: Groups of members that share a plan.
        scene_of: Function that returns the scene of a member, given its index.
    """

    count: int
    groups: Sequence[Group]
    scene_of: Callable[[int], Scene]


def members_plan(scene: Scene) -> Plan:
    """Return the plan of a scene for the integration of many members.

    If the scene does not select a method, DOP853 replaces AdaptiveGauss, and Radau unless DOP853
    costs more even in lanes.  DOP853 integrates one member in each SIMD lane, but AdaptiveGauss
    uses the lanes for its stages, and Radau does not use them.  Members with stops do not run in
    lanes, so they have the method of `simulate`.
    """
    plan = plan_of(scene)
    if scene.method != "auto" or scene.tolerance[0] < DOP853_LEAST or scene.bounds:
        return plan
    in_lanes = isinstance(plan.method, AdaptiveGauss)
    if isinstance(plan.method, Radau):
        in_lanes = radau_gain(scene) < LANES_GAIN * RADAU_GAIN
    return plan_of(replace(scene, method="DOP853")) if in_lanes else plan


def of_scenes(scenes: Sequence[Scene]) -> Members:
    """Return members given as scenes of one system with equal report times.

    Args:
        scenes: The scenes.
    Returns:
        The members.
    Raises:
        InputError: An entry is not a Scene, or the scenes differ in system or report times.
    """
    for k, scene in enumerate(scenes):
        if not isinstance(scene, Scene):
            raise InputError(
                f"simulate_many takes Scenes in a list, but entry {k} is {brief(scene)}"
            )
    first = scenes[0]
    plans = [members_plan(scene) for scene in scenes]
    sets: dict[Hashable, list[int]] = {}
    for k, (scene, plan) in enumerate(zip(scenes, plans, strict=True)):
        if nominal(scene.system) is not nominal(first.system):
            raise InputError(
                f"the Scenes of simulate_many must be of one System, but that of entry {k} is "
                "another; load a robot once and use it in all"
            )
        if not (scene.end == first.end and np.array_equal(scene.report_times, first.report_times)):
            raise InputError(
                f"the Scenes of simulate_many must report at the same times, but entry {k} goes to "
                f"{scene.end:g} s with {len(scene.report_times)} reports, entry 0 to "
                f"{first.end:g} s with {len(first.report_times)}; give them times="
            )
        if scene.outputs != first.outputs:
            raise InputError(
                f"the Scenes of simulate_many must have the same outputs, but entry {k} has "
                f"'{scene.outputs}', entry 0 '{first.outputs}'"
            )
        sets.setdefault(_structure(plan), []).append(k)
    groups = [_group(np.array(indices), [plans[k] for k in indices]) for indices in sets.values()]
    return Members(len(scenes), groups, [plan.scene for plan in plans].__getitem__)


def _structure(plan: Plan) -> Hashable:
    """Return a key that is equal for scenes that share a kernel, a method and stops."""
    forces, states = plan.forces, plan.scene.given
    varied = plan.scene.varied
    robot = None if varied is None else (varied.names, plan.gravity.astype(bool).tobytes())
    stops = plan.stops
    if plan.stops_vary and forces is not None:  # members stop at their own switches
        stops = forces.tables.breaks
    stop_key: Hashable = (stops.tobytes(), robot)
    if forces is not None and forces.held:
        stop_key = id(plan)  # Controllers have states, so each member has its own.
    # Members with events or joint stops are simulated one by one.
    alone = bool(plan.scene.events_given), bool(plan.scene.bounds)
    return None if forces is None else forces.key, plan.method, stop_key, states.mu is None, alone


def _group(members: Indices, plans: Sequence[Plan]) -> Group:
    columns: dict[str, Any] = {
        name: None
        if values is None
        else np.concatenate([getattr(p.scene.given, name) for p in plans])
        for name, values in vars(plans[0].scene.given).items()
    }
    parameters = MemberParameters(numbers=np.array([plan.numbers for plan in plans]))
    if plans[0].forces is not None:
        tables = [plan.forces.tables for plan in plans if plan.forces is not None]
        parameters = replace(parameters, tables=tables_of_runs(tables))
    varied = plans[0].scene.varied
    if varied is not None:
        variables = plans[0].freed(generic=True)
        parameters = replace(
            parameters, robot=np.array([free_numbers(p.system, variables) for p in plans])
        )
        if varied.gravity:
            acting = np.array([plan.gravity for plan in plans])
            fall = np.array([falling(plan.system) for plan in plans])
            parameters = replace(parameters, gravity=acting, fall=fall)
    return Group(members, plans[0], GivenStates(**columns), parameters)
