"""Fixed-point iteration to round-off: stages of a step, their tangents, and their covectors.

The three systems of equations have the form V_i = v + Σ T_ij Z_j, Z_j = h b_j g(V_j). For the
stages, v is the state, T is μ (see `tables`), and g the vector field. For tangents, v is a
direction of the state, and g the derivative of the vector field along V_j. For covectors, v is the
covector at the end of the step, T is μ transposed, and g the adjoint of the vector field.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import bind_globals, compiled, inlined, unbound
from ..stepping.kernel_call import call, call_adjoint, call_slopes
from ..stepping.state_rows import NEW, Y
from .stage_products import multiply, refresh
from .stage_rows import MU, RATE, ROWS, STAGE, work_rows
from .stages import scale_by_largest
from .tables import tables

# Rows after those of `stage_rows`: μ transposed; the tangents or covectors of the stages; their
# increments Z of this step, of the step treated before, and of a shorter step to a report time.
TRANSPOSED, SEED, Z, OLD_Z, SUB_Z = range(ROWS, ROWS + 5)

_MOST = 400  # largest number of fixed-point iterations per solve
_PATIENCE = 2  # limit on iterations without improvement, near round-off
_WAVES = 20  # the same limit far from round-off, where slow convergence comes in waves
# Relative change above which an iteration that has stopped improving counts as not converged.
_CLOSE = 1e-10
_EPS = float(np.finfo(float).eps)
_SURE = 64.0 * _EPS  # change below which the ratio of two changes predicts the remaining error


def sensitivity_rows(stages: int, n: int) -> Array:
    """Return work rows for the steps of a run, with the tables of the method stored in them."""
    return _first_rows(stages, n).copy()


@lru_cache(maxsize=16)
def _first_rows(stages: int, n: int) -> Array:
    stage_rows = work_rows(stages, n, 0)
    work = np.zeros((SUB_Z + 1, stage_rows.shape[1]))
    work[:ROWS] = stage_rows
    mu = tables(stages).mu
    work[TRANSPOSED, : mu.size] = mu.ravel()
    return work


# --- names that `_solver` binds -----------------------------------------------------------------


BASE = TABLE = OUT = 0  # rows of v, of T, and of V
evaluate = unbound  # (address, params, work, more, count): write g(V), `count` numbers, to RATE


def solve(
    address: int, params: Array, work: Array, n: int, lanes: int, row: int, h: float, more: Array
) -> bool:
    """Solve for the increments in `row` from a first guess, and write V.

    Args:
        address: Address of the kernel, the tangent kernel or the adjoint kernel.
        params: Parameters, (p,).
        work: Work rows.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        row: Row of the increments Z.
        h: Length of the step [s].
        more: For tangents, the direction of the parameters, (p,); for covectors, workspace for the
            output of the adjoint kernel, ((n + p) lanes,).
    Returns:
        Whether the iteration converged.
    """
    scale_by_largest(work, n, lanes, BASE, row)
    previous, best, idle = np.inf, np.inf, 0
    for _ in range(_MOST):
        multiply(work, OUT, BASE, TABLE, row, n, lanes)
        evaluate(address, params, work, more, n * lanes)
        change = refresh(work, row, n, lanes, h)
        if not change < np.inf:
            return False
        idle = idle + 1 if change >= best else 0
        best = min(best, change)
        if _settled(change, previous, best, idle):
            multiply(work, OUT, BASE, TABLE, row, n, lanes)
            return best <= _CLOSE
        previous = change
    return False


@compiled
def _settled(change: float, previous: float, best: float, idle: int) -> bool:
    """Return whether further fixed-point iterations would not improve the solution."""
    if change <= _EPS or idle >= (_PATIENCE if best <= _CLOSE else _WAVES):
        return True
    ratio = change / previous
    return change <= _SURE and ratio < 1.0 and change * ratio <= _EPS * (1.0 - ratio)


@inlined
def fill_rates(address: int, params: Array, work: Array, more: Array, count: int) -> None:  # noqa: ARG001
    """Evaluate the vector field at the stages."""
    call(address, work[STAGE], params, work[RATE])


@inlined
def fill_tangent_rates(address: int, params: Array, work: Array, more: Array, count: int) -> None:  # noqa: ARG001
    """Evaluate the derivative of the vector field along the tangents of the stages."""
    call_slopes(address, work[STAGE], params, work[SEED], more, work[RATE])


@inlined
def fill_adjoint_rates(address: int, params: Array, work: Array, more: Array, count: int) -> None:
    """Evaluate the adjoint of the vector field for the covectors of the stages."""
    call_adjoint(address, work[STAGE], params, work[SEED], more)
    for i in range(count):
        work[RATE, i] = more[i]


def _solver(
    name: str, rates: Callable[..., None], base: int, table: int, out: int
) -> Callable[..., bool]:
    bound = bind_globals(solve, f"gauss_{name}", evaluate=rates, BASE=base, TABLE=table, OUT=out)
    return compiled(bound)


find_stages = _solver("stages", fill_rates, Y, MU, STAGE)
find_tangents = _solver("tangents", fill_tangent_rates, NEW, MU, SEED)
find_covectors = _solver("covectors", fill_adjoint_rates, NEW, TRANSPOSED, SEED)
