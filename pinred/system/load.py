"""load(): from a name, a file or a model to a System with its symmetry group."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats, entries_of, vector
from ..common.errors import (
    ChoiceError,
    InputError,
    LeftOutWarning,
    LoadError,
    ModelError,
    ModelWarning,
)
from ..common.paths import is_file
from ..common.plain_names import brief, listed, quoted
from ..lie.group import Group
from ..lie.groups import GROUPS, group_named
from ..lie.se3 import SE3
from . import catalogue
from .contents import Contents, Coupling, Origin
from .coordinates import InitialState
from .coupling import locked_by, with_followers
from .joints import motion_group, root_joint
from .locked_joints import LockedJoints, Tie
from .mjcf.package import is_mujoco
from .mjcf.read import read_mujoco
from .model_parameters import with_parameters
from .passive import passive_contents
from .rebuild import rebuild, without_mimics
from .robot_files import is_mjcf, read_description, read_text, read_xml
from .root_chain import RootChain, places_on_root, root_chain
from .system import System
from .urdf import mimic_couplings
from .visuals import mesh_folders, with_visuals

if TYPE_CHECKING:
    from mujoco import MjModel, MjSpec

Pair: TypeAlias = tuple[pin.Model, pin.GeometryModel]

_HUGE = 1e100  # m/s²; the square of what is far above overflows


def load(
    source: str | Path | pin.Model | pin.RobotWrapper | Pair | MjModel | MjSpec,
    *,
    group: str | Group | None = None,
    lock: Iterable[str] | Mapping[str, float] = (),
    gravity: ArrayLike | None = None,
    root: str | None = None,
    strict: bool = False,
    meshes: str | Path | Iterable[str | Path] = (),
    parameters: Mapping[str, ArrayLike] | None = None,
) -> System:
    """Load a robot and read it as symmetry group times shape.

    source: the name of a bundled robot or of one in example-robot-data, the path of a
        URDF or MJCF file, a pin.Model (which is copied), a pin.RobotWrapper or a pair (model,
        visual_model), whose shapes playback then shows, or mujoco's MjModel or MjSpec.
        Meshes are read only where an MJCF file takes mass from them.
    group: the symmetry, "R", "SO2", "SE2", "SO3", "SE3" or "RxSE2".  If None, the file's own
        root: its free, planar or spherical root joint (the link above that is the ground); or
        its first moving joint, if the link above has no mass (a mere anchor) and all else
        hangs on it; else SE3: a root link with mass floats on a new root joint.  Joints at
        the root with nothing between them are one joint, if a group moves so.
    lock: joints to freeze at zero, or a mapping from joint to its fixed value [rad | m].
        Those that follow a locked joint are locked with it.
    gravity: (3,) in the world frame [m/s²]; if None, what the robot comes with
        (Pinocchio's 9.81 along −z for a URDF).
    root: of an MJCF file, the body of the world that carries the robot, where several move.
    strict: whether to refuse what there is otherwise only a ModelWarning about: moments of
        inertia that no distribution of mass has, and mass matrices singular at single shapes.
    meshes: a folder, or several, in which playback looks for the meshes of a URDF file, beside
        those above the file.
    parameters: {name: value} of masses, placements and other numbers of the robot that are to be
        others than in the file, by the names that `Scene` has for them.

    Warns with LeftOutWarning of what acts in a file and is not part of the reduction
    (System.left_out).  Raises LoadError if there is nothing to read, ModelError if pinred
    cannot reduce the model, InputError for an unknown group, joint or root,
    MissingPackageError for MJCF without mujoco.
    """
    wanted = group_named(group) if isinstance(group, str) else group
    if wanted is not None and not isinstance(wanted, Group):
        raise InputError(f"group must be one of {', '.join(GROUPS)}, got {brief(group)}")
    if not (root is None or isinstance(root, str)):
        raise InputError(f"root must be the name of a body, got {brief(root)}")
    weight = None if gravity is None else _gravity(gravity)
    locked = _locked(lock)
    folders = mesh_folders(meshes)
    given = {} if parameters is None else parameters
    if mujoco := _as_mujoco(source):
        if folders:
            raise InputError("meshes= is for URDF; an MJCF file says where its meshes are")
        system = _load_mujoco(source, mujoco, wanted, locked, weight, root)
        return with_parameters(system, given)
    visuals = with_visuals(source)
    if visuals is not None:
        source = visuals.model
    if not isinstance(source, (str, Path, pin.Model)):
        raise InputError(
            "load takes a name, a path, a pin.Model, a pin.RobotWrapper, (model, visual_model), an "
            f"MjModel or an MjSpec, got {type(source).__name__}"
        )
    if folders and isinstance(source, pin.Model):
        raise InputError("meshes= is for robots from files; a model comes with its shapes, or none")
    if root is not None:
        raise InputError(f"root={quoted(root)} is for MJCF; elsewhere one link carries the robot")
    initial: InitialState | None = None
    name = str(source)
    origin: Origin | None = Origin(name, locked, meshes=folders)
    couplings: tuple[Coupling, ...]
    if isinstance(source, pin.Model):
        raw, couplings = without_mimics(source)
        name, origin = source.name, None
    elif (robot := catalogue.bundled_robots().get(name)) is not None:
        raw, couplings = read_description(robot.path)
        raw.gravity.linear = np.array(robot.gravity)
        wanted = wanted or group_named(robot.group)
        if not locked and wanted.name == robot.group:
            initial = _initial_state(robot.initial)
    elif is_path(name):
        raw, couplings = read_description(Path(source))
        name = Path(source).stem
        origin = Origin(str(Path(source).absolute()), locked, meshes=folders)
    else:
        raw, couplings = _example(name)
    every = couplings
    locked, couplings = with_followers(locked, every, list(raw.names))
    bare = rebuild(raw, frozen=_frozen(raw, locked))
    chain = root_chain(bare)
    model = _on_root(bare, wanted, chain)
    contents = passive_contents(raw, list(model.names)[2:], locked)
    fixed = None
    if locked:
        ties = {
            name: Tie(each.leader, (each.offset, each.ratio))
            for name, each in locked_by(locked, every, list(raw.names)).items()
        }
        places = {} if chain is None else places_on_root(bare, chain)
        several = tuple(n for n in locked if raw.joints[raw.getJointId(n)].nv > 1)
        fixed = LockedJoints(raw, locked, ties, places, str(model.names[1]), several)
    contents = replace(contents, visuals=visuals, couplings=couplings, locked=fixed)
    if weight is not None:
        model.gravity.linear = weight
    model.name = name
    system = System(model, name=name, initial=initial, origin=origin, contents=contents)
    _warn_of_left_out(system)
    for doubt in system.doubts:
        if strict:
            raise ModelError(f"{quoted(name)} is refused, strictly: {doubt}")
        warnings.warn(f"{quoted(name)}: {doubt}", ModelWarning, stacklevel=2)
    return with_parameters(system, given)


def _as_mujoco(source: object) -> str:
    """Return what kind of MJCF a source is: a path, an MjModel or an MjSpec; else nothing."""
    for kind in ("MjModel", "MjSpec"):
        if is_mujoco(source, kind):
            return kind
    if not isinstance(source, (str, Path)) or str(source) in catalogue.bundled_robots():
        return ""
    path = Path(source)
    return "path" if is_path(str(source)) and is_file(path) and is_mjcf(read_text(path)) else ""


def _load_mujoco(
    source: Any,
    kind: str,
    wanted: Group | None,
    locked: Mapping[str, float],
    gravity: Array | None,
    root: str | None,
) -> System:
    """Return the system of an MJCF file, an MjModel or an MjSpec, and warn of what is left out."""
    robot = read_mujoco(source, root=root, lock=locked, gravity=gravity)
    model = _on_root(robot.model, wanted, None)
    origin = None
    if kind == "path":
        name = Path(source).stem
        origin = Origin(str(Path(source).absolute()), locked, root)
    else:
        name = robot.name
    model.name = name
    own = motion_group(model.joints[1])
    contents = Contents() if own is None else robot.contents(own)
    system = System(model, name=name, origin=origin, contents=contents)
    _warn_of_left_out(system, above=1)
    return system


def _warn_of_left_out(system: System, above: int = 0) -> None:
    """Warn of what acts in a file and is not simulated.  above: functions below `load`."""
    if system.left_out:
        counts = ", ".join(f"{left.what} ({len(left.names)})" for left in system.left_out)
        warnings.warn(
            f"{system.name}: in the file, but not simulated: {counts} (see System.left_out)",
            LeftOutWarning,
            stacklevel=3 + above,
        )


def _gravity(given: ArrayLike) -> Array:
    gravity = vector(given, 3, "gravity")
    if np.abs(gravity).max() > _HUGE:
        raise InputError(f"gravity must be below {_HUGE:g} m/s², got {gravity}")
    return gravity


def _initial_state(entry: Mapping[str, Any]) -> InitialState:
    x, xdot, xi = (np.array(entry[key], dtype=float) for key in ("x", "xdot", "xi"))
    return InitialState(x=x, xdot=xdot, xi=xi, duration=float(entry["duration"]))


def is_path(name: str) -> bool:
    """Return whether a source is the path of a file, not the name of a known robot."""
    if "/" in name or Path(name).suffix != "":
        return True
    try:
        return Path(name).is_file()
    except OSError:  # no name of a file at all
        return False


def _example(name: str) -> tuple[pin.Model, tuple[Coupling, ...]]:
    """Return the model of a robot in example-robot-data, armature from its rotors.

    And how its joints follow others.
    """
    names = catalogue.example_robots()
    if name not in names:
        near = difflib.get_close_matches(name[:200], [*catalogue.bundled_robots(), *names], n=3)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        more = "" if names else f"; for solo12, talos, ur5 and others: {catalogue.INSTALL_ROBOTS}"
        raise LoadError(
            f"unknown robot {quoted(name)}; {hint}`pinred robots` lists what can be loaded{more}"
        )
    robot = catalogue.example_robot(name)
    if robot.build is None:
        model, couplings = read_description(robot.urdf)
    else:
        model, couplings = without_mimics(robot.build().robot.model)
        if not couplings:
            found = mimic_couplings(read_xml(robot.urdf))
            couplings = tuple(each for each in found if model.existJointName(each.follower))
    if robot.rotors is not None:
        pin.loadRotorParameters(model, str(robot.rotors), False)
        model.armature = model.rotorInertia * model.rotorGearRatio**2
    return model, couplings


def _locked(lock: Iterable[str] | Mapping[str, float]) -> dict[str, float]:
    """Return the joints to freeze with their values.  Raises InputError."""
    if isinstance(lock, str):
        raise InputError(f"lock must be a list of joint names, not text; use [{lock!r}]")
    names = list(lock) if isinstance(lock, Mapping) else entries_of(lock)
    if names is None:
        raise InputError(
            f"lock must be a list of joint names or a mapping to values, got {brief(lock)}"
        )
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"lock must hold names of joints, got {brief(names)}")
    values = dict(lock.items()) if isinstance(lock, Mapping) else dict.fromkeys(names, 0.0)
    for name, value in values.items():
        number = as_floats(value, f"lock: the value for joint {quoted(name)}")
        if number.ndim or not np.isfinite(number):
            raise InputError(
                f"lock: the value for joint {quoted(name)} must be finite, got {brief(value)}"
            )
    return {str(name): float(value) for name, value in values.items()}


def _frozen(raw: pin.Model, locked: Mapping[str, float]) -> dict[int, Array]:
    """Return the configurations at which joints are frozen, by joint."""
    frozen: dict[int, Array] = {}
    neutral = pin.neutral(raw)
    for name, value in locked.items():
        if not raw.existJointName(name) or name == "universe":
            known = listed(list(raw.names)[1:], 60)
            raise InputError(f"lock: no joint {quoted(name)}; the joints are {known}")
        joint = raw.joints[raw.getJointId(name)]
        if joint.nv > 1 and value != 0.0:
            raise InputError(
                f"lock: joint {quoted(name)} has {joint.nv} degrees of freedom and "
                "freezes at zero only"
            )
        q = neutral[joint.idx_q : joint.idx_q + joint.nq].copy()
        if joint.nv == 1:
            q[:] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        frozen[joint.id] = q
    return frozen


def _on_root(raw: pin.Model, wanted: Group | None, chain: RootChain | None) -> pin.Model:
    """Return the model with the symmetry's root joint first: its own, or a new one.

    chain: the joints at its root that are one joint together.
    """
    own = _own_root(raw) if chain is None else chain.group
    if own is None:
        if wanted is None and raw.njoints > 1 and raw.inertias[0].mass == 0.0:
            raise ChoiceError(_unclear(raw), "group", ("SE3",))
        return rebuild(raw, root=root_joint(wanted or SE3))
    if wanted in (None, own):
        return raw if chain is None else rebuild(raw, root=root_joint(own), chain=chain)
    joints = list(raw.names)[1 : 2 if chain is None else chain.last + 1]
    locked = "' or '".join(joints)
    way_out = f"load it with group='{own}', or lock '{locked}'"
    if chain is None and raw.joints[1].nv == 1:
        way_out += ", or give the link above it, which has none, a mass so that it can float"
    raise ModelError(
        f"group {wanted} was asked for, but the root joint '{'+'.join(joints)}' of the model has "
        f"group {own}; {way_out}"
    )


def _unclear(raw: pin.Model) -> str:
    """Return why the root link of a model neither stands nor floats."""
    links = [f.name for f in raw.frames if f.parentJoint == 0 and f.type == pin.FrameType.BODY]
    carried = [raw.names[i] for i in range(1, raw.njoints) if raw.parents[i] == 0]
    who = f"the root link {quoted(links[0])}" if links else "the root"
    return (
        f"{who} has no mass and carries several joints ({listed(carried)}): does it stand, or "
        "float? group='SE3' lets it float; as a ground it must carry one joint: lock the others, "
        "or give it a mass"
    )


def _own_root(raw: pin.Model) -> Group | None:
    if raw.njoints < 2:
        return None
    group = motion_group(raw.joints[1])
    if raw.joints[1].nv > 1:
        return group
    anchored = raw.inertias[0].mass == 0.0
    carries_all = all(raw.parents[i] != 0 for i in range(2, raw.njoints))
    return group if anchored and carries_all else None
