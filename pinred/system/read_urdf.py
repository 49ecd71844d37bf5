"""read_urdf(): the robot in a URDF file, without meshes, and the joints that close its loops.

Pinocchio ignores, or replaces by defaults, entries that change the dynamics: mimic joints, links
on two joints, axes of length zero, incomplete inertias.  `urdf_elements` reads these entries from
the file; they are used or refused.  `urdf_words` reports what is left out.

Loops are closed by joints beyond the tree, as other programs write them:

| written as | frames |
|---|---|
| <gazebo><joint>, as in SDF | pose in the child; the parent has the same frame at zero |
| Drake's <loop_joint> | both stated |
| Drake's <drake:ball_constraint> | both points stated |
| a second <joint> with the same child | origin in the parent; the frame of the child |
| links closing_NAME_1 and closing_NAME_2 of onshape-to-robot | these links, at one point |
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn, TypeVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import LoadError, ModelError
from ..common.names import listed, nearest, plain, plain_path, quoted
from .copy_model import NewJoint, copy_losses, rebuild
from .find_robot_files import library_output, place, read_xml
from .loops.loop import HEAVY_GROUND, Loop, LoopKind
from .passive import UNLIMITED, Spring
from .robot_file_contents import Coupling, LeftOut
from .urdf_elements import (
    WORLD,
    axis_of,
    check_urdf,
    file_frames,
    file_springs,
    floats,
    keep_numbers,
    link_inertias,
    mimic_couplings,
    origin_of,
    prepare,
    reduced_text,
    replace_commas,
    rotation_to,
    rotor_inertias,
    special_joints,
    tree_depth,
    unit_vector,
)
from .urdf_words import LOOPS, SPRINGS, left_out_words

# Kind of loop that each type of joint closes; "axis" for a hinge.
_KINDS = {
    "revolute": "axis",
    "continuous": "axis",
    "hinge": "axis",
    "ball": "3d",
    "spherical": "3d",
    "fixed": "6d",
}
_CLOSING = re.compile(r"(closing_.+)_([12])")
_ALIGNED = 1e-12  # largest deviation of a unit axis from x, y or z that counts as round-off
_MODEL = ("__model__", "model")  # SDF's names of the frame of the model


@dataclass(frozen=True, eq=False)
class ClosingJoint:
    """A joint of a file that closes a loop.

    Attributes:
        name: Name of the joint.
        line: Its line, as " (line 7)".
        kind: Type of the joint, in `_KINDS`.
        links: Names of both links.
        second: Placement of the joint in the second link.
        first: Placement in the first link; None if both coincide where all joints are at zero.
        axis: Axis of a hinge in the frame of the joint, (3,).
        relative_to: Link in whose frame `second` is stated, if it is not the second link.
        axis_in: Link in whose frame `axis` is stated, if it is not the frame of the joint.
    """

    name: str
    line: str
    kind: str
    links: tuple[str, str]
    second: pin.SE3 = field(default_factory=pin.SE3.Identity)
    first: pin.SE3 | None = None
    axis: Array = field(default_factory=lambda: np.eye(3)[0])
    relative_to: str = ""
    axis_in: str = ""

    @property
    def label(self) -> str:
        """The name and the line."""
        return f"{quoted(self.name)}{self.line}"


def take_closing_joints(robot: Element) -> tuple[tuple[ClosingJoint, ...], tuple[LeftOut, ...]]:
    """Remove the joints that close loops from a robot, in place, so that a tree remains.

    Args:
        robot: Element <robot>, after `prepare`.
    Returns:
        The joints that close loops, and what is left out of them.
    Raises:
        ModelError: A joint lacks a link or a number, or follows another joint.
    """
    second, losses, limits = _second_joints(robot)
    closing = [*second, *_loop_joints(robot), *_gazebo_joints(robot)]
    closing += [*_ball_constraints(robot), *_closing_frames(robot)]
    links = {link.get("name", "") for link in robot.findall("link")}
    if second and len(roots := _roots(robot)) > 1:
        _refuse_several_roots(robot, second[0], roots)
    for joint in closing:
        for name in joint.links:
            if name == WORLD and name not in links:
                tied = joint.links[joint.links[0] == WORLD]
                raise ModelError(
                    f"joint {joint.label} ties link {quoted(tied)} to the world, so the base "
                    f"{quoted(next(iter(_roots(robot)), '?'))} cannot move freely, which breaks "
                    f"the symmetry; remove it, or make {quoted(tied)} the base: a <joint> from a "
                    f"link 'world' carries it, and it carries the others; or {HEAVY_GROUND}"
                )
            if name not in links:
                raise ModelError(
                    f"joint {joint.label} closes a loop at the link {quoted(name)}, which the file "
                    f"does not contain; {nearest(name, sorted(links))}name a link of the robot"
                )
    other = [joint.label for joint in closing if joint.kind not in _KINDS]
    return tuple(joint for joint in closing if joint.kind in _KINDS), tuple(
        left
        for left in (
            LeftOut(LOOPS, tuple(other)),
            LeftOut(SPRINGS, tuple(losses)),
            LeftOut("limits of joints that close loops", tuple(limits), demanded=True),
        )
        if left.names
    )


def add_loops(model: pin.Model, closing: Sequence[ClosingJoint]) -> tuple[Loop, ...]:
    """Return the loops that joints close, and add the frames of the loops to a model.

    Args:
        model: Model of the tree.
        closing: The joints.
    """
    if not closing:
        return ()
    data, loops = model.createData(), []
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    places = {
        str(frame.name): data.oMf[k].copy()
        for k, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY
    }
    model_place = places[str(next(f.name for f in model.frames if f.type == pin.FrameType.BODY))]
    places |= dict.fromkeys(_MODEL, model_place)
    for joint in closing:
        first, second = (places[link] for link in joint.links)
        at = joint.second
        if joint.relative_to:
            at = second.actInv(places[joint.relative_to] * at)
        axis = joint.axis
        if joint.axis_in:
            axis = (second * at).rotation.T @ places[joint.axis_in].rotation @ axis
        kind, turn = _aligned(_KINDS[joint.kind], axis)
        ends = (first.actInv(second * at) if joint.first is None else joint.first, at)
        frames = []
        for number, (link, end) in enumerate(zip(joint.links, ends, strict=True), start=1):
            body = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
            frames.append(_unused(model, f"{joint.name} {number}"))
            placement = body.placement * end * turn
            kind_of_frame = pin.FrameType.OP_FRAME
            model.addFrame(
                pin.Frame(frames[-1], body.parentJoint, 0, placement, kind_of_frame), False
            )
        loops.append(Loop(frames[0], frames[1], kind, joint.name))
    return tuple(loops)


def _aligned(kind: str, axis: Array) -> tuple[LoopKind, pin.SE3]:
    """Return the kind of a loop, and the rotation of its frames that puts a hinge on an axis."""
    here = pin.SE3.Identity()
    if kind != "axis":
        return ("3d" if kind == "3d" else "6d"), here
    for k, name in ((0, "x"), (1, "y"), (2, "z")):
        if np.abs(np.delete(axis, k)).max() <= _ALIGNED:
            return name, here  # type: ignore[return-value]
    turn = rotation_to(axis)
    assert turn is not None
    return "z", pin.SE3(turn, np.zeros(3))


def _unused(model: pin.Model, name: str) -> str:
    while model.existFrame(name):
        name = f"{name}_"
    return name


def _second_joints(robot: Element) -> tuple[list[ClosingJoint], list[str], list[str]]:
    """Remove the joints whose child another joint carries already.

    Returns:
        The joints, and the names of their springs, dampers and friction, and of their limits.
    Raises:
        ModelError: A joint follows another joint.
    """
    joints, losses, limits = list[ClosingJoint](), list[str](), list[str]()
    carried = set[str]()
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            continue  # Pinocchio's reader rejects the joint.
        link = child.get("link", "?")
        if link not in carried:
            carried.add(link)
            continue
        name, line = _name(joint)
        if joint.find("mimic") is not None:
            raise ModelError(
                f"joint {quoted(name)}{line} closes a loop, because another joint carries link "
                f"{quoted(link)}, but it follows a joint; remove its <mimic>"
            )
        robot.remove(joint)
        dynamics = joint.find("dynamics")
        if dynamics is not None and any(_is_nonzero(v) for v in dynamics.attrib.values()):
            losses.append(f"{name}{line}")
        if joint.find("limit") is not None:
            limits.append(f"{name}{line}")
        joints.append(
            ClosingJoint(
                name, line, joint.get("type", ""), (parent.get("link", "?"), link),
                first=origin_of(joint.find("origin"), f"joint {quoted(name)}"),
                axis=axis_of(joint.find("axis"), name),
            )
        )  # fmt: skip
    return joints, losses, limits


def _roots(robot: Element) -> list[str]:
    """Return the names of the links that no joint carries."""
    carried = {child.get("link") for child in robot.iterfind("joint/child")}
    names = [link.get("name", "?") for link in robot.findall("link")]
    return [name for name in names if name not in carried]


def _refuse_several_roots(robot: Element, joint: ClosingJoint, roots: list[str]) -> NoReturn:
    """Reject a second joint of a link that ties two trees.  Raises ModelError."""
    link = joint.links[1]
    first = next(
        other for other in robot.findall("joint")
        if (child := other.find("child")) is not None and child.get("link") == link
    )  # fmt: skip
    name, line = _name(first)
    raise ModelError(
        f"joint {joint.label} carries link {quoted(link)}, which joint {quoted(name)}{line} "
        f"carries, too, so {listed(roots, 6)} have no joint that carries them, but only the root "
        f"link may have none; reverse the joints between {quoted(link)} and one of these, or "
        "remove a joint"
    )


def _is_nonzero(text: str) -> bool:
    try:
        return float(text) != 0.0
    except ValueError:
        return True


def _loop_joints(robot: Element) -> list[ClosingJoint]:
    """Return Drake's joints that close loops."""
    joints = []
    for joint in [*robot.findall("loop_joint"), *robot.findall("drake:loop_joint")]:
        name, line = _name(joint)
        first, second = (_child(joint, tag) for tag in ("link1", "link2"))
        joints.append(
            ClosingJoint(
                name, line, joint.get("type", ""),
                (first.get("link", "?"), second.get("link", "?")),
                origin_of(second, f"joint {quoted(name)}"),
                origin_of(first, f"joint {quoted(name)}"), axis_of(joint.find("axis"), name),
            )
        )  # fmt: skip
    return joints


def _ball_constraints(robot: Element) -> list[ClosingJoint]:
    """Return Drake's constraints that hold a point of one body at a point of another."""
    joints = []
    for number, element in enumerate(robot.findall("drake:ball_constraint"), start=1):
        name = f"ball_constraint_{number}"
        a, b, p, q = (
            _child(element, f"drake:ball_constraint_{end}")
            for end in ("body_A", "body_B", "p_AP", "p_BQ")
        )
        at_p, at_q = (
            pin.SE3(np.eye(3), floats(point, "value", f"a point of {name}", 3)) for point in (p, q)
        )
        links = a.get("name", ""), b.get("name", "")
        joints.append(ClosingJoint(name, place(element), "ball", links, at_q, at_p))
    return joints


def _gazebo_joints(robot: Element) -> list[ClosingJoint]:
    """Return the joints in elements <gazebo>, which are those of SDF."""
    joints = []
    for joint in robot.iterfind("gazebo/joint"):
        name, line = _name(joint)
        links = [_link_of(_child(joint, tag)) for tag in ("parent", "child")]
        pose, axis = joint.find("pose"), joint.find("axis")
        values = np.zeros(6)
        if pose is not None:
            values = floats(pose, "", f"the pose of joint {quoted(name)}", 6)
        closing = ClosingJoint(
            name, line, joint.get("type", ""), (links[0], links[1]),
            pin.SE3(pin.rpy.rpyToMatrix(values[3:]), values[:3]),
            relative_to="" if pose is None else pose.get("relative_to", pose.get("frame", "")),
        )  # fmt: skip
        xyz = None if axis is None else axis.find("xyz")
        if axis is not None and xyz is not None:
            in_model = (axis.findtext("use_parent_model_frame") or "0").strip().lower()
            frame = _MODEL[0] if in_model in ("1", "true") else xyz.get("expressed_in", "")
            vector = floats(xyz, "", f"the axis of joint {quoted(name)}", 3)
            closing = ClosingJoint(
                **{**vars(closing), "axis": unit_vector(vector, name), "axis_in": frame}
            )
        links_of_file = {link.get("name") for link in robot.findall("link")}
        for key in ("relative_to", "axis_in"):
            frame = vars(closing)[key]
            if frame and frame not in (*_MODEL, *links_of_file):
                raise ModelError(
                    f"joint {quoted(name)}{line} in <gazebo> refers to the frame {quoted(frame)}; "
                    "refer to a link"
                )
        joints.append(closing)
    return joints


def _closing_frames(robot: Element) -> list[ClosingJoint]:
    """Return the pairs of links that onshape-to-robot adds where a loop is cut."""
    pairs: dict[str, dict[str, Element]] = {}
    for link in robot.findall("link"):
        match = _CLOSING.fullmatch(link.get("name", ""))
        if match:
            pairs.setdefault(match[1], {})[match[2]] = link
    return [
        ClosingJoint(
            name, place(pair["1"]), "ball", (f"{name}_1", f"{name}_2"), first=pin.SE3.Identity()
        )
        for name, pair in pairs.items()
        if len(pair) == 2
    ]  # fmt: skip


def _name(joint: Element) -> tuple[str, str]:
    return joint.get("name", "?"), place(joint)


def _child(element: Element, tag: str) -> Element:
    child = element.find(tag)
    if child is None:
        name = quoted(element.get("name", element.tag))
        raise ModelError(f"{name}{place(element)} closes a loop, but has no <{tag}>; add it")
    return child


def _link_of(element: Element) -> str:
    """Return the link that an element of SDF names."""
    return element.get("link", element.text or "").strip()


T = TypeVar("T")

# Message of the URDF parser: one line with the error, and one with a position in its C++ source.
URDFDOM = re.compile(
    rb"^(?:Error|Warning|Info|Debug):[^\n]*\n +at line \d+ in [^\n]*\n?", re.MULTILINE
)
# Above this depth of links, the parser runs in a thread with this stack size per link [byte].
_DEEP, _STACK = 500, 65536
_MOST_LINKS = 20_000  # largest accepted number of links, because the parser recurses once per link


@dataclass(frozen=True, eq=False)
class FileRobot:
    """A robot as its URDF or SDF file, or a pin.Model, describes it.

    Attributes:
        model: Model with all joints and the root joint of the file.
        couplings: Couplings of joints that follow others.
        springs: Springs at joints.
        loops: Closed loops; their frames are in the model.
        left_out: Words and actions of the file that are left out.
        warning: Warning about parts of the file that are not read as written, or "".
        inertias: Inertia of each link with mass, in its own frame.
        lines: Lines of the joints that close loops, such as " (line 7)", by name.
        fixed: Names of the links with mass that the file fixes to the world.
    """

    model: pin.Model
    couplings: tuple[Coupling, ...] = ()
    springs: tuple[Spring, ...] = ()
    loops: tuple[Loop, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    warning: str = ""
    inertias: Mapping[str, pin.Inertia] = field(default_factory=dict)
    lines: Mapping[str, str] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class UrdfRobot(FileRobot):
    """A robot in a URDF file.

    Attributes:
        special: Joints that Pinocchio's parser does not read, by name.
    """

    special: Mapping[str, NewJoint] = field(default_factory=dict)


def read_urdf(path: Path) -> UrdfRobot:
    """Read the robot in a URDF file.

    Args:
        path: Path of the file.
    Returns:
        The robot.
    Raises:
        LoadError: The file cannot be read.
        ModelError: pinred cannot reduce the robot.
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise LoadError(
            f"{plain_path(path)}, line {root.line}: expected <robot> (URDF), <mujoco> (MJCF) or "
            f"<sdf>, got <{plain(root.tag)}>; convert the file to one of these formats"
        )
    _refuse_macros(path, root)
    if (links := len(root.findall("link"))) > _MOST_LINKS:
        raise LoadError(f"{plain_path(path)} has {links} links, more than {_MOST_LINKS}")
    left_out = left_out_words(root)
    warning = replace_commas(root)
    prepare(root)
    check_urdf(root)
    closing, beyond = take_closing_joints(root)
    springs, more = file_springs(root)
    couplings = mimic_couplings(root)
    model = _parsed(path, root)
    inertias = link_inertias(root)
    _check_mass(path, model, sum(inertia.mass for inertia in inertias.values()))
    for limits in (model.lowerPositionLimit, model.upperPositionLimit):
        limits[np.abs(limits) >= UNLIMITED] *= np.inf
    special = special_joints(root)
    model = with_other_joints(model, special)
    keep_numbers(root, model)
    rotors = _add_rotors(root, model)
    file_frames(root, model)
    loops = add_loops(model, closing)
    left_out = (*left_out, *beyond, *more, *rotors)
    lines = {joint.name: joint.line for joint in closing}
    return UrdfRobot(
        model, couplings, springs, loops, left_out, warning, inertias, lines,
        _fixed_links(model, inertias), special,
    )  # fmt: skip


def _parsed(path: Path, root: ElementTree.Element) -> pin.Model:
    """Return the model that Pinocchio reads from the elements of a file.  Raises LoadError."""
    text, depth = reduced_text(root), tree_depth(root)
    model, why = None, ""
    with library_output(URDFDOM) as messages:
        try:
            model = with_deep_stack(lambda: pin.buildModelFromXML(text), depth)
        except Exception as error:  # Pinocchio raises parser errors of any type.
            why = str(error).strip() or type(error).__name__
    if model is None:
        reason = messages[0].splitlines()[0] if messages else why.splitlines()[-1]
        raise LoadError(
            f"Pinocchio cannot read {plain_path(path)}: {reason.removeprefix('Error:').strip()}"
        )
    return model


def with_other_joints(model: pin.Model, special: Mapping[str, NewJoint]) -> pin.Model:
    """Return a model with some joints replaced, whose other joints keep all their numbers.

    Args:
        model: The model.
        special: New joints by name.
    Returns:
        The model; `model` itself if no joint is replaced.
    """
    if not special:
        return model
    replaced = {int(model.getJointId(name)): [joint] for name, joint in special.items()}
    rebuilt = rebuild(model, replaced=replaced)
    copy_losses(model, rebuilt, dict.fromkeys(replaced, ()))
    return rebuilt


def _fixed_links(model: pin.Model, inertias: Mapping[str, pin.Inertia]) -> tuple[str, ...]:
    """Return the links with mass that a file fixes to a link `world` without mass."""
    names = [
        str(frame.name)
        for frame in model.frames
        if frame.parentJoint == 0 and frame.type == pin.FrameType.BODY
    ]
    if names[:1] != [WORLD] or WORLD in inertias:
        return ()
    return tuple(name for name in names if name in inertias)


def _add_rotors(root: ElementTree.Element, model: pin.Model) -> tuple[LeftOut, ...]:
    """Add armature to a model; return the armature that is left out."""
    rotors = []
    for name, armature in rotor_inertias(root).items():
        joint = model.joints[model.getJointId(name)]
        if joint.nv == 1 or joint.shortname() == "JointModelSpherical":
            model.armature[joint.idx_v : joint.idx_v + joint.nv] = armature
        else:
            rotors.append(name)
    what = "armature of joints with several degrees of freedom"
    return (LeftOut(what, tuple(rotors)),) if rotors else ()


def with_deep_stack(parse: Callable[[], T], depth: int) -> T:
    """Run a parser on a robot whose chains have at most `depth` links; return its result."""
    if depth < _DEEP:
        return parse()
    # The parser recurses once per link and would overflow the default stack.
    before = threading.stack_size(_STACK * depth)
    try:
        with ThreadPoolExecutor(1) as one:
            return one.submit(parse).result()
    finally:
        threading.stack_size(before)


def _check_mass(path: Path, model: pin.Model, file_mass: float) -> None:
    """Reject a model from which Pinocchio dropped the inertia of a link."""
    model_mass = sum(inertia.mass for inertia in model.inertias)
    if abs(model_mass - file_mass) > 1e-9 * max(model_mass, file_mass):
        raise ModelError(
            f"{plain_path(path)} has links of {file_mass:g} kg in total, but Pinocchio reads "
            f"{model_mass:g} kg; check the inertial elements"
        )


def _refuse_macros(path: Path, root: ElementTree.Element) -> None:
    """Reject a template that xacro must expand.  Raises LoadError with the command to run."""
    used = next((e.tag for e in root.iter() if e.tag.startswith("xacro:")), "")
    elements = [*root.iterfind("joint"), *root.iterfind("link/inertial")]
    values = [
        value for top in elements for element in top.iter() for value in element.attrib.values()
    ]
    values += [link.get("name", "") for link in root.iterfind("link")]
    if used or any(mark in value for mark in ("${", "$(") for value in values):
        name = path.name.partition(".")[0] + ("" if path.suffix == ".xacro" else "_expanded")
        shown = plain_path(path)
        raise LoadError(
            f"{shown} is a template with macros{f' (<{used}>)' if used else ''}; expand it with "
            f"`xacro {shown} > {plain_path(Path(name))}.urdf`, and load the result"
        )
