"""load(): robots by name, from files and from models, as a System with its symmetry group."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..common.errors import (
    ChoiceError,
    InputError,
    LeftOutWarning,
    LoadError,
    ModelError,
    ModelWarning,
)
from ..common.files import is_file
from ..common.names import brief, listed, quoted
from ..common.waiting import Wait
from ..lie.group import Group
from ..lie.groups import GROUPS, SE3, group_named
from .body_parameters import link_inertias
from .coordinates import InitialState
from .copy_model import rebuild, split_joints, with_joint_types, without_mimics
from .coupling import ties_of, with_followers
from .find_robot_files import (
    INSTALL_ROBOTS,
    Visuals,
    bundled_robots,
    example_robot,
    example_robots,
    is_mjcf,
    is_mujoco,
    lines_in_messages,
    mesh_folders,
    outermost,
    read_text,
    read_xml,
    text_in_file,
    with_visuals,
)
from .independent_reader import second_reading
from .joints import (
    RootChain,
    is_ball,
    is_shape_joint,
    motion_group,
    places_on_root,
    root_chain,
    root_joint,
)
from .locked_joints import (
    LockedJoints,
    LockValue,
    frozen_configurations,
    lock_values,
    separate_attitudes,
)
from .loops.independent_joints import with_constant_loops
from .loops.kinematics import loop_ends
from .loops.loop import (
    HEAVY_GROUND,
    Constraint,
    JointPolynomial,
    Loop,
    LoopFile,
    parse_loops,
    requested_loops,
)
from .merge_hinges import coupled_joints, locked_hinges, merge_of, requested_balls
from .mjcf.read import read_mujoco
from .model_parameters import with_parameters
from .passive import passive_contents, stated_limits
from .read_sdf import read_sdf
from .read_urdf import FileRobot, read_urdf
from .robot_description import Model
from .robot_file_contents import Contents, Origin
from .system import System, checked_gravity
from .urdf_elements import mimic_couplings
from .urdf_words import left_out_words

if TYPE_CHECKING:
    from mujoco import MjModel, MjSpec

Pair: TypeAlias = tuple[pin.Model, pin.GeometryModel]

_SAME_POINT = 1e-9  # largest distance of points that count as one [m]
_CALLER = 4  # stack level of the caller of `load` for warnings, outside the check of arguments


@dataclass(frozen=True)
class _Robot:
    """A robot before its joints are locked and its root is chosen.

    Attributes:
        file: The robot as its file or model describes it.
        name: Name of the robot.
        origin: File or name that was loaded, if any.
        group: Requested or catalogued symmetry group, if any.
        initial: Generic initial state, if any.
    """

    file: FileRobot
    name: str
    origin: Origin | None
    group: Group | None
    initial: InitialState | None = None


@checks_arguments
def load(
    source: (
        str | Path | Model | pin.Model | pin.RobotWrapper | Pair | MjModel | MjSpec | None
    ) = None,
    *,
    text: str | None = None,
    group: str | Group | None = None,
    lock: Iterable[str] | Mapping[str, ArrayLike] = (),
    gravity: ArrayLike | None = None,
    root: str | None = None,
    strict: bool = False,
    meshes: str | Path | Iterable[str | Path] = (),
    parameters: Mapping[str, ArrayLike] | None = None,
    balls: bool | Iterable[str] = False,
    loops: str | Path | Iterable[Loop | JointPolynomial | Mapping[str, str]] = (),
) -> System:
    """Load a robot as symmetry group times shape.

    Emits a LeftOutWarning for actions in the file that pinred does not simulate
    (System.left_out; not for the limits that URDF demands), and a ModelWarning for doubtful
    inertias, for commas in number lists of a URDF file, and for armature of a free joint.

    Args:
        source: Name of a bundled robot or of one in example-robot-data; path of a URDF, MJCF or SDF
            file; pin.Model, which is copied; pin.RobotWrapper or pair (model, visual_model),
            whose shapes playback shows; mujoco.MjModel; mujoco.MjSpec; or pinred.Model.
        text: Content of a URDF, MJCF or SDF file instead of a source, such as ROS's parameter
            robot_description.  Relative paths in it are searched in `meshes` only.
        group: Symmetry group: "R", "SO2", "SE2", "SO3", "SE3" or "RxSE2".  If None, it follows
            from the file.  A free, planar or spherical root joint sets the group, and the link
            above it is the ground.  So does any first moving joint whose link above is massless
            and carries all other links.  Otherwise the group is SE3: the root link floats on a new
            root joint.  Consecutive joints at the root count as one joint if they move in a group.
        lock: Joints to lock at zero, or mapping from joint to its locked value [rad | m].  The
            value of a ball is a rotation vector [rad] or a quaternion (x, y, z, w).  Followers of a
            locked joint are locked with it.
        gravity: Gravity in the world frame, (3,) [m/s²].  If None, the robot's gravity
            (Pinocchio's 9.81 along −z for a URDF).
        root: For MJCF, the body of the world that carries the robot, if several can move.  For
            SDF, the base link of the robot, or its model.
        strict: Whether to reject robots with doubtful inertias instead of emitting a warning, and
            URDF and SDF files that Pinocchio or Drake, given the untouched file, reads
            differently.  Inertias are doubtful if no mass distribution has these moments, or if
            the mass matrix is singular at isolated shapes.
        meshes: Folder, or folders, in which playback looks for the meshes of a URDF file, and
            `load` for the models that an SDF file includes, besides those above the file.
        parameters: Robot parameters {name: value} that replace values of the file, such as masses
            and placements; `Scene` lists the names.
        balls: Three consecutive hinges to merge into a ball joint, by the name of the ball or of a
            hinge; True: all that meet at one point at right angles, without bodies between them,
            and whose armature, springs, damping and friction are equal.  `inspect` lists them.
            Bundled robots with balls merge theirs by default; an empty list keeps the hinges.
        loops: Closed kinematic loops between links or frames, besides those of the file: `Loop`
            values, mappings with their attributes, a text FRAME=FRAME:KIND,…, or the path of a YAML
            file in the format of example-parallel-robots, which may also change types of joints.
            A relative path is relative to the current folder or to the robot's file.
    Returns:
        System of the robot.
    Raises:
        LoadError: The source does not exist or cannot be read.
        ModelError: pinred cannot reduce the model, or a loop does not close.
        InputError: The group, a joint, the root or another argument is not valid.
        MissingPackageError: The source is MJCF or SDF, and mujoco or drake is not installed.
    """
    if isinstance(source, Model) and text is None:
        balls = (source.balls or False) if balls is False else balls
        text, source = source.urdf(), None
    if (source is None) == (text is None):
        number = "neither" if text is None else "both"
        raise InputError(f"load: expected either a source or text=, got {number}")
    requested = group_named(group) if isinstance(group, str) else group
    if requested is not None and not isinstance(requested, Group):
        raise InputError(f"group must be one of {', '.join(GROUPS)}, got {brief(group)}")
    if not (root is None or isinstance(root, str)):
        raise InputError(f"root must be the name of a body, got {brief(root)}")
    new_gravity = None if gravity is None else checked_gravity(gravity)
    locked, merged = lock_values(lock), requested_balls(balls)
    added = requested_loops(loops, source)
    folders = mesh_folders(meshes)
    with (
        text_in_file(text) if text is not None else nullcontext(source) as place,
        lines_in_messages(_file_of(place)),
    ):
        system = _load_source(place, requested, locked, new_gravity, root, merged, folders, added)
        if strict:
            _check_second_reading(place, folders, root)
    if text is not None:
        # The file is gone, so the text itself is the origin.
        vars(system)["origin"] = Origin("", locked, root, folders, text)
    _report(system, strict=strict)
    return system if parameters is None else with_parameters(system, parameters)


@Wait("reads a robot")
def _load_source(
    source: Any,
    group: Group | None,
    locked: Mapping[str, LockValue],
    gravity: Array | None,
    root: str | None,
    balls: bool | tuple[str, ...],
    folders: tuple[str, ...],
    loops: LoopFile,
) -> System:
    """Load a source other than a text; the arguments are those of `load`, checked."""
    if mjcf_kind := _mjcf_kind(source):
        if folders:
            raise InputError(
                "meshes= applies to URDF and SDF; an MJCF file contains the paths of its meshes"
            )
        return _load_mujoco(
            source, mjcf_kind, group, locked, gravity, root=root, balls=balls, loops=loops
        )
    visuals = with_visuals(source)
    if visuals is not None:
        source = visuals.model
    if not isinstance(source, (str, Path, pin.Model)):
        raise InputError(
            "load takes a name, a path, a pin.Model, a pin.RobotWrapper, (model, "
            f"visual_model), an MjModel or an MjSpec, got {type(source).__name__}"
        )
    if folders and isinstance(source, pin.Model):
        raise InputError(
            "meshes= applies to robots from files only; shapes of a model are passed with it"
        )
    if root is not None and not _is_sdf(source):
        raise InputError(
            f"root={quoted(root)} applies to MJCF and SDF only; in a URDF file or a model one link "
            "carries the robot"
        )
    robot = _read(source, group, locked, folders, root)
    bundled = bundled_robots().get(str(source))
    balls = balls or (balls is False and bundled is not None and bundled.balls)
    if bundled is not None:
        loops = replace(loops, loops=(*bundled.loops, *loops.loops))
    return _load_model(robot, locked, gravity, visuals, balls, loops)


def _check_second_reading(source: object, folders: tuple[str, ...], root: str | None) -> None:
    """Reject a file that an independent reader reads differently.  Raises ModelError."""
    path = _file_of(source)
    if path is None:
        return
    reading = second_reading(path, folders, root)
    if reading is not None and reading.differences:
        raise ModelError(
            f"{quoted(path.stem)} is refused because of strict=True: {reading.reader} reads the "
            f"file differently: {'; '.join(reading.differences[:6])}"
        )


def _file_of(source: object) -> Path | None:
    """Return the file of a source, if it has one."""
    if not isinstance(source, (str, Path)):
        return None
    name = str(source)
    if (bundled := bundled_robots().get(name)) is not None:
        return bundled.path
    if is_path(name):
        return Path(source)
    robots = example_robots()
    return example_robot(name).urdf if name in robots else None


def _report(system: System, *, strict: bool) -> None:
    """Warn about actions left out and about doubts, or refuse doubts if `strict`."""
    # URDF demands limits at most joints, so a warning about them would meet every file.
    unusual = [entry for entry in system.left_out if not entry.demanded]
    if unusual:
        counts = ", ".join(f"{entry.what} ({len(entry.names)})" for entry in unusual)
        message = f"{system.name}: in the file, but not simulated: {counts} (see System.left_out)"
        warnings.warn(message, LeftOutWarning, stacklevel=_CALLER)
    for warning in system.contents.warnings:
        warnings.warn(f"{quoted(system.name)}: {warning}", ModelWarning, stacklevel=_CALLER)
    for doubt in system.doubts:
        if strict:
            raise ModelError(f"{quoted(system.name)} is refused because of strict=True: {doubt}")
        warnings.warn(f"{quoted(system.name)}: {doubt}", ModelWarning, stacklevel=_CALLER)


def _mjcf_kind(source: object) -> str:
    """Return "MjModel", "MjSpec", "path" (the path of an MJCF file), or "" for other sources."""
    for kind in ("MjModel", "MjSpec"):
        if is_mujoco(source, kind):
            return kind
    if not isinstance(source, (str, Path)) or str(source) in bundled_robots():
        return ""
    path = Path(source)
    return "path" if is_path(str(source)) and is_file(path) and is_mjcf(read_text(path)) else ""


def _load_mujoco(
    source: Any,
    kind: str,
    group: Group | None,
    locked: Mapping[str, LockValue],
    gravity: Array | None,
    *,
    root: str | None,
    balls: bool | tuple[str, ...],
    loops: LoopFile,
) -> System:
    """Load a MuJoCo source of a `kind` (see `_mjcf_kind`); other arguments: see `load`."""
    robot = read_mujoco(source, root=root, lock=locked, gravity=gravity, balls=balls)
    model, name, origin = _on_root(robot.model, group, None), robot.name, None
    if kind == "path":
        name = Path(source).stem
        origin = Origin(str(Path(source).absolute()), locked, root)
    model.name = name
    root_group = motion_group(model.joints[1])
    contents = Contents() if root_group is None else robot.contents(root_group)
    if loops.joints:
        raise InputError(
            f"{loops.path}: joint_type: types of joints apply to URDF only; state them in the MJCF "
            "file"
        )
    contents = replace(contents, loops=parse_loops((*contents.loops, *loops.loops)))
    system = System(model, name=name, origin=origin, contents=contents)
    return with_constant_loops(system) if system.loops else system


def _read(
    source: str | Path | pin.Model,
    group: Group | None,
    locked: Mapping[str, LockValue],
    folders: tuple[str, ...],
    root: str | None,
) -> _Robot:
    """Read a robot from a name, a URDF or SDF file or a model; see `load` for the arguments."""
    if isinstance(source, pin.Model):
        described = FileRobot(*without_mimics(source), inertias=link_inertias(source))
        return _Robot(described, source.name, None, group)
    name = str(source)
    origin = Origin(name, locked, meshes=folders)
    if (robot := bundled_robots().get(name)) is not None:
        urdf = read_urdf(robot.path)
        urdf.model.gravity.linear = np.array(robot.gravity)
        group = group or GROUPS[robot.group]
        initial = None
        if not locked and group.name == robot.group:
            x, xdot, xi = (np.array(robot.initial[k], dtype=float) for k in ("x", "xdot", "xi"))
            initial = InitialState(x, xdot, xi, float(robot.initial["duration"]))
        return _Robot(urdf, name, origin, group, initial)
    if _is_sdf(source):
        origin = replace(origin, source=str(Path(source).absolute()), root=root)
        return _Robot(read_sdf(Path(source), folders, root), Path(source).stem, origin, group)
    if is_path(name):
        origin = replace(origin, source=str(Path(source).absolute()))
        return _Robot(read_urdf(Path(source)), Path(source).stem, origin, group)
    return _Robot(_example_model(name), name, origin, group)


def _load_model(
    robot: _Robot,
    lock: Mapping[str, LockValue],
    gravity: Array | None,
    visuals: Visuals | None,
    balls: bool | tuple[str, ...],
    loops: LoopFile,
) -> System:
    """Lock and merge joints of a robot, choose its root joint, and return its system."""
    lock, file = {**dict.fromkeys(loops.fixed, 0.0), **lock}, robot.file
    split = split_joints(with_joint_types(file.model, loops))
    names = list(split.model.names)
    all_couplings = (*file.couplings, *split.couplings)
    lock, balls = locked_hinges(split.model, balls, split.locked(lock))
    ball_names = [n for i, n in enumerate(names) if i and is_ball(split.model.joints[i])]
    values, attitudes = separate_attitudes(lock, ball_names, names)
    locked, couplings = with_followers(values, all_couplings, names)
    hinges = [n for n in names[1:] if split.model.joints[split.model.getJointId(n)].nv == 1]
    forces = passive_contents(split.model, hinges, locked, (), file.springs).passive
    kept = {*locked, *coupled_joints(couplings)}
    merge = merge_of(split.model, balls, passive=forces, kept=kept)
    raw = merge.model(split.model)
    bare = rebuild(raw, frozen=frozen_configurations(raw, locked, attitudes))
    chain = root_chain(bare)
    model = _on_root(bare, robot.group, chain)
    locked_joints = None
    if locked:
        ties, shared = ties_of(locked, all_couplings, names)
        places = {} if chain is None else places_on_root(bare, chain)
        several = tuple(n for n in locked if raw.joints[raw.getJointId(n)].nv > 1)
        locked_joints = LockedJoints(
            raw, locked, ties, places, str(model.names[1]), several, attitudes, shared
        )
    shape = merge.with_hinges(list(model.names)[2:])
    passive = passive_contents(split.model, shape, locked, split.sliding, file.springs)
    contents = replace(
        passive,
        left_out=(
            *file.left_out,
            *passive.left_out,
            *merge.left_out(forces),
            *merge.limits(split.model),
            *stated_limits(file.model, locked=split.whole(locked), merged=merge.hinges),
        ),
        passive=merge.forces(passive.passive),
        links=file.inertias,
        visuals=visuals,
        warnings=(*([file.warning] if file.warning else []), *merge.warnings(split.model)),
        couplings=couplings,
        freed="" if _root_group(bare, chain) else "".join(file.fixed[:1]),
        locked=locked_joints,
        merged=merge.triples,
        loops=parse_loops((*_moving_loops(robot, model, loops.loops), *loops.loops)),
    )
    initial = robot.initial
    if initial is not None:
        followers = {coupling.follower for coupling in couplings}
        initial = merge.initial(initial, [name for name in shape if name not in followers])
    if gravity is not None:
        model.gravity.linear = gravity
    model.name = robot.name
    system = System(model, robot.name, initial, robot.origin, contents)
    return with_constant_loops(system, loops.driven) if system.loops else system


def _is_sdf(source: object) -> bool:
    """Return whether a source is the path of an SDF file."""
    if not isinstance(source, (str, Path)) or str(source) in bundled_robots():
        return False
    return is_path(str(source)) and outermost(read_text(Path(source))) == "sdf"


def _moving_loops(
    robot: _Robot, model: pin.Model, requested: Sequence[Constraint]
) -> Iterator[Loop]:
    """Yield the loops of a file, without those that locked joints or the call replace.

    Args:
        robot: The robot.
        model: Its model, with its root joint and without locked joints.
        requested: Loops that the call states; they replace loops of the same name, or at the same
            points.
    Raises:
        ModelError: A loop attaches the robot to the world.
    """
    names = {loop.name for loop in requested}
    stated = [_points(model, loop) for loop in requested if isinstance(loop, Loop)]
    for loop in robot.file.loops:
        points = _points(model, loop)
        joints = {joint for joint, _ in points}
        if loop.name in names or len(joints) == 1 or any(_same_points(points, p) for p in stated):
            continue
        if 0 in joints:
            raise ModelError(
                f"joint {quoted(loop.name)}{robot.file.lines.get(loop.name, '')} of "
                f"{quoted(robot.name)} closes a loop through the world, so the base cannot move "
                "freely, which breaks the symmetry; remove it, lock the joints of the loop, fix a "
                "link with mass to the world, which carries the others and is then the root link, "
                f"or {HEAVY_GROUND}"
            )
        yield loop


def _points(model: pin.Model, loop: Loop) -> list[tuple[int, Array]]:
    """Return the ends of a loop as (joint, point in its frame), ordered by joint."""
    ends = loop_ends(model, loop)
    return sorted(((end.joint, end.placement.translation) for end in ends), key=lambda e: e[0])


def _same_points(a: list[tuple[int, Array]], b: list[tuple[int, Array]]) -> bool:
    """Return whether two loops have their ends at the same points."""
    return all(
        i == j and np.abs(p - q).max() <= _SAME_POINT for (i, p), (j, q) in zip(a, b, strict=True)
    )


def is_path(name: str) -> bool:
    """Return whether a source is a file path instead of the name of a known robot."""
    return "/" in name or Path(name).suffix != "" or is_file(Path(name))


def _on_root(raw: pin.Model, group: Group | None, chain: RootChain | None) -> pin.Model:
    """Return the model with a root joint of the requested group: its current root, or a new one.

    Args:
        raw: Model.
        group: Requested group, or None for the group of the current root.
        chain: Consecutive joints at the root that form one joint, if any.
    Raises:
        ChoiceError: It is unclear whether the root link is fixed or floats.
        ModelError: The current root moves in another group.
    """
    root_group = _root_group(raw, chain)
    if root_group is None:
        if group is None and raw.njoints > 1 and raw.inertias[0].mass == 0.0:
            raise ChoiceError(_unclear_root(raw), "group", ("SE3",))
        return rebuild(raw, root=root_joint(group or SE3))
    if group in (None, root_group):
        return raw if chain is None else rebuild(raw, root=root_joint(root_group), chain=chain)
    joints = list(raw.names)[1 : 2 if chain is None else chain.last + 1]
    locked = "' or '".join(joints)
    way_out = f"load it with group='{root_group}', or lock '{locked}'"
    if chain is None and raw.joints[1].nv == 1:
        way_out += ", or give the massless link above it a mass so that it can float"
    raise ModelError(
        f"group {group} was requested, but the root joint '{'+'.join(joints)}' of the model has "
        f"group {root_group}; {way_out}"
    )


def _unclear_root(raw: pin.Model) -> str:
    """Return the error message that asks whether a massless root link is fixed or floats."""
    links = [f.name for f in raw.frames if f.parentJoint == 0 and f.type == pin.FrameType.BODY]
    carried = [raw.names[i] for i in range(1, raw.njoints) if raw.parents[i] == 0]
    link = f"the root link {quoted(links[0])}" if links else "the root"
    return (
        f"{link} has no mass and carries several joints ({listed(carried)}): does it stand, or "
        "float? group='SE3' lets it float; as a ground it must carry one joint: lock the others, "
        "or give it a mass"
    )


def _root_group(raw: pin.Model, chain: RootChain | None) -> Group | None:
    """Return the group of the root joints in a model, or None if it needs a new root."""
    if chain is not None:
        return chain.group
    if raw.njoints < 2:
        return None
    group = motion_group(raw.joints[1])
    if not is_shape_joint(raw.joints[1]):
        return group
    anchored = raw.inertias[0].mass == 0.0
    carries_all = all(raw.parents[i] != 0 for i in range(2, raw.njoints))
    return group if anchored and carries_all else None


def _example_model(name: str) -> FileRobot:
    """Return a robot of example-robot-data, with rotor armature.

    Raises:
        LoadError: The name is unknown; the message has similar names.
    """
    names = example_robots()
    if name not in names:
        near = difflib.get_close_matches(name[:200], [*bundled_robots(), *names], n=3)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        more = "" if names else f"; for solo12, talos, ur5 and others: {INSTALL_ROBOTS}"
        raise LoadError(
            f"unknown robot {quoted(name)}; {hint}`pinred robots` lists what can be loaded{more}"
        )
    robot = example_robot(name)
    if robot.build is None:
        described: FileRobot = read_urdf(robot.urdf)
    else:
        root = read_xml(robot.urdf)
        model, couplings = without_mimics(robot.build().robot.model)
        if not couplings:
            candidates = mimic_couplings(root)
            couplings = tuple(c for c in candidates if model.existJointName(c.follower))
        described = FileRobot(model, couplings, left_out=left_out_words(root))
    if robot.rotors is not None:
        model = described.model
        pin.loadRotorParameters(model, str(robot.rotors), False)
        model.armature = model.rotorInertia * model.rotorGearRatio**2
    return described
