"""Initial states of robots with closed loops: the nearest state that keeps all loops closed."""

from __future__ import annotations

import warnings

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError, LoopWarning
from ..common.names import quoted
from ..reduction.pointwise_reduction import PointwiseReduction
from ..system.loops.closure import CLOSED, assemble, describe_gap, loop_gaps, project_rates
from ..system.system import System

_NOTICEABLE = 1e-6  # change of an initial state that is reported [rad | fraction of sizes]


def close_state(
    system: System, x: Array, xdot: Array, *, stated: tuple[bool, bool]
) -> tuple[Array, Array]:
    """Move a state to the nearest one that keeps all loops closed.

    Joints move by least squares, and rates change by the least kinetic energy.

    Args:
        system: The system, with loops.
        x: Shape, (nx,) [rad | m].
        xdot: Shape rate, (m,) [rad/s | m/s].
        stated: Whether the user stated the shape and the rates; a noticeable change of a stated
            value is reported by a LoopWarning.
    Returns:
        Shape and shape rate.
    Raises:
        InputError: The loops do not close near this shape; the message names a loop and its gap.
    """
    assert system.closure is not None
    length = system.closure.length
    gaps = loop_gaps(system, x, length)
    closed = x
    if gaps.max() > CLOSED:
        closed, remaining = assemble(system, x, length)
        if remaining.max() > CLOSED:
            raise InputError(
                f"x0: the loops of '{system.name}' do not close near this shape: "
                f"{describe_gap(system, remaining, length)} at the nearest shape that was found. "
                "Start nearer to a closed shape; System.closure.x is one."
            )
    tree = system.open_tree()
    reduction = tree.workspace(PointwiseReduction, lambda: PointwiseReduction(tree))
    rates = project_rates(system, closed, xdot, reduction.split(closed).reduced_metric)
    if stated[0] and gaps.max() > _NOTICEABLE:
        worst = quoted(system.loops[int(np.argmax(gaps))].name)
        _warn(system, f"x0 leaves loop {worst} open by {gaps.max() * length:.3g}", closed - x)
    if stated[1] and np.abs(rates - xdot).max() > _NOTICEABLE * np.abs(xdot).max():
        _warn(system, "xdot0 opens a loop", rates - xdot)
    return closed, rates


def _warn(system: System, what: str, change: Array) -> None:
    k = int(np.argmax(np.abs(change)))
    warnings.warn(
        f"{what}; the nearest state that keeps the loops of '{system.name}' closed is used, which "
        f"changes joints by up to {np.abs(change[k]):.3g} ({quoted(system.shape_names[k])})",
        LoopWarning,
        stacklevel=2,
    )
