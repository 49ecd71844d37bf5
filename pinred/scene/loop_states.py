"""Initial states of robots with closed loops: the nearest state that keeps all loops closed."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError, LoopWarning
from ..common.names import listed, quoted
from ..reduction.pointwise_reduction import PointwiseReduction
from ..system.loops.loop_assembly import CLOSED, assemble, describe_gap, loop_gaps, project_rates
from ..system.system import System

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel

_NOTICEABLE = 1e-6  # change of an initial state that is reported [relative]
_ROUND_OFF = 1e-12  # change of a rate that is never reported [rad/s | m/s]


@dataclass(frozen=True)
class HeldJoints:
    """How the user stated joint values.

    Attributes:
        stated: Whether the user stated any value.
        names: Joints that were stated by name and keep their values; empty if all were stated.
    """

    stated: bool
    names: tuple[str, ...]


def held_joints(x0: Any, xdot0: Any) -> tuple[HeldJoints, HeldJoints]:
    """Return which joints keep their values and their rates when loops are closed."""
    by_name = [
        tuple(map(str, given)) if isinstance(given, Mapping) else () for given in (x0, xdot0)
    ]
    return HeldJoints(x0 is not None, by_name[0]), HeldJoints(xdot0 is not None, by_name[1])


def closed_state(
    system: System,
    x: Array,
    xdot: Array,
    held: tuple[HeldJoints, HeldJoints],
    report: tuple[bool, bool],
    model: ForceModel | None,
) -> tuple[Array, Array]:
    """Return the nearest shape (nx,) and rates (m,) that keep all loops closed.

    Args:
        system: The system, with loops.
        x: Shape, (nx,), with planned values of prescribed joints.
        xdot: Shape rate, (m,), with planned values of prescribed joints.
        held: How the user stated values and rates of joints.
        report: Whether to report noticeable changes of values, and of rates, in any case.
        model: Forces and prescribed joints; None if there are none.
    """
    driven = () if model is None else model.joints
    x = closed_shape(system, x, held[0], report=report[0], driven=driven)
    return x, closed_rates(system, x, xdot, held[1], report=report[1], driven=driven)


def closed_shape(
    system: System,
    x: Array,
    held: HeldJoints,
    *,
    report: bool = False,
    driven: Collection[int] = (),
    nearby: bool = False,
) -> Array:
    """Return the shape nearest to x, (nx,), by least squares, that closes all loops.

    Args:
        system: The system, with loops.
        x: Shape, (nx,) [rad | m].
        held: Joints that keep their values if the loops can close by motion of the others.
        report: Whether to report a noticeable change although `held` states no value.
        driven: Indices of the rates of prescribed joints, which keep their values.
        nearby: Whether joints start from x although `held` states no value.
    Returns:
        The closed shape, (nx,).
    Raises:
        InputError: The loops do not close near this shape; the message names a loop and its gap.
    """
    assert system.closure is not None
    length = system.closure.length
    gaps = loop_gaps(system, x, length)
    if gaps.max() <= CLOSED:
        return x
    may_move = _may_move(system, driven)
    free = np.logical_and(_free(system, held), may_move)
    start = x
    if held.names or (driven and not (held.stated or nearby)):
        # The other joints start from a closed shape instead of zero.
        start = x.copy()
        for joint in system.space.joints:
            if free[joint.v].all():
                start[joint.x] = system.closure.x[joint.x]
        closed, remaining = assemble(system, start, length, free)
        if remaining.max() <= CLOSED:
            return closed
    closed, remaining = assemble(system, start, length, may_move)
    if remaining.max() > CLOSED and driven:
        names = listed([system.space.names[k] for k in driven], 6)
        raise InputError(
            f"prescribed: the loops of '{system.name}' do not close with the prescribed positions "
            f"of {names} at time 0: {describe_gap(system, remaining, length)} at the nearest shape "
            "that was found. Start the motion at a closed shape, or give x0 of the other joints."
        )
    if remaining.max() > CLOSED and not (held.stated or report):
        return system.closure.x  # a random shape need not be near a closed one
    if remaining.max() > CLOSED:
        raise InputError(
            f"x0: the loops of '{system.name}' do not close near this shape: "
            f"{describe_gap(system, remaining, length)} at the nearest shape that was found. "
            "Start nearer to a closed shape; System.closure.x is one."
        )
    if (held.stated or report) and gaps.max() > _NOTICEABLE:
        name = quoted(system.loops[int(np.argmax(gaps))].name)
        _warn(
            system,
            f"x0 leaves loop {name} open by {gaps.max() * length:.3g} m",
            system.space.difference(x, closed),
        )
    return closed


def closed_rates(
    system: System,
    x: Array,
    xdot: Array,
    held: HeldJoints,
    *,
    report: bool = False,
    driven: Collection[int] = (),
) -> Array:
    """Return the rates nearest to ẋ, (m,), in the kinetic metric, that keep all loops closed.

    Args:
        system: The system, with loops.
        x: Closed shape, (nx,) [rad | m].
        xdot: Shape rate, (m,) [rad/s | m/s].
        held: Joints that keep their rates if the loops allow it.
        report: Whether to report a noticeable change although `held` states no value.
        driven: Indices of the rates of prescribed joints, which keep their values.
    Returns:
        The rates, (m,).
    Raises:
        InputError: The prescribed joints leave no rates of the others that keep the loops closed.
    """
    tree = system.open_tree()
    reduction = tree.workspace(PointwiseReduction, lambda: PointwiseReduction(tree))
    may_move = _may_move(system, driven)
    metric = reduction.split(x).reduced_metric
    free = np.logical_and(_free(system, held), may_move)
    rates = None if free.all() else project_rates(system, x, xdot, metric, free)
    if rates is not None:
        return rates
    rates = project_rates(system, x, xdot, metric, may_move if driven else None)
    if rates is None:
        names = listed([system.space.names[k] for k in driven], 6)
        raise InputError(
            f"prescribed: the motions of {names} contradict the loops of '{system.name}' near "
            f"x = {x}: other joints cannot follow. Prescribe at most {system.shape_dim} joints, "
            "which determine the others."
        )
    change = np.abs(rates - xdot).max()
    if (held.stated or report) and change > max(_NOTICEABLE * np.abs(xdot).max(), _ROUND_OFF):
        _warn(system, "xdot0 opens a loop", rates - xdot)
    return rates


def _free(system: System, held: HeldJoints) -> Array:
    """Return which shape rates are not held, (m,)."""
    free = np.ones(system.m, dtype=bool)
    for joint in system.space.joints:
        free[joint.v] = joint.name not in held.names
    return free


def _may_move(system: System, driven: Collection[int]) -> Array:
    """Return which shape rates are not prescribed, (m,)."""
    free = np.ones(system.m, dtype=bool)
    free[list(driven)] = False
    return free


def _warn(system: System, what: str, change: Array) -> None:
    k = int(np.argmax(np.abs(change)))
    unit = system.units[k]
    warnings.warn(
        f"{what}. The nearest state that keeps the loops of '{system.name}' closed is used; it "
        f"changes joint {quoted(system.space.names[k])} by {change[k]:.3g} {unit} (or {unit}/s). "
        "To keep chosen joints, state only those, by name.",
        LoopWarning,
        stacklevel=2,
    )
