"""integrate_in_lanes(): many runs of an explicit method at once, on several threads."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from ...common.errors import InputError
from ...common.memo import once_for_all
from ..explicit.tableau import Tableau
from ..integrate import begun_by
from ..integrate_many import Solutions, checked_batch, over_threads, solutions
from ..methods.method import Explicit
from .of_tableau import LaneLoop, make_lane_loop

WIDTHS = (8, 16)  # lanes that there are loops for


def integrate_in_lanes(
    method: Explicit,
    address: int,
    width: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: float,
    times: ArrayLike,
    quaternion: int = -1,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for every i, as many at once as there are lanes.

    address: of a kernel of f at `width` states at once, each with its own parameters: number j of
    state k stands at j width + k, of y, params and rates.  The other arguments are those of
    `integrate_many`.
    A run's steps and numbers depend on nothing but itself: neither on the others, nor on their
    order, nor on the number of threads.  They are those of `integrate` but for round-off.
    A run that fails has a status and leaves the others alone.  Raises InputError.
    """
    if width not in WIDTHS:
        raise InputError(f"width must be one of {WIDTHS}, got {width!r}")
    asked = checked_batch(address, params, y0, t_end, times, quaternion, threads)
    batch = asked.batch
    (size, n), parameters = batch.y0.shape, batch.params.shape[1]
    loop = _lane_loop(type(method).__name__, method.order, method.tableau(), width)
    unbegun = begun_by(method, address, n, asked.end, quaternion, (0, 0))
    queue = np.zeros(1, dtype=np.int64)
    most = min(width, max(1, ceil(size / asked.threads)))

    def share() -> None:
        loop.members(batch, unbegun, queue, loop.room(n, parameters), most)

    over_threads([share] * asked.threads, asked, progress)
    return solutions(method, batch)


@once_for_all
def _lane_loop(name: str, order: int, tableau: Tableau, width: int) -> LaneLoop:
    return make_lane_loop(name, order, tableau, width)
