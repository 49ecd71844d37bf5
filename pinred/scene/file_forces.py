"""Selection of the forces in a robot's file for a scene: passive forces and actuators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..common.arrays import positive
from ..common.errors import InputError
from ..common.names import listed
from ..forces.controller import Controller
from ..forces.force import Force
from ..system.passive import BallSpring, Damper, Friction, Spring
from ..system.system import System

if TYPE_CHECKING:
    from ..forces.controller import Control


def check_passive(passive: Any, friction: Any) -> tuple[bool, float | None]:
    """Validate the options `passive` and `friction` [rad/s | m/s]; raise InputError."""
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
    """Return the forces of the robot's file that act in a scene.

    Args:
        system: System with the forces of its file.
        passive: Whether springs and dampers act.
        friction: Width of the smooth friction law [rad/s | m/s]; None for no friction.
    Returns:
        The forces, with friction in its smooth form.
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
    """Describe the forces of the robot's file that do not act.

    Args:
        system: System with the forces of its file.
        passive: Whether springs and dampers act.
        friction: Width of the smooth friction law [rad/s | m/s]; None for no friction.
        who: Subject of the sentence.
    Returns:
        A sentence with the options that make them act; empty if all forces act.
    """
    springs = [f for f in system.passive if not passive and not isinstance(f, Friction)]
    rubbing = [f for f in system.passive if friction is None and isinstance(f, Friction)]
    omitted = [*springs, *rubbing]
    if not omitted:
        return ""
    counts = [
        f"{count} {singular if count == 1 else plural}"
        for kind, singular, plural in (
            (Damper, "damper", "dampers"),
            ((Spring, BallSpring), "spring", "springs"),
            (Friction, "joint with dry friction", "joints with dry friction"),
        )
        if (count := sum(isinstance(force, kind) for force in omitted))
    ]
    names = counts[0] if len(counts) == 1 else f"{', '.join(counts[:-1])} and {counts[-1]}"
    pronoun = "it" if len(omitted) == 1 else "them"
    hints = []
    if springs:
        hints.append(f"passive=True uses {'springs and dampers' if rubbing else pronoun}")
    if rubbing:
        hints.append(f"friction=WIDTH uses {'the friction' if springs else pronoun}")
    return f"the file has {names}; {who} leaves {pronoun} out ({', '.join(hints)})"


def actuation(system: System, controls: Mapping[str, Control] | Controller) -> tuple[Force, ...]:
    """Return the forces of the actuators that a scene drives.

    Args:
        system: System with the actuators of its file.
        controls: Checked controls of the scene.
    """
    from ..forces.controller import Actuation

    if isinstance(controls, Controller):
        return (controls,)
    by_name = {actuator.name: actuator for actuator in system.actuators}
    driven = tuple((by_name[name], control) for name, control in controls.items())
    return (Actuation(driven),) if driven else ()


def actuators_left_out(
    system: System, controls: Mapping[str, Any] | Controller | None = None, who: str = "the run"
) -> str:
    """Describe the actuators of the robot's file that do not act.

    Args:
        system: System with the actuators of its file.
        controls: Controls of the scene; None for none.
        who: Subject of the sentence.
    Returns:
        A sentence with the option that drives them; empty if all actuators act.
    """
    names = [actuator.name for actuator in system.actuators]
    driven = controls.driven(()) if isinstance(controls, Controller) else controls or ()
    idle = [name for name in names if name not in driven]
    if not idle:
        return ""
    count, pronoun = ("1", "it") if len(idle) == 1 else (str(len(idle)), "them")
    noun = f"{'more ' if driven else ''}{'actuator' if len(idle) == 1 else 'actuators'}"
    return (
        f"the file has {count} {noun} ({listed(idle, 6)}); {who} leaves {pronoun} out "
        f"(controls={{NAME: …}} drives {pronoun})"
    )
