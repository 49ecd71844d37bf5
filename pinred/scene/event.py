"""Events: moments at which an expression of the state crosses zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from ..common.errors import InputError
from ..common.plain_names import brief

if TYPE_CHECKING:
    from ..forces.watched import Watched
    from ..system.system import System

Direction = Literal[-1, 0, 1]
DIRECTIONS: tuple[Direction, ...] = (-1, 0, 1)


@dataclass(frozen=True)
class Event:
    """A moment at which an expression of the state crosses zero, wherever that is within a step.

    expression: a function of (t, x, xdot, mu), or of one SeenState (see pinred.forces), called
    once with CasADi symbols; or a formula as text, in t, x, xdot, mu, and pose, xi, J of the base,
    such as "x['hinge'] - 0.5".  name: what results call it.  terminal: whether the motion ends
    there.  direction: 1 for rising, −1 for falling, 0 for both.

    A crossing is a change of sign: one that the expression begins with, where it is zero at the
    start, is none, and neither is a zero that it only touches.  A step is looked at in four
    places, so of two crossings within a quarter of it both are missed.
    """

    expression: Callable[..., Any] | str
    name: str = "event"
    terminal: bool = field(default=False, kw_only=True)
    direction: Direction = field(default=0, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"the name of an event must be text, got {brief(self.name)}")
        if not (callable(self.expression) or isinstance(self.expression, str)):
            raise InputError(
                f"event '{self.name}' must have a function of the state or a formula, "
                f"got {brief(self.expression)}"
            )
        if not isinstance(self.terminal, bool):
            raise InputError(f"terminal of event '{self.name}' must be True or False")
        if isinstance(self.direction, bool) or self.direction not in DIRECTIONS:
            raise InputError(
                f"direction of event '{self.name}' must be 1 (rising), -1 (falling) or 0 (both), "
                f"got {brief(self.direction)}"
            )


def watched_of(system: System, events: Sequence[Event], *, base: bool) -> Watched | None:
    """Return the expressions of events, None if there are none.

    base: whether the scene has the base.  Raises InputError, naming the event.
    """
    if not events:
        return None
    from ..forces.watched import Watched  # needs CasADi

    labels = [f"event '{event.name}'" for event in events]
    watched = Watched(system, [event.expression for event in events], labels)
    if watched.sees_base and not base:
        raise InputError(
            "an event sees the base in space, which outputs='shape' leaves out; use outputs='all'"
        )
    return watched


def checked_events(given: Any) -> tuple[Event, ...]:
    """Return the events of a scene, one or several.  Raises InputError."""
    events = (given,) if isinstance(given, Event) else given
    if isinstance(events, str) or not hasattr(events, "__iter__"):
        raise InputError(f"events must be a list of Event, got {brief(given)}")
    events = tuple(events)
    for event in events:
        if not isinstance(event, Event):
            raise InputError(f"events must be a list of Event, got {brief(event)} in it")
    names = [event.name for event in events]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f"two events are called '{twice[0]}'; give each a name of its own")
    return events
