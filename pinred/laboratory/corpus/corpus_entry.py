"""Robot descriptions in folders, classified by their root XML element.

An entry is one row of the corpus table: a description and the outcome of its trial.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, TypeAlias
from xml.parsers import expat

from ...common.errors import LoadError
from ...common.files import write_table

Kind: TypeAlias = Literal["urdf", "mjcf", "sdf", "name"]
Outcome: TypeAlias = Literal[
    "passed", "without gravity", "refused", "stopped", "FAILED", "error", "fragment"
]
GOOD: tuple[Outcome, ...] = ("passed", "without gravity")


@dataclass(frozen=True)
class Entry:
    """The outcome of one description.

    Attributes:
        file: Path of the file, or name of the robot.
        kind: "urdf", "mjcf", "sdf" or "name".
        outcome: "passed"; "without gravity" (gravity breaks the symmetry of its root);
            "refused" (an error of pinred); "stopped" (the simulation or the time limit);
            "FAILED" (differs from ABA, MuJoCo or the independent reader); "error" (other exception,
            or a crash);
            "fragment" (only part of other files).
        reason: Reason of the outcome in one line.
        about: Category of the reason, for the summary.
        due: Whether the description should work, see `trial`.
        why_not: Reason why the description is not required to work.
        choice: Option that resolved an ambiguity of the description, such as "root=arm".
        group: Symmetry group of the system.
        joints: Number of joints m.
        duration: Duration of the motion [s].
        aba: Largest error against ABA, relative to the motion's size.
        allowed: Largest `aba` that passes.
        mass: Largest relative error of the mass matrix against MuJoCo's reading; NaN if none.
        forces: Largest relative error of the forces against MuJoCo's reading; NaN if none.
        second: Reason why there is no comparison with MuJoCo's reading.
        reader: Independent reader of the format whose reading was compared; "" if there is none
            or if it does not open the file.
        unread: Reason why that reader does not open the file.
        load: Time for loading [s].
        simulate: Time for the first simulation [s].
        wall: Total time [s].
    """

    file: str
    kind: Kind
    outcome: Outcome
    reason: str = ""
    about: str = ""
    due: bool = True
    why_not: str = ""
    choice: str = ""
    group: str = ""
    joints: int = -1
    duration: float = math.nan
    aba: float = math.nan
    allowed: float = math.nan
    mass: float = math.nan
    forces: float = math.nan
    second: str = ""
    reader: str = ""
    unread: str = ""
    load: float = math.nan
    simulate: float = math.nan
    wall: float = math.nan

    @property
    def good(self) -> bool:
        """Whether the description was loaded and simulated, and agrees with ABA and MuJoCo."""
        return self.outcome in GOOD


COLUMNS = tuple(field.name for field in fields(Entry))


def write_entries(path: Path, entries: Iterable[Entry]) -> None:
    """Write entries as csv; raise OutputError and keep the old file on failure."""
    write_table(path, COLUMNS, (vars(entry) for entry in entries))


_SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro", ".sdf", ".world", ".model")
_MOST_BYTES = 256_000_000
_KINDS: dict[str, Kind] = {"robot": "urdf", "mujoco": "mjcf", "sdf": "sdf"}


@dataclass(frozen=True)
class Description:
    """A robot description: a file, or the name of a robot.

    included: whether another file in the folders includes this file.
    """

    file: str
    kind: Kind
    included: bool = False


@dataclass(frozen=True)
class SearchResult:
    """The descriptions in some folders.

    Attributes:
        descriptions: Complete robot descriptions.
        fragments: Number of files with parts of robots only, for other files to include.
        macros: Number of templates that xacro must expand.
        copies: Number of files with the same content as another file.
    """

    descriptions: tuple[Description, ...]
    fragments: int = 0
    macros: int = 0
    copies: int = 0


@dataclass(frozen=True)
class _Header:
    """Properties of an XML file that determine its kind.

    tag: root element.  xacro: whether the file needs xacro.  has_bodies: whether the file has links
    or bodies.  includes: other files that this file includes.
    """

    tag: str
    xacro: bool
    has_bodies: bool
    includes: tuple[Path, ...]


def find_descriptions(folders: Iterable[str | Path]) -> SearchResult:
    """Find all robot descriptions in folders (or files), sorted by path, without duplicates.

    Args:
        folders: Folders or files.
    Returns:
        The descriptions, and the numbers of files of all other kinds.
    Raises:
        LoadError: A folder is missing.
    """
    files = sorted({path for folder in folders for path in _files(Path(folder))})
    headers = {path: header for path in files if (header := _read_header(path)) is not None}
    included = {path.resolve() for header in headers.values() for path in header.includes}
    fragments = macros = copies = 0
    contents: set[str] = set()
    descriptions = []
    for path, header in headers.items():
        if header.tag == "mujocoinclude" or not header.has_bodies:
            fragments += 1
        elif header.xacro:
            macros += 1
        else:
            content = _content_hash(path, headers, set())
            copies += content in contents
            if content not in contents:
                contents.add(content)
                kind = _KINDS[header.tag]
                descriptions.append(Description(str(path), kind, path.resolve() in included))
    return SearchResult(tuple(descriptions), fragments, macros, copies)


def _files(folder: Path) -> Iterator[Path]:
    if folder.is_file():
        yield folder
        return
    if not folder.is_dir():
        raise LoadError(f"no such folder: {folder}")
    for path in folder.rglob("*"):
        if path.suffix.lower() in _SUFFIXES and path.is_file():
            yield path


def _read_header(path: Path) -> _Header | None:
    """Read the XML up to its first error; return None if it is neither URDF, MJCF nor SDF."""
    first: list[tuple[str, bool]] = []
    includes: list[Path] = []
    has_bodies = False

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal has_bodies
        if not first:
            first.append((tag, any(name.startswith("xmlns:xacro") for name in attributes)))
        has_bodies |= tag in ("link", "body", "replicate", "attach", "composite", "flexcomp")
        if tag == "include" and "file" in attributes:
            includes.append(path.parent / attributes["file"])
            has_bodies = True
        has_bodies |= first[0][0] == "sdf" and tag == "include"

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    with suppress(expat.ExpatError, ValueError, OSError):
        if path.stat().st_size <= _MOST_BYTES:
            parser.Parse(path.read_bytes().lstrip(), True)
    if not first or first[0][0] not in (*_KINDS, "mujocoinclude"):
        return None
    tag, declared = first[0]
    xacro = tag == "robot" and (path.suffix == ".xacro" or (declared and _has_macros(path)))
    return _Header(tag, xacro, has_bodies, tuple(includes))


def _has_macros(path: Path) -> bool:
    text = path.read_bytes()
    return b"<xacro:" in text or b"${" in text


def _content_hash(path: Path, headers: dict[Path, _Header], including: set[Path]) -> str:
    """Hash a file with the files it includes; `including`: chain of files that include it."""
    content = hashlib.sha256()
    with suppress(OSError):
        content.update(path.read_bytes())
    for other in headers[path].includes if path in headers else ():
        if other not in including:
            content.update(_content_hash(other, headers, including | {path}).encode())
    return content.hexdigest()
