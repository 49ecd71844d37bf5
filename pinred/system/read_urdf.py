"""read_urdf(): the robot in a URDF file, without meshes.

Pinocchio ignores, or replaces by defaults, entries that change the dynamics: mimic joints, links
on two joints, axes of length zero, incomplete inertias.  `urdf_elements` and `urdf_loops` read
these entries from the file; they are used or refused.  `urdf_words` reports what is left out.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..common.errors import LoadError, ModelError
from ..common.names import plain, plain_path
from .loops.loop import Loop
from .passive import Spring
from .rebuild import NewJoint, copy_losses, rebuild
from .robot_file_contents import Coupling, LeftOut
from .robot_files import library_output, read_xml
from .urdf_elements import (
    UNLIMITED,
    WORLD,
    check_urdf,
    file_frames,
    file_springs,
    keep_numbers,
    link_inertias,
    mimic_couplings,
    prepare,
    reduced_text,
    replace_commas,
    rotor_inertias,
    special_joints,
    tree_depth,
)
from .urdf_loops import add_loops, take_closing_joints
from .urdf_words import left_out_words

T = TypeVar("T")

# Message of the URDF parser: one line with the error, and one with a position in its C++ source.
URDFDOM = re.compile(
    rb"^(?:Error|Warning|Info|Debug):[^\n]*\n +at line \d+ in [^\n]*\n?", re.MULTILINE
)
# Above this depth of links, the parser runs in a thread with this stack size per link [byte].
_DEEP, _STACK = 500, 65536
_MOST_LINKS = 20_000  # largest accepted number of links, because the parser recurses once per link


@dataclass(frozen=True, eq=False)
class UrdfRobot:
    """A robot in a URDF file.

    Attributes:
        model: Model with the root joint of the file.
        couplings: Couplings of joints that follow others.
        springs: Springs at joints.
        loops: Closed loops; their frames are in the model.
        left_out: Words of the file that are left out.
        warning: Warning about the text of the file, or "".
        special: Joints that Pinocchio's parser does not read, by name.
        links: Inertia of each link with mass, in its own frame.
        lines: Lines of the joints that close loops, such as " (line 7)", by name.
        fixed: Names of the links with mass that the file fixes to a link `world` without mass.
    """

    model: pin.Model
    couplings: tuple[Coupling, ...] = ()
    springs: tuple[Spring, ...] = ()
    loops: tuple[Loop, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    warning: str = ""
    special: Mapping[str, NewJoint] = field(default_factory=dict)
    links: Mapping[str, pin.Inertia] = field(default_factory=dict)
    lines: Mapping[str, str] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()


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
        model, couplings, springs, loops, left_out, warning, special, inertias, lines,
        _fixed_links(model, inertias),
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
