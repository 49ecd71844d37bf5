"""Initial states of members of robots with closed loops, and members that pass singular shapes."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError, LoopWarning, RejectedValuesError
from ...scene.scene import Scene
from ..closed_loops import may_pass_singular_shape
from ..simulate import trajectory_of
from .trajectories import Batch, Failure


def close_members(scene_of: Callable[[int], Scene], count: int) -> tuple[Array, Array]:
    """Return the initial shapes and rates of all members with closed loops, as in `simulate`.

    Args:
        scene_of: Function that returns the scene of a member, given its index.
        count: Number of members N.
    Returns:
        Shapes, (N, nx), and rates, (N, m).
    Raises:
        RejectedValuesError: The loops of some members do not close; it has the reason for each.
    """
    shapes, rates, reasons = [], [], dict[int, str]()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for member in range(count):
            try:
                given = scene_of(member).given
            except InputError as error:
                reasons[member] = str(error)
                continue
            shapes.append(given.x)
            rates.append(given.xdot)
    if reasons:
        raise RejectedValuesError(reasons)
    _warn_once(caught, count)
    return np.concatenate(shapes), np.concatenate(rates)


def _warn_once(caught: list[warnings.WarningMessage], count: int) -> None:
    """Repeat the first warning about loops with the number of such members, and all others."""
    loops = [entry for entry in caught if issubclass(entry.category, LoopWarning)]
    for entry in caught:
        if entry not in loops:
            warnings.warn_explicit(entry.message, entry.category, entry.filename, entry.lineno)
    if loops:
        warnings.warn(
            f"{len(loops)} initial states of {count} members leave loops open. The first: "
            f"{loops[0].message}",
            LoopWarning,
            stacklevel=2,
        )


def reject_singular(batch: Batch, times: Array, scene_of: Callable[[int], Scene]) -> list[Failure]:
    """Return the failures of members that pass a singular shape, and remove their later states.

    Lanes store no steps.  So members whose reported shapes cannot exclude a singular shape are
    simulated alone, which finds it.

    Args:
        batch: Solutions of the members, whose states after a singular shape become NaN.
        times: Report times, (T,) [s].
        scene_of: Function that returns the scene of a member, given its index.
    Returns:
        The failures.
    """
    assert batch.flow is not None
    system, failures = batch.flow.kernel.system, []
    if system.closure is None:
        return []
    shapes = np.empty((len(batch.members), len(times), system.nx))
    batch.flow.fill_states(times, batch.y, np.arange(len(shapes)), {"x": shapes})
    failed = {failure.member for failure in batch.failures}
    for k, member in enumerate(batch.members.tolist()):
        if member in failed or not may_pass_singular_shape(system, shapes[k]):
            continue
        try:
            trajectory_of(scene_of(member))
        except IntegrationError as error:
            reached = getattr(error, "time", 0.0)
            batch.y[k, times > reached] = np.nan
            failures.append(Failure(member, reached, str(error)))
    return failures
