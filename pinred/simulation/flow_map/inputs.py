"""The inputs of a flow map: which there are, and the columns that the begin of a flow takes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np

from ...common.arrays import Array, as_floats, entries_of, vector
from ...common.errors import InputError, ShapeError
from ...common.names import brief, listed, nearest
from ...kernels.initial_conditions import TwistOrMomentum
from ...kernels.kernel import Kernel
from ...reduction.potential import falling
from ...reduction.tree.free_bodies import free_numbers
from ...scene import input_formats
from ...scene.scene import Scene
from ..robot_columns import RobotColumns, with_own

_NONE: Mapping[str, Array] = MappingProxyType({})
STATE = ("x0", "xdot0", "pose0", "xi0", "momentum")


@dataclass(frozen=True)
class Given:
    """Inputs as columns.

    state: (pose, x, ẋ, ξ or μ).  constants: parameters from gravity on, and then how the centre of
    mass falls, (k,).  robot: values of the robot's parameters that were given.
    """

    state: Array
    constants: Array
    robot: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))


class Inputs:
    """The inputs of one scene's flow under one kernel.

    names: those with derivatives, in their order.  sizes: how many numbers each has; of a pose, of
    its tangent.  motion: "xi" or "mu", which of both the scene gives.
    """

    def __init__(self, scene: Scene, kernel: Kernel, gravity: Array, wrt: Sequence[str]) -> None:
        """Take the scene and the names.  Raises InputError for others than there are."""
        self._scene, self._kernel = scene, kernel
        system, model = scene.system, scene.force_model
        self.motion = motion_of(scene)
        self._parameters = () if model is None else model.parameters
        self._slopes = np.zeros((0, 0)) if model is None else model.slopes
        layout, group = kernel.layout, system.group
        own = scene.given
        self._place = {}
        at = 0
        twist = "xi0" if self.motion == "xi" else "momentum"
        for name, size in (
            ("pose0", group.size),
            ("x0", system.m),
            ("xdot0", system.m),
            (twist, system.r),
        ):
            self._place[name] = slice(at, at + size)
            at += size
        state = np.concatenate([own.pose[0], own.x[0], own.xdot[0], own.motion[0]])
        numbers = np.empty(0) if model is None else model.numbers
        bodies = free_numbers(system, layout.freed)
        parts = [gravity[list(layout.gravity)], bodies, numbers, falling(system)]
        self.own = Given(state, np.concatenate(parts))
        first = len(layout.gravity) + len(bodies)
        self._numbers_at = slice(first, first + len(numbers))
        self._robot = None if scene.varied is None else RobotColumns(scene, layout, len(numbers))
        self._robot_values = {} if self._robot is None else self._robot.values
        self._values = {each.name: each.value for each in self._parameters}
        self._of = {name: k for k, name in enumerate(self._values)}
        self._values |= {
            name: float(np.ravel(as_floats(value, name))[0])
            for name, value in scene.parameters.items()
            if name in self._values
        }
        for name in self._values:
            if name in self._place or name in self._robot_values:
                raise InputError(
                    f"a Parameter of the forces is called '{name}', as another input of the flow; "
                    "give it another name"
                )
        self.known = (*self._place, *self._values, *self._robot_values)
        self.names = tuple(checked_names(wrt, self.known))
        sizes = {name: place.stop - place.start for name, place in self._place.items()}
        sizes["pose0"] = system.r
        sizes |= {name: len(value) for name, value in self._robot_values.items()}
        self.sizes = {name: sizes.get(name, 1) for name in self.names}
        self._spans, first = {}, 0
        for name, size in self.sizes.items():
            self._spans[name] = slice(first, first + size)
            first += size
        self._own: tuple[Array, Array] | None = None  # of basis, at the scene's values
        self._last: tuple[Given, tuple[Array, Array]] | None = None  # basis

    def value(self, name: str) -> Array:
        """Return the scene's value of an input, (size,)."""
        if name in self._robot_values:
            return self._robot_values[name]
        place = self._place.get(name)
        return np.array([self._values[name]]) if place is None else self.own.state[place]

    def given(self, values: Mapping[str, Any]) -> Given:
        """Return the columns for these values; what is not given stays.  Raises InputError."""
        if not values:
            return self.own
        system = self._scene.system
        state, constants = self.own.state.copy(), self.own.constants.copy()
        mine = self._robot_values.keys() & values.keys() if self._robot_values else ()
        now: dict[str, Array] = {}
        if mine and self._robot is not None:
            now = self._robot.now({k: values[k] for k in mine})
            self._robot.put(constants, now, mine)
            now = {name: now[name] for name in mine}
        for name, value in values.items():
            if name in mine:
                continue
            place = self._place.get(name)
            if place is None:
                if name not in self._values:
                    checked_names([name], self.known)
                self._set(constants, name, value)
            elif name == "pose0":
                state[place] = system.group.pose(value)
            elif isinstance(value, Mapping):
                state[place] = input_formats.order_by_joint(value, system, name)
            elif type(value) is np.ndarray and value.shape == (place.stop - place.start,):
                state[place] = value
            else:
                state[place] = vector(value, place.stop - place.start, name)
        if not np.isfinite(state).all():
            raise ShapeError(f"the inputs of a flow must be finite, got {brief(dict(values))}")
        return Given(state, constants, now or _NONE)

    def directions(self, along: Mapping[str, Any], at: Given) -> tuple[Array, Array]:
        """Return the columns (…, 1) of state and constants along directions by name."""
        whole = np.zeros((sum(self.sizes.values()), 1))
        for name, value in along.items():
            checked_names([name], self.names)
            direction = vector(np.atleast_1d(value), self.sizes[name], f"the direction of {name}")
            whole[self._spans[name], 0] = direction
        state, constants = self.basis(at)
        return state @ whole, constants @ whole

    def basis(self, at: Given) -> tuple[Array, Array]:
        """Return the columns (…, N) of state and constants along every number of the inputs."""
        if self._last is not None and self._last[0] is at:
            return self._last[1]
        state, constants = self._own_columns()
        if "pose0" in self.sizes and at is not self.own:
            state = state.copy()
            self._put_pose(state, at)
        if at.robot and self._robot is not None:
            constants = constants.copy()
            self._put_slopes(constants, {**self._robot_values, **at.robot}, at.robot)
        self._last = (at, (state, constants))
        return state, constants

    def _own_columns(self) -> tuple[Array, Array]:
        """Return the columns of `basis` at the scene's values."""
        if self._own is None:
            state, constants = self._fixed_columns()
            if "pose0" in self.sizes:
                self._put_pose(state, self.own)
            if self._robot is not None:
                self._put_slopes(constants, self._robot_values, self._robot_values)
            self._own = state, constants
        return self._own

    def _put_pose(self, state: Array, at: Given) -> None:
        group, place = self._scene.system.group, self._place["pose0"]
        poses = np.broadcast_to(at.state[place], (group.dim, group.size))
        state[place, self._spans["pose0"]] = group.rate(poses, np.eye(group.dim)).T

    def _put_slopes(
        self, constants: Array, now: Mapping[str, Array], changed: Collection[str]
    ) -> None:
        assert self._robot is not None
        if not self._robot_values.keys() & self.sizes.keys():
            return
        for where, name, slope in self._robot.slopes(now, changed):
            if name in self._spans:
                constants[where, self._spans[name]] = slope

    def _fixed_columns(self) -> tuple[Array, Array]:
        """Return the columns of `basis` but for a pose and the robot's numbers."""
        count = sum(self.sizes.values())
        state = np.zeros((len(self.own.state), count))
        constants = np.zeros((len(self.own.constants), count))
        parameters = [each.name for each in self._parameters]
        for name, span in self._spans.items():
            if name in parameters:
                slopes = self._slopes[:, [parameters.index(name)]]
                constants[self._numbers_at, span] = slopes
            elif name in self._place and name != "pose0":
                state[self._place[name], span] = np.eye(self.sizes[name])
        return state, constants

    def by_name(self, rows: Array) -> dict[str, Array]:
        """Return (…, N) numbers for each input, in the order of `basis`, by their names.

        A parameter has one number, and its axis is left out.
        """
        out, first = {}, 0
        for name, size in self.sizes.items():
            part = rows[..., first : first + size]
            out[name] = part if name in self._place or size > 1 else part[..., 0]
            first += size
        return out

    def _set(self, constants: Array, name: str, value: Any) -> None:
        number = value if type(value) is float and isfinite(value) else _number(value, name)
        k = self._of[name]
        moved = number - self._values[name]
        constants[self._numbers_at] += self._slopes[:, k] * moved


def with_varied(scene: Scene, names: Sequence[str]) -> Scene:
    """Return a scene with the robot's parameters among the names as its own, at their values.

    Raises InputError for bodies and joints that are not there.
    """
    return with_own(scene, _listed(names))


def motion_of(scene: Scene) -> TwistOrMomentum:
    """Return which of twist and momentum a scene gives: "xi" or "mu"."""
    return "xi" if scene.given.mu is None else "mu"


def checked_names(names: Sequence[str], known: Sequence[str]) -> list[str]:
    """Return names of inputs if all are known and none comes twice.  Raises InputError."""
    given = _listed(names)
    for name in given:
        if name not in known:
            hint = nearest(name, list(known)) if isinstance(name, str) else ""
            raise InputError(
                f"a flow of this scene has no input {brief(name)}; {hint}"
                f"its inputs are {listed(list(known), 200)}"
            )
        if given.count(name) > 1:
            raise InputError(f"the input '{name}' of a flow is named twice")
    return given


def _listed(names: Any) -> list[Any]:
    """Return names as a list.  Raises InputError for what is none."""
    given = [names] if isinstance(names, str) else entries_of(names)
    if given is None:
        raise InputError(f"wrt must be a list of names of inputs, got {brief(names)}")
    return given


def _number(value: Any, name: str) -> float:
    return float(vector(np.ravel(value), 1, name)[0])
