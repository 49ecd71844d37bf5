"""Numbers of a robot by name as parameters: inertias, placements, locked joints, gravity."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, entries_of, read_only
from ..common.errors import InputError
from ..common.names import nearest
from ..common.plain_names import brief
from .body_parameters import SIZES as BODY_SIZES
from .body_parameters import Bodies, body_names, body_parameter, inertia_of, numbers
from .joint_parameters import PLACED, Joints, joint_parameter
from .system import System
from .variants import in_gravity, nominal, with_numbers

# Gravity in the world frame [m/s²], or its strength along the direction that it has.
GRAVITY = {"gravity": 3, "gravity.strength": 1}
# What says a part of what another kind of parameter says.
_PARTS = {"translation": "placement"} | {
    kind: "log_cholesky" for kind in BODY_SIZES if kind != "log_cholesky"
}
_HUGE = 1e100  # kg, kg m², m, m/s²
_NONE: Mapping[str, Array] = MappingProxyType({})
INERTIAL = ("mass", "com", "inertia")  # the kinds of a whole body, of which "all" is made


def size_of(system: System, name: str) -> int | None:
    """Return how many numbers a parameter of a robot has; None if the name is of none.

    Raises InputError for bodies and joints that are not there.
    """
    if isinstance(name, str) and name in GRAVITY:
        return GRAVITY[name]
    body = body_parameter(system, name)
    if body is not None:
        return body.size
    joint = joint_parameter(system, name)
    return None if joint is None else joint.size


def plain_value(value: Array) -> float | Array:
    """Return a value as scenes show it: one number, or a read-only array."""
    return read_only(value.copy()) if value.size > 1 else float(value[0])


def kinds_near(system: System, name: object, known: Sequence[str] = ()) -> str:
    """Return words on what may vary of a robot, the nearest name to a wrong one first.

    known: other names that there are.
    """
    words = [f"{body}.{kind}" for body in body_names(system) for kind in BODY_SIZES]
    words += [f"{joint}.{kind}" for joint in list(system.model.names)[2:] for kind in PLACED]
    locked = system.contents.locked
    words += [] if locked is None else [f"{joint}.lock" for joint in locked.names]
    hint = nearest(str(name), [*known, *GRAVITY, *words]) if isinstance(name, str) else ""
    return (
        f"{hint}of the robot these may vary: {', '.join(f'LINK.{kind}' for kind in BODY_SIZES)}, "
        f"{', '.join(f'JOINT.{kind}' for kind in (*PLACED, 'lock'))}, {', '.join(GRAVITY)}"
    )


def joined(already: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters, of which those that are given win, and stand for all they say."""
    out = {**already, **given}
    for name in already.keys() - given.keys():
        if any(
            name.endswith(f".{part}") and name.removesuffix(part) + whole in given
            for part, whole in _PARTS.items()
        ) or (name in GRAVITY and "gravity" in given):
            del out[name]
    return out


def with_parameters(system: System, parameters: Any) -> System:
    """Return the system with other numbers; those that it has already stay where none are given.

    Raises InputError for names that the robot does not have, and values that no real one has.
    """
    if not isinstance(parameters, Mapping):
        raise InputError(f"parameters must be {{name: value}}, got {brief(parameters)}")
    own, values = nominal(system), joined(system.parameters, parameters)
    varied = ModelParameters(own, list(values))
    for name in values:
        if name not in varied.names:
            raise InputError(f"parameters: there is no {brief(name)}; {kinds_near(own, name)}")
    return varied.system(varied.checked(values))


def all_names(system: System) -> list[str]:
    """Return the names of masses, centres and moments of all bodies, and of all placements."""
    names = [str(name) for name in system.model.names]
    bodies = [i for i in range(1, len(names)) if system.model.inertias[i].mass > 0.0]
    found = [f"{names[i]}.{kind}" for i in bodies for kind in INERTIAL]
    return [*found, *(f"{name}.placement" for name in names[2:])]


def requested(system: System, parameters: Any) -> tuple[dict[str, Any], list[str]]:
    """Return parameters with values, and names of others that are inputs at their own values.

    parameters: {name: value}, a list of names, which is for the robot's own values, or "all", its
    inertias and placements.  Raises InputError for others.
    """
    if isinstance(parameters, Mapping):
        return dict(parameters), []
    names = all_names(system) if parameters == "all" else entries_of(parameters)
    if names is None or (isinstance(parameters, str) and parameters != "all"):
        raise InputError(
            "parameters must be {name: value}, a list of names, or 'all' for the robot's inertias "
            f"and placements, got {brief(parameters)}"
        )
    mine = [name for name in names if size_of(system, name) is not None]
    own = ModelParameters(system, mine).own()
    values = {name: own[name] if own[name].size > 1 else float(own[name][0]) for name in mine}
    return values, [name for name in names if name not in mine]


class ModelParameters:
    """The numbers of a robot as functions of parameters.

    names: of the parameters, in their order.  free: indices of the bodies, 0 for the root, whose
    inertias vary.  placed: of those whose joints' placements do; turned: of these, those whose
    axes turn.  links: frames of links whose places on their bodies vary: behind locked joints.
    gravity: whether that varies.
    """

    def __init__(self, system: System, names: Sequence[str]) -> None:
        """Find the parameters.  Raises InputError for those that say the same thing twice."""
        self._system = system
        self._bodies, self._joints = Bodies(system, names), Joints(system, names)
        self._gravity = [name for name in names if isinstance(name, str) and name in GRAVITY]
        if len(self._gravity) > 1:
            raise InputError("parameters: give gravity or gravity.strength, not both")
        self.gravity = bool(self._gravity)
        for each in self._bodies.parameters:
            if each.body in self._joints.free:
                raise InputError(
                    f"parameters: '{each.name}' is of a body that has a locked joint on it, whose "
                    "value varies; leave out one of them"
                )
        self.sizes = {each.name: each.size for each in self._bodies.parameters}
        self.sizes |= {each.name: each.size for each in self._joints.parameters}
        self.sizes |= {name: GRAVITY[name] for name in self._gravity}
        self.names = tuple(self.sizes)
        self.free = tuple(sorted({*self._bodies.free, *self._joints.free}))
        self.placed, self.turned = self._joints.placed, self._joints.turned
        self.links = self._joints.links

    def own(self) -> dict[str, Array]:
        """Return the values that the system has, {name: (size,)}."""
        out = self._bodies.own() | self._joints.own()
        if self._gravity:
            g = self._system.gravity
            whole = self._gravity == ["gravity"]
            out[self._gravity[0]] = g if whole else np.array([float(np.linalg.norm(g))])
        return out

    def checked(
        self, given: Mapping[str, Any], known: Mapping[str, Array] = _NONE
    ) -> dict[str, Array]:
        """Return values as arrays that nobody changes.  Raises InputError for unphysical ones.

        known: values that were checked before, of what is not given.
        """
        out = self._bodies.checked(given, known) | self._joints.checked(given)
        for name in self._gravity:
            if name in given:
                out[name] = read_only(numbers(given[name], name, GRAVITY[name]))
        for name, value in out.items():
            if np.abs(value).max() > _HUGE:
                raise InputError(
                    f"parameters: '{name}' is above {_HUGE:g}, of which products overflow; take "
                    "other units"
                )
        if self._gravity == ["gravity.strength"] and not self._system.gravity.any():
            raise InputError(
                f"parameters: '{self._system.name}' has no gravity, and so no direction of it for "
                "'gravity.strength'; give 'gravity'"
            )
        return {name: out[name] if name in out else known[name] for name in self.names}

    def inertias(
        self, values: Mapping[str, Array], changed: Collection[str] | None = None
    ) -> dict[int, tuple[Array, dict[str, Array]]]:
        """Return of each free body its moments (10,), and their slopes (10, size) by each value.

        About its joint's origin: m, m c, then xx, xy, xz, yy, yz, zz.
        changed: only of the bodies that these parameters change.
        """
        names = self.sizes if changed is None else changed
        found = {i: self._bodies.dynamic(i, values) for i in self._bodies.changed_by(names)}
        for i, moments, slopes in self._joints.inertias(values, names):
            found[i] = moments, slopes
        return dict(sorted(found.items()))

    def placements(
        self, values: Mapping[str, Array], changed: Collection[str] | None = None
    ) -> dict[int, tuple[pin.SE3, dict[str, Array]]]:
        """Return of each placed body its joint's placement, and twists (6, size) by each value.

        Twists are in the carrier's frame, taken at its origin.
        changed: only of the bodies that these parameters place.
        """
        names = self.sizes if changed is None else changed
        return {i: (place, twists) for i, place, twists in self._joints.placements(values, names)}

    def places(self, values: Mapping[str, Array]) -> dict[int, tuple[pin.SE3, dict[str, Array]]]:
        """Return of each of `links` its place on its body, and twists (6, size) by each value.

        Twists are as those of `placements`.
        """
        return self._joints.places(values)

    def gravity_of(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return gravity in the world frame, (3,), and its slopes, (3, size)."""
        g = self._system.gravity
        if not self._gravity:
            return g, np.zeros((3, 0))
        value = values[self._gravity[0]]
        if self._gravity == ["gravity"]:
            return value, np.eye(3)
        unit = g / np.linalg.norm(g)
        return value[0] * unit, unit[:, None]

    def system(self, values: Mapping[str, Array]) -> System:
        """Return the system with these values."""
        if not self.names:
            return self._system
        inertias = {i + 1: inertia_of(found) for i, (found, _) in self.inertias(values).items()}
        places = {i + 1: place for i, (place, _) in self.placements(values).items()}
        frames = {k: place for k, (place, _) in self.places(values).items()}
        other = with_numbers(self._system, inertias, places, frames)
        if self._gravity:
            other = in_gravity(other, self.gravity_of(values)[0])
        vars(other)["_parameters"] = {name: plain_value(values[name]) for name in self.names}
        return other

    def perturbed(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return values that have nothing in common with those of the system."""
        out = self._bodies.perturbed(rng) | self._joints.perturbed(rng)
        return out | {name: 1.3 * self.own()[name] for name in self._gravity}

    def gravity_name(self) -> str:
        """Return the name under which gravity varies, or ""."""
        return self._gravity[0] if self._gravity else ""
