"""Checks of scene options beyond the type of the value.

The options are the keyframe, report times and lists of forces, and the time span that
signals and controllers cover.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Array, as_floats, entries_of, positive
from ..common.errors import InputError, ShapeError
from ..common.names import brief, listed, one_of
from ..forces.force import Force
from ..system.system import System
from .initial_state import DURATION

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel

EVEN_TIMES = 201  # number of report times if a scene states none; they are evenly spaced
_COUNTS = np.arange(float(EVEN_TIMES))
# Relative difference of two times that count as equal: four units in the last place.
_SAME_TIME = 4.0 * float(np.finfo(float).eps)
MOST_CALLS = 1_000_000  # largest number of calls of a controller in a scene; each call ends a step


def check_keyframe(system: System, name: str) -> str:
    """Return the name of a keyframe; raise InputError if the robot's file does not have it."""
    if not one_of(name, system.keyframes):
        valid = listed(list(system.keyframes), 60) or "none"
        raise InputError(
            f"keyframe: '{system.name}' has no keyframe {brief(name)}; the keyframes are {valid}"
        )
    return name


def compute_report_times(times: Any, duration: float | None, system: System) -> Array:
    """Return the report times of a scene, (T,) [s].

    Args:
        times: Requested times, or None for EVEN_TIMES evenly spaced times.
        duration: Duration of the scene [s], or None.
        system: System whose own duration is used if neither times nor duration are stated.
    Returns:
        Increasing times, (T,), not before 0 [s].
    Raises:
        InputError: the times do not increase, or are outside the duration.
        ShapeError: `times` is not a vector of finite numbers.
    """
    if times is None:
        default = system.initial.duration if system.initial else DURATION
        last = default if duration is None else float(duration)
        even: Array = _COUNTS * (last / _COUNTS[-1])
        even[-1] = last
        return even
    requested = np.atleast_1d(as_floats(times, "times")).copy()
    end = np.inf if duration is None else float(duration)
    if requested.ndim != 1 or requested.size == 0 or not np.isfinite(requested).all():
        raise ShapeError("times must be a vector of finite times")
    if (np.diff(requested) <= 0.0).any() or requested[0] < 0.0 or requested[-1] > end:
        raise InputError(
            f"times must increase from 0 or later to the duration at most ({end:g} s), "
            f"got {requested[0]:g} … {requested[-1]:g}"
        )
    if duration is None:
        positive(requested[-1], "the last of times, which stands for the duration,")
    return requested


def list_forces(forces: Any) -> tuple[Any, ...]:
    """Return the option `forces` (a Force, several, or None) as a tuple; raise InputError."""
    if forces is None or isinstance(forces, Force):
        return () if forces is None else (forces,)
    entries = entries_of(forces)
    if entries is None:
        raise InputError(f"forces must be a list of objects of pinred.forces, got {brief(forces)}")
    return tuple(entries)


def check_span(model: ForceModel, end: float, *, base: bool) -> None:
    """Check that the scene's time span and outputs satisfy its forces.

    Args:
        model: Forces and prescribed joints.
        end: End of the scene [s].
        base: Whether the motion of the base is computed.
    Raises:
        InputError: a signal is not defined over the whole scene, a force observes a base that
            is not computed, or a controller would be called too often.
    """
    for signal in (*model.signals, *model.references):
        first, last = signal.span
        if not first <= 0.0 <= end <= last * (1.0 + _SAME_TIME):
            # Times that six digits do not distinguish are written in full.
            digits = 17 if f"{last:g}" == f"{end:g}" else 6
            raise InputError(
                f"{signal!r} is defined from {first:.{digits}g} to {last:.{digits}g} s, "
                f"but the scene goes from 0 to {end:.{digits}g} s"
            )
    if model.sees_base and not base:
        raise InputError(
            "a force or controller depends on the base in space, which outputs='shape' omits; "
            "use outputs='all'"
        )
    for controller, _ in model.held:
        if end / controller.period > MOST_CALLS:
            raise InputError(
                f"a period of {controller.period:g} s would call {controller.name} more than "
                f"{MOST_CALLS} times in {end:g} s"
            )
