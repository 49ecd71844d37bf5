"""read_document(): an SDF file and the files that it includes, each read once.

The reader checks every word by the tables of `sdf_words`, and writes copies for Drake.  A copy has
only the words that place links and joints, and includes other copies.  Numbers of joints, which
Drake ignores in part, come from the same elements.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ..common.arrays import Array
from ..common.errors import LoadError, ModelError, PinredError
from ..common.names import plain, plain_path, quoted
from . import sdf_words
from .find_robot_files import (
    NEWEST,
    element_on_line,
    find_file,
    line_of,
    read_xml,
    version_of,
    whole_copy,
    xml_text,
)
from .sdf_words import TABLES, Use, Word

_MOST_ELEMENTS = 1_000_000  # largest accepted number of elements in all files together
_DEEPEST = 20  # largest number of files that include each other in a chain
_UNIQUE = (1, 7)  # first version of SDF in which a link and a joint must have different names
_UNLIMITED = 1e16  # position limit that stands for infinity in older versions of SDF
_SCENERY = ("sun", "ground_plane")  # Gazebo's light and floor, on which nothing moves
_GRAVITY = (0.0, 0.0, -9.8)  # gravity of a world that states none [m/s²]
_WITH_ACTUATOR = ("revolute", "continuous", "prismatic", "screw")  # types with Drake's actuators
_WITHOUT_AXIS = ("fixed", "ball")
_AXES = {  # axes that each type of joint needs
    **dict.fromkeys(_WITH_ACTUATOR, ("axis",)),
    "universal": ("axis", "axis2"),
    **dict.fromkeys(_WITHOUT_AXIS, ()),
}
_TYPES = "revolute, continuous, prismatic, universal, screw, ball, planar or fixed joints"
_TRUE = ("true", "1")
# SDF's defaults of moments of inertia [kg m²].
_MOMENTS = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
_ROUND_OFF = 1e-9  # relative margin of the triangle inequality
_NAMED = ("link", "joint", "frame", "model", "drake:joint")  # elements that messages name
_REMEDIES = (  # remedies by words of Drake's messages
    ("not found in|not match|unable to find", "name a link, joint, frame or model that exists"),
    ("Non-unique name", "rename one of them"),
    ("is reserved", "rename it"),
    ("must specify different|resolve to different|to itself", "connect two links"),
    ("cycle detected", "attach one of the frames to a link"),
    ("Error reading element", "write the numbers that SDF defines for it"),
    ("already has joint", "remove one of the joints"),
    ("Only fixed joints", "make it fixed, or put it into a model that moves"),
    ("MakeConvexHull", "state the inertia, or convert the mesh to .obj"),
    ("", "correct this element, or remove it"),
)


@dataclass(frozen=True)
class Axis:
    """Numbers of one axis of a joint [rad | m, N·m | N].

    Attributes:
        damping: Coefficient of the damper.
        friction: Dry friction.
        stiffness: Stiffness of the spring.
        rest: Position without force of the spring.
        lower: Lower limit of the position.
        upper: Upper limit of the position.
        effort: Limit of the effort.
        velocity: Limit of the rate.
    """

    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf
    velocity: float = np.inf

    @property
    def has_forces(self) -> bool:
        """Whether a spring, damper or friction acts."""
        return bool(self.damping or self.friction or self.stiffness)


@dataclass(frozen=True)
class Mimic:
    """A follower axis: value = ratio · (leader − reference) + offset.

    Attributes:
        axis: Number of the follower axis, 0 or 1.
        leader: Leader joint, (model, name).
        leader_axis: Number of the leader axis, 0 or 1.
        ratio: Ratio of the rates.
        offset: Value of the follower where the leader is at zero [rad | m].
        where: Place of the element in the file.
    """

    axis: int
    leader: tuple[str, str]
    leader_axis: int
    ratio: float
    offset: float
    where: str


@dataclass(frozen=True)
class JointWords:
    """Words of a joint that Drake does not read, or reads in part.

    Attributes:
        type: Type of the joint.
        where: Place of the element in the file.
        axes: Numbers of its axes.
        mimics: Axes that follow others.
        pitch: Displacement of a screw joint per revolution [m].
    """

    type: str
    where: str
    axes: tuple[Axis, ...] = ()
    mimics: tuple[Mimic, ...] = ()
    pitch: float = 1.0


@dataclass(frozen=True, eq=False)
class BallConstraint:
    """A point of one link that coincides with a point of another link.

    Attributes:
        model: Model of both links.
        links: Names of the links.
        points: Points in the frames of the links, (2, 3) [m].
        where: Place of the element in the file.
    """

    model: str
    links: tuple[str, str]
    points: Array
    where: str


@dataclass(frozen=True)
class Report:
    """An action in the file that pinred does not simulate.

    Attributes:
        kind: Kind of action.
        name: Name of the action, with its place in the file.
        model: Model to which it belongs; "" for the world.
    """

    kind: str
    name: str
    model: str


@dataclass
class SdfDocument:
    """An SDF file with the files that it includes.

    Attributes:
        copies: Text of the copy of each file for Drake; the first one includes the others.
        paths: Paths of the files.
        joints: Words of each joint, by model and name.
        weightless: Links on which no gravity acts, (model, name).
        colliding: Links with collision shapes, (model, name).
        added: Moment added to each link in the copies, and trace of its moments [kg m²], by link.
        constraints: Points that coincide.
        reports: Actions that are not simulated.
        gravity: Gravity of the world, (3,) [m/s²]; None without a world.
        found: Path of the file, or of the mesh, that each URI names.
        renamed: Name in the file of each joint, by model and name in the copies, if they differ.
    """

    copies: list[str] = field(default_factory=list)
    paths: list[Path] = field(default_factory=list)
    joints: dict[tuple[str, str], JointWords] = field(default_factory=dict)
    weightless: set[tuple[str, str]] = field(default_factory=set)
    colliding: list[tuple[str, str]] = field(default_factory=list)
    added: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    constraints: list[BallConstraint] = field(default_factory=list)
    reports: list[Report] = field(default_factory=list)
    gravity: Array | None = None
    found: dict[str, Path] = field(default_factory=dict)
    renamed: dict[tuple[str, str], str] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Write the copies for Drake to a folder; return the path of the first one."""
        for number, text in enumerate(self.copies):
            (folder / f"{number}.sdf").write_text(text.replace(_HERE, str(folder)), "utf-8")
        return folder / "0.sdf"

    def with_own_paths(self, message: str, folder: Path) -> str:
        """Replace paths of copies in a message of Drake by paths of the files."""
        for number, path in reversed([*enumerate(self.paths)]):
            copy = re.escape(str(folder / f"{number}.sdf").lstrip("/"))
            message = re.sub(rf"/*{copy}", lambda _: plain_path(path), message)  # noqa: B023
        return message

    def drake_error(self, message: str, folder: Path) -> str:
        """Return an error message of Drake with the file, the line and a remedy."""
        message = self.with_own_paths(message, folder).splitlines()[0]
        match = re.match(r"(.*?):([1-9]\d*): error: (.*)", message)
        unplaced = "", "", message.partition("error: ")[2] or message
        file, line, why = match.groups() if match else unplaced
        why = re.sub(r"^At XML path \S+: ", "", why).removesuffix(".")
        remedy = next(way for words, way in _REMEDIES if re.search(words, why))
        where = f"{file}, line {line}" if line else self._line_of_name(why)
        return f"Drake cannot read {where}: {why}; {remedy}"

    def _line_of_name(self, message: str) -> str:
        """Return the place of an element that a message names, or of the one that refers to it."""
        names = [a or b for a, b in re.findall(r"\[([^\]]+)\]|'([^']+)'", message)]
        elements = [(p, e) for p in dict.fromkeys(self.paths) for e in read_xml(p).iter()]
        for name in names:
            bare = name.rpartition("::")[2]  # Drake scopes names, as "model::link".
            using = [(path, e) for path, e in elements if bare in e.attrib.values()]
            named = [(path, e) for path, e in using if e.tag in _NAMED and e.get("name") == bare]
            places = named or using
            if len(places) == 1 or (named and message.startswith("Non-unique")):
                return f"{plain_path(places[-1][0])}, line {line_of(places[-1][1])}"
        return plain_path(self.paths[0])


_HERE = "\0folder\0"  # stands for the folder of the copies


def read_document(path: Path, folders: Sequence[str], *, tolerant: bool = False) -> SdfDocument:
    """Read an SDF file and the files that it includes.

    Nothing is downloaded, and nothing in the files is executed.

    Args:
        path: Path of the file.
        folders: Folders in which included models are searched, besides those in Gazebo's
            environment variables and those above the including file.
        tolerant: Whether to report models of the world that are not found, instead of raising.
    Returns:
        The document.
    Raises:
        LoadError: A file does not exist or is not valid; the message names file and line.
        ModelError: The file contains a word that pinred refuses.
    """
    reader = _Reader(folders, tolerant)
    reader.read(path, None)
    return reader.document


@dataclass(frozen=True)
class _Place:
    """Where an element is.

    Attributes:
        file: Path of its file.
        chain: Files that include each other, the last of which is `file`.
        model: Scoped name of its model; "" for the world.
        static: Whether the model does not move.
        owner: Name of its link or joint, if any.
        version: Version of SDF of the file.
        taken: Names of the links and joints of its model.
    """

    file: Path
    chain: tuple[Path, ...]
    model: str = ""
    static: bool = False
    owner: str = ""
    version: tuple[int, ...] = NEWEST
    taken: tuple[str, ...] = ()

    def inside(self, name: str) -> str:
        """Return the scoped name of a model in this place."""
        return f"{self.model}::{name}" if self.model else name

    def line(self, element: Element) -> str:
        """Return the line of an element in words, with the file if another one includes it."""
        line = f"line {line_of(element)}"
        return line if len(self.chain) == 1 else f"{plain(self.file.name)}, {line}"

    def fail(self, element: Element, problem: str, kind: type[PinredError] = LoadError) -> NoReturn:
        """Raise an error about an element."""
        raise kind(f"{plain_path(self.file)}, line {line_of(element)}: {problem}")


class _Reader:
    """The reader of a file and of the files that it includes."""

    def __init__(self, folders: Sequence[str], tolerant: bool) -> None:
        self.document = SdfDocument()
        self._folders, self._tolerant, self._count = folders, tolerant, 0
        self._models = set[str]()

    def read(self, path: Path, include: _Include | None) -> int | None:
        """Read a file; return the number of its copy, or None if it contains no links.

        Args:
            path: Path of the file.
            include: The <include> that names the file, if any.
        Returns:
            Number of the copy.
        Raises:
            LoadError: The file cannot be read.
        """
        root = read_xml(path)
        self._count += sum(1 for _ in root.iter())
        if self._count > _MOST_ELEMENTS:
            raise LoadError(f"{plain_path(path)}: more than {_MOST_ELEMENTS} elements in all files")
        chain = (*(include.place.chain if include else ()), path.resolve())
        place = _Place(path, chain)
        if root.tag != "sdf":
            place.fail(root, f"expected <sdf>, got <{plain(root.tag)}>")
        place = replace(place, version=version_of(root))
        if place.version == (0,):
            place.fail(root, '<sdf> has no valid version; state one, as in <sdf version="1.9">')
        if place.version > NEWEST:
            stated = plain(root.get("version", ""))
            place.fail(root, f"pinred reads SDF up to version 1.12, not {stated}; convert the file")
        if len(worlds := root.findall("world")) > 1:
            place.fail(worlds[1], "pinred reads one world of a file; remove the others")
        if include is not None:
            if not root.findall("model") + root.findall("include"):
                if root.find("world") is not None or not len(root):
                    place.fail(root, "an included file must contain a <model>")
                return None  # a light or an actor
            place = replace(place, model=include.place.model, static=include.place.static)
        number = len(self.document.copies)
        self.document.copies.append("")
        self.document.paths.append(path)
        copy = self._copy(root, "sdf", place, include)
        self.document.copies[number] = xml_text(copy)
        return number

    def _copy(
        self, element: Element, table: str, place: _Place, include: _Include | None = None
    ) -> Element:
        """Check an element by its table; return its copy for Drake."""
        words = TABLES[table]
        if table in ("link", "joint"):
            place = replace(place, owner=element.get("name", ""))
        copy = element_on_line(element.tag, element, element.text or "")
        for key, value in element.attrib.items():
            word = words.get(f"@{key}", words.get(f"@{sdf_words.ANY}"))
            if _is_outdated(f"@{key}", place):
                word = _if_stated(value)
            if word is not None and word.drake:
                copy.set(key, value)
            elif word is None and not key.startswith(sdf_words.NAMESPACES):
                name = f"attribute {key} of <{plain(element.tag)}>"
                self._report(sdf_words.UNKNOWN, name, element, place)
        tags = set[str]()
        for child in element:
            word = words.get(child.tag, words.get(sdf_words.ANY))
            is_read = word is not None and word.use is Use.READ
            if is_read and child.tag in tags - sdf_words.SEVERAL:
                self._report(sdf_words.REPEATED, f"<{child.tag}>", child, place)
            tags.add(child.tag)
            if _is_outdated(child.tag, place):
                word = _if_stated(child.text or "")
            if word is None:
                name = f"<{plain(child.tag)}> in <{plain(element.tag)}>"
                self._report(sdf_words.UNKNOWN, name, child, place)
            elif word.use is Use.REFUSED:
                place.fail(child, f"<{child.tag}> is not supported; {word.kind}", ModelError)
            elif word.use is Use.LEFT_OUT:
                self._left_out(child, word, place)
            elif word.use is Use.READ and child.tag != "collision":
                self._add(child, word, copy, place, include)
        return copy

    def _add(
        self,
        child: Element,
        word: Word,
        copy: Element,
        place: _Place,
        include: _Include | None,
    ) -> None:
        """Read an element, and add its copy to the copy of its parent if Drake gets it."""
        readers = {
            "world": self._world, "link": self._link, "joint": self._joint,
            "drake:joint": self._drake_joint,
        }  # fmt: skip
        if word.table == "model":
            self._add_model(child, copy, place, include)
        elif word.table == "include":
            self._add_include(child, copy, place)
        elif word.table in readers:
            copy.append(readers[word.table](child, place))
        elif word.table == "drake:ball_constraint":
            self._constraint(child, place)
        else:
            inside = self._copy(child, word.table, place)
            if word.drake:
                copy.append(inside)

    def _world(self, world: Element, place: _Place) -> Element:
        """Read a world."""
        gravity = world.find("gravity")
        if gravity is None:
            gravity = world.find("physics/gravity")
        self.document.gravity = np.array(_GRAVITY)
        if gravity is not None:
            self.document.gravity = self._numbers(gravity, place, 3)
        return self._copy(world, "world", place)

    def _add_model(
        self, model: Element, copy: Element, place: _Place, include: _Include | None
    ) -> None:
        """Read a model; `include` is the <include> of its file, if any."""
        name, static = model.get("name", ""), _is_true(model.findtext("static"))
        if include is not None:
            name = include.name or name
            static = static if include.static is None else include.static
        inside = place
        if include is None or not include.merges:
            inside = replace(place, model=place.inside(name), static=place.static or static)
        if inside.model in self._models and inside.model != place.model:
            shown = f"a second model is called {quoted(inside.model.rpartition('::')[2])}; "
            if include is not None:
                include.place.fail(include.element, f"{shown}give the <include> another <name>")
            place.fail(model, f"{shown}rename it")
        self._models.add(inside.model)
        named = [*model.findall("link"), *model.findall("joint")]
        for link in model.findall("link"):
            if link.get("name") == "world" and not inside.static:
                place.fail(link, "the name 'world' belongs to the ground; rename the link")
        inside = replace(inside, taken=tuple(part.get("name", "") for part in named))
        copy.append(self._copy(model, "model", inside))

    def _add_include(self, element: Element, copy: Element, place: _Place) -> None:
        """Read an <include> and its file; its copy includes the copy of the file."""
        uri = (element.findtext("uri") or "").strip()
        shown = f"<include> of {quoted(uri)}"
        if not uri:
            place.fail(element, "<include> has no <uri>; add it")
        name = (element.findtext("name") or "").strip()
        path = self._find(uri, place)
        if isinstance(path, str):
            last = uri.rstrip("/").rpartition("/")[2].lower()
            scenery = last.replace("%20", "_").replace(" ", "_") in _SCENERY
            if copy.tag == "world" and (scenery or self._tolerant):
                kind = "scenery that was not found" if scenery else "models that were not found"
                label = f"{plain(name or uri)} ({place.line(element)})"
                self.document.reports.append(Report(kind, label, ""))
                return
            more = "; or load one robot without it, by root=" if copy.tag == "world" else ""
            place.fail(element, f"{shown}: {path}{more}")
        if path.resolve() in place.chain:
            place.fail(element, f"{shown}: the file includes itself; remove the <include>")
        if len(place.chain) > _DEEPEST:
            place.fail(element, f"{shown}: more than {_DEEPEST} files include each other")
        if path.suffix.lower() in (".urdf", ".mjcf"):
            place.fail(
                element, f"{shown}: only SDF files can be included; convert it to SDF", ModelError
            )
        static = element.findtext("static")
        fixed = None if static is None else _is_true(static)
        include = _Include(place, element, name, fixed, _is_true(element.get("merge")))
        number = self.read(path, include)
        inside = self._copy(element, "include", place)
        if number is not None:
            inside.append(element_on_line("uri", element, f"file://{_HERE}/{number}.sdf"))
            copy.append(inside)

    def _find(self, uri: str, place: _Place) -> Path | str:
        """Return the path of an included model or of a mesh, or why there is none."""
        path = find_file(uri, place.file, self._folders)
        if isinstance(path, Path):
            self.document.found[uri] = path
        return path

    def _link(self, link: Element, place: _Place) -> Element:
        """Read a link."""
        copy, key = self._copy(link, "link", place), (place.model, link.get("name", ""))
        if (gravity := link.findtext("gravity")) is not None and not _is_true(gravity):
            self.document.weightless.add(key)
        if shapes := link.findall("collision"):
            self.document.colliding.append(key)
        inertial = link.find("inertial")
        if inertial is not None and _is_true(inertial.get("auto")):
            self._add_shapes(shapes, copy, place)
        elif inertial is not None:
            try:
                owner = replace(place, owner=key[1])
                self.document.added[key] = self._added_moment(inertial, copy, owner)
            except LoadError:
                if not place.static:
                    raise
                # Nothing static moves, so its inertia does not matter.
                copy.remove(copy.find("inertial"))  # type: ignore[arg-type]
                self._report("inertias that are not valid", key[1], inertial, place)
        return copy

    def _added_moment(self, inertial: Element, copy: Element, place: _Place) -> tuple[float, float]:
        """Add a multiple of the identity to moments that no rigid body has, in a copy of a link.

        Drake would replace them, and the mass, by others.  What is added is the same in all axes,
        and is subtracted from what Drake has read.

        Returns:
            The moment that is added to each diagonal entry, 0 for a rigid body, and the trace of
            the moments without it [kg m²].
        """
        mass, owner = inertial.find("mass"), f"link {quoted(copy.get('name', ''))}"
        kg = self._number(mass, place, 1.0)
        values = {
            key: self._number(inertial.find(f"inertia/{key}"), place, default)
            for key, default in _MOMENTS.items()
        }
        if mass is not None and kg <= 0.0 and (kg < 0.0 or any(values.values())):
            place.fail(
                mass,
                f"{owner} has mass {kg:g} and moments of inertia; state a positive mass, or zeros",
            )
        xx, xy, xz, yy, yz, zz = values.values()
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[0] + moments[1] >= (1.0 + _ROUND_OFF) * moments[2] or not moments.any():
            return 0.0, xx + yy + zz
        if moments[0] < -_ROUND_OFF * abs(moments[2]):
            shown = ", ".join(f"{moment:g}" for moment in moments)
            place.fail(
                inertial,
                f"{owner} has principal moments of inertia {shown}; all must be positive or 0",
            )
        added = 4.0 * float(np.abs(moments).max())
        element = _child(_child(copy, "inertial"), "inertia")
        for key in ("ixx", "iyy", "izz"):
            _child(element, key).text = repr(values[key] + added)
        return added, xx + yy + zz

    def _add_shapes(self, shapes: Sequence[Element], copy: Element, place: _Place) -> None:
        """Add the shapes from which the inertia of a link follows."""
        for shape in shapes:
            added = element_on_line("collision", shape)
            added.set("name", shape.get("name", ""))
            for child in shape:
                if child.tag in sdf_words.SHAPE:
                    added.append(whole_copy(child))
            for uri in added.iterfind("geometry/mesh/uri"):
                path = self._find((uri.text or "").strip(), place)
                if isinstance(path, str):
                    place.fail(uri, f"mesh {quoted((uri.text or '').strip())}: {path}")
                uri.text = f"file://{path.resolve()}"
            copy.append(added)

    def _joint(self, joint: Element, place: _Place) -> Element:
        """Read a joint.  In a static model it is fixed."""
        copy, key = self._copy(joint, "joint", place), (place.model, joint.get("name", ""))
        joint_type, where = joint.get("type", ""), place.line(joint)
        elements = [joint.find("axis"), joint.find("axis2")]
        if place.static:
            copy.set("type", "fixed")
            joint_type = "fixed"
        else:
            self._check_type(joint, place)
        if place.version < _UNIQUE and place.taken.count(key[1]) > 1:
            name = f"{key[1]}_joint"
            while name in place.taken:
                name += "_"
            copy.set("name", name)
            self.document.renamed[place.model, name] = key[1]
        if joint_type == "screw":
            copy.set("type", "revolute")  # Drake does not tell the axis of a screw
        axes = tuple(
            self._axis(axis, place)
            for axis in elements
            if axis is not None and joint_type != "fixed"
        )
        mimics = () if joint_type == "fixed" else tuple(self._mimics(joint, elements, place))
        for k, axis in enumerate(list(copy.findall("axis") + copy.findall("axis2"))):
            if joint_type in _WITHOUT_AXIS or (k and joint_type in _WITH_ACTUATOR):
                copy.remove(axis)
            elif joint_type not in _WITH_ACTUATOR:
                _without_actuator(axis)
        if len(axes) > 1 and joint_type in _WITH_ACTUATOR:
            self._report("axes that a joint does not have", f"axis2 of {key[1]}", joint, place)
            axes = axes[:1]
        if joint_type == "ball" and any(axis.stiffness for axis in axes):
            self._report("springs of ball joints", key[1], joint, place)
        if key in self.document.joints:
            place.fail(joint, f"a second joint is called {quoted(key[1])}; rename it")
        pitch = self._pitch(joint, place) if joint_type == "screw" else 1.0
        self.document.joints[key] = JointWords(joint_type, where, axes, mimics, pitch)
        return copy

    def _drake_joint(self, joint: Element, place: _Place) -> Element:
        """Read a <drake:joint>."""
        joint_type, name = joint.get("type", ""), joint.get("name", "")
        if joint_type != "planar":
            place.fail(joint, unread_type(name, joint_type), ModelError)
        for tag in ("drake:parent", "drake:child", "drake:damping"):
            if joint.find(tag) is None:
                place.fail(joint, f"joint {quoted(name)} has no <{tag}>; add it")
        self.document.joints[place.model, name] = JointWords(joint_type, place.line(joint))
        return self._copy(joint, "drake:joint", place)

    @staticmethod
    def _check_type(joint: Element, place: _Place) -> None:
        """Reject a joint of another type, or without an axis."""
        joint_type, name = joint.get("type", ""), joint.get("name", "")
        if joint_type not in _AXES:
            place.fail(joint, unread_type(name, joint_type), ModelError)
        for tag in _AXES[joint_type]:
            if joint.find(tag) is None:
                place.fail(joint, f"{joint_type} joint {quoted(name)} has no <{tag}>; add it")

    def _pitch(self, joint: Element, place: _Place) -> float:
        """Return the displacement of a screw joint per revolution [m]."""
        pitch, old = joint.find("screw_thread_pitch"), joint.find("thread_pitch")
        if pitch is not None or old is None:
            return self._number(pitch, place, 1.0)
        turns = self._number(old, place)
        if turns == 0.0:
            place.fail(old, "<thread_pitch> must not be zero")
        # Before version 1.10 the pitch is an angle per displacement, left-handed.
        return -2.0 * np.pi / turns

    def _axis(self, axis: Element, place: _Place) -> Axis:
        """Return the numbers of an axis."""

        def number(path: str, default: float) -> float:
            element = axis.find(path)
            if element is None or not (element.text or "").strip():
                return default
            return float(self._numbers(element, place, 1, finite=path.startswith("dyn"))[0])

        if (xyz := axis.find("xyz")) is not None and not self._numbers(xyz, place, 3).any():
            place.fail(xyz, "the axis is zero; state a direction")
        lower, upper = number("limit/lower", -np.inf), number("limit/upper", np.inf)
        most = [number(f"limit/{what}", np.inf) for what in ("effort", "velocity")]
        stated = Axis(
            damping=number("dynamics/damping", 0.0),
            friction=number("dynamics/friction", 0.0),
            stiffness=number("dynamics/spring_stiffness", 0.0),
            rest=number("dynamics/spring_reference", 0.0),
            lower=-np.inf if lower <= -_UNLIMITED else lower,
            upper=np.inf if upper >= _UNLIMITED else upper,
            # SDF defines negative limits of effort and velocity as infinite.
            effort=np.inf if most[0] < 0.0 else most[0],
            velocity=np.inf if most[1] < 0.0 else most[1],
        )
        for what in ("damping", "friction", "stiffness"):
            if (value := getattr(stated, what)) < 0.0:
                place.fail(axis, f"{what} must not be negative, got {value:g}")
        if stated.lower > stated.upper:
            place.fail(
                axis, f"limits {stated.lower:g} > {stated.upper:g}; exchange lower and upper"
            )
        return stated

    def _mimics(
        self, joint: Element, axes: Sequence[Element | None], place: _Place
    ) -> Iterator[Mimic]:
        """Yield the couplings of a joint."""
        for k, axis in enumerate(axes):
            for mimic in () if axis is None else axis.findall("mimic"):
                ratio, shift, zero = (
                    self._number(mimic.find(tag), place, default)
                    for tag, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
                )
                tag = mimic.get("axis", "axis")
                if tag not in ("axis", "axis2"):
                    place.fail(mimic, f"<mimic>: axis must be axis or axis2, got {quoted(tag)}")
                leader = self._leader(mimic, place)
                offset, where = shift - ratio * zero, place.line(mimic)
                yield Mimic(k, leader, int(tag == "axis2"), ratio, offset, where)
        for mimic in joint.findall("drake:mimic"):
            ratio, offset = (
                self._number(element_on_line(f"drake:mimic {key}", mimic, text), place)
                for key, text in (
                    ("multiplier", mimic.get("multiplier", "1")),
                    ("offset", mimic.get("offset", "0")),
                )
            )
            yield Mimic(0, self._leader(mimic, place), 0, ratio, offset, place.line(mimic))

    def _leader(self, mimic: Element, place: _Place) -> tuple[str, str]:
        """Return the model and the name of the joint that a <mimic> names."""
        name = mimic.get("joint", "")
        if not name:
            place.fail(mimic, f"<{mimic.tag}> names no joint; add the attribute joint=")
        nested, _, last = name.rpartition("::")
        return (place.inside(nested) if nested else place.model), last

    def _constraint(self, element: Element, place: _Place) -> None:
        """Read a <drake:ball_constraint>."""
        self._copy(element, "drake:ball_constraint", place)
        links, points = [], []
        for body, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
            link, position = (element.find(f"{element.tag}_{part}") for part in (body, point))
            if link is None or position is None:
                place.fail(element, f"add <{element.tag}_{body}> and _{point} to <{element.tag}>")
            links.append((link.text or "").strip())
            points.append(self._numbers(position, place, 3))
        self.document.constraints.append(
            BallConstraint(place.model, (links[0], links[1]), np.array(points), place.line(element))
        )

    def _number(self, element: Element | None, place: _Place, default: float = 0.0) -> float:
        """Return the number in an element; the default without an element."""
        return default if element is None else float(self._numbers(element, place, 1)[0])

    def _numbers(self, element: Element, place: _Place, size: int, *, finite: bool = True) -> Array:
        """Return the numbers in an element."""
        words = (element.text or "").split()
        try:
            values = np.array([float(word) for word in words if "_" not in word])
        except ValueError:
            values = np.empty(0)
        valid = np.isfinite(values).all() if finite else not np.isnan(values).any()
        if len(words) != size or len(values) != size or not valid:
            expected = "finite number" if finite else "number"
            place.fail(
                element,
                f"<{plain(element.tag)}>: expected {size} {expected}{'s' * (size > 1)}, got "
                f"{quoted(element.text or '')}",
            )
        return values

    def _left_out(self, element: Element, word: Word, place: _Place) -> None:
        """Report an element that acts and is not simulated."""
        if word.is_idle(" ".join(element.itertext())):
            return
        kind, name = word.kind, element.get("name") or f"<{element.tag}>"
        if element.tag == "plugin":
            kind = sdf_words.plugin_kind(element.get("filename", ""))
            name = element.get("name") or element.get("filename") or "<plugin>"
        if kind:
            self._report(kind, name, element, place)

    def _report(self, kind: str, name: str, element: Element, place: _Place) -> None:
        owner = f"{plain(place.owner)}: " if place.owner else ""
        label = f"{owner}{plain(name)} ({place.line(element)})"
        self.document.reports.append(Report(kind, label, place.model))


@dataclass(frozen=True)
class _Include:
    """An <include>.

    Attributes:
        place: Its place.
        element: The element.
        name: Name that it gives to the model, or "".
        static: Whether it says that the model is static; None if it does not say.
        merges: Whether the contents of the model become part of the including model.
    """

    place: _Place
    element: Element
    name: str
    static: bool | None
    merges: bool


def unread_type(name: str, type_name: str) -> str:
    """Return the error message about a joint of a type that is not read."""
    shown = f"joint {quoted(name)} is of type {plain(type_name) or '?'}"
    return f"{shown}, which pinred does not read from SDF; use {_TYPES}"


def _without_actuator(axis: Element) -> None:
    """Set the effort of an axis to zero, so that Drake does not look for an actuator."""
    if (limit := axis.find("limit")) is not None:
        axis.remove(limit)
    axis.append(element_on_line("limit", axis))
    axis[-1].append(element_on_line("effort", axis, "0"))


def _is_outdated(key: str, place: _Place) -> bool:
    """Return whether a word was removed from the format before the version of a file."""
    return key in sdf_words.REMOVED and place.version >= sdf_words.REMOVED[key]


def _if_stated(value: str) -> Word | None:
    """Return a harmless word for an empty or false value, and None for others."""
    return Word(Use.HARMLESS) if value.strip().lower() in ("", "0", "false") else None


def _is_true(text: str | None) -> bool:
    return (text or "").strip().lower() in _TRUE


def _child(element: Element, tag: str) -> Element:
    child = element.find(tag)
    return SubElement(element, tag) if child is None else child
