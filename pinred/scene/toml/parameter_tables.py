"""Parameters in files: robot parameters, and parameters of formulas, by name.

A name with dots, such as hand.mass, may be written in TOML as nested tables or as a quoted key.
Both forms have the same meaning.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...system.body_parameters import refuse_vague
from ...system.model_parameters import kinds_near, size_of, with_parameters
from ...system.system import System
from .file_place import Place, naming
from .schema import Node, Schema
from .signal_tables import NUMBER, NUMBERS


@dataclass(frozen=True)
class NamedNumbers(Node):
    """A table from names to numbers or lists of numbers; nested tables extend the names."""

    types = (dict,)
    words = "a table {name = number or list of numbers}"
    name = "parameters"

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for name, entry in value.items():
            node: Node = self if isinstance(entry, dict) else NUMBER
            if isinstance(entry, list):
                node = NUMBERS
            values[name] = node.read(entry, place / name)
        return values

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        nodes = (NUMBER, NUMBERS, self)
        return {
            "type": "object",
            "additionalProperties": {"anyOf": [node.schema(defs) for node in nodes]},
        }


@dataclass(frozen=True)
class FileParameter:
    """A parameter in a file.

    Attributes:
        name: Full name, with dots.
        value: A number or a list of numbers.
        place: Its place in the file.
    """

    name: str
    value: Any
    place: Place


def file_parameters(document: Mapping[str, Any], place: Place) -> list[FileParameter]:
    """Return the parameters of a document; raise InputError if a name occurs twice."""
    parameters: dict[str, FileParameter] = {}
    for parameter in _flatten(document.get("parameters", {}), "", place / "parameters"):
        if parameter.name in parameters:
            parameter.place.fail(
                f"'{parameter.name}' is given twice, here and as a name in another form"
            )
        parameters[parameter.name] = parameter
    return list(parameters.values())


def _flatten(table: Mapping[str, Any], prefix: str, place: Place) -> Iterator[FileParameter]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}.", place / key)
        else:
            yield FileParameter(prefix + key, value, place / key)


def with_robot_parameters(
    system: System, parameters: Sequence[FileParameter], place: Place
) -> tuple[System, list[FileParameter]]:
    """Apply the parameters of a file that belong to the robot.

    Args:
        system: The robot as loaded.
        parameters: The parameters of the file.
        place: Place of the top level of the document.
    Returns:
        The robot with its parameters, and the remaining parameters, which belong to formulas.
    Raises:
        InputError: a value is not physical; the message names the key.
    """
    values: dict[str, Any] = {}
    other_parameters: list[FileParameter] = []
    for parameter in parameters:
        with naming(parameter.place, "parameters: "):
            if size_of(system, parameter.name) is None:
                other_parameters.append(parameter)
                continue
            refuse_vague(system, parameter.name)
            values[parameter.name] = parameter.value
            with_parameters(system, {parameter.name: parameter.value})
    with naming(place / "parameters", "parameters: "):
        return with_parameters(system, values) if values else system, other_parameters


def refuse_others(system: System, others: Sequence[FileParameter]) -> None:
    """Raise InputError for parameters that the robot does not have."""
    for parameter in others:
        parameter.place.fail(
            f"there is no '{parameter.name}'; {kinds_near(system, parameter.name)}"
        )
