"""Robot description files as text and as XML elements, and detection of MJCF files.

`read_text` rejects files that are too large.  `read_xml` rejects files with too many elements, or
elements that are nested too deeply.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree
from xml.parsers import expat

from ..common.errors import LoadError, ModelError
from ..common.files import is_file, is_folder
from ..common.names import plain_path, quoted, quoted_path

_MOST_BYTES = 256_000_000  # largest accepted size of a file [byte]
_DEEPEST = 100  # largest depth of nested URDF elements; valid files need only a few
_MOST_ELEMENTS = 1_000_000
_CHUNK = 4096  # number of characters per call of the XML parser
_ELEMENT = re.compile(r"<[^!?]")
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)
# Name of the robot in the outermost element of URDF, MJCF, or the model of SDF.
_NAME = re.compile(
    r"""<(?:robot|mujoco|model)\s[^>]*?\b(?:name|model)\s*=\s*["']([\w-]{1,100})["']"""
)

_TAGS = {  # tags of elements by the words for them in messages
    "link": ("link",),
    "joint": ("joint", "freejoint", "drake:joint"),
    "body": ("body",),
    "tendon": ("fixed", "spatial"),
}
# Constraints of an MJCF file, named by their kinds; a joint of this kind is no joint of a body.
_EQUALITY = "equality (?:connect|weld|joint|tendon)"
_MENTION = re.compile(rf"\b({_EQUALITY}|{'|'.join(_TAGS)}) ('[^']*')")
# Elements of MJCF that add constraints, so that their numbers are not those of the file.
_COPIES = ("include", "replicate", "attach", "composite", "flexcomp")
_LINE = re.compile(r"\bline \d")


class FileElement(ElementTree.Element):
    """An element of a file.

    Attributes:
        line: Number of its line in the file, from 1; 0 for an element that no file contains.
    """

    line: int = 0


def line_of(element: ElementTree.Element) -> int:
    """Return the number of the line of an element, from 1; 0 if it is in no file."""
    return element.line if isinstance(element, FileElement) else 0


def place(element: ElementTree.Element) -> str:
    """Return the line of an element in its file, as " (line 7)"; "" if it has none."""
    line = line_of(element)
    return f" (line {line})" if line else ""


def read_text(path: Path) -> str:
    """Return the text of an XML file.  Raises LoadError."""
    if not is_file(path):
        what = "is a folder" if is_folder(path) else "no such file"
        raise LoadError(f"{what}: {plain_path(path)}")
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise LoadError(
            f"the name {quoted_path(path)} has bytes that are not UTF-8, which neither Pinocchio "
            "nor MuJoCo opens; rename the file or its folder"
        ) from None
    try:
        # The operating system's virtual files, which may be endless, also report size zero.
        if path.stat().st_size == 0:
            raise LoadError(f"{plain_path(path)} is empty; a robot file must be XML")
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise LoadError(f"{plain_path(path)} is larger than {_MOST_BYTES // 10**6} MB")
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise LoadError(
            f"{plain_path(path)} is not XML in UTF-8; save it in this encoding"
        ) from None
    except OSError as error:
        raise LoadError(f"{plain_path(path)} cannot be read: {error.strerror}") from None
    if "<!DOCTYPE" in text:
        raise LoadError(
            f"{plain_path(path)} declares a document type, which is not supported; "
            "remove the <!DOCTYPE> declaration"
        )
    return text


def is_mjcf(text: str) -> bool:
    """Return whether the outermost XML element of a text is that of an MJCF file."""
    return outermost(text) == "mujoco"


def outermost(text: str) -> str:
    """Return the name of the outermost XML element of a text in lower case; "" if there is none."""
    tags: list[str] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, _: tags.append(tag) if not tags else None
    text = _without_declaration(text)
    with suppress(expat.ExpatError, ValueError):
        for start in range(0, len(text), _CHUNK):
            parser.Parse(text[start : start + _CHUNK])
            if tags:
                break
    return tags[0].lower() if tags else ""


@contextmanager
def text_in_file(text: str) -> Iterator[Path]:
    """Write a text to a temporary file, named after the robot.

    Args:
        text: Content of a robot file.
    Yields:
        Path of the temporary file.
    Raises:
        LoadError: As the block does, with "the text" for the path.
        ModelError: Likewise.
    """
    name = _NAME.search(text[:_CHUNK])
    with TemporaryDirectory(prefix="pinred-") as folder:
        path = Path(folder) / f"{name[1] if name else 'robot'}.xml"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        try:
            yield path
        except (LoadError, ModelError) as error:
            if type(error) not in (LoadError, ModelError) or folder not in str(error):
                raise
            message = str(error).replace(quoted_path(path), "the text")
            raise type(error)(message.replace(plain_path(path), "the text")) from None


def read_xml(path: Path) -> FileElement:
    """Return the root element of an XML file; all its elements are FileElements.

    Element names keep their namespace prefixes, whether or not the file declares them.

    Raises:
        LoadError: The file cannot be read, is too large, or is not XML.
    """
    builder = ElementTree.TreeBuilder(element_factory=FileElement)
    parser, text = expat.ParserCreate(), read_text(path)
    content = _without_declaration(text)
    removed = text.count("\n") - content.count("\n")  # lines before the first element
    count = depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count, depth
        count, depth = count + 1, depth + 1
        if count > _MOST_ELEMENTS or depth > _DEEPEST:
            deep = depth > _DEEPEST
            what = f"{_DEEPEST} nested elements" if deep else f"{count - 1} elements"
            where = f"{plain_path(path)}, line {removed + parser.CurrentLineNumber}"
            raise LoadError(f"{where}: more than {what}")
        element = builder.start(tag, attributes)
        assert isinstance(element, FileElement)
        element.line = removed + parser.CurrentLineNumber

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(content, True)
        root = builder.close()
        assert isinstance(root, FileElement)
        return root
    except (expat.ExpatError, ValueError) as error:
        advice = ""
        if path.suffix == ".toml":
            advice = ". Scene files are simulated by `pinred run`, and compared by its --compare"
        raise LoadError(f"{plain_path(path)} is not XML: {error}{advice}") from None


@contextmanager
def lines_in_messages(path: Path | None) -> Iterator[None]:
    """Add the lines of links, joints, bodies and equalities to messages of errors in the block.

    A message that states a line already stays as it is, and so do names that several elements have.

    Args:
        path: The robot's file, if any.
    Yields:
        Nothing.
    Raises:
        LoadError: As the block does.
        ModelError: Likewise.
    """
    try:
        yield
    except (LoadError, ModelError) as error:
        if path is not None:
            _add_lines(error, path)
        raise


def _add_lines(error: LoadError | ModelError, path: Path) -> None:
    """Add lines to the message of an error, in place."""
    message = str(error)
    if not _MENTION.search(message) or _LINE.search(message):
        return
    try:
        root = read_xml(path)
    except LoadError:
        return
    elements = list(root.iter())
    equalities = [constraint for part in root.iterfind("equality") for constraint in part]
    others = [element for element in elements if element not in equalities]
    is_whole = not any(element.tag in _COPIES for element in elements)

    def with_line(match: re.Match[str]) -> str:
        named, kind = others, match[1].removeprefix("equality ")
        tags = _TAGS.get(kind, (kind,))
        if kind != match[1]:
            named, tags = equalities, (kind,)
        lines = {
            line_of(element)
            for element in named
            if element.tag in tags and quoted(element.get("name", "")) == match[2]
        }
        if kind != match[1] and is_whole and not lines:  # Constraints without a name have numbers.
            lines = {
                line_of(element)
                for number, element in enumerate(equalities)
                if match[2] == quoted(f"equality {number}")
            }
        return f"{match[0]} (line {lines.pop()})" if len(lines) == 1 else match[0]

    error.args = (_MENTION.sub(with_line, message), *error.args[1:])


def without_hyphens(text: str) -> str:
    """Return an XML text without comments that contain "--", an error for strict parsers only."""
    if "<!--" not in text:
        return text
    return _COMMENT.sub(lambda m: "\n" * m[0].count("\n") if "--" in m[1] else m[0], text)


def _without_declaration(text: str) -> str:
    """Return an XML text without its XML declaration, an error unless it starts the file."""
    text = without_hyphens(text)
    head, mark, tail = text.partition("<?xml")
    if mark and not _ELEMENT.search(head):
        text = head + tail.partition("?>")[2]
    return text.lstrip()
