"""The outputs of a sweep: fields of the states, their entries, and functions of the members."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ..common.argument_kinds import call_function
from ..common.arrays import Array, as_floats
from ..common.errors import InputError, ShapeError
from ..common.names import brief, listed, nearest, quoted
from ..scene.scene import Scene
from ..simulation.members.trajectories import Trajectories
from ..system.entry_labels import entry_names, label_entries
from ..system.state_fields import FIELDS, ShapeState, State, dimension

Function: TypeAlias = Callable[[Trajectories], Any]
Outputs: TypeAlias = Mapping[str, str | Function] | Sequence[str]
_FIELD = re.compile(r"(\w+)(?:\.(.+?))?(\(t\))?")
_DEFAULT = ("x", "xdot", "pose", "energy")


@dataclass(frozen=True)
class Output:
    """One output of a sweep.

    Attributes:
        name: Name in the results.
        field: Field of State; "" for a function.
        entry: Index of the stored entry; None for all entries.
        over_time: Whether all report times are stored, not only the last one.
        function: Function of the members, or None.
        dims: Names of the dimensions after the point.
        unit: Unit; "" if unknown.
    """

    name: str
    field: str
    entry: int | None
    over_time: bool
    function: Function | None
    dims: tuple[str, ...]
    unit: str

    def read(self, fields: Mapping[str, Array], many: Trajectories) -> Array:
        """Return the values of all members, (N, …).

        Args:
            fields: Fields of State that the outputs need, (N, T, …).
            many: The members.
        Raises:
            InputError: The function raises an exception.
            ShapeError: The function returns other than one row of numbers for each member.
        """
        if self.function is not None:
            values = self._computed(self.function, many)
            if values.ndim == 0 or len(values) != len(many):
                raise ShapeError(
                    f"outputs: the function of {quoted(self.name)} must return one row for each of "
                    f"the {len(many)} members, got shape {values.shape}"
                )
            return values
        values = fields[self.field]
        if self.entry is not None:
            values = values[..., self.entry]
        return values if self.over_time else values[:, -1]

    def _computed(self, function: Function, many: Trajectories) -> Array:
        name = quoted(self.name)
        values = call_function(function, f"outputs: the function of {name}", many)
        if isinstance(values, np.ndarray) and values.dtype == bool:
            values = values.astype(float)
        return as_floats(values, f"outputs: the values of {name}")


def parse_outputs(scene: Scene, outputs: Outputs | None) -> tuple[Output, ...]:
    """Return the outputs of a sweep.

    Args:
        scene: The scene.
        outputs: {name: field or function}, a list of fields, or None for the default.
    Returns:
        The outputs.
    Raises:
        InputError: A field is unknown, or the argument has another form.
    """
    known = _fields_of(scene)
    if outputs is None:
        outputs = [name for name in _DEFAULT if name in known]
    if not isinstance(outputs, Mapping):
        if isinstance(outputs, str) or not all(isinstance(name, str) for name in outputs):
            raise InputError(
                f"outputs: expected {{name: field or function}} or a list of fields, got "
                f"{brief(outputs)}"
            )
        outputs = {name.removesuffix("(t)"): name for name in outputs}
    if not outputs:
        raise InputError(f"outputs: expected at least one; the fields are {listed(known, 60)}")
    return tuple(_output(scene, name, value, known) for name, value in outputs.items())


def _fields_of(scene: Scene) -> list[str]:
    kind = State if scene.outputs == "all" else ShapeState
    return [name for name in kind.__dataclass_fields__ if name != "t"]


def _output(scene: Scene, name: str, value: str | Function, known: Sequence[str]) -> Output:
    if callable(value):
        return Output(name, "", None, over_time=True, function=value, dims=(), unit="")
    match = _FIELD.fullmatch(value) if isinstance(value, str) else None
    if match is None or match[1] not in known:
        near = nearest(match[1], known) if match else ""
        raise InputError(
            f"outputs: {quoted(name)}: expected a function or a field, got {brief(value)}; {near}"
            f"the fields are {listed(known, 60)}, each also as FIELD.ENTRY, and over time as "
            "FIELD(t)"
        )
    field, label, over_time = match[1], match[2], match[3] is not None
    dims, entry = ("t",) * over_time, None
    labels = label_entries(scene.system, field)
    unit = " | ".join(dict.fromkeys(unit for _, unit in labels)) or FIELDS[field].unit
    if label is not None:
        names = entry_names(scene.system, field)
        if FIELDS[field].axis is None or label not in names:
            entries = listed([text for text, _ in labels], 60) or "none"
            raise InputError(
                f"outputs: {quoted(name)}: {field} has no entry {quoted(label)}; "
                f"{nearest(label, list(names))}the entries are {entries}"
            )
        entry = names[label]
        unit = labels[entry][1] or unit
    elif (axis := FIELDS[field].axis) is not None:
        dims = (*dims, dimension(scene.system, axis))
    return Output(name, field, entry, over_time, None, dims, unit)
