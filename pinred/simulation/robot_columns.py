"""The robot's own numbers among the columns that the begin of a flow takes, and their slopes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError, SymmetryError
from ..kernels.layout import Layout
from ..reduction.potential import acting_gravity, falling
from ..reduction.tree.body_frames import Body, bodies_of, step_at
from ..reduction.tree.free_bodies import (
    frame_map,
    link_numbers,
    link_slopes,
    step_of_body,
    step_slopes,
)
from ..scene.scene import Scene
from ..system.model_parameters import ModelParameters
from ..system.variants import in_gravity, nominal

Slopes = dict[str, Array]

_FLAT = 1e-6  # cos δ below which the angles of a step have no slopes


class RobotColumns:
    """The robot's parameters of a flow: where their numbers stand among its constants.

    values: of the scene, {name: (size,)}.
    """

    def __init__(self, scene: Scene, layout: Layout, numbers: int) -> None:
        """Take the scene.  numbers: how many there are in the forces."""
        assert scene.varied is not None
        self._varied: ModelParameters = scene.varied
        self._system, self._layout = nominal(scene.system), layout
        self.values = self._varied.checked({n: scene.parameters[n] for n in self._varied.names})
        self._bodies = bodies_of(self._system)
        self._maps = {i: frame_map(self._bodies[i]) for i in self._varied.free}
        self._bodies_at = len(layout.gravity)
        self._fall_at = self._bodies_at + layout.freed.size + numbers
        self._gravity: tuple[Array, Array] | None = None

    def now(self, given: Mapping[str, Any]) -> dict[str, Array]:
        """Return all values, of which some are given.  Raises InputError for unphysical ones."""
        return self._varied.checked(given, self.values)

    def put(self, constants: Array, now: Mapping[str, Array], changed: Collection[str]) -> None:
        """Write the numbers for these values among the constants, where they have changed.

        changed: names of the parameters that are not those of the scene.
        """
        for place, numbers, _ in self._of_bodies(now, changed):
            constants[place] = numbers
        first = self._bodies_at
        if self._varied.gravity:
            acting, fall = self._in_gravity(self._varied.gravity_of(now)[0])
            constants[:first] = acting
            constants[self._fall_at :] = fall

    def slopes(
        self, now: Mapping[str, Array], changed: Collection[str]
    ) -> Iterator[tuple[slice, str, Array]]:
        """Yield places among the constants, names, and slopes (…, size) there; see `put`."""
        for place, _, slopes in self._of_bodies(now, changed):
            for name, slope in slopes().items():
                yield place, name, slope
        if self._varied.gravity:
            _, slope = self._varied.gravity_of(now)
            acting, fall = self._gravity_maps()
            name = self._varied.gravity_name()
            yield slice(0, self._bodies_at), name, acting @ slope
            yield slice(self._fall_at, self._fall_at + len(fall)), name, fall @ slope

    def _of_bodies(
        self, now: Mapping[str, Array], changed: Collection[str]
    ) -> Iterator[tuple[slice, Array, Callable[[], Slopes]]]:
        """Yield places among the constants, the numbers there, and what gives their slopes."""
        freed = self._layout.freed
        for i, (moments, slopes) in self._varied.inertias(now, changed).items():
            place, turn = freed.of_inertia(i), self._maps[i]
            yield (
                self._among_constants(place),
                turn @ moments,
                partial(_turned, turn, slopes),
            )
        for i, (joint, twists) in self._varied.placements(now, changed).items():
            body, own = self._bodies[i], self._system.model.jointPlacements[i + 1]
            parent = self._bodies[body.parent]
            moved = replace(body, **step_at(parent, body, own, joint))
            place = freed.of_step(i)
            yield (
                self._among_constants(place),
                step_of_body(moved),
                partial(_step_slopes, parent, moved, twists),
            )
        for k, body, link, twists in self._links(now):
            place = freed.of_link(k)
            yield (
                self._among_constants(place),
                link_numbers(body, link),
                partial(_link_slopes, body, link, twists),
            )

    def _among_constants(self, place: slice) -> slice:
        return slice(self._bodies_at + place.start, self._bodies_at + place.stop)

    def _links(
        self, now: Mapping[str, Array]
    ) -> Iterator[tuple[int, Body, pin.SE3, dict[str, Array]]]:
        """Yield frame, body, place and twists by name of each link that a force acts on."""
        links = self._layout.freed.links
        for k, (place, twists) in self._varied.places(now).items() if links else ():
            if k in links:
                joint = self._system.model.frames[k].parentJoint
                yield k, self._bodies[joint - 1], place, twists

    def _in_gravity(self, g: Array) -> tuple[Array, Array]:
        """Return what of a gravity acts along the kernel's axes, and how the system falls.

        Raises SymmetryError if it breaks the symmetry, InputError if it acts along others.
        """
        system = in_gravity(self._system, g)
        acting, axes = acting_gravity(system), list(self._layout.gravity)
        others = np.delete(acting, axes)
        if others.any() or (axes and not acting.any()):
            raise InputError(
                f"the flow was prepared for gravity along other axes than {g.tolist()}; make one "
                "of a scene with a gravity like this, or with 'gravity' among wrt"
            )
        return acting[axes], falling(system)

    def _gravity_maps(self) -> tuple[Array, Array]:
        """Return the maps from gravity in the world to what acts, and to the fall.

        Raises InputError if gravity along some axis of the world would break the symmetry, where
        all of it varies.
        """
        if self._gravity is not None:
            return self._gravity
        columns, falls, axes = [], [], list(self._layout.gravity)
        root = self._system.model.jointPlacements[1].rotation
        whole = self._varied.gravity_name() == "gravity"
        for unit in np.eye(3):
            system = in_gravity(self._system, unit)
            try:
                acting = acting_gravity(system)
            except SymmetryError as broken:
                if whole:
                    raise InputError(
                        f"'gravity' has no derivatives by all its numbers: {broken}; vary "
                        "'gravity.strength'"
                    ) from None
                acting = np.zeros(3)
            columns.append(acting[axes])
            falls.append(falling(system))
        if not whole:  # along a direction that keeps the symmetry the map is linear
            g = self._system.gravity
            acting = acting_gravity(self._system)[axes]
            columns = list(np.outer(g, acting) / (g @ g))
        elif self._system.group.is_pivot and axes:
            columns = list(root)  # row k: of the world's axis k
        self._gravity = (
            np.transpose(columns).reshape(len(axes), 3),
            np.transpose(falls).reshape(-1, 3),
        )
        return self._gravity


def with_own(scene: Scene, names: Sequence[Any]) -> Scene:
    """Return a scene with the robot's parameters among the names as its own, at their values.

    Raises InputError for bodies and joints that are not there.
    """
    known = [name for name in names if isinstance(name, str)]
    own = nominal(scene.system)
    varied = ModelParameters(own, list(dict.fromkeys([*scene.parameters, *known])))
    if not varied.names:
        return scene
    values = {**varied.own(), **scene.parameters}
    return replace(scene, parameters=values)


def _turned(turn: Array, slopes: Slopes) -> Slopes:
    return {name: turn @ slope for name, slope in slopes.items()}


def _step_slopes(parent: Body, body: Body, twists: Slopes) -> Slopes:
    """Return the slopes of a step's numbers by name.  Raises InputError where there are none."""
    if abs(body.delta[0]) < _FLAT:
        raise InputError(
            f"{next(iter(twists))} turns the joint by a right angle from where the robot has it; "
            "there its numbers have no slopes: load the robot with a placement that is nearer"
        )
    by_twist = step_slopes(parent, body)
    return {name: by_twist @ twist for name, twist in twists.items()}


def _link_slopes(body: Body, place: pin.SE3, twists: Slopes) -> Slopes:
    return {name: link_slopes(body, place, twist) for name, twist in twists.items()}
