"""Loops and joint types in a YAML file beside a URDF, in the format of example-parallel-robots.

closed_loop: [[frame_a, frame_b], …]   # links, frames or joints whose frames coincide
type: ["6d", "3d", …]                  # kind of each loop; "6d" if there is no such key
joint_name: [ankle, …]                 # joints of the URDF that have another type
joint_type: [SPHERICAL, CARDAN, …]     # their types
name_mot: [hip, …]                     # joints with motors, which pinred does not need
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pinocchio as pin

from ...common.errors import InputError, LoadError
from ...common.files import is_file
from ...common.names import brief, listed, nearest, plain_path, quoted
from ...common.optional_packages import install_command, optional_package
from ..rebuild import NewJoint, copy_losses, rebuild
from .loop import KINDS, Constraint, Loop, parse_loops

SUFFIXES = (".yaml", ".yml")
_KEYS = ("closed_loop", "type", "joint_name", "joint_type", "name_mot")
_TYPES = ("SPHERICAL", "CARDAN", "FIXED", "UJOINT_XY")  # UJOINT with any two of X, Y and Z
_UNIVERSAL = re.compile(r"UJOINT_(?!(.)\1)([XYZ])([XYZ])")
_MOST_BYTES = 1_000_000
_HINGES = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}


@dataclass(frozen=True)
class LoopFile:
    """Loops of a robot, and joints of its URDF that have another type.

    Attributes:
        loops: The loops.
        joints: Type of each joint that differs from the URDF.
        path: Path of the file in messages; "" without a file.
        driven: Names of joints with motors.
    """

    loops: tuple[Constraint, ...] = ()
    joints: Mapping[str, str] = field(default_factory=dict)
    path: str = ""
    driven: tuple[str, ...] = ()

    @property
    def fixed(self) -> tuple[str, ...]:
        """Names of the joints of type FIXED."""
        return tuple(name for name, kind in self.joints.items() if kind == "FIXED")

    def with_joints(self, raw: pin.Model) -> pin.Model:
        """Return a model whose joints have the types of the file.

        A universal joint becomes two hinges, whose names end in _X, _Y or _Z, as in
        example-parallel-robots.

        Args:
            raw: Model of the URDF.
        Returns:
            The model; `raw` itself if the types are those of the URDF.
        Raises:
            InputError: The model lacks a joint or a frame that the file names.
        """
        names = [str(name) for name in raw.names]
        for name in self.joints:
            self._check("joint_name", name, names[1:], "joint")
        if self.path:
            frames = [str(frame.name) for frame in raw.frames][1:]
            for loop in self.loops:
                assert isinstance(loop, Loop)
                for frame in (loop.frame_a, loop.frame_b):
                    self._check("closed_loop", frame, frames, "link or frame")
        chains = {
            names.index(name): _joints_of(name, kind)
            for name, kind in self.joints.items()
            if kind != "FIXED"
        }
        if not chains:
            return raw
        model = rebuild(raw, replaced=chains)
        copy_losses(raw, model, dict.fromkeys(chains, ()))
        return model

    def _check(self, key: str, name: str, known: list[str], what: str) -> None:
        if name not in known:
            raise InputError(
                f"{self.path}: {key}: the robot has no {what} {quoted(name)}; "
                f"{nearest(name, known)}the names are {listed(known, 60)}"
            )


def requested_loops(loops: object, robot: object = None) -> LoopFile:
    """Return the loops that a call, a file or the command line states.

    Args:
        loops: Path of a YAML file, or the loops (see `parse_loops`).
        robot: Source of the robot.  A relative path of a YAML file that does not exist is searched
            beside the robot's file.
    Raises:
        LoadError: The file does not exist or is not YAML.
        InputError: The file or an entry is not valid.
    """
    if not isinstance(loops, Path) and not (isinstance(loops, str) and loops.endswith(SUFFIXES)):
        return LoopFile(parse_loops(loops))
    path = Path(loops)
    if isinstance(robot, (str, Path)) and not path.is_absolute() and not is_file(path):
        beside = Path(robot).parent / path
        path = beside if is_file(beside) else path
    return read_loop_file(path)


def read_loop_file(path: Path) -> LoopFile:
    """Read loops and joint types from a YAML file.

    Nothing in the file is executed.

    Args:
        path: Path of the file.
    Returns:
        The loops and joint types.
    Raises:
        LoadError: The file does not exist or is not YAML.
        InputError: A key or value is not valid; the message names the file, the key and the valid
            names.
        MissingPackageError: PyYAML is not installed.
    """
    shown, content = plain_path(path), _read(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{shown}: expected the keys {', '.join(_KEYS)}, got {brief(content)}")
    for key in content:
        if key not in _KEYS:
            raise InputError(f"{shown}: unknown key {brief(key)}; the keys are {', '.join(_KEYS)}")
    loops = tuple(_loops(shown, content))
    names, kinds = (_texts(shown, content, key) for key in ("joint_name", "joint_type"))
    if len(names) != len(kinds):
        raise InputError(
            f"{shown}: joint_type: expected a type for each of the {len(names)} entries of "
            f"joint_name, got {len(kinds)}"
        )
    joints = dict(zip(names, [kind.upper() for kind in kinds], strict=True))
    for name, kind in joints.items():
        if kind not in _TYPES and not _UNIVERSAL.fullmatch(kind):
            raise InputError(
                f"{shown}: joint_type: expected one of {', '.join(_TYPES)}, UJOINT_XZ, …, got "
                f"{brief(kind)} for joint {quoted(name)}"
            )
    return LoopFile(parse_loops(loops), joints, shown, tuple(_texts(shown, content, "name_mot")))


def _read(path: Path) -> Any:
    yaml = optional_package("yaml", f"YAML is read by PyYAML: {install_command('yaml')}")
    shown = plain_path(path)
    if not is_file(path):
        raise LoadError(f"no such file: {shown}")
    try:
        with path.open("rb") as file:
            text = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise LoadError(f"{shown} cannot be read: {error.strerror}") from None
    if len(text) > _MOST_BYTES:
        raise LoadError(f"{shown} is larger than {_MOST_BYTES // 10**6} MB")
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        where = getattr(error, "problem_mark", None)
        line = "" if where is None else f" in line {where.line + 1}"
        raise LoadError(f"{shown} is not YAML{line}") from None


def _loops(shown: str, content: Mapping[str, Any]) -> Iterable[Loop]:
    """Yield the loops of a file."""
    pairs = content.get("closed_loop") or []
    if not isinstance(pairs, list) or not all(_is_pair(pair) for pair in pairs):
        raise InputError(f"{shown}: closed_loop: expected pairs of names, got {brief(pairs)}")
    kinds = _texts(shown, content, "type") if "type" in content else ["6d"] * len(pairs)
    if len(kinds) != len(pairs):
        raise InputError(
            f"{shown}: type: expected a kind for each of the {len(pairs)} entries of closed_loop, "
            f"got {len(kinds)}"
        )
    for (first, second), kind in zip(pairs, kinds, strict=True):
        if kind.lower() not in KINDS:
            raise InputError(
                f"{shown}: type: expected one of {', '.join(KINDS)}, got {brief(kind)}"
            )
        yield Loop(first, second, kind.lower())  # type: ignore[arg-type]


def _is_pair(pair: object) -> bool:
    return isinstance(pair, list) and len(pair) == 2 and all(isinstance(name, str) for name in pair)


def _texts(shown: str, content: Mapping[str, Any], key: str) -> list[str]:
    texts = content.get(key) or []
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise InputError(f"{shown}: {key}: expected a list of texts, got {brief(texts)}")
    return texts


def _joints_of(name: str, kind: str) -> list[NewJoint]:
    """Return the joints that replace a joint of the URDF."""
    here = pin.SE3.Identity()
    if kind == "SPHERICAL":
        return [NewJoint(name, pin.JointModelSpherical(), here)]
    axes = "XY" if kind == "CARDAN" else kind[-2:]
    return [NewJoint(f"{name}_{axis}", _HINGES[axis](), here) for axis in axes]
