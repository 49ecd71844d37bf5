"""Contents of a robot's file beside bodies and joints: keyframes, couplings, springs and more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

from ..common.arrays import Array, freeze
from ..common.plain_names import plain
from .force import Force
from .locked_joints import LockedJoints
from .visuals import Visuals


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A state that the file has a name for; arrays are read-only.

    pose: (size,) of the base.  x, xdot: (m,) shape [rad | m] and its rate.  xi: (r,) body
    twist of the base [linear; angular].  time: s.
    """

    pose: Array
    x: Array
    xi: Array
    xdot: Array
    time: float = 0.0

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Coupling:
    """A joint that follows another: x_follower = ratio · x_leader + offset.

    Coordinates are those of the shape [rad | m], not relative to a reference position.
    """

    follower: str
    leader: str
    ratio: float
    offset: float

    def __str__(self) -> str:
        shift = "" if self.offset == 0.0 else f" {'+-'[self.offset < 0]} {abs(self.offset):g}"
        return f"{self.follower} = {self.ratio:g}·{self.leader}{shift}"


@dataclass(frozen=True)
class LeftOut:
    """Things of one kind that act in the file and are not part of the reduction.

    what: the kind, as "actuators".  names: what they are called.
    """

    what: str
    names: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.what}: {shortened(self.names)}"


@dataclass(frozen=True)
class Contents:
    """Contents of a file beside bodies and joints.

    left_out: what acts in it and is not simulated.  passive: springs, dampers and dry friction
    at joints of the shape, which act where a scene asks for them.  keyframes: states by name.
    couplings: joints that follow others.  freed: the body that the file fixes to the world and
    that floats here, or "".
    visuals: shapes to draw that were given along with the model.  locked: the joints that were
    locked, if some were.
    """

    left_out: tuple[LeftOut, ...] = ()
    passive: tuple[Force, ...] = ()
    keyframes: Mapping[str, Keyframe] = field(default_factory=lambda: MappingProxyType({}))

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only views of mappings cannot be pickled.
        parts = [getattr(self, entry.name) for entry in fields(self)]
        return type(self), tuple(dict(p) if isinstance(p, MappingProxyType) else p for p in parts)

    couplings: tuple[Coupling, ...] = ()
    freed: str = ""
    visuals: Visuals | None = None
    locked: LockedJoints | None = None


def shortened(names: tuple[str, ...], most: int = 6) -> str:
    """Return names in a list, of which the last are left out where there are many."""
    shown = ", ".join(map(plain, names[:most]))
    return shown if len(names) <= most else f"{shown}, … ({len(names)} in all)"
