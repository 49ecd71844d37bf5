"""The loop over members in lanes, bound to a tableau and to how many lanes there are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from ...common.arrays import Array
from ..explicit.row_sums import Rate, Sum
from ..explicit.runge_kutta import digest, order_in_twos, steps_of
from ..explicit.tableau import Tableau
from ..stepping.compiling import bound, compiled, woven
from . import lane_loop, lane_steps
from .lane_loop import READY_REGISTERS, REGISTERS, Room
from .lane_program import lane_program
from .lane_steps import READY_ROWS
from .vectors import of_width

_LINE = 64  # bytes of a line of the cache, on which vectors of eight begin


@dataclass(frozen=True)
class LaneLoop:
    """The compiled loop over members in lanes of one method.

    width: how many lanes there are.  members: the loop.  rows: those of `work`.
    """

    width: int
    members: Callable[..., None]
    rows: int

    def room(self, n: int, parameters: int) -> Room:
        """Return the room of a thread, for n numbers in a state and so many parameters."""
        width = self.width
        return Room(
            work=aligned(self.rows, n * width),
            params=aligned(1, parameters * width)[0],
            own=aligned(REGISTERS, width),
            ready=aligned(READY_ROWS, n * width),
            ready_params=aligned(1, parameters * width)[0],
            ready_own=aligned(READY_REGISTERS, width),
        )


def make_lane_loop(name: str, order: int, tableau: Tableau, width: int) -> LaneLoop:
    """Return the loop of a method of this name and order, for so many lanes."""
    steps = steps_of(tableau)

    def calls(some: list[Sum | Rate]) -> float:
        return float(sum(isinstance(step, Rate) for step in some))

    made = SimpleNamespace(
        **order_in_twos(order),
        **vars(of_width(width)),
        WIDTH=width,
        STAGES=tableau.stages,
        FIRST=steps.first,
        TERMS=steps.rows - steps.first,
        OUT=steps.rows,
        AT_STEP=calls(steps.to_end),
        AT_END=calls(steps.at_end),
        AT_DENSE=calls(steps.dense),
        fill_step=lane_program(steps.to_end, width),
        fill_end=lane_program(steps.at_end, width),
        fill_errors=lane_program(steps.errors, width),
        fill_dense=lane_program(steps.dense, width),
    )
    told = f"{name}_{digest(order, tableau)}_{width}_lanes"

    def made_of(function: Any, how: Callable[[Any], Any]) -> Any:
        part = how(bound(function, f"{told}_{function.__name__}", **vars(made)))
        setattr(made, function.__name__, part)
        return part

    made_of(lane_steps.root, woven)
    one = len(tableau.errors) == 1
    made.estimate = made_of(lane_steps.one_error if one else lane_steps.two_errors, woven)
    in_place: tuple[Any, ...] = (
        lane_steps.first_step, lane_steps.unit, lane_steps.finite, lane_steps.accept,
        lane_steps.next_step, lane_steps.prepare, lane_steps.between, lane_loop.write,
    )  # fmt: skip
    for function in in_place:
        made_of(function, woven)
    for function in (lane_loop.make_ready, lane_loop.culprit, lane_loop.enter):
        made_of(function, compiled)
    members = made_of(lane_loop.lane_members, compiled)
    return LaneLoop(width, members, steps.rows + 1)


def aligned(rows: int, size: int) -> Array:
    """Return rows (rows, size) of zeros that begin on a line of the cache."""
    raw = np.zeros(rows * size + _LINE // 8)
    first = -(raw.ctypes.data // 8) % (_LINE // 8)
    return raw[first : first + rows * size].reshape(rows, size)
