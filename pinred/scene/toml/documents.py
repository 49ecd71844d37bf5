"""TOML documents: their keys, derived from the options, and the robot that they name."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, LoadError, PinredError
from ...common.files import is_file
from ...system.load import load
from ...system.loops.loop import SUFFIXES
from ...system.robot_files import bundled_robots
from ...system.system import System
from ..scene_options import LOAD, RUN_OPTIONS, SCENE_OPTIONS, SWEEP, Option, list_conflicts
from .schema import (
    Either,
    Flag,
    Key,
    ListOf,
    Number,
    Place,
    Schema,
    Table,
    Text,
    document_schema,
    one_line,
    read_text,
    with_places,
)

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


# Options of a run that a part of a chain does not have, and those that only its first robot has.
_OF_ONE_MOTION = ("outputs", "checkpoint")
_OF_FIRST = ("duration", "times", "samples", "events")
# What happens before a later phase, by key.
IMPACTS = {
    "capture": Key(
        Table(
            {
                "at": Key(Text(), "link or frame of the first robot", required=True),
                "onto": Key(Text(), "link or frame of the second one", required=True),
                "tolerance": Key(
                    Number(positive=True),
                    "largest distance [m] and angle [rad] of the frames",
                    default="1e-6",
                ),
                "prefix": Key(
                    Text(),
                    "text before the names of the second",
                    default="its name if names collide",
                ),
                "align": Key(
                    Flag(),
                    "move the start of the second robot, so that the frames meet",
                    default="false",
                ),
            },
            "a capture",
        ),
        "the robots become one, by a plastic impact (docs/capture.md)",
    ),
    "release": Key(
        Table(
            {
                "link": Key(
                    Text(), "link behind the joint that opens, or the joint", required=True
                ),
                "root": Key(
                    Text(), "link of the released part that its pose describes", default="link"
                ),
            },
            "a release",
        ),
        "the robot becomes two; the released part is the second",
    ),
    "land": Key(
        Table(
            {
                "frame": Key(
                    Either((Text(), ListOf(Text()))), "frame that stops, or several", required=True
                ),
                "contact": Key(
                    Text(("point", "flat")),
                    "point: its origin stops; flat: it stops turning, too",
                    default="point",
                ),
            },
            "a landing",
        ),
        "the robot stops at the ground and turns about its foot",
    ),
}


def scene_table(options: Mapping[str, Option]) -> Table:
    """Return the table of keys of a scene file with these options."""
    remaining = {name: option for name, option in options.items() if name not in _OF_ONE_MOTION}
    second = {name: option for name, option in remaining.items() if name not in _OF_FIRST}
    later = {name: option for name, option in remaining.items() if option.table != "start"}
    beside = {name: option for name, option in second.items() if option.table != "start"}
    pairs = [(a, b) for a in IMPACTS for b in IMPACTS if a < b]
    words = "forces, prescribed joints and so on of the second robot"
    motion = Table(_motion_keys(beside), words)
    phase = Table(
        {**IMPACTS, **_motion_keys(later), "second": Key(motion, words)},
        "a phase",
        apart=tuple(pairs),
    )
    another = Table({**ROBOT, **_motion_keys(second)}, "another robot")
    keys = {
        "sweep": SWEEP,
        "second": Key(another, "another robot, which moves at the same time until both become one"),
        "phases": Key(
            ListOf(phase),
            "what follows the motion, each with an impact before it or without",
            default="none",
        ),
    }
    return with_places(
        Table(
            {**ROBOT, **_motion_keys(options), **keys},
            "a scene",
            apart=(("sweep", "phases"),),
        )
    )


def _motion_keys(options: Mapping[str, Option]) -> dict[str, Key]:
    """Return the keys of the options of a motion, in their tables."""

    def keys_in(table: str) -> dict[str, Key]:
        return {name: option for name, option in options.items() if option.table == table}

    tables = {
        name: Table(
            keys_in(name),
            words,
            apart=tuple(p for p in list_conflicts(options) if {*p} <= keys_in(name).keys()),
        )
        for name, words in _TABLES.items()
        if keys_in(name)
    }
    return {name: Key(table, table.words) for name, table in tables.items()} | keys_in("")


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


_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+\s*\.\s*){50}""")


def read_document(path: str | Path, table: Table, kind: str) -> tuple[dict[str, Any], Place]:
    """Read a TOML file and validate its keys.

    Args:
        path: Path of the file.
        table: The valid keys.
        kind: "scene" or "gait", for messages.
    Returns:
        The document, and the place of its top level.
    Raises:
        InputError: a key or a value is not valid.
        LoadError: the file cannot be read.
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"load_{kind} takes the path of a TOML file, got {type(path).__name__}")
    text = read_text(Path(path), f"{kind} file")
    place = Place(str(Path(path)), text)
    return table.read(_parsed(text, place, f"a {kind}"), place), place


def _parsed(text: str, place: Place, what: str) -> dict[str, Any]:
    """Parse a TOML text.  Raises LoadError if it is not TOML; `what` names the expected content."""
    if _LONG_KEY.search(text):
        raise LoadError(f"{place.file}: not {what}: a key of more than 50 parts")
    try:
        return tomllib.loads(text + "\n")  # With a final line break, every error has a line number.
    except tomllib.TOMLDecodeError as error:
        match = re.fullmatch(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", str(error))
        problem, where = match.groups() if match else (str(error), None)
        raise LoadError(f"{place.file}, {where or 'at its end'}: not TOML: {problem}") from None
    except RecursionError:
        raise LoadError(f"{place.file}: not {what}: tables or lists nested too deeply") from None
    except ValueError:
        raise LoadError(f"{place.file}: not TOML: a number with thousands of digits") from None


def robot_in(document: Mapping[str, Any], folder: Path, place: Place) -> System:
    """Load the robot that a document names, with the options in its table `load`.

    Args:
        document: The document.
        folder: Folder of the file; paths in the document are relative to it.
        place: Place of the top level of the document.
    Returns:
        The robot.
    Raises:
        InputError: the file of the robot does not exist.
        PinredError: `pinred.load` fails; the message names the key.
    """
    robot, options = document["robot"], dict(document.get("load", {}))
    if "meshes" in options:
        meshes = options["meshes"]
        paths = [meshes] if isinstance(meshes, str) else meshes
        options["meshes"] = [folder / path for path in paths]
    loops = options.get("loops")
    if isinstance(loops, str) and loops.endswith(SUFFIXES):
        options["loops"] = folder / loops
    source: str | Path = robot
    file = folder / robot
    exists = is_file(file)
    if robot not in bundled_robots() and (exists or "/" in robot or Path(robot).suffix):
        if not exists:
            (place / "robot").fail(f"no such file: {str(file)!r}")
        source = file
    try:
        return load(source, **options)
    except PinredError as error:
        key = "load" if isinstance(error, InputError) else "robot"
        raise type(error)((place / key).message(one_line(error))) from None
