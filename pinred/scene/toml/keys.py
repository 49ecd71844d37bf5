"""The keys of scene files, derived from the descriptions of the scene options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...common.argument_kinds import checks_arguments
from ..load_options import LOAD
from ..scene_options import RUN_OPTIONS, SCENE_OPTIONS, Option, list_conflicts
from ..sweep_options import SWEEP
from .schema import Key, Schema, Table, Text, document_schema, with_places

# The keys of scene files and gait files that name the robot.
ROBOT = {
    "robot": Key(
        Text(),
        "a robot's name, or a URDF or MJCF file relative to this file (with a suffix or /)",
        required=True,
    ),
    "load": Key(LOAD, "how to read the robot: the options of pinred.load"),
}
_TABLES = {"start": "the initial state", "run": "how to simulate"}
FILE_OPTIONS: Mapping[str, Option] = {**SCENE_OPTIONS, **RUN_OPTIONS}


def scene_table(options: Mapping[str, Option]) -> Table:
    """Return the table of keys of a scene file with these options."""

    def keys_in(table: str) -> dict[str, Key]:
        return {name: option for name, option in options.items() if option.table == table}

    tables = {
        name: Table(
            keys_in(name),
            words,
            apart=tuple(p for p in list_conflicts(options) if {*p} <= keys_in(name).keys()),
        )
        for name, words in _TABLES.items()
    }
    keys = {**ROBOT, **{name: Key(table, table.words) for name, table in tables.items()}}
    return with_places(Table(keys | keys_in("") | {"sweep": SWEEP}, "a scene"))


def options_in(document: Mapping[str, Any], options: Mapping[str, Option]) -> dict[str, Any]:
    """Return {option: value} of a document that scene_table has validated."""
    tables = {"": document, **{name: document.get(name, {}) for name in _TABLES}}
    return {
        name: tables[option.table][name]
        for name, option in options.items()
        if name in tables[option.table]
    }


SCENE = scene_table(FILE_OPTIONS)


@checks_arguments
def scene_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of scene files, as parsed from TOML.

    Returns:
        The schema, as a dictionary that can be written as JSON.
    """
    return document_schema(SCENE, "pinred scene")
