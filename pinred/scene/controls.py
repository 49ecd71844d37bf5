"""What signals and controllers ask of a scene: its span, how often they act, and the base."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..common.errors import InputError

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel

MOST_CALLS = 1_000_000  # of one controller; each ends a run of the integrator


def check_span(model: ForceModel, end: float, *, base: bool) -> None:
    """Raise InputError unless a scene to `end` [s] has what its forces need.

    base: whether the base is followed.
    """
    for signal in (*model.signals, *model.references):
        first, last = signal.span
        if not first <= 0.0 <= end <= last:
            raise InputError(
                f"{signal!r} is defined from {first:g} to {last:g} s, "
                f"but the scene goes from 0 to {end:g} s"
            )
    if model.sees_base and not base:
        raise InputError(
            "a force or controller sees the base in space, which outputs='shape' leaves out; "
            "use outputs='all'"
        )
    for controller, _ in model.held:
        if end / controller.period > MOST_CALLS:
            raise InputError(
                f"a period of {controller.period:g} s would call {controller.name} more than "
                f"{MOST_CALLS} times in {end:g} s"
            )
