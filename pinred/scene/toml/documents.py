"""Documents of TOML: parsed with the line of a fault, and the robot that they name."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...common.errors import InputError, LoadError, PinredError
from ...system.catalogue import bundled_robots
from ...system.load import load
from ...system.system import System
from .csv_columns import read_text
from .places import Place, one_line
from .schema import Table

_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+\s*\.\s*){50}""")


def read_document(path: str | Path, table: Table, kind: str) -> tuple[dict[str, Any], Place]:
    """Return the document of a file, which has the keys that it should have, and its place.

    kind: "scene" or "gait", for messages.  Raises LoadError for a file that cannot be read, and
    InputError for a key.
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"load_{kind} takes the path of a TOML file, got {type(path).__name__}")
    text = read_text(Path(path), f"{kind} file")
    place = Place(str(Path(path)), text)
    return table.read(_parsed(text, place, f"a {kind}"), place), place


def _parsed(text: str, place: Place, what: str) -> dict[str, Any]:
    """Return the tables of a text.  Raises LoadError, that it is not `what`, if it is not TOML."""
    if _LONG_KEY.search(text):
        raise LoadError(f"{place.file}: not {what}: a key of more than 50 parts")
    try:
        return tomllib.loads(text + "\n")  # so that every fault has its line
    except tomllib.TOMLDecodeError as error:
        said = re.fullmatch(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", str(error))
        problem, where = said.groups() if said else (str(error), None)
        raise LoadError(f"{place.file}, {where or 'at its end'}: not TOML: {problem}") from None
    except RecursionError:
        raise LoadError(f"{place.file}: not {what}: tables or lists nested too deep") from None
    except ValueError:
        raise LoadError(f"{place.file}: not TOML: a number of thousands of digits") from None


def robot_in(document: Mapping[str, Any], folder: Path, place: Place) -> System:
    """Return the robot that a document names, loaded with the options under `load`.

    folder: of the file, to which paths in it are relative.  Raises what load does, with the key.
    """
    robot, options = document["robot"], dict(document.get("load", {}))
    if "meshes" in options:
        given = options["meshes"]
        folders = [given] if isinstance(given, str) else given
        options["meshes"] = [folder / one for one in folders]
    source: str | Path = robot
    file = folder / robot
    exists = _is_file(file)
    if robot not in bundled_robots() and (exists or "/" in robot or Path(robot).suffix):
        if not exists:
            (place / "robot").fail(f"no such file: {str(file)!r}")
        source = file
    try:
        return load(source, **options)
    except PinredError as error:
        key = "load" if isinstance(error, InputError) else "robot"
        raise type(error)((place / key).tell(one_line(error))) from None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # no name of a file at all
        return False
