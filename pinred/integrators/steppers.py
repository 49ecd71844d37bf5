"""What runs a method: its compiled functions, the rows they work on, and their registers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from . import dop853, rkmk4, variational
from .gauss import adaptive as gauss_adaptive
from .gauss import fixed_step as gauss
from .gauss import newton as gauss_newton
from .gauss import stages as implicit
from .machine.kernel_call import LANES as WHOLE
from .machine.kernel_call import SEEDS
from .machine.registers import (
    ATOL,
    BUDGET,
    COUNTS,
    ENTRY,
    LANES,
    MAX_STEP,
    MAX_STEPS,
    PAIRS,
    QUATERNION,
    REALS,
    RTOL,
    SOLVER,
    SPIN,
    STAGES,
    T_END,
    TOTAL,
    Counts,
    H,
    N,
)
from .methods import (
    DOP853,
    FIXED_POINT,
    RKMK4,
    SOLVERS,
    AdaptiveGauss,
    Gauss,
    Method,
    Radau,
    Variational,
)
from .radau import dense as radau_dense
from .radau import steps as radau

MOST_STEPS = 1e12  # of one length; the clock counts them
EVALUATIONS_BETWEEN_PAUSES = 4096  # at most some milliseconds: Ctrl-C and progress come through


@dataclass(frozen=True)
class Stepper:
    """The compiled functions of a method.

    advance, recall: see dop853.py.  state: the row of `work` with the state.  kept: numbers at
    a knot for one in the state.
    """

    advance: Callable[..., int]
    recall: Callable[..., None]
    state: int
    kept: int = 1


_STEPPERS: dict[type[Any], Stepper] = {
    DOP853: Stepper(dop853.advance, dop853.recall, dop853.Y),
    RKMK4: Stepper(rkmk4.advance, rkmk4.recall, rkmk4.Y),
    Gauss: Stepper(gauss.advance, gauss.recall, implicit.Y),
    AdaptiveGauss: Stepper(gauss_adaptive.advance, gauss_adaptive.recall, implicit.Y),
    Variational: Stepper(variational.advance, variational.recall, variational.Y),
    Radau: Stepper(radau.advance, radau_dense.recall, radau_dense.Y, radau_dense.KEPT),
}


def stepper_of(method: Method) -> Stepper:
    """Return the compiled functions of a method."""
    return _STEPPERS[type(method)]


def work_rows(method: Method, n: int, *, tangent: bool = False) -> Array:
    """Return the rows that a stepper works on, padded to whole vectors.

    tangent: with what Newton's method takes besides, where it is not always used.
    """
    if isinstance(method, (Gauss, AdaptiveGauss)):
        behind = gauss_newton.room(n, method.stages) if tangent else 0
        work = implicit.work_rows(method.stages, n, behind)
        if tangent:
            gauss_newton.fill(work, method.stages)
        return work
    if isinstance(method, Radau):
        return np.zeros((radau_dense.MATRIX + 5 * n, -(-n // SEEDS) * SEEDS))
    if isinstance(method, Variational):
        n = max(n, variational.LEAST)
    rows = {DOP853: dop853.ROWS, RKMK4: rkmk4.ROWS, Variational: variational.ROWS}
    return np.zeros((rows[type(method)], -(-n // WHOLE) * WHOLE))


def with_tangent(method: Method, n: int, work: Array) -> Array:
    """Return rows that hold what `work` does, with room for Newton's method."""
    larger = work_rows(method, n, tangent=True)
    larger[: len(work)] = work
    return larger


def registers(
    method: Method, n: int, t_end: float, quaternion: int, canonical: tuple[int, int]
) -> tuple[Array, Counts]:
    """Return `real` and `count` of run.py for a run that has not begun."""
    real, count = np.zeros(REALS), np.zeros(COUNTS, dtype=np.int64)
    real[T_END] = t_end
    count[N], count[QUATERNION] = n, quaternion
    count[PAIRS], count[SPIN] = canonical
    count[ENTRY], count[BUDGET] = -1, EVALUATIONS_BETWEEN_PAUSES
    if isinstance(method, (Gauss, AdaptiveGauss)):
        count[STAGES], count[LANES] = method.stages, method.lanes
        count[SOLVER] = FIXED_POINT
    if isinstance(method, Gauss):
        count[SOLVER] = SOLVERS[method.solver]
    if isinstance(method, (DOP853, AdaptiveGauss, Radau)):
        real[RTOL], real[ATOL], real[MAX_STEP] = method.rtol, method.atol, method.max_step
        count[MAX_STEPS] = method.max_steps
    else:
        if not t_end <= MOST_STEPS * method.step:
            raise InputError(
                f"steps of {method.step:g} s are more than {MOST_STEPS:.0e} in {t_end:g} s, which "
                "no run comes to the end of: take longer ones"
            )
        # The part of a step that round-off adds to the quotient is no step.
        total = max(1, ceil(t_end / method.step * (1.0 - 1e-12)))
        count[TOTAL], real[H] = total, t_end / total
    return real, count
