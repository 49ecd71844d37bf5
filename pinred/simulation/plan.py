"""The plan of a scene: all quantities that can be computed before integration.

A plan is built once for a scene and used everywhere.  It does not determine whether the angular
momentum of the base is zero, because that depends on the initial state, in which the members of one
plan may differ.  `Plan.structure` returns the structure of
the equations in either case.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import SymmetryError
from ..common.memo import once
from ..forces.force_model import ForceModel, touched_by
from ..forces.force_numbers import SpanNumbers
from ..forces.switch_times import ROUND_OFF
from ..integrators.methods import EqualSteps, ErrorControl, Method
from ..kernels.state_layout import Layout, Structure, layout_of
from ..reduction.cyclic_joints import (
    SymmetricBall,
    always_symmetric,
    axial_among,
    cyclic_of,
    rotors_among,
    symmetric_balls_of,
)
from ..reduction.potential import acting_gravity, pivot_weight
from ..reduction.tree.free_bodies import NOTHING, Freed, freed_of
from ..scene.scene import Scene
from ..system.model_parameters import ModelParameters
from ..system.system import System
from .choose_method import Choice, choose
from .step_limits import step_limits

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
        return MemberParameters(*(None if rows is None else rows[members] for rows in columns))


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
class Acting:
    """Properties of a system with its forces, shared by several scenes; arrays are read-only.

    Attributes:
        system: The system.
        forces: Forces besides gravity and prescribed joints; None if there are none.
        weight: Gravity force m g in the root joint's fixed frame if it rotates a pivoted base, else
            zero, (3,) [N].
        gravity: The part of gravity that acts on the shape or rotates the base, in that frame,
            (3,) [m/s²].
        momentum_changes: Whether a force changes the angular momentum of the base.
        cyclic: Indices of the joints whose momentum is constant.
        symmetric_balls: Balls whose momentum about an axis of symmetry is constant.
        driven: Indices of the prescribed joints.
        free: Indices of all other joints.
    """

    system: System
    forces: ForceModel | None
    weight: Array
    gravity: Array
    momentum_changes: bool
    cyclic: tuple[int, ...]
    symmetric_balls: tuple[SymmetricBall, ...]
    driven: tuple[int, ...]
    free: tuple[int, ...]

    @property
    def wrench(self) -> bool:
        """Whether a force acts on the base itself."""
        return self.forces is not None and self.forces.has_wrench

    @property
    def turned(self) -> bool:
        """Whether gravity rotates a pivoted base."""
        return bool(self.weight.any())


@dataclass(frozen=True, eq=False)
class Plan:
    """All quantities of a scene that are computed before integration; arrays are read-only.

    Attributes:
        scene: The scene.
        acting: Properties of the scene's system and forces.
        stops: Times at which integration stops, with the end of the scene as last, (S,) [s].
        numbers: Initial force parameters, (p,).
        longest: Longest step of methods with step control [s].
    """

    scene: Scene
    acting: Acting
    stops: Array
    numbers: Array
    longest: float = np.inf

    @property
    def system(self) -> System:
        """The system of the scene."""
        return self.scene.system

    @property
    def forces(self) -> ForceModel | None:
        """Forces besides gravity and prescribed joints; None if there are none."""
        return self.acting.forces

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
        shared, acting = self.scene.shared, self.acting
        changes = acting.momentum_changes
        make = partial(choose, self.scene, self.stops, acting.cyclic, momentum_changes=changes)
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
    def passes_stops(self) -> bool:
        """Whether there are several stops, without controllers or events between them."""
        return len(self.stops) > 1 and not self.is_observed

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
        acting, varied = self.acting, self.scene.varied
        zero = zero_momentum and not acting.momentum_changes
        # With symplectic methods, a quaternion is integrated to rotate the constant angular
        # momentum into the body frame.
        constant = self.system.group.turns == 3 and not (zero or acting.momentum_changes)
        lifted = self.method.symplectic and constant
        lifted_balls = self.method.symplectic and bool(self.system.space.balls)
        any_gravity = generic and varied is not None and varied.gravity_name() == "gravity"
        freed = self.freed(generic=generic)
        # Lifted balls have conjugate momenta, none of which is constant.
        symmetric = () if lifted_balls or all_momenta else acting.symmetric_balls

        def make() -> Structure:
            axes = tuple(np.flatnonzero(acting.gravity).tolist())
            return Structure(
                zero_momentum=zero,
                cyclic=acting.cyclic,
                rotors=rotors_among(symmetric),
                axial=axial_among(symmetric),
                gravity=(0, 1, 2) if axes and any_gravity else axes,
                base=self.wanted,
                lifted=lifted,
                lifted_balls=lifted_balls,
                freed=freed,
            )

        return once(
            acting,
            (Structure, zero, self.wanted, lifted, lifted_balls, freed, any_gravity, all_momenta),
            make,
        )

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
        rows = slice(first, last)
        spans.append(Span(start, stop, rows, read_only(reports[rows] - start)))
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
        system, forces, varied = scene.system, scene.force_model, scene.varied
        # Scenes of one force model, which belongs to one system, share these properties.
        owner = system if forces is None else forces
        key = (Acting, *(varied.names if varied is not None else ()))
        acting = once(owner, key, lambda: _acting(system, forces, varied))
        numbers = _NONE if forces is None else read_only(forces.numbers_from(0.0, scene.end))
        return Plan(scene, acting, read_only(stops_of(scene)), numbers)

    # The plan refers to its scene, so a scene that kept its plan would not be freed at once.
    first = once(scene.shared, Plan, make)
    if first.scene is scene:
        return first
    plan = object.__new__(Plan)
    vars(plan).update(vars(first), scene=scene)  # all cached properties belong to the structure
    return plan


def _acting(system: System, forces: ForceModel | None, varied: ModelParameters | None) -> Acting:
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
    return Acting(
        system=system,
        forces=forces,
        weight=weight,
        gravity=gravity,
        momentum_changes=bool(weight.any()) or pushed,
        cyclic=cyclic,
        symmetric_balls=balls,
        driven=driven,
        free=tuple(k for k in range(system.m) if k not in driven),
    )
