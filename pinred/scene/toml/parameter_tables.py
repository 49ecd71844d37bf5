"""Parameters in files: names with numbers, of the robot and of formulas.

A name with dots, such as hand.mass, is a table in TOML unless it stands in quotes; both say the
same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...system.model_parameters import kinds_near, size_of, with_parameters
from ...system.system import System
from .places import Place, naming
from .schema import Node, Schema
from .signal_keys import NUMBER, NUMBERS


@dataclass(frozen=True)
class NamedNumbers(Node):
    """A table from names to numbers, or lists of them; tables in it are parts of names."""

    types = (dict,)
    words = "a table {name = number or list of numbers}"

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for name, entry in value.items():
            here = place / name
            node: Node = self if isinstance(entry, dict) else NUMBER
            if isinstance(entry, list):
                node = NUMBERS
            out[name] = node.read(entry, here)
        return out

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return a reference to a schema that holds itself, and put that among defs."""
        if "parameters" not in defs:
            defs["parameters"] = {}
            kinds = [NUMBER.schema(defs), NUMBERS.schema(defs), {"$ref": "#/$defs/parameters"}]
            defs["parameters"] = {"type": "object", "additionalProperties": {"anyOf": kinds}}
        return {"$ref": "#/$defs/parameters"}


@dataclass(frozen=True)
class FileParameter:
    """A parameter in a file.  place: where it stands."""

    name: str
    value: Any
    place: Place


def file_parameters(document: Mapping[str, Any], place: Place) -> list[FileParameter]:
    """Return the parameters of a document.  Raises InputError for one that is given twice."""
    found: dict[str, FileParameter] = {}
    for each in _flat(document.get("parameters", {}), "", place / "parameters"):
        if each.name in found:
            each.place.fail(f"'{each.name}' is given twice, here and as a name in another form")
        found[each.name] = each
    return list(found.values())


def _flat(table: Mapping[str, Any], before: str, place: Place) -> Iterator[FileParameter]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{key}.", place / key)
        else:
            yield FileParameter(before + key, value, place / key)


def with_robots_own(
    system: System, given: Sequence[FileParameter], place: Place
) -> tuple[System, list[FileParameter]]:
    """Return the robot with those parameters that are numbers of it, and the others.

    Raises InputError, naming the key, for what it does not have, and for values of no real robot.
    """
    mine: dict[str, Any] = {}
    others: list[FileParameter] = []
    for each in given:
        with naming(each.place, "parameters: "):
            if size_of(system, each.name) is None:
                others.append(each)
                continue
            mine[each.name] = each.value
            with_parameters(system, {each.name: each.value})
    with naming(place / "parameters", "parameters: "):
        return with_parameters(system, mine) if mine else system, others


def refuse_others(system: System, others: Sequence[FileParameter]) -> None:
    """Raise InputError for parameters that are no numbers of the robot, where only these count."""
    for each in others:
        each.place.fail(f"there is no '{each.name}'; {kinds_near(system, each.name)}")
