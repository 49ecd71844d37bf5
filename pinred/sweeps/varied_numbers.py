"""The numbers of a scene that a sweep varies: their keys, and members with their values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.names import listed, nearest, quoted
from ..scene.scene import Scene

_XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class VariedNumber:
    """A number that varies.

    Attributes:
        key: Its name, such as "base.mass", "x0.bend" or "gravity.z".
        member: Name of the values of members of simulate_many that contain it.
        entry: Index of its entry in them; None if they are one number for each member.
    """

    key: str
    member: str
    entry: int | None


def varied_numbers(scene: Scene, keys: Sequence[str]) -> tuple[VariedNumber, ...]:
    """Return the numbers of a scene with the given keys.

    Args:
        scene: The scene.
        keys: Names of robot parameters and Parameters, with ".x", ".y", ".z" or an index for an
            entry of a vector; and entries of the state and of gravity, such as "x0.bend".
    Returns:
        The numbers, in the order of the keys.
    Raises:
        InputError: A key is unknown; the message lists the keys that are possible.
    """
    numbers = _numbers_of(scene)
    for key in keys:
        if key not in numbers:
            raise InputError(
                f"vary: no number {quoted(key)} in this scene; {nearest(key, list(numbers))}the "
                f"numbers are {listed(list(numbers), 60)}"
            )
    return tuple(numbers[key] for key in keys)


def _numbers_of(scene: Scene) -> dict[str, VariedNumber]:
    """Return all numbers of a scene that can vary, by key."""
    system, group = scene.system, scene.system.group
    motion = "momentum" if scene.given.mu is not None else "xi0"
    entries: dict[str, Sequence[str]] = {
        "x0": system.shape_names,
        "xdot0": system.shape_names,
        motion: group.twist_names,
        "gravity": _XYZ,
    }
    numbers = {
        f"{member}.{label}": VariedNumber(f"{member}.{label}", member, k)
        for member, labels in entries.items()
        for k, label in enumerate(labels)
    }
    for name, value in (scene.system.parameter_values | dict(scene.parameters)).items():
        size = np.size(value)
        if size == 1:
            numbers[name] = VariedNumber(name, name, None)
            continue
        labels = _XYZ if size == 3 else tuple(str(k) for k in range(size))
        for k, label in enumerate(labels):
            numbers[f"{name}.{label}"] = VariedNumber(f"{name}.{label}", name, k)
    return numbers


def members_of(scene: Scene, numbers: Sequence[VariedNumber], values: Array) -> dict[str, Any]:
    """Return the values of members of simulate_many.

    Args:
        scene: The scene, which has all other numbers.
        numbers: The numbers that vary.
        values: Their values, (N, number of numbers).
    Returns:
        {name: (N, …)}.
    """
    members: dict[str, Any] = {}
    for number, column in zip(numbers, values.T, strict=True):
        if number.entry is None:
            members[number.member] = column
            continue
        if number.member not in members:
            nominal = _nominal(scene, number.member)
            members[number.member] = np.tile(nominal, (len(values), 1))
        members[number.member][:, number.entry] = column
    space = scene.system.space
    if "x0" in members and space.balls:  # from rotation vectors to quaternions
        members["x0"] = space.integrate(space.neutral, members["x0"])
    return members


def _nominal(scene: Scene, member: str) -> Array:
    """Return the value of a vector in the scene; balls have rotation vectors in x0."""
    given = scene.given
    if member == "x0":
        return scene.system.space.chart(scene.start.x[None])[0]
    if member == "gravity":
        return np.asarray(scene.system.gravity)
    if member == "momentum":
        assert given.mu is not None
        return np.asarray(given.mu[0])
    states: Mapping[str, Array] = {"xdot0": scene.start.xdot, "xi0": scene.start.xi}
    return np.asarray(states.get(member, scene.system.parameter_values.get(member)))
