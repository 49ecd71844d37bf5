"""Groups of members that share a plan, and members given as scenes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...common.errors import InputError
from ...common.names import brief
from ...forces.force_numbers import tables_of_runs
from ...integrators.methods import DOP853_LEAST, AdaptiveGauss, Radau
from ...reduction.potential import falling
from ...reduction.tree.free_bodies import free_numbers
from ...scene.initial_state import GivenStates
from ...scene.scene import Scene
from ...system.coordinates import Indices
from ...system.system import nominal
from ..choose_method import LANES_GAIN, RADAU_GAIN, radau_gain
from ..plan import NO_DIFFERENCES, MemberParameters, Plan, plan_of


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
        if (len(plan.stops) > 1 or plan.stops_vary) and plan.acting.driven:
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
    robot = None if varied is None else (varied.names, plan.acting.gravity.astype(bool).tobytes())
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
        freed = plans[0].freed(generic=True)
        parameters = replace(
            parameters, robot=np.array([free_numbers(p.system, freed) for p in plans])
        )
        if varied.gravity:
            acting = np.array([plan.acting.gravity for plan in plans])
            fall = np.array([falling(plan.system) for plan in plans])
            parameters = replace(parameters, gravity=acting, fall=fall)
    return Group(members, plans[0], GivenStates(**columns), parameters)
