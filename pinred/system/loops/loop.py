"""Loops: constraints that close kinematic loops between two frames, and polynomials of joints.

Loops and joint types may be in a YAML file beside a URDF, in the format of example-parallel-robots:

closed_loop: [[frame_a, frame_b], …]   # links, frames or joints whose frames coincide
type: ["6d", "3d", …]                  # kind of each loop; "6d" if there is no such key
joint_name: [ankle, …]                 # joints of the URDF that have another type
joint_type: [SPHERICAL, CARDAN, …]     # their types
name_mot: [hip, …]                     # joints with motors, which pinred does not need
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, LoadError, install_command, optional_package
from ...common.files import is_file
from ...common.names import brief, plain_path, quoted

LoopKind = Literal["3d", "6d", "x", "y", "z"]
KINDS: tuple[str, ...] = get_args(LoopKind)
# Remedy for loops through the world.
HEAVY_GROUND = "describe the ground as a heavy root link (docs/robots.md, Mechanisms on the ground)"
_KEYS = ("frame_a", "frame_b", "kind", "name", "coupled")


@checks_arguments
@dataclass(frozen=True)
class Loop:
    """A constraint that closes a kinematic loop between two frames of a robot.

    Attributes:
        frame_a: Name of a link or frame of the robot.
        frame_b: Name of a link or frame of the robot.
        kind: "3d": the origins of both frames coincide, as in a ball joint.  "6d": the frames
            coincide, as in a weld.  "x", "y" or "z": the origins and this axis of both frames
            coincide, as in a hinge about the axis.
        name: Name in messages; by default "frame_a = frame_b".
        coupled: Whether couplings replace the loop if its closed shapes are linear in independent
            joints, as in a parallelogram.
    """

    frame_a: str
    frame_b: str
    kind: LoopKind = "3d"
    name: str = ""
    coupled: bool = True

    def __post_init__(self) -> None:
        for key in ("frame_a", "frame_b", "name"):
            if not isinstance(getattr(self, key), str):
                raise InputError(
                    f"Loop: {key}: expected a name, got {brief(getattr(self, key))}. Pass the name "
                    "of a link or frame."
                )
        if self.kind not in KINDS:
            raise InputError(
                f"Loop: kind: expected one of {', '.join(KINDS)}, got {brief(self.kind)}"
            )
        if not isinstance(self.coupled, bool):
            raise InputError(f"Loop: coupled: expected true or false, got {brief(self.coupled)}")
        if not self.name:
            object.__setattr__(self, "name", f"{self.frame_a} = {self.frame_b}")

    @property
    def equations(self) -> int:
        """Number of scalar equations."""
        return {"3d": 3, "6d": 6}.get(self.kind, 5)

    def __str__(self) -> str:
        default = f"{self.frame_a} = {self.frame_b}"
        label = "" if self.name == default else f"{self.name}: "
        return f"{label}{default} ({self.kind})"


@checks_arguments
@dataclass(frozen=True)
class JointPolynomial:
    """A constraint x_follower = x_follower⁰ + Σ c_k (x_leader − x_leader⁰)^k between two joints.

    Attributes:
        follower: Name of a hinge or slide.
        leader: Name of another hinge or slide.
        coefficients: Coefficients c_0, c_1, … [(rad | m) / (rad | m)^k].
        follower_zero: Value x_follower⁰ [rad | m].
        leader_zero: Value x_leader⁰ [rad | m].
        name: Name in messages; by default "follower(leader)".
    """

    follower: str
    leader: str
    coefficients: tuple[float, ...]
    follower_zero: float = 0.0
    leader_zero: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", f"{self.follower}({self.leader})")

    @property
    def equations(self) -> int:
        """Number of scalar equations."""
        return 1

    def __str__(self) -> str:
        degree = max((k for k, c in enumerate(self.coefficients) if c), default=0)
        default = f"{self.follower}({self.leader})"
        label = "" if self.name == default else f"{self.name}: "
        return f"{label}{self.follower} is a polynomial of degree {degree} in {self.leader}"


@dataclass(frozen=True)
class BallSurface:
    """A constraint that keeps a bounded angle of a ball joint at its bound.

    With the quaternion q = (v, w) of the ball and the axis n, φ is w² − cos²(limit/2) for the
    "angle" of the whole rotation, (v·n)² + w² − cos²(limit/2) for the "swing" of the axis, and
    v·n cos(limit/2) − w sin(limit/2) for the "twist" about it.  The gradient of each has the same
    length on the whole surface.

    Attributes:
        ball: Name of the ball.
        kind: "angle", "swing" or "twist".
        limit: Value of the angle [rad].
        axis: Unit vector, (3,).
    """

    ball: str
    kind: str
    limit: float
    axis: tuple[float, float, float]

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"{self.ball} at its {self.kind} stop"

    @property
    def equations(self) -> int:
        """Number of scalar equations."""
        return 1

    @property
    def form(self) -> tuple[Array, Array, float]:
        """S (4, 4), l (4,) and c of φ = ½ qᵀSq + lᵀq − c."""
        n, cosine = np.append(self.axis, 0.0), math.cos(0.5 * self.limit)
        if self.kind == "twist":
            return np.zeros((4, 4)), cosine * n - [0.0, 0.0, 0.0, math.sin(0.5 * self.limit)], 0.0
        S = np.diag([0.0, 0.0, 0.0, 2.0]) + 2.0 * (self.kind == "swing") * np.outer(n, n)
        return S, np.zeros(4), cosine**2


def quaternion_parts(surfaces: Sequence[BallSurface]) -> list[tuple[Array, float]]:
    """Return the parts of quaternions that have constant norms on surfaces of one ball.

    On the surface of an angle, these are v and w, with the norms sin(angle/2) and cos(angle/2).
    A swing leaves the norms of v across the axis, and of (v·n, w).  A twist leaves no part in one
    direction.  Two surfaces leave a circle, on which the part of v across the axis turns.

    Args:
        surfaces: No more than two independent surfaces; none for unit quaternions.
    Returns:
        Orthogonal projectors on the parts, (4, 4), and the norms.
    """
    limits = {surface.kind: surface.limit for surface in surfaces}
    if not limits:
        return [(np.eye(4), 1.0)]
    n, real = np.append(surfaces[0].axis, 0.0), np.diag([0.0, 0.0, 0.0, 1.0])
    along, vector = np.outer(n, n), np.eye(4) - real
    cosines = {kind: math.cos(0.5 * limit) for kind, limit in limits.items()}
    if len(limits) == 1:
        ((kind, limit),) = limits.items()
        part, size = math.sin(0.5 * limit), cosines[kind]
        if kind == "twist":
            absent = size * n - part * real[3]
            return [(np.eye(4) - np.outer(absent, absent), 1.0)]
        constant = real + along if kind == "swing" else real
        return [(np.eye(4) - constant, part), (constant, size)]
    if "angle" not in limits or len(limits) > 2:
        w = cosines["swing"] * cosines["twist"]
        axial = cosines["swing"] * abs(math.sin(0.5 * limits["twist"]))
    elif "swing" in limits:
        w = cosines["angle"]
        axial = math.sqrt(max(cosines["swing"] ** 2 - w**2, 0.0))
    else:
        w = cosines["angle"]
        axial = w * abs(math.tan(0.5 * limits["twist"]))
    across = math.sqrt(max(1.0 - axial**2 - w**2, 0.0))
    return [(vector - along, across), (along, axial), (real, w)]


Constraint: TypeAlias = Loop | JointPolynomial | BallSurface


def parse_loops(loops: object) -> tuple[Constraint, ...]:
    """Convert loops of a call, a file or the command line to Loop values.

    Args:
        loops: Loop and JointPolynomial values, or mappings with the keys of a Loop; or a text
            A=B:KIND,…, where a missing kind is "3d".
    Returns:
        The loops.
    Raises:
        InputError: An entry is not a loop, or two loops have the same name.
    """
    if isinstance(loops, str):
        loops = [_loop_from_text(word) for word in loops.split(",") if word]
    if isinstance(loops, Loop | JointPolynomial) or not isinstance(loops, Iterable):
        raise InputError(f"loops: expected a list of Loop, got {brief(loops)}")
    parsed = tuple(_parse_loop(entry) for entry in loops)
    names = [loop.name for loop in parsed]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"loops: two loops have the name {quoted(name)}; rename one of them")
    return parsed


def _loop_from_text(text: str) -> Loop:
    first, _, ends = text.partition("=")
    # Names of nested models contain "::".
    second, _, kind = (word.replace("\0", "::") for word in ends.replace("::", "\0").partition(":"))
    if not (first and second) or (kind and kind not in KINDS):
        raise InputError(
            f"loops: expected FRAME=FRAME or FRAME=FRAME:KIND with a kind of {', '.join(KINDS)}, "
            f"got {brief(text)}"
        )
    return Loop(frame_a=first, frame_b=second, kind=kind or "3d")  # type: ignore[arg-type]


def _parse_loop(entry: Any) -> Constraint:
    if isinstance(entry, Loop | JointPolynomial):
        return entry
    if not isinstance(entry, Mapping):
        raise InputError(f"loops: expected a Loop, got {brief(entry)}")
    unknown = [key for key in entry if key not in _KEYS]
    if unknown or not {"frame_a", "frame_b"} <= set(entry):
        raise InputError(
            "loops: expected frame_a, frame_b and perhaps kind, name and coupled, got the keys "
            f"{', '.join(map(str, entry)) or 'none'}"
        )
    return Loop(**entry)


SUFFIXES = (".yaml", ".yml")
_FILE_KEYS = ("closed_loop", "type", "joint_name", "joint_type", "name_mot")
_TYPES = ("SPHERICAL", "CARDAN", "FIXED", "UJOINT_XY")  # UJOINT with any two of X, Y and Z
_UNIVERSAL = re.compile(r"UJOINT_(?!(.)\1)([XYZ])([XYZ])")
_MOST_BYTES = 1_000_000


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
        raise InputError(
            f"{shown}: expected the keys {', '.join(_FILE_KEYS)}, got {brief(content)}"
        )
    for key in content:
        if key not in _FILE_KEYS:
            raise InputError(
                f"{shown}: unknown key {brief(key)}; the keys are {', '.join(_FILE_KEYS)}"
            )
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
