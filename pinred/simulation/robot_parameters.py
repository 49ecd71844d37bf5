"""Robot parameters as inputs of a flow, and the derivatives of the kernel's constants."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError, SymmetryError
from ..kernels.kernel import Layout
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
from ..system.system import in_gravity, nominal

Slopes = dict[str, Array]

# cos δ below which the angles between two bodies are near their singularity (δ = ±90°), where
# they have no derivatives.
_FLAT = 1e-6


class RobotColumns:
    """The robot parameters of a flow and their places among the kernel's constants.

    Attributes:
        values: Values in the scene, {name: (size,)}.
    """

    def __init__(self, scene: Scene, layout: Layout, numbers: int) -> None:
        """Prepare the robot parameters of a scene.

        Args:
            scene: The scene; some of its robot's parameters are variable.
            layout: Layout of the kernel.
            numbers: Number of parameters of the forces.
        """
        assert scene.varied is not None
        self._varied: ModelParameters = scene.varied
        self._system, self._layout = nominal(scene.system), layout
        self.values = self._varied.checked({n: scene.parameters[n] for n in self._varied.names})
        self._bodies = bodies_of(self._system)
        self._maps = {i: frame_map(self._bodies[i]) for i in self._varied.free}
        self._bodies_at = len(layout.gravity)
        self._fall_at = self._bodies_at + layout.freed.size + numbers
        self._gravity: tuple[Array, Array] | None = None

    def now(self, changes: Mapping[str, Any]) -> dict[str, Array]:
        """Return all values after the given changes.  Raises InputError for unphysical values."""
        return self._varied.checked(changes, self.values)

    def put(self, constants: Array, now: Mapping[str, Array], changed: Collection[str]) -> None:
        """Write changed values into the kernel's constants.

        Args:
            constants: Constants of the kernel, which are overwritten.
            now: Values of all parameters.
            changed: Names of the parameters whose values differ from the scene's.
        """
        for place, numbers, _ in self._of_bodies(now, changed):
            constants[place] = numbers
        first = self._bodies_at
        if self._varied.gravity:
            acting, fall = self._in_gravity(self._varied.gravity_of(now)[0])
            constants[:first] = acting
            constants[self._fall_at :] = fall

    def rows(self, changes: Mapping[str, Array]) -> tuple[Array, dict[int, str]]:
        """Return the variable parameters of the bodies for many values of the parameters.

        Args:
            changes: Changed values, {name: (N, size)}.
        Returns:
            The parameters, (N, s), and {row: reason} of the rows that are not physical.
        """
        count, size = len(next(iter(changes.values()))), self._layout.freed.size
        fall = len(falling(self._system))
        constants = np.zeros(self._fall_at + fall)
        numbers, reasons = np.empty((count, size)), dict[int, str]()
        among = self._among_constants(slice(0, size))
        inertial = self._varied.body_rows(changes, self.values)
        if inertial is not None:
            self.put(constants, self.values, self.values.keys())
            numbers[:] = constants[among]
            for i, moments in inertial[0].items():
                # One product for each row, so that its bits do not depend on the other rows.
                numbers[:, self._layout.freed.of_inertia(i)] = (
                    self._maps[i] @ moments[:, :, None]
                )[:, :, 0]
            return numbers, inertial[1]
        for k in range(count):
            try:
                values = self.now({name: column[k] for name, column in changes.items()})
            except InputError as error:
                reasons[k] = str(error)
                continue
            self.put(constants, values, values.keys())
            numbers[k] = constants[among]
        return numbers, reasons

    def slopes(
        self, now: Mapping[str, Array], changed: Collection[str]
    ) -> Iterator[tuple[slice, str, Array]]:
        """Yield slices of the constants, parameter names, and derivatives (…, size).

        Args:
            now: Values of all parameters.
            changed: Names of the parameters whose values differ from the scene's.
        Yields:
            The slice, the name, and the derivatives of the constants in the slice.
        """
        for place, _, derivatives in self._of_bodies(now, changed):
            for name, slope in derivatives().items():
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
        """Yield slices of the constants, their values, and functions that return derivatives."""
        variables = self._layout.freed
        for i, (moments, slopes) in self._varied.inertias(now, changed).items():
            place, frame = self._among_constants(variables.of_inertia(i)), self._maps[i]
            yield place, frame @ moments, partial(_map_slopes, frame, slopes)
        for i, (joint, twists) in self._varied.placements(now, changed).items():
            body, nominal_place = self._bodies[i], self._system.sorted_model.jointPlacements[i + 1]
            parent = self._bodies[body.parent]
            placed = replace(body, **step_at(parent, body, nominal_place, joint))
            place = self._among_constants(variables.of_step(i))
            yield place, step_of_body(placed), partial(_step_slopes, parent, placed, twists)
        for k, body, link, twists in self._links(now):
            place = self._among_constants(variables.of_link(k))
            yield place, link_numbers(body, link), partial(_link_slopes, body, link, twists)

    def _among_constants(self, place: slice) -> slice:
        return slice(self._bodies_at + place.start, self._bodies_at + place.stop)

    def _links(
        self, now: Mapping[str, Array]
    ) -> Iterator[tuple[int, Body, pin.SE3, dict[str, Array]]]:
        """Yield frame, body, placement, and {name: twists}, for each link that a force acts on."""
        links = self._layout.freed.links
        for k, (place, twists) in self._varied.places(now).items() if links else ():
            if k in links:
                joint = self._system.sorted_model.frames[k].parentJoint
                yield k, self._bodies[joint - 1], place, twists

    def _in_gravity(self, g: Array) -> tuple[Array, Array]:
        """Compute the components of gravity along the kernel's axes, and the free fall.

        Args:
            g: Gravity in the world frame, (3,) [m/s²].
        Returns:
            The components, and the acceleration of the centre of mass along the translations.
        Raises:
            InputError: Gravity has components along other axes.
            SymmetryError: Gravity breaks the symmetry.
        """
        system = in_gravity(self._system, g)
        acting, axes = acting_gravity(system), list(self._layout.gravity)
        excluded = np.delete(acting, axes)
        if excluded.any() or (axes and not acting.any()):
            raise InputError(
                f"the flow was prepared for gravity along other axes than {g.tolist()}. Prepare a "
                "flow of a scene with gravity along these axes, or with 'gravity' among wrt."
            )
        return acting[axes], falling(system)

    def _gravity_maps(self) -> tuple[Array, Array]:
        """Compute the linear maps from gravity in the world frame to the results of `_in_gravity`.

        Returns:
            Maps to the components, (axes, 3), and to the free fall, (k, 3); cached.
        Raises:
            InputError: The whole vector of gravity varies, and a direction breaks the symmetry.
        """
        if self._gravity is not None:
            return self._gravity
        columns, falls, axes = [], [], list(self._layout.gravity)
        root = self._system.model.jointPlacements[1].rotation
        is_vector = self._varied.gravity_name() == "gravity"
        for unit in np.eye(3):
            system = in_gravity(self._system, unit)
            try:
                acting = acting_gravity(system)
            except SymmetryError as broken:
                if is_vector:
                    raise InputError(
                        f"'gravity' cannot be differentiated in every component: {broken}; vary "
                        "'gravity.strength'"
                    ) from None
                acting = np.zeros(3)
            columns.append(acting[axes])
            falls.append(falling(system))
        if not is_vector:  # The map is linear along directions that keep the symmetry.
            g = self._system.gravity
            acting = acting_gravity(self._system)[axes]
            columns = list(np.outer(g, acting) / (g @ g))
        elif self._system.group.is_pivot and axes:
            columns = list(root)  # Entry k is the image of the world's axis k.
        self._gravity = (
            np.transpose(columns).reshape(len(axes), 3),
            np.transpose(falls).reshape(-1, 3),
        )
        return self._gravity


def with_own(scene: Scene, names: Sequence[Any]) -> Scene:
    """Return a scene in which the named robot parameters are variable, with their current values.

    Raises InputError for bodies and joints that the robot does not have.
    """
    requested = [name for name in names if isinstance(name, str)]
    varied = ModelParameters(
        nominal(scene.system), list(dict.fromkeys([*scene.parameters, *requested]))
    )
    if not varied.names:
        return scene
    values = {**varied.own(), **scene.parameters}
    return replace(scene, parameters=values)


def without_own(scene: Scene) -> Scene:
    """Return a scene without robot parameters whose values are those of the robot's file.

    A number that may vary is an input of the kernel, where the file's number is folded, which
    changes round-off.
    """
    if scene.varied is None:
        return scene
    own = scene.varied.own()
    equal = {name for name in own if np.array_equal(np.ravel(scene.parameters[name]), own[name])}
    if not equal:
        return scene
    values = {name: value for name, value in scene.parameters.items() if name not in equal}
    return replace(scene, system=nominal(scene.system), parameters=values)


def _map_slopes(matrix: Array, slopes: Slopes) -> Slopes:
    return {name: matrix @ slope for name, slope in slopes.items()}


def _step_slopes(parent: Body, body: Body, twists: Slopes) -> Slopes:
    """Return {name: derivatives} of a body-to-body step.  Raises InputError at a right angle."""
    if abs(body.delta[0]) < _FLAT:
        raise InputError(
            f"{next(iter(twists))} turns the joint by a right angle from the robot's placement, "
            "where derivatives do not exist: load the robot with a placement that is nearer"
        )
    by_twist = step_slopes(parent, body)
    return {name: by_twist @ twist for name, twist in twists.items()}


def _link_slopes(body: Body, place: pin.SE3, twists: Slopes) -> Slopes:
    return {name: link_slopes(body, place, twist) for name, twist in twists.items()}
