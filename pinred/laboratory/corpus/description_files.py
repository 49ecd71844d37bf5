"""Robot descriptions in folders: what a file is, by its outermost element."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from ...common.errors import LoadError
from .corpus_entry import Kind

_SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro")
_MOST_BYTES = 256_000_000


@dataclass(frozen=True)
class Description:
    """A robot description: a file, or the name of a robot.

    included: whether another file includes it.
    """

    file: str
    kind: Kind
    included: bool = False


@dataclass(frozen=True)
class Found:
    """The descriptions in some folders.

    fragments: how many files hold only parts of robots, for others to include.  macros: how many
    are templates that xacro has to expand.  copies: how many say the same as another file.
    """

    descriptions: tuple[Description, ...]
    fragments: int = 0
    macros: int = 0
    copies: int = 0


@dataclass(frozen=True)
class _Seen:
    """The outermost element of a file and what decides what it is.

    parts: whether it has links, or bodies.  includes: files that it names.
    """

    tag: str
    xacro: bool
    parts: bool
    includes: tuple[Path, ...]


def find_descriptions(folders: Iterable[str | Path]) -> Found:
    """Return all robots described in folders (or files), sorted by path, each content once.

    Raises LoadError for a folder that is not there.
    """
    files = sorted({path for folder in folders for path in _files(Path(folder))})
    seen = {path: found for path in files if (found := _look(path)) is not None}
    included = {path.resolve() for found in seen.values() for path in found.includes}
    fragments = macros = copies = 0
    known: set[str] = set()
    out = []
    for path, found in seen.items():
        if found.tag == "mujocoinclude" or not found.parts:
            fragments += 1
        elif found.xacro:
            macros += 1
        else:
            content = _content(path, seen, set())
            copies += content in known
            if content not in known:
                known.add(content)
                kind: Kind = "urdf" if found.tag == "robot" else "mjcf"
                out.append(Description(str(path), kind, path.resolve() in included))
    return Found(tuple(out), fragments, macros, copies)


def _files(folder: Path) -> Iterator[Path]:
    if folder.is_file():
        yield folder
        return
    if not folder.is_dir():
        raise LoadError(f"no such folder: {folder}")
    for path in folder.rglob("*"):
        if path.suffix.lower() in _SUFFIXES and path.is_file():
            yield path


def _look(path: Path) -> _Seen | None:
    """Return what a file is, None if it is neither URDF nor MJCF.

    Of text that is no XML, as far as it can be read.
    """
    first: list[tuple[str, bool]] = []
    includes: list[Path] = []
    parts = False

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal parts
        if not first:
            first.append((tag, any(name.startswith("xmlns:xacro") for name in attributes)))
        parts = parts or tag in ("link", "body", "replicate", "attach", "composite", "flexcomp")
        if tag == "include" and "file" in attributes:
            includes.append(path.parent / attributes["file"])
            parts = True

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    with suppress(expat.ExpatError, ValueError, OSError):
        if path.stat().st_size <= _MOST_BYTES:
            parser.Parse(path.read_bytes().lstrip(), True)
    if not first or first[0][0] not in ("robot", "mujoco", "mujocoinclude"):
        return None
    tag, declared = first[0]
    xacro = tag == "robot" and (path.suffix == ".xacro" or (declared and _has_macros(path)))
    return _Seen(tag, xacro, parts, tuple(includes))


def _has_macros(path: Path) -> bool:
    text = path.read_bytes()
    return b"<xacro:" in text or b"${" in text


def _content(path: Path, seen: dict[Path, _Seen], inside: set[Path]) -> str:
    """Return what stands in a file and in all that it includes, as a hash."""
    content = hashlib.sha256()
    with suppress(OSError):
        content.update(path.read_bytes())
    for other in seen[path].includes if path in seen else ():
        if other not in inside:
            content.update(_content(other, seen, inside | {path}).encode())
    return content.hexdigest()
