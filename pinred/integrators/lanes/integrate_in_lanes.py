"""integrate_in_lanes(): integrate a batch with an explicit method, in SIMD lanes and threads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.memo import once_for_all
from ..explicit.row_programs import Rate, Sum
from ..explicit.runge_kutta import bind_formulas, digest, steps_of
from ..explicit.tableau import Tableau
from ..integrate import begun_by
from ..integrate_many import Solutions, checked_batch, over_threads, solutions
from ..methods.method import Explicit
from ..stepping.compiling import compiled
from ..stepping.run_state import NOT_CANONICAL
from ..stepping.state_rows import Quaternions
from ..stepping.vector_rows import FUSED
from . import members_in_lanes
from .members_in_lanes import READY_REGISTERS, READY_ROWS, REGISTERS, Workspace
from .vectors import functions_of_width, vector_type

WIDTHS = (8, 16)  # supported numbers of SIMD lanes
_CACHE_LINE = 64  # alignment of vectors of eight floats [bytes]


def integrate_in_lanes(
    method: Explicit,
    address: int,
    width: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: ArrayLike,
    times: ArrayLike,
    quaternions: Quaternions = (0, 0),
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for all members i, several at once in SIMD lanes.

    Steps and results of a member do not depend on the other members, their order or the number
    of threads. They equal the steps and results of `integrate` up to round-off. A failing member
    reports a status and does not affect the others.

    Args:
        method: Explicit method.
        address: Address of a kernel of f at `width` states at once, each with its parameters.
            Entry j of state k is number j·width + k of y, params and rates.
        width: Number of SIMD lanes, one of WIDTHS.
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        t_end: End time, or one for each member, (N,) [s].
        times: Sorted report times, (T,) or (N, T), as for `integrate_many` [s].
        quaternions: As for `integrate`.
        threads: Number of threads, None for all processors.
        progress: Called with the finished fraction of the members.
    Returns:
        The solutions, member first.
    Raises:
        InputError: An argument is invalid.
    """
    if width not in WIDTHS:
        raise InputError(f"width must be one of {WIDTHS}, got {width!r}")
    asked = checked_batch(address, params, y0, t_end, times, quaternions, threads)
    batch = asked.batch
    (size, n), parameters = batch.y0.shape, batch.params.shape[1]
    loop = _lane_loop(type(method).__name__, method.order, method.tableau(), width)
    initial_run = begun_by(method, address, n, asked.end, quaternions, NOT_CANONICAL)
    queue = np.zeros(1, dtype=np.int64)
    most = min(width, max(1, ceil(size / asked.threads)))

    def run_members() -> None:
        loop.members(batch, initial_run, queue, loop.workspace(n, parameters), most)

    over_threads([run_members] * asked.threads, asked, progress)
    return solutions(method, batch)


@dataclass(frozen=True)
class LaneLoop:
    """The compiled loop over members in SIMD lanes of one method.

    Attributes:
        width: Number of lanes.
        members: Compiled function, see members_in_lanes.run_members.
        rows: Number of rows of `work`.
    """

    width: int
    members: Callable[..., None]
    rows: int

    def workspace(self, n: int, parameters: int) -> Workspace:
        """Return the workspace of a thread for states with n entries and a number of parameters."""
        width = self.width
        return Workspace(
            work=_aligned(self.rows, n * width),
            params=_aligned(1, parameters * width)[0],
            registers=_aligned(REGISTERS, width),
            ready=_aligned(READY_ROWS, n * width),
            ready_params=_aligned(1, parameters * width)[0],
            ready_registers=_aligned(READY_REGISTERS, width),
        )


@once_for_all
def _lane_loop(name: str, order: int, tableau: Tableau, width: int) -> LaneLoop:
    """Compile the loop of a method for a number of lanes."""
    steps = steps_of(tableau)

    def calls(program: list[Sum | Rate]) -> float:
        return float(sum(isinstance(step, Rate) for step in program))

    numbers: dict[str, Any] = {
        **functions_of_width(width),
        "WIDTH": width,
        "OUT": steps.rows,
        "AT_STEP": calls(steps.to_end),
        "AT_END": calls(steps.at_end),
        "AT_DENSE": calls(steps.dense),
    }
    prefix = f"{name}_{digest(order, tableau)}_{width}_lanes"
    bindings = bind_formulas(
        prefix,
        order,
        tableau,
        numbers,
        width=width,
        lane_steps=partial(vector_type, width),
        flags=FUSED,
    )
    for function in members_in_lanes.INLINED:
        bindings.add(function)
    for compiled_function in members_in_lanes.COMPILED:
        bindings.add(compiled_function, compiled)
    return LaneLoop(width, bindings.values["run_members"], steps.rows + 1)


def _aligned(rows: int, size: int) -> Array:
    """Return zeros, (rows, size), aligned to a cache line."""
    raw = np.zeros(rows * size + _CACHE_LINE // 8)
    first = -(raw.ctypes.data // 8) % (_CACHE_LINE // 8)
    return raw[first : first + rows * size].reshape(rows, size)
