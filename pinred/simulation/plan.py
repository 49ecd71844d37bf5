"""The plan of a scene: everything that follows from it before anything is integrated.

It is made once, and everybody takes it: both routes, `simulate_many`, the balances, and what
is told of a scene.  The one thing it leaves open is whether the angular momentum of the base
is zero, which depends on the initial state: `kind` has both answers, for of many members some
may have momentum and others none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import SymmetryError
from ..common.memo import once
from ..forces.force_model import ForceModel, touched_by
from ..integrators.methods import Method
from ..kernels.kernel import Layout, Structure, layout_of
from ..reduction.cyclic_joints import cyclic_of
from ..reduction.potential import acting_gravity, pivot_weight
from ..reduction.tree.free_bodies import NOTHING, Freed, freed_of
from ..scene.scene import Scene
from ..system.model_parameters import ModelParameters
from ..system.system import System
from .choose_method import Choice, choose

_NONE = read_only(np.empty(0))


@dataclass(frozen=True, eq=False)
class Kind:
    """The terms of a plan with angular momentum of the base, or without any.

    structure: which terms there are.
    """

    system: System
    forces: ForceModel | None
    structure: Structure

    @cached_property
    def layout(self) -> Layout:
        """Numbers that are integrated, and where they stand; made when first looked at."""
        return layout_of(self.system, self.structure, self.forces)


@dataclass(frozen=True)
class MemberParameters:
    """Parameters in which members differ from their plan; None for those of the plan.

    Attributes:
        numbers: Force parameters, (N, p).
        robot: Variable parameters of the bodies, (N, s).
        gravity: The part of gravity that acts on the shape or turns the base, (N, 3) [m/s²].
        fall: Acceleration of the centre of mass in free fall, (N, k) [m/s²].
    """

    numbers: Array | None = None
    robot: Array | None = None
    gravity: Array | None = None
    fall: Array | None = None

    def __getitem__(self, members: Any) -> MemberParameters:
        """Return the parameters of one or some of the members."""
        columns = vars(self).values()
        return MemberParameters(*(None if rows is None else rows[members] for rows in columns))


NO_DIFFERENCES = MemberParameters()


@dataclass(frozen=True)
class Span:
    """The time between two stops.

    Attributes:
        start: Start time [s].
        stop: End time [s].
        rows: Indices of the report times that belong to it.
        times: These report times from its start on, (T,) [s].
    """

    start: float
    stop: float
    rows: slice
    times: Array


@dataclass(frozen=True, eq=False)
class Acting:
    """What a system and the forces on it say of every scene with both; arrays are read-only.

    forces: all that acts besides gravity, and the prescribed joints; None if there is nothing.
    weight: (3,) m g in the root joint's fixed frame where it turns a pivoted base, else zero
    [N].  gravity: (3,) what of it acts on the shape or turns the base, in that frame [m/s²].
    momentum_changes: whether something acts on the angular momentum of the base.
    cyclic, driven, free: indices of the joints whose momentum is constant, of those that are
    prescribed, and of all others than these last.
    """

    system: System
    forces: ForceModel | None
    weight: Array
    gravity: Array
    momentum_changes: bool
    cyclic: tuple[int, ...]
    driven: tuple[int, ...]
    free: tuple[int, ...]

    @property
    def wrench(self) -> bool:
        """Whether a force acts on the base itself."""
        return self.forces is not None and self.forces.has_wrench

    @property
    def turned(self) -> bool:
        """Whether gravity turns a pivoted base."""
        return bool(self.weight.any())

    def kind(
        self, *, zero_momentum: bool, base: bool, symplectic: bool, freed: Freed, every: bool
    ) -> Kind:
        """Return the terms there are, made once.

        zero_momentum: whether the angular momentum is exactly zero.  base: whether somebody asks
        for the base.  symplectic: whether the integrator is.  freed: numbers of bodies that vary.
        every: whether gravity may come to act along any axis.
        """
        zero = zero_momentum and not self.momentum_changes
        # A constant angular momentum that turns in the body is a quaternion to symplectic methods.
        constant = self.system.group.turns == 3 and not (zero or self.momentum_changes)
        lifted = symplectic and constant
        key = (zero, base, lifted, freed, every)
        return once(self, key, lambda: self._kind(*key))

    def _kind(self, zero: bool, base: bool, lifted: bool, freed: Freed, every: bool) -> Kind:
        acts = self.gravity.any()
        axes = (0, 1, 2) if every and acts else tuple(np.flatnonzero(self.gravity).tolist())
        structure = Structure(
            zero_momentum=zero,
            cyclic=self.cyclic,
            gravity=axes,
            base=base,
            lifted=lifted,
            freed=freed,
        )
        return Kind(self.system, self.forces, structure)


@dataclass(frozen=True, eq=False)
class Plan:
    """All that follows from a scene before it is integrated; arrays are read-only.

    acting: what it shares with other scenes.  stops: (S,) times at which integration stops, the
    end last [s].  numbers: (p,) those in the forces at the start.
    """

    scene: Scene
    acting: Acting
    stops: Array
    numbers: Array

    @property
    def system(self) -> System:
        """The system of the scene."""
        return self.scene.system

    @property
    def forces(self) -> ForceModel | None:
        """All that acts besides gravity, and the prescribed joints; None if there is nothing."""
        return self.acting.forces

    @property
    def wanted(self) -> bool:
        """Whether somebody asks for the base."""
        return self.scene.outputs == "all"

    @cached_property
    def spans(self) -> list[Span]:
        """The times between stops; a report time at a stop belongs to the span that ends there."""
        reports, spans, first, start = self.scene.report_times, [], 0, 0.0
        for stop in self.stops.tolist():
            last = int(np.searchsorted(reports, stop, side="right"))
            rows = slice(first, last)
            spans.append(Span(start, stop, rows, read_only(reports[rows] - start)))
            first, start = last, stop
        return spans

    @cached_property
    def choice(self) -> Choice:
        """The integrator of the compiled route, and why it is this one."""
        return choose(self.scene, self.stops)

    @property
    def method(self) -> Method:
        """The integrator of the compiled route."""
        return self.choice.method

    def kind(self, *, zero_momentum: bool, generic: bool = False) -> Kind:
        """Return the terms there are if the angular momentum is exactly zero, or if it is not.

        generic: whether numbers of the robot that vary may become any.
        """
        varied = self.scene.varied
        return self.acting.kind(
            zero_momentum=zero_momentum,
            base=self.wanted,
            symplectic=self.method.symplectic,
            freed=self.freed(generic=generic),
            every=generic and varied is not None and varied.gravity_name() == "gravity",
        )

    def freed(self, *, generic: bool = False) -> Freed:
        """Return the numbers of the robot that are inputs of the kernel; see `kind`."""
        varied, forces = self.scene.varied, self.forces
        if varied is None:
            return NOTHING
        links = () if forces is None else forces.freed.links
        bodies = varied.free, varied.placed, varied.turned
        return freed_of(self.system, *bodies, links, generic=generic)


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
    # Times that differ by round-off are one stop, and the end has to remain.
    distinct = np.append(np.diff(stops) > 1e-12 * end, True)
    return np.asarray(stops[distinct])


def plan_of(scene: Scene) -> Plan:
    """Return the plan of a scene, made once.

    Raises SymmetryError if gravity breaks the symmetry.
    """
    return once(scene, Plan, lambda: _plan(scene))


def _plan(scene: Scene) -> Plan:
    system, forces = scene.system, scene.force_model
    # A force model belongs to one system.
    varied = scene.varied
    key = (Acting, *(varied.names if varied is not None else ()))
    owner = system if forces is None else forces
    acting = once(owner, key, lambda: _acting(system, forces, varied))
    numbers = _NONE if forces is None else read_only(forces.numbers_from(0.0, scene.end))
    return Plan(scene, acting, read_only(stops_of(scene)), numbers)


def _acting(system: System, forces: ForceModel | None, varied: ModelParameters | None) -> Acting:
    weight, gravity = pivot_weight(system), acting_gravity(system)
    weighed = forces is not None and forces.weighed
    driven = forces.joints if forces is not None else ()
    pushed = forces is not None and forces.has_wrench
    cyclic = cyclic_of(system, touched_by(forces), pushed=pushed)
    if varied is not None:  # a joint that another value would not leave cyclic is none
        other = varied.system(varied.perturbed(np.random.default_rng(0)))
        if not weight.any() and pivot_weight(other).any():  # nor a base that others would turn
            gravity = system.model.jointPlacements[1].rotation.T @ system.gravity
            weight = system.mass * gravity
        always = cyclic_of(other, touched_by(forces), pushed=pushed)
        cyclic = tuple(k for k in cyclic if k in always)
    if weighed and weight.any():
        raise SymmetryError(
            f"gravity turns the base of '{system.name}', so that its accelerations do not follow "
            "from shape and momentum alone; use PD control, or gravity=(0, 0, 0)"
        )
    return Acting(
        system=system,
        forces=forces,
        weight=weight,
        gravity=gravity,
        momentum_changes=bool(weight.any()) or pushed,
        cyclic=cyclic,
        driven=driven,
        free=tuple(k for k in range(system.m) if k not in driven),
    )
