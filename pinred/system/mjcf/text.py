"""Size limits on MJCF files and their includes, checked before MuJoCo parses them.

MuJoCo's parser recurses, and expands <replicate>, <flexcomp> and <attach>, so a few lines could
exhaust the memory or the stack.  This module counts the expanded elements without making them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from ...common.errors import LoadError
from ...common.paths import is_file
from ...common.plain_names import plain_path
from ..robot_files import read_text

_DEEPEST = 450  # nested elements; MuJoCo refuses 500
_DEEPEST_INCLUDES = 50  # nested files
_MOST = 100_000  # expanded elements; the largest files in use have a tenth of that
_CELLS = 100  # cells of a height field that need as much memory as one element
_MOST_ATTRIBUTES = 100  # attributes of one element; MuJoCo's schema has half as many
_MOST_LETTERS = 64_000_000  # characters of all files together


@dataclass
class _Open:
    """An open element.  before: number of elements ahead of it."""

    tag: str
    attributes: dict[str, str]
    before: int


@dataclass
class _Measure:
    """The size of a file and its includes, as far as they were read.

    Attributes:
        top: Folder of the file.
        count: Number of expanded elements.
        letters: Number of characters.
        named: Number of elements in each named body or frame.
        models: Number of elements in each attached file, by its model name.
        reading: Open files, each included by the one before.
    """

    top: Path
    count: int = 0
    letters: int = 0
    named: dict[str, int] = field(default_factory=dict)
    models: dict[str, int] = field(default_factory=dict)
    reading: list[Path] = field(default_factory=list)


def check_text(path: Path, text: str) -> None:
    """Refuse an MJCF file, with its text, that is too large or too deep for a parser.

    Raises LoadError with the file at fault.
    """
    _measure(path, text, _Measure(path.parent), 0)


def _measure(path: Path, text: str, size: _Measure, depth: int) -> None:
    """Add the size of a file to `size`.  depth: number of elements around it."""
    size.letters += len(text)
    if size.letters > _MOST_LETTERS:
        raise LoadError(f"{plain_path(path)}: more than {_MOST_LETTERS} letters of MJCF in all")
    if path.resolve() in size.reading or len(size.reading) > _DEEPEST_INCLUDES:
        raise LoadError(f"{plain_path(path)} includes itself, or too many files include each other")
    size.reading.append(path.resolve())
    stack: list[_Open] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = _Open(tag.lower(), attributes, size.count)
        stack.append(element)
        size.count += 1
        if depth + len(stack) > _DEEPEST:
            raise LoadError(f"{where()}: more than {_DEEPEST} elements within one another")
        if len(attributes) > _MOST_ATTRIBUTES:
            raise LoadError(f"{where()}: <{tag}> has more than {_MOST_ATTRIBUTES} attributes")
        if element.tag in ("include", "model") and "file" in attributes:
            _measure_named(path, attributes, element.tag, size, depth + len(stack))
        elif element.tag in _EXPANSIONS:
            size.count += _EXPANSIONS[element.tag](attributes)
        elif element.tag == "attach":
            size.count += size.models.get(attributes.get("model", ""), 0)
            size.count += _attached_size(
                attributes.get("body", attributes.get("frame", "")), size.named
            )
        check_count()

    def end(_: str) -> None:
        element = stack.pop()
        count = size.count - element.before
        if element.tag == "replicate":
            count *= _product(element.attributes.get("count", ""))
            size.count = element.before + count
            check_count()
        if element.tag in ("body", "frame") and "name" in element.attributes:
            name = element.attributes["name"]
            size.named[name] = max(count, size.named.get(name, 0))

    def where() -> str:
        return f"{path}, line {parser.CurrentLineNumber}"

    def check_count() -> None:
        if size.count > _MOST:
            raise LoadError(f"{where()}: more than {_MOST} elements of MJCF in all")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise LoadError(f"{plain_path(path)} is not XML: {error}") from None
    size.reading.pop()


def _measure_named(
    path: Path, attributes: dict[str, str], tag: str, size: _Measure, depth: int
) -> None:
    """Measure a file that is included, or attached as a model, in every folder it may be in."""
    before = size.count
    name, last = attributes["file"], Path(attributes["file"]).name
    folders = dict.fromkeys((size.top, path.parent))
    files = [folder / name for folder in folders]
    # With strippath="true" only the last component of a name counts.  It may name an open file,
    # which MuJoCo does not include again.
    stripped = [folder / last for folder in folders if name != last]
    if tag == "include":
        stripped = [file for file in stripped if file.resolve() not in size.reading]
    for file in dict.fromkeys([*files, *stripped]):
        if is_file(file):
            _measure(file, read_text(file), size, depth)
    if tag == "model":  # Its elements count where it is attached.
        name = attributes.get("name", Path(attributes["file"]).stem)
        size.models[name], size.count = size.count - before, before


def _product(counts: str) -> int:
    """Return the product of the whole numbers in a text, at least 1 and bounded above."""
    product = 1.0
    for word in counts.split():
        try:
            product *= max(1.0, float(word))
        except ValueError:  # MuJoCo refuses the word.
            continue
    return int(min(product, _CELLS * _MOST))


def _mesh_vertices(attributes: dict[str, str]) -> int:
    """Return about how many vertices a mesh has that MuJoCo generates from parameters."""
    if "builtin" not in attributes:
        return 0
    first, *more = attributes.get("params", "").split() or [""]
    # Superquadrics are divided along both directions by the first parameter.
    twice = attributes["builtin"].startswith("super")
    return _product(f"{first} {first if twice else more[0] if more else ''}")


# Number of elements to which MuJoCo expands one element.  A cell of a height field is one number.
_EXPANSIONS: dict[str, Callable[[dict[str, str]], int]] = {
    "flexcomp": lambda attributes: (
        _product(attributes.get("count", "")) + _product(attributes.get("cellcount", ""))
    ),
    "mesh": _mesh_vertices,
    "hfield": lambda attributes: (
        _product(f"{attributes.get('nrow', '')} {attributes.get('ncol', '')}") // _CELLS
    ),
}


def _attached_size(target: str, sizes: dict[str, int]) -> int:
    """Return the number of elements in an attached body; its name may have a prefix."""
    return max((count for name, count in sizes.items() if target.endswith(name)), default=0)
