"""The inputs of a flow map: which there are, and the columns that the begin of a flow takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.arrays import Array, vector
from ...common.errors import InputError, ShapeError
from ...common.names import nearest
from ...common.plain_names import brief, listed
from ...kernels.kernel import Kernel
from ...scene import forms
from ...scene.scene import Scene

STATE = ("x0", "xdot0", "pose0", "xi0", "momentum")


@dataclass(frozen=True)
class Given:
    """Inputs as columns.  state: (pose, x, ẋ, ξ or μ).  constants: parameters from gravity on."""

    state: Array
    constants: Array


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
        self.own = Given(state, np.concatenate([gravity[list(layout.gravity)], numbers]))
        self._numbers_at = len(layout.gravity)
        self._values = {
            each.name: float(scene.parameters.get(each.name, each.value))
            for each in self._parameters
        }
        self.known = (*self._place, *self._values)
        self.names = tuple(checked_names(wrt, self.known))
        sizes = {name: place.stop - place.start for name, place in self._place.items()}
        sizes["pose0"] = system.r
        self.sizes = {name: sizes.get(name, 1) for name in self.names}

    def given(self, values: Mapping[str, Any]) -> Given:
        """Return the columns for these values; what is not given stays.  Raises InputError."""
        if not values:
            return self.own
        system = self._scene.system
        state, constants = self.own.state.copy(), self.own.constants.copy()
        for name, value in values.items():
            place = self._place.get(name)
            if place is None:
                if name not in self._values:
                    checked_names([name], self.known)
                self._set(constants, name, value)
            elif name == "pose0":
                state[place] = system.group.pose(value)
            elif isinstance(value, Mapping):
                state[place] = forms.in_order(value, system, name)
            else:
                array = np.asarray(value, dtype=float) if _is_numbers(value) else value
                if isinstance(array, np.ndarray) and array.shape == (place.stop - place.start,):
                    state[place] = array
                else:
                    state[place] = vector(value, place.stop - place.start, name)
        if not np.isfinite(state).all():
            raise ShapeError(f"the inputs of a flow must be finite, got {brief(dict(values))}")
        return Given(state, constants)

    def directions(self, along: Mapping[str, Any], at: Given) -> tuple[Array, Array]:
        """Return the columns (…, 1) of state and constants along directions by name."""
        state, constants = np.zeros((len(at.state), 1)), np.zeros((len(at.constants), 1))
        for name, value in along.items():
            checked_names([name], self.names)
            direction = vector(np.atleast_1d(value), self.sizes[name], f"the direction of {name}")
            both = self._columns(name, at)
            state += (both[0] @ direction)[:, None]
            constants += (both[1] @ direction)[:, None]
        return state, constants

    def basis(self, at: Given) -> tuple[Array, Array]:
        """Return the columns (…, N) of state and constants along every number of the inputs."""
        both = [self._columns(name, at) for name in self.names]
        if not both:
            return np.zeros((len(at.state), 0)), np.zeros((len(at.constants), 0))
        return np.hstack([a for a, _ in both]), np.hstack([b for _, b in both])

    def by_name(self, rows: Array) -> dict[str, Array]:
        """Return (…, N) numbers for each input, in the order of `basis`, by their names.

        A parameter has one number, and its axis is left out.
        """
        out, first = {}, 0
        for name, size in self.sizes.items():
            part = rows[..., first : first + size]
            out[name] = part if name in self._place else part[..., 0]
            first += size
        return out

    def _columns(self, name: str, at: Given) -> tuple[Array, Array]:
        size = self.sizes[name]
        state, constants = np.zeros((len(at.state), size)), np.zeros((len(at.constants), size))
        place = self._place.get(name)
        if place is None:
            k = [each.name for each in self._parameters].index(name)
            constants[self._numbers_at :, 0] = self._slopes[:, k]
        elif name == "pose0":
            group = self._scene.system.group
            pose = at.state[place]
            state[place] = np.transpose([group.rate(pose, each) for each in np.eye(size)])
        else:
            state[place] = np.eye(size)
        return state, constants

    def _set(self, constants: Array, name: str, value: Any) -> None:
        number = float(vector(np.ravel(value), 1, name)[0])
        k = [each.name for each in self._parameters].index(name)
        moved = number - self._values[name]
        constants[self._numbers_at :] += self._slopes[:, k] * moved


def motion_of(scene: Scene) -> str:
    """Return which of twist and momentum a scene gives: "xi" or "mu"."""
    return "xi" if scene.given.mu is None else "mu"


def checked_names(names: Sequence[str], known: Sequence[str]) -> list[str]:
    """Return names of inputs if all are known and none comes twice.  Raises InputError."""
    given = [names] if isinstance(names, str) else list(names)
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


def _is_numbers(value: Any) -> bool:
    return isinstance(value, (np.ndarray, list, tuple))
