"""The text of an MJCF file and of what it includes, measured before MuJoCo's parser sees it.

That parser recurses, and unrolls <replicate>, <flexcomp> and <attach>: a few lines could fill
the memory or the stack.  Here the elements that a file unrolls to are counted, not made.
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

_DEEPEST = 450  # elements in one another; MuJoCo refuses 500
_DEEPEST_INCLUDES = 50  # files in one another
_MOST = 100_000  # elements, unrolled; the largest files in use have a tenth
_CELLS = 100  # of a landscape, that take no more room than an element
_MOST_ATTRIBUTES = 100  # of one element; MuJoCo's schema has half as many
_MOST_LETTERS = 64_000_000  # of all files together


@dataclass
class _Open:
    """An element that is being read.  before: elements ahead of it."""

    tag: str
    attributes: dict[str, str]
    before: int


@dataclass
class _Measure:
    """The amount read so far: of a file, and of all that it includes.

    top: the folder of the file.  count: elements, unrolled.  letters: of all texts.  named: how
    many elements a body or frame of a name has.  models: the same of files that are attached.
    reading: the files that are open, one included by the other.
    """

    top: Path
    count: int = 0
    letters: int = 0
    named: dict[str, int] = field(default_factory=dict)
    models: dict[str, int] = field(default_factory=dict)
    reading: list[Path] = field(default_factory=list)


def check_text(path: Path, text: str) -> None:
    """Refuse an MJCF file that would be too large or too deep for a parser.

    text: what stands in it.  Raises LoadError with the file at fault.
    """
    _measure(path, text, _Measure(path.parent), 0)


def _measure(path: Path, text: str, found: _Measure, depth: int) -> None:
    found.letters += len(text)
    if found.letters > _MOST_LETTERS:
        raise LoadError(f"{plain_path(path)}: more than {_MOST_LETTERS} letters of MJCF in all")
    if path.resolve() in found.reading or len(found.reading) > _DEEPEST_INCLUDES:
        raise LoadError(f"{plain_path(path)} includes itself, or too many files include each other")
    found.reading.append(path.resolve())
    inside: list[_Open] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = _Open(tag.lower(), attributes, found.count)
        inside.append(element)
        found.count += 1
        if depth + len(inside) > _DEEPEST:
            raise LoadError(f"{where()}: more than {_DEEPEST} elements within one another")
        if len(attributes) > _MOST_ATTRIBUTES:
            raise LoadError(f"{where()}: <{tag}> has more than {_MOST_ATTRIBUTES} attributes")
        if element.tag in ("include", "model") and "file" in attributes:
            _measure_named(path, attributes, element.tag, found, depth + len(inside))
        elif element.tag in _MAKES:
            found.count += _MAKES[element.tag](attributes)
        elif element.tag == "attach":
            found.count += found.models.get(attributes.get("model", ""), 0)
            found.count += _size_of(
                attributes.get("body", attributes.get("frame", "")), found.named
            )
        check_count()

    def end(_: str) -> None:
        element = inside.pop()
        own = found.count - element.before
        if element.tag == "replicate":
            own *= _product(element.attributes.get("count", ""))
            found.count = element.before + own
            check_count()
        if element.tag in ("body", "frame") and "name" in element.attributes:
            name = element.attributes["name"]
            found.named[name] = max(own, found.named.get(name, 0))

    def where() -> str:
        return f"{path}, line {parser.CurrentLineNumber}"

    def check_count() -> None:
        if found.count > _MOST:
            raise LoadError(f"{where()}: more than {_MOST} elements of MJCF in all")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise LoadError(f"{plain_path(path)} is not XML: {error}") from None
    found.reading.pop()


def _measure_named(
    path: Path, attributes: dict[str, str], tag: str, found: _Measure, depth: int
) -> None:
    """Measure a file that is included, or attached as a model, in any place it may stand in."""
    before = found.count
    name, last = attributes["file"], Path(attributes["file"]).name
    folders = dict.fromkeys((found.top, path.parent))
    files = [folder / name for folder in folders]
    # With strippath="true" only the last part of a name counts; it may be that of a file which
    # is being read, and which MuJoCo does not include again.
    stripped = [folder / last for folder in folders if name != last]
    if tag == "include":
        stripped = [file for file in stripped if file.resolve() not in found.reading]
    for file in dict.fromkeys([*files, *stripped]):
        if is_file(file):
            _measure(file, read_text(file), found, depth)
    if tag == "model":  # it counts where it is attached
        name = attributes.get("name", Path(attributes["file"]).stem)
        found.models[name], found.count = found.count - before, before


def _product(counts: str) -> int:
    """Return the product of whole numbers in a text, 1 at least and bounded above."""
    product = 1.0
    for word in counts.split():
        try:
            product *= max(1.0, float(word))
        except ValueError:  # MuJoCo will say so
            continue
    return int(min(product, _CELLS * _MOST))


def _of_mesh(attributes: dict[str, str]) -> int:
    """Return about how many vertices a mesh has that MuJoCo makes of a few parameters."""
    if "builtin" not in attributes:
        return 0
    first, *more = attributes.get("params", "").split() or [""]
    twice = attributes["builtin"].startswith("super")  # around and along
    return _product(f"{first} {first if twice else more[0] if more else ''}")


# What MuJoCo makes of a single element, in elements; a cell of a landscape is only a number.
_MAKES: dict[str, Callable[[dict[str, str]], int]] = {
    "flexcomp": lambda said: _product(said.get("count", "")) + _product(said.get("cellcount", "")),
    "mesh": _of_mesh,
    "hfield": lambda said: _product(f"{said.get('nrow', '')} {said.get('ncol', '')}") // _CELLS,
}


def _size_of(target: str, sizes: dict[str, int]) -> int:
    """Return how many elements what is attached has; its name may have got a prefix before."""
    return max((size for name, size in sizes.items() if target.endswith(name)), default=0)
