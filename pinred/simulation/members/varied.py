"""Members given as arrays: what differs between them, by the names of options and parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...common.arrays import Array, as_floats, dimensions, vectors
from ...common.errors import InputError, ShapeError, SymmetryError
from ...common.plain_names import brief, listed
from ...integrators.methods import Method
from ...reduction.potential import acting_gravity, falling
from ...scene import input_formats
from ...scene.angles import refuse_vague
from ...scene.initial_state import GivenStates
from ...scene.random_state import random_state
from ...scene.scene import Scene
from ...system.model_parameters import GRAVITY, kinds_near, requested, size_of
from ...system.system import System
from ...system.variants import in_gravity, nominal
from ..plan import MemberParameters
from ..robot_columns import RobotColumns, with_own
from ..simulate import as_scene
from .member_groups import Group, Members, members_plan

STATES = ("x0", "xdot0", "xi0", "momentum", "pose0", "q0", "v0")
_BY_JOINT = ("x0", "xdot0")
_OF_Q = (("pose0", "pose"), ("x0", "x"))
_OF_V = (("xi0", "xi"), ("xdot0", "xdot"))
_WHAT = f"{', '.join(STATES)}, gravity or a parameter"


class Varied:
    """Options of many members, apart by what differs between them.

    states: {option: (N, …)}.  parameters: {name: (N,)}.  gravity: (N, 3) in the world frame
    [m/s²], or None.  common: all other options.  count: N.  system: as it was loaded.
    """

    def __init__(
        self,
        base: System | Scene,
        options: Mapping[str, Any],
        members: Mapping[str, Any] | None,
        seeds: Sequence[int] | None,
    ) -> None:
        """Take options of a scene, and members by name.  Raises InputError and ShapeError."""
        self.seeds = seeds
        own = dict(base.parameters)
        if isinstance(base, Scene):
            self.system = system = nominal(base.system)
            self.base: System | Scene = replace(base, system=system, parameters={})
        else:
            self.base = self.system = system = nominal(base)
        self.common = dict(options)
        parameters = self.common.pop("parameters", None)
        parameters = {} if parameters is None else parameters
        if not isinstance(parameters, Mapping):  # names alone, of what all have as it is
            parameters, others = requested(system, parameters)
            parameters |= {name: own[name] for name in parameters if name in own}
            if others:
                raise InputError(
                    f"parameters: {brief(others[0])} is no number of the robot, and has no value "
                    "here; give {name: value}"
                )
        self.gravity: Array | None = None
        given = dict(parameters)
        for name, value in _named(members).items():
            if name in (*self.common, *given):
                raise InputError(f"'{name}' is given among the members and beside them")
            if name == "gravity":
                self.gravity = vectors(value, 3, "gravity")
                if self.gravity.ndim != 2:
                    raise ShapeError(f"gravity must have shape (N, 3), got {self.gravity.shape}")
            elif name in STATES:
                self.common[name] = value
            else:
                given[name] = value
        for name in _BY_JOINT:
            if name in self.common:
                self.common[name] = input_formats.order_by_joint(self.common[name], system, name)
        self.states = {
            name: as_floats(self.common.pop(name), name)
            for name in STATES
            if self.common.get(name) is not None and dimensions(self.common[name]) == 2
        }
        sizes = {n: size_of(system, n) for n in given}
        self.robot = {n: size for n, size in sizes.items() if size is not None}
        if "gravity" in given and dimensions(given["gravity"]) == 2 and self.gravity is None:
            self.gravity = vectors(given.pop("gravity"), 3, "gravity")
            del self.robot["gravity"]
        strength = given.get("gravity.strength")
        if strength is not None and dimensions(strength) == 1 and self.gravity is None:
            g = np.asarray(own.get("gravity", self.system.gravity))
            unit = g / np.linalg.norm(g) if g.any() else g
            self.gravity = np.outer(_column(strength, "gravity.strength"), unit)
            del given["gravity.strength"], self.robot["gravity.strength"]
        self.parameters = {
            name: _column(value, name)
            for name, value in given.items()
            if dimensions(value) == (2 if self.robot.get(name, 1) > 1 else 1)
        }
        fixed = {name: value for name, value in given.items() if name not in self.parameters}
        if self.gravity is not None:
            own = {name: value for name, value in own.items() if name not in GRAVITY}
        fixed = {name: value for name, value in own.items() if name not in given} | fixed
        self.common["parameters"] = fixed
        self.count = self._count()

    def _count(self) -> int:
        sizes = {n: len(v) for n, v in (self.states | self.parameters).items()}
        if self.gravity is not None:
            sizes["gravity"] = len(self.gravity)
        if self.seeds is not None:
            if "seed" in self.common:
                raise InputError("give seeds or seed, not both")
            both = [name for name in self.states if name != "pose0"]
            if both:
                raise InputError(f"seeds stands for whole random states; do not give {both[0]}")
            sizes["seeds"] = len(self.seeds)
        if len(set(sizes.values())) != 1:
            found = ", ".join(f"{name}: {size}" for name, size in sizes.items()) or "none"
            same = ", ".join(self.common["parameters"])
            raise ShapeError(
                f"at least one of {_WHAT} must have shape (N, …), all with the same N; "
                f"the lengths are {found}" + (f", and one for all {same}" if same else "")
            )
        count = next(iter(sizes.values()))
        if not count:
            raise InputError("simulate_many needs at least one member")
        return count

    def scene(self, member: int, *, common_parameters: bool = False) -> Scene:
        """Return the scene of one member, perhaps with parameters as all members share them."""
        options: dict[str, Any] = {name: values[member] for name, values in self.states.items()}
        own = {name: values[member] for name, values in self.parameters.items()}
        options |= self.common
        if not common_parameters:
            options["parameters"] = {**self.common["parameters"], **own}
        if self.seeds is not None:
            options["seed"] = self.seeds[member]
        base = self.base
        if self.gravity is not None:
            moved = in_gravity(self.system, self.gravity[member])
            base = replace(base, system=moved) if isinstance(base, Scene) else moved
        return as_scene(base, options, "simulate_many")

    def _scene_by(self, method: Method | str, member: int) -> Scene:
        """Return the scene of one member, by the method that members are given to."""
        return replace(self.scene(member), method=method)

    def members(self) -> Members:
        """Return the members in groups.  Raises InputError for scenes that make no sense."""
        # With parameters that all share, so that no number depends on who is the first.
        template = self.scene(0, common_parameters=True)
        model = template.force_model
        known = [] if model is None else [each.name for each in model.parameters]
        for name in self.parameters:
            if name not in (*known, *self.robot):
                raise InputError(
                    f"members: nothing called {brief(name)} varies in these scenes; "
                    f"{kinds_near(self.system, name, [*STATES, *known])}; of the scenes {_WHAT}: "
                    f"{listed(known, 60) or 'none'}"
                )
        first = self.scene(0)  # checks all that is common
        varying = [name for name in self.robot if name in self.parameters]
        if varying:
            template = with_own(template, varying)
        elif self.gravity is not None:
            template = replace(template, system=self.system)
        numbers = self._numbers(template)
        given = (
            self._given(template, numbers) if self.seeds is None else self._drawn(template, numbers)
        )
        method = members_plan(first).scene.method
        robot = self._robot_numbers(template) if varying else None
        scene_of = partial(self._scene_by, method)
        if self.gravity is None:
            own = MemberParameters(numbers, robot)
            every = np.arange(self.count)
            return Members(self.count, [Group(every, members_plan(template), given, own)], scene_of)
        return Members(self.count, self._by_gravity(template, given, numbers, robot), scene_of)

    def _by_gravity(
        self, template: Scene, given: GivenStates, numbers: Array | None, robot: Array | None
    ) -> list[Group]:
        """Return members in groups by the axes along which gravity acts."""
        assert self.gravity is not None
        rows, which = np.unique(self.gravity, axis=0, return_inverse=True)
        which = which.reshape(-1)
        systems = [in_gravity(self.system, row) for row in rows]
        acting = np.array([acting_gravity(system) for system in systems])
        fall = np.array([falling(system) for system in systems])
        groups = []
        for axes in np.unique(acting != 0.0, axis=0):
            kinds = np.flatnonzero(((acting != 0.0) == axes).all(axis=1))
            members = np.flatnonzero(np.isin(which, kinds))
            # Its own kernel is there already, if that is of this kind.
            system = systems[kinds[0]]
            with suppress(SymmetryError):
                if np.array_equal(acting_gravity(template.system) != 0.0, axes):
                    system = template.system
            plan = members_plan(replace(template, system=system))
            own = MemberParameters(
                numbers=None if numbers is None else numbers[members],
                robot=None if robot is None else robot[members],
                gravity=acting[which[members]],
                fall=fall[which[members]],
            )
            groups.append(Group(members, plan, given[members], own))
        return groups

    def _numbers(self, template: Scene) -> Array | None:
        """Return the numbers in the forces of each member, (N, p), if they differ."""
        model = template.force_model
        if not self.parameters or model is None:
            return None
        names = [each.name for each in model.parameters]
        moved = np.zeros((self.count, len(names)))
        for name, values in self.parameters.items():
            if name in self.robot:
                continue
            k = names.index(name)
            moved[:, k] = values - model.parameters[k].value
        # Entry by entry, so that a member's numbers do not depend on how many there are.
        numbers = np.repeat(model.numbers_from(0.0, template.end)[None], self.count, axis=0)
        for k in range(len(names)):
            numbers += moved[:, k : k + 1] * model.slopes[:, k]
        return numbers

    def _robot_numbers(self, template: Scene) -> Array:
        """Return the numbers of freed bodies of each member, (N, s).

        Raises InputError, naming the member, for what no real robot has.
        """
        layout = members_plan(template).kind(zero_momentum=False, generic=True).layout
        columns = RobotColumns(template, layout, 0)
        numbers, first = np.empty((self.count, layout.freed.size)), len(layout.gravity)
        whole = np.zeros(first + layout.freed.size + len(falling(template.system)))
        names = self.robot.keys() & self.parameters.keys()
        for k in range(self.count):
            try:
                now = columns.now({name: self.parameters[name][k] for name in names})
            except InputError as error:
                raise type(error)(f"member {k}: {error}") from None
            columns.put(whole, now, now)
            numbers[k] = whole[first : first + layout.freed.size]
        return numbers

    def _given(self, scene: Scene, numbers: Array | None) -> GivenStates:
        """Return the initial states of all members: the scene's where they do not vary."""
        system, own, count = scene.system, scene.given, self.count
        varying = dict(self.states)
        if "q0" in varying:
            places = [input_formats.parse_configuration(q, system) for q in varying.pop("q0")]
            varying |= {name: np.array([getattr(p, key) for p in places]) for name, key in _OF_Q}
        if "v0" in varying:
            motions = [input_formats.parse_velocity(v, system) for v in varying.pop("v0")]
            varying |= {name: np.array([getattr(v, key) for v in motions]) for name, key in _OF_V}
        sizes = {"x0": system.m, "xdot0": system.m, "xi0": system.r, "momentum": system.r}

        def rows(name: str, first: Array | None) -> Array | None:
            if name in varying:
                return vectors(varying[name], sizes[name], name)
            return None if first is None else np.repeat(first, count, axis=0)

        x, xdot = rows("x0", own.x), rows("xdot0", own.xdot)
        assert x is not None
        assert xdot is not None
        pose = np.repeat(own.pose, count, axis=0)
        if "pose0" in varying:
            pose = np.array([system.group.pose(each) for each in varying["pose0"]])
        refuse_vague(np.abs(x).max(axis=0), system)
        x, xdot = _with_prescribed(scene, x, xdot, numbers)
        return GivenStates(pose, x, xdot, rows("xi0", own.xi), rows("momentum", own.mu))

    def _drawn(self, scene: Scene, numbers: Array | None) -> GivenStates:
        """Return the random initial states of seeds."""
        assert self.seeds is not None
        states = [random_state(scene.system, seed) for seed in self.seeds]
        x, xdot, xi = (np.array([getattr(s, name) for s in states]) for name in ("x", "xdot", "xi"))
        x, xdot = _with_prescribed(scene, x, xdot, numbers)
        pose = np.repeat(scene.given.pose, len(states), axis=0)
        if "pose0" in self.states:
            pose = np.array([scene.system.group.pose(each) for each in self.states["pose0"]])
        return GivenStates(pose, x, xdot, xi, None)


def _named(members: Mapping[str, Any] | None) -> Mapping[str, Any]:
    if members is None:
        return {}
    if not (isinstance(members, Mapping) and all(isinstance(name, str) for name in members)):
        raise InputError(f"members must be {{name: (N, …) values}}, got {brief(members)}")
    return members


def _column(value: Any, name: str) -> Array:
    """Return the values (N,), or (N, k), of a parameter.  Raises ShapeError."""
    column = as_floats(value, name)
    return vectors(column, column.shape[-1], f"parameters['{name}']")


def _with_prescribed(
    scene: Scene, x: Array, xdot: Array, numbers: Array | None
) -> tuple[Array, Array]:
    """Return initial shapes and rates (N, m) with those of the prescribed joints in them."""
    model = scene.force_model
    if model is None or not model.joints or numbers is None:
        return scene.with_prescribed(x, xdot)
    x, xdot, joints = x.copy(), xdot.copy(), list(model.joints)
    for k, own in enumerate(numbers):
        given = model.prescribed(0.0, own)
        x[k, joints], xdot[k, joints] = given.x, given.xdot
    return x, xdot
