"""Loop: a constraint that closes a kinematic loop between two frames, and JointPolynomial."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ...common.names import brief, quoted

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


Constraint: TypeAlias = Loop | JointPolynomial


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
    first, _, rest = text.partition("=")
    # Names of nested models contain "::".
    second, _, kind = (part.replace("\0", "::") for part in rest.replace("::", "\0").partition(":"))
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
