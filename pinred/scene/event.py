"""Events: times at which an expression of the state crosses zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from ..common.argument_kinds import checks_arguments
from ..common.errors import InputError
from ..common.names import brief
from .toml.schema import Flag, Key, Table, Text, Whole

if TYPE_CHECKING:
    from ..forces.force import Watched
    from ..system.system import System

Direction = Literal[-1, 0, 1]
DIRECTIONS: tuple[Direction, ...] = (-1, 0, 1)
EVENT_TABLE = Table(
    {
        "function": Key(
            Text((), "a formula"), "formula of the state whose zero crossings are the event",
            required=True,
        ),
        "name": Key(Text(), "name of the event in the results", default="event"),
        "terminal": Key(Flag(), "whether the motion ends at the event", default="false"),
        "direction": Key(Whole(-1, 1), "1 for rising, -1 for falling, 0 for both", default="0"),
    },
    "an event",
)  # fmt: skip


@checks_arguments
@dataclass(frozen=True)
class Event:
    """A time at which an expression of the state crosses zero, also inside integration steps.

    A crossing is a change of sign.  A zero at the start of the motion does not count as a crossing,
    nor does a zero without a change of sign.  All crossings of an expression of time alone are
    found, or an error is raised.  Other expressions are sampled on the dense output, at eight to
    256 times in each step: more where the samples do not predict the next ones.  Two crossings
    between two samples are both missed.

    Attributes:
        expression: A function of (t, x, xdot, mu), or of one SeenState (see pinred.forces); pinred
            calls the function once, with CasADi symbols.  Alternatively, a formula as text in t, x,
            xdot, mu, and pose, xi, J of the base, such as "x['hinge'] - 0.5".  In formulas,
            height['foot'] is the height of a link or frame [m], against gravity.
        name: Name of the event in the results.
        terminal: Whether the motion ends at the event.
        direction: 1 for rising crossings, −1 for falling ones, 0 for both.
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
    """Compile the expressions of events.

    Args:
        system: System whose state the events observe.
        events: The events.
        base: Whether the scene computes the motion of the base.
    Returns:
        The expressions; None if there are no events.
    Raises:
        InputError: an expression is not valid, or observes a base that is not computed.
    """
    if not events:
        return None
    from ..forces.force import Watched  # Imported here because it imports CasADi.

    labels = [f"event '{event.name}'" for event in events]
    watched = Watched(system, [event.expression for event in events], labels)
    if watched.sees_base and not base:
        raise InputError(
            "an event depends on the base in space, which outputs='shape' omits; use outputs='all'"
        )
    return watched


def list_events(events: Any) -> tuple[Event, ...]:
    """Return the option `events`, an Event or several, as a tuple; raise InputError."""
    sequence = (events,) if isinstance(events, Event) else events
    if isinstance(sequence, str) or not hasattr(sequence, "__iter__"):
        raise InputError(f"events must be a list of Event, got {brief(events)}")
    entries = tuple(sequence)
    for event in entries:
        if not isinstance(event, Event):
            raise InputError(f"events must be a list of Event, got {brief(event)} in it")
    names = [event.name for event in entries]
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise InputError(f"two events are called '{repeated[0]}'; give each a unique name")
    return entries
