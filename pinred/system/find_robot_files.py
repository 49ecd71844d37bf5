"""Robot files: bundled robots, shapes passed with models, text in XML, and files that URIs name.

Lines that C++ libraries print on standard error while they read a file are captured.  A process has
one standard error, so the output of other threads is captured, too.  Therefore only one thread
captures at a time, and all other output is printed at the end of the capture.  A fork waits until
the capture ends.

Nothing is downloaded.  Models of Gazebo's server are searched in the given folders, and in the
folder in which Gazebo keeps what it has downloaded.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import RLock
from types import MappingProxyType
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

import pinocchio as pin

from ..common.arrays import entries_of
from ..common.errors import InputError, LoadError, ModelError, install_command
from ..common.files import is_file, is_folder
from ..common.names import brief, listed, plain_path, quoted, quoted_path
from .loops.loop import Constraint, parse_loops

EVERYTHING = re.compile(rb".+", re.DOTALL)  # matches all output, as one text
_STDERR = 2
_LOCK = RLock()
os.register_at_fork(
    before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release
)


@contextmanager
def library_output(own: re.Pattern[bytes]) -> Iterator[list[str]]:
    """Collect the output of a C++ library on standard error.

    Args:
        own: Pattern that matches the library's output.  All other output is printed at the end
            of the context.
    Yields:
        A list, to which the library's output is appended when the context ends.
    """
    texts: list[str] = []
    with _LOCK:
        if sys.stderr is not None:
            with suppress(OSError, ValueError):  # standard error is closed
                sys.stderr.flush()
        try:
            stderr = os.dup(_STDERR)
        except OSError:  # the process has no standard error
            yield texts
            return
        with tempfile.TemporaryFile() as file:
            os.dup2(file.fileno(), _STDERR)
            try:
                yield texts
            finally:
                os.dup2(stderr, _STDERR)
                os.close(stderr)
                file.seek(0)
                text = file.read()
                texts += [m[0].decode(errors="replace").strip() for m in own.finditer(text)]
                _print(own.sub(b"", text))


def _print(text: bytes) -> None:
    with suppress(OSError):
        while text:
            text = text[os.write(_STDERR, text) :]


INSTALL_ROBOTS = install_command("robots")


@dataclass(frozen=True)
class BundledRobot:
    """A robot that is bundled with pinred: one entry of robots/robots.toml.

    Attributes:
        name: Name of the robot.
        path: Path of its URDF file.
        group: Name of its symmetry group.
        description: Description of the robot in one line.
        gravity: Gravity in the world frame, (3,) [m/s²].
        initial: Generic initial state, with the keys x, xdot, xi and duration.
        balls: Whether hinges that meet at one point are merged into balls (see `load`).
        closed_form: Results that are known in closed form.
        source: Publication that describes the problem.
        loops: Closed kinematic loops.
    """

    name: str
    path: Path
    group: str
    description: str
    gravity: tuple[float, float, float]
    initial: dict[str, Any]
    balls: bool = False
    closed_form: str = ""
    source: str = ""
    loops: tuple[Constraint, ...] = ()


@dataclass(frozen=True)
class ExampleRobot:
    """A robot of example-robot-data.

    Attributes:
        urdf: Path of its URDF file.
        rotors: SRDF file with the rotor inertias, if the robot has one.
        build: Loader of the model, if the URDF file alone is not enough; the loader reads meshes.
    """

    urdf: Path
    rotors: Path | None
    build: Callable[[], Any] | None


def bundled_folder() -> Path:
    """Return the folder of bundled robots, in the installed package or in the checkout."""
    package = Path(__file__).parent.parent
    installed = package / "robots"
    return installed if installed.is_dir() else package.parent / "robots"


@cache
def bundled_robots() -> Mapping[str, BundledRobot]:
    """Return the bundled robots by name.  The file is read once."""
    folder = bundled_folder()
    table = tomllib.loads((folder / "robots.toml").read_text(encoding="utf-8"))
    robots = {}
    for name, entry in table.items():
        path, gravity = folder / entry.pop("file"), tuple(entry.pop("gravity"))
        loops = parse_loops(entry.pop("loops", ()))
        robots[name] = BundledRobot(name=name, path=path, gravity=gravity, loops=loops, **entry)
    return MappingProxyType(robots)


def has_example_robots() -> bool:
    """Return whether example-robot-data with its Python loaders is installed."""
    return find_spec("example_robot_data") is not None


def example_robots() -> tuple[str, ...]:
    """Return the names of the robots in example-robot-data; empty if it is not installed."""
    return tuple(sorted(_loaders())) if has_example_robots() else ()


def example_robot(name: str) -> ExampleRobot:
    """Return the files of a robot in example-robot-data.  Raises LoadError if it has no URDF."""
    import example_robot_data.utils as utils

    loader = _loaders()[name]
    if not loader.urdf_filename:
        raise LoadError(
            f"'{name}' is only available as {loader.sdf_filename}; load this file by its path"
        )

    def path(folder: str, file: str) -> Path:
        relative = Path(loader.path, folder, file)
        return Path(utils.getModelPath(str(relative))) / relative

    has_rotors = loader.srdf_filename and loader.has_rotor_parameters
    return ExampleRobot(
        urdf=path(loader.urdf_subpath, loader.urdf_filename),
        rotors=path(loader.srdf_subpath, loader.srdf_filename) if has_rotors else None,
        build=None if loader.__init__ is utils.RobotLoader.__init__ else loader,
    )


def _loaders() -> dict[str, Any]:
    from example_robot_data.robots_loader import ROBOTS

    return dict(ROBOTS)


@dataclass(frozen=True, eq=False)
class Visuals:
    """Shapes for playback; treat both attributes as read-only.

    Attributes:
        model: Model whose joints and frames carry the shapes.
        geometry: Geometry model that contains the shapes.
    """

    model: pin.Model
    geometry: pin.GeometryModel


def with_visuals(source: object) -> Visuals | None:
    """Copy the model and shapes of a pin.RobotWrapper or of a pair (model, visual_model).

    Returns:
        The copies, or None for other sources.
    Raises:
        InputError: The pair is not valid, or its shapes belong to another model.
    """
    if isinstance(source, pin.RobotWrapper):
        pair: Any = (source.model, source.visual_model)
    elif isinstance(source, tuple):
        pair = source
    else:
        return None
    if len(pair) != 2 or not isinstance(pair[0], pin.Model):
        raise InputError(
            "load takes a pair (model, visual_model) of a pin.Model and a pin.GeometryModel, got "
            f"({', '.join(type(entry).__name__ for entry in pair)})"
        )
    model, geometry = pair
    if geometry is None:  # A RobotWrapper may lack shapes.
        geometry = pin.GeometryModel()
    if not isinstance(geometry, pin.GeometryModel):
        raise InputError(f"visual_model must be a pin.GeometryModel, got {type(geometry).__name__}")
    for entry in geometry.geometryObjects:
        if entry.parentJoint >= model.njoints:
            raise InputError(
                f"visual_model: shape '{entry.name}' is attached to joint {entry.parentJoint}, "
                f"which model '{model.name}' does not have"
            )
    return Visuals(model.copy(), geometry.copy())


def mesh_folders(meshes: Any) -> tuple[str, ...]:
    """Return the absolute paths of one or several folders with meshes.

    Raises:
        InputError: `meshes` is not valid, or a folder does not exist.
    """
    entries = entries_of((meshes,) if isinstance(meshes, (str, Path)) else meshes)
    if entries is None or not all(isinstance(entry, (str, Path)) for entry in entries):
        raise InputError(f"meshes must be a folder or a list of folders, got {brief(meshes)}")
    folders = [Path(folder) for folder in entries]
    for folder in folders:
        if not is_folder(folder):
            raise InputError(f"meshes: there is no folder {quoted_path(folder)}")
    return tuple(str(folder.absolute()) for folder in folders)


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


def is_mujoco(source: object, kind: str) -> bool:
    """Return whether an object is mujoco's MjModel or MjSpec, without importing mujoco."""
    package = type(source).__module__.partition(".")[0]
    return package == "mujoco" and type(source).__name__ == kind


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
    equalities = [constraint for section in root.iterfind("equality") for constraint in section]
    other_elements = [element for element in elements if element not in equalities]
    is_whole = not any(element.tag in _COPIES for element in elements)

    def with_line(match: re.Match[str]) -> str:
        named, kind = other_elements, match[1].removeprefix("equality ")
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


def element_on_line(tag: str, original: Element, text: str = "") -> FileElement:
    """Return a new element on the line of another one."""
    element = FileElement(tag)
    element.line, element.text = line_of(original), text.strip().replace("\n", " ")
    return element


def whole_copy(element: Element) -> Element:
    """Return a copy of an element with all its contents."""
    copy = element_on_line(element.tag, element, element.text or "")
    copy.attrib.update(element.attrib)
    for child in element:
        copy.append(whole_copy(child))
    return copy


def xml_text(root: Element) -> str:
    """Return an XML text whose elements have the lines of the file, for Drake's messages."""
    pieces, line = list[str](), 1

    def add(element: Element) -> None:
        nonlocal line
        if line_of(element) > line:
            pieces.append("\n" * (line_of(element) - line))
            line = line_of(element)
        attributes = "".join(f" {key}={quoteattr(value)}" for key, value in element.items())
        pieces.append(f"<{element.tag}{attributes}>{escape(element.text or '')}")
        for child in element:
            add(child)
        pieces.append(f"</{element.tag}>")

    add(root)
    return "".join(pieces)


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


NEWEST = (1, 12)  # newest version of SDF that pinred reads
_FOLDERS = (  # environment variables with folders of models
    "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH", "ROS_PACKAGE_PATH",
)  # fmt: skip
# Folders of Gazebo's downloads: an environment variable, or a folder in the home folder.
_DOWNLOADS = (
    ("GZ_FUEL_CACHE_PATH", ".gz/fuel"),
    ("IGN_FUEL_CACHE_PATH", ".ignition/fuel"),
)
# Server, owner, name, version and inner path of a model.
_SERVED = re.compile(
    r"(?:https?|fuel)://(?P<server>[^/]+)/(?:\d[\d.]*/)?(?P<owner>[^/]+)/models/(?P<name>[^/]+)"
    r"(?:/(?P<version>\d+|tip))?(?:/files)?(?:/(?P<inside>.+))?"
)


def find_file(uri: str, file: Path, folders: Sequence[str]) -> Path | str:
    """Return the path of a model or mesh, or why there is none.

    Args:
        uri: URI in the file.
        file: Path of the file.
        folders: Folders in which models are searched, besides those of the environment and those
            above the file.
    Raises:
        LoadError: The config of a model is not XML.
    """
    scheme, mark, location = uri.partition("://")
    scheme, location = (scheme, location) if mark else ("", uri)
    above = [str(folder) for folder in file.resolve().parents]
    named = [*folders, *_environment()]
    if scheme in ("http", "https", "fuel"):
        candidates = list(_downloads(uri, named))
    elif scheme == "file":
        candidates = [Path(location)]
    elif scheme == "":
        candidates = [Path(folder, location) for folder in (above[0], *named)]
    elif scheme in ("model", "package"):
        first, _, inside = location.partition("/")
        candidates = [Path(folder, location) for folder in (*named, *above)]
        candidates += [Path(folder, inside) for folder in named if Path(folder).name == first]
    else:
        return f"unknown scheme {quoted(scheme)}; use model://, package:// or file://"
    for candidate in candidates if location else ():
        if is_file(candidate):
            return candidate
        if is_folder(candidate):
            return _model_file(candidate)
    if scheme in ("http", "https", "fuel"):
        served = _SERVED.fullmatch(uri)
        name = "the model" if served is None else quoted(unquote(served["name"]))
        return (
            f'pinred downloads nothing. Download the model (`gz fuel download -u "'
            f'{plain_path(uri)}"`), or pass a folder that contains {name} as meshes='
        )
    return (
        f"not found in {listed([plain_path(path.parent) for path in candidates], 4)}; pass the "
        "folder that contains the model as meshes=, or set GZ_SIM_RESOURCE_PATH"
    )


def _downloads(uri: str, named: Sequence[str]) -> Iterator[Path]:
    """Yield the places of a model of Gazebo's server: in folders, and among its downloads."""
    served = _SERVED.fullmatch(uri)
    if served is None:
        return
    name, inside = unquote(served["name"]), unquote(served["inside"] or "")
    yield from (Path(folder, name, inside) for folder in named)
    for variable, folder in _DOWNLOADS:
        cache = Path(os.environ.get(variable) or Path.home() / folder)
        # Gazebo writes owners and names in lower case, with a folder for each version.
        model = cache / served["server"] / unquote(served["owner"]).lower() / "models"
        model /= name.lower()
        versions = [path.name for path in model.glob("*") if path.name.isdigit()]
        stated = served["version"] or "tip"
        for version in sorted(versions, key=int, reverse=True):
            if stated in ("tip", version):
                yield model / version / inside


def _environment() -> list[str]:
    """Return the folders in the environment variables of Gazebo and ROS."""
    folders = [
        folder
        for variable in _FOLDERS
        for folder in os.environ.get(variable, "").split(os.pathsep)
        if folder
    ]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*folders, *(str(Path(prefix, "share")) for prefix in prefixes if prefix)]


def _model_file(folder: Path) -> Path | str:
    """Return the file of a model in the newest version that its config names, or why not."""
    best, source = None, folder
    version: tuple[int, ...] = (-1,)
    for name in ("model.config", "manifest.xml"):
        config = folder / name
        if best is not None or not is_file(config):
            continue
        source = config
        for entry in read_xml(config).findall("sdf"):
            number = version_of(entry)
            if version < number <= NEWEST and (entry.text or "").strip():
                best, version = (entry.text or "").strip(), number
        if best is None:
            return f"{plain_path(config)} names no SDF file of version 1.12 or less; add one"
    path = folder / (best or "model.sdf")
    if best is None and not is_file(path):
        return f"{plain_path(folder)} has no model.config that names its SDF file; add one"
    if not is_file(path):
        return (
            f"{plain_path(source)} names the file {quoted(best or '')}, which does not exist; "
            "generate it, or name another"
        )
    return path


def version_of(element: Element) -> tuple[int, ...]:
    """Return the version of SDF that an element states; (0,) if it is missing or not valid."""
    numbers = element.get("version", "").strip().split(".")
    return tuple(map(int, numbers)) if all(map(str.isdigit, numbers)) else (0,)
