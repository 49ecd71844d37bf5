"""The springs, dampers and dry friction of a robot's file in a scene: those that act, or do not."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..common.arrays import positive
from ..common.errors import InputError
from ..forces.force import Force
from ..system.passive import Damper, Friction, Spring
from ..system.system import System


def checked_passive(passive: Any, friction: Any) -> tuple[bool, float | None]:
    """Return both options if they can be used.  Raises InputError."""
    if not isinstance(passive, bool):
        raise InputError(f"passive must be True or False, got {passive!r}")
    if friction is None:
        return passive, None
    if isinstance(friction, bool):
        raise InputError(
            f"friction must be the width of the smooth law [rad/s | m/s], got {friction!r}"
        )
    return passive, positive(friction, "friction")


def acting_passive(system: System, *, passive: bool, friction: float | None) -> tuple[Force, ...]:
    """Return what of a file acts: springs and dampers, and friction with a width.

    friction: the width [rad/s | m/s] of the smooth law; None leaves the friction out.
    """
    acting: list[Force] = []
    for force in system.passive:
        if not isinstance(force, Friction):
            if passive:
                acting.append(force)
        elif friction is not None:
            acting.append(force.smoothed(friction))
    return tuple(acting)


def passive_left_out(
    system: System, *, passive: bool = False, friction: float | None = None, who: str = "the run"
) -> str:
    """Return the sentence that says what of a file does not act, and how it would; or nothing."""
    left = [
        force
        for force in system.passive
        if (friction is None if isinstance(force, Friction) else not passive)
    ]
    if not left:
        return ""
    counts = [
        _count(left, Damper, "damper", "dampers"),
        _count(left, Spring, "spring", "springs"),
        _count(left, Friction, "joint with dry friction", "joints with dry friction"),
    ]
    said = [text for text in counts if text]
    what = said[0] if len(said) == 1 else f"{', '.join(said[:-1])} and {said[-1]}"
    them = "it" if len(left) == 1 else "them"
    sprung = any(not isinstance(force, Friction) for force in left)
    rubbed = any(isinstance(force, Friction) for force in left)
    ways = []
    if sprung:
        ways.append(f"passive=True uses {'springs and dampers' if rubbed else them}")
    if rubbed:
        ways.append(f"friction=WIDTH uses {'the friction' if sprung else them}")
    return f"the file has {what}; {who} leaves {them} out ({', '.join(ways)})"


def _count(forces: Iterable[Force], kind: type[Force], one: str, many: str) -> str:
    count = sum(isinstance(force, kind) for force in forces)
    return "" if not count else f"{count} {one if count == 1 else many}"
