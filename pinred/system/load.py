"""load(): from a name, a file or a pin.Model to a System with its symmetry group."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, vector
from ..common.errors import InputError, LoadError, ModelError, ModelWarning
from ..common.plain_names import listed, quoted
from ..lie.groups import GROUPS, SE3, Group, group_named
from . import catalogue
from .admission import refuse_mimicking
from .joints import motion_group, root_joint
from .rerooting import rebuild
from .robot_files import read_description, read_xml
from .system import InitialState, Origin, System
from .urdf import mimic_joints, refuse_mimics

_HUGE = 1e100  # m/s²; the square of what is far above overflows


def load(
    source: str | Path | pin.Model,
    *,
    group: str | Group | None = None,
    lock: Iterable[str] | Mapping[str, float] = (),
    gravity: ArrayLike | None = None,
    strict: bool = False,
) -> System:
    """Load a robot and read it as symmetry group times shape.

    source: the name of a bundled robot or of one in example-robot-data, the path of a
        URDF or MJCF file, or a pin.Model (which is copied).  Meshes are not read.
    group: the symmetry, "R", "SO2", "SE2", "SO3" or "SE3".  If None, the file's own root:
        its free, planar or spherical root joint (the link above that is the ground); or its
        first moving joint, if the link above has no mass (a mere anchor) and all else
        hangs on it; else SE3: a root link with mass floats on a new root joint.
    lock: joints to freeze at zero, or a mapping from joint to its fixed value [rad | m].
    gravity: (3,) in the world frame [m/s²]; if None, what the robot comes with
        (Pinocchio's 9.81 along −z for a URDF).
    strict: whether to refuse what there is otherwise only a ModelWarning about: moments of
        inertia that no distribution of mass has, and mass matrices singular at single shapes.

    Raises LoadError if there is nothing to read, ModelError if pinred cannot reduce the
    model, InputError for an unknown group or joint.
    """
    wanted = group_named(group) if isinstance(group, str) else group
    if wanted is not None and not isinstance(wanted, Group):
        raise InputError(f"group must be one of {', '.join(GROUPS)}, got {group!r}")
    if not isinstance(source, (str, Path, pin.Model)):
        raise InputError(f"load takes a name, a path or a pin.Model, got {type(source).__name__}")
    locked = _locked(lock)
    initial: InitialState | None = None
    name = str(source)
    origin: Origin | None = Origin(name, locked)
    if isinstance(source, pin.Model):
        refuse_mimicking(source)
        raw, name, origin = source.copy(), source.name, None
    elif (robot := catalogue.bundled_robots().get(name)) is not None:
        raw = read_description(robot.path, locked)
        raw.gravity.linear = np.array(robot.gravity)
        wanted = wanted or group_named(robot.group)
        if not locked and wanted.name == robot.group:
            initial = _initial_state(robot.initial)
    elif _is_path(name):
        raw, name = read_description(Path(source), locked), Path(source).stem
        origin = Origin(str(Path(source).absolute()), locked)
    else:
        raw = _example(name, locked)
    model = _on_root(rebuild(raw, _frozen(raw, locked)), wanted)
    if gravity is not None:
        model.gravity.linear = vector(gravity, 3, "gravity")
        if np.abs(model.gravity.linear).max() > _HUGE:
            raise InputError(f"gravity must be below {_HUGE:g} m/s², got {gravity}")
    model.name = name
    system = System(model, name=name, initial=initial, origin=origin)
    for doubt in system.doubts:
        if strict:
            raise ModelError(f"{quoted(name)} is refused, strictly: {doubt}")
        warnings.warn(f"{quoted(name)}: {doubt}", ModelWarning, stacklevel=2)
    return system


def _initial_state(entry: Mapping[str, Any]) -> InitialState:
    x, xdot, xi = (np.array(entry[key], dtype=float) for key in ("x", "xdot", "xi"))
    return InitialState(x=x, xdot=xdot, xi=xi, duration=float(entry["duration"]))


def _is_path(name: str) -> bool:
    if "/" in name or Path(name).suffix != "":
        return True
    try:
        return Path(name).is_file()
    except OSError:  # no name of a file at all
        return False


def _example(name: str, locked: Mapping[str, float]) -> pin.Model:
    """Return the model of a robot in example-robot-data, armature from its rotors."""
    names = catalogue.example_robots()
    if name not in names:
        near = difflib.get_close_matches(name, [*catalogue.bundled_robots(), *names], n=3)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        more = "" if names else f"; for solo12, talos, ur5 and others: {catalogue.INSTALL_ROBOTS}"
        raise LoadError(
            f"unknown robot '{name}'; {hint}`pinred robots` lists what can be loaded{more}"
        )
    robot = catalogue.example_robot(name)
    if robot.build is None:
        model = read_description(robot.urdf, locked)
    else:
        model = robot.build().robot.model
        mimics = mimic_joints(read_xml(robot.urdf))
        refuse_mimics([name for name in mimics if model.existJointName(name)], locked)
    if robot.rotors is not None:
        pin.loadRotorParameters(model, str(robot.rotors), False)
        model.armature = model.rotorInertia * model.rotorGearRatio**2
    return model


def _locked(lock: Iterable[str] | Mapping[str, float]) -> dict[str, float]:
    """Return the joints to freeze with their values.  Raises InputError."""
    if isinstance(lock, str):
        raise InputError(f"lock must be a list of joint names, not text; use [{lock!r}]")
    if not isinstance(lock, Iterable):
        raise InputError(f"lock must be a list of joint names or a mapping to values, got {lock!r}")
    if not all(isinstance(name, str) for name in lock):
        raise InputError(f"lock must hold names of joints, got {list(lock)!r}")
    values = dict(lock.items()) if isinstance(lock, Mapping) else dict.fromkeys(lock, 0.0)
    for name, value in values.items():
        if not (isinstance(value, (int, float, np.number)) and np.isfinite(value)):
            raise InputError(f"lock: the value for joint '{name}' must be finite, got {value!r}")
    return {str(name): float(value) for name, value in values.items()}


def _frozen(raw: pin.Model, locked: Mapping[str, float]) -> dict[int, Array]:
    """Return the configurations at which joints are frozen, by joint."""
    frozen: dict[int, Array] = {}
    neutral = pin.neutral(raw)
    for name, value in locked.items():
        if not raw.existJointName(name) or name == "universe":
            known = ", ".join(list(raw.names)[1:])
            raise InputError(f"lock: no joint '{name}'; the joints are {known}")
        joint = raw.joints[raw.getJointId(name)]
        if joint.nv > 1 and value != 0.0:
            raise InputError(
                f"lock: joint '{name}' has {joint.nv} degrees of freedom and freezes at zero only"
            )
        q = neutral[joint.idx_q : joint.idx_q + joint.nq].copy()
        if joint.nv == 1:
            q[:] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        frozen[joint.id] = q
    return frozen


def _on_root(raw: pin.Model, wanted: Group | None) -> pin.Model:
    """Return the model with the symmetry's root joint first: its own, or a new one."""
    own = _own_root(raw)
    if own is None:
        if wanted is None and raw.njoints > 1 and raw.inertias[0].mass == 0.0:
            raise ModelError(_unclear(raw))
        return rebuild(raw, {}, root_joint(wanted or SE3))
    if wanted in (None, own):
        return raw
    way_out = f"load it with group='{own}', or lock '{raw.names[1]}'"
    if raw.joints[1].nv == 1:
        way_out += ", or give the link above it, which has none, a mass so that it can float"
    raise ModelError(
        f"group {wanted} was asked for, but the root joint '{raw.names[1]}' of the model has "
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
