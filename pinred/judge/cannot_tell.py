"""Reasons for the verdict CANNOT TELL: the comparison of final states carries no information."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .distances import FullMotion, Size
from .reference_solution import PERTURBATION

INFORMATIVE = 0.1  # rad, or fraction of the motion's size; larger bounds carry no information
_REST = 1e-12  # rad, or fraction of the robot's size; a motion below it tests nothing


def count_informative_times(bounds: Array, growth: Array) -> int:
    """Return the number of leading times at which errors can be judged.

    Args:
        bounds: Bounds on relative errors over time, (T,).
        growth: Factors by which a small perturbation has grown, (T,).
    Returns:
        Number of times before a bound or the perturbation exceeds INFORMATIVE.
    """
    uninformative = (bounds > INFORMATIVE) | (growth * PERTURBATION > INFORMATIVE)
    return int(np.argmax(uninformative)) if uninformative.any() else len(bounds)


def explain_uninformative_times(
    times: Array, count: int, bounds: Array, growth: Array
) -> tuple[str, ...]:
    """Return the reason why only the first times can be judged; empty if all can.

    Args:
        times: Times of the comparison, (T,) [s].
        count: Number of times that can be judged.
        bounds: Bounds on relative errors over time, (T,).
        growth: Factors by which a small perturbation has grown, (T,).
    Returns:
        One sentence, or none.
    """
    if count == len(times):
        return ()
    cause = (
        f"a small change of the initial state has grown {growth[-1]:.1e} times by the end"
        if growth[-1] * PERTURBATION > INFORMATIVE
        else f"errors up to {bounds[-1]:.1e} would pass by the end"
    )
    return (
        f"errors of the motion can be judged until t = {times[max(count - 1, 0)]:g} s only: "
        f"{cause}; compare a shorter motion, or a tighter tolerance",
    )


def explain_rest(reference: FullMotion, size: Size) -> tuple[str, ...]:
    """Return the reason why a system at rest cannot be judged; empty if it moves."""
    configurations = np.abs(reference.q - reference.q[0]).max(initial=0.0)
    joints = (np.abs(reference.x - reference.x[0]) / size.joints).max(initial=0.0)
    if max(float(configurations) / max(size.position, 1.0), float(joints)) > _REST:
        return ()
    return ("nothing moves, so the equations are not tested: give rates, a twist or forces",)
