"""Newton's method for the stages of Gauss's methods, where fixed-point iteration is slow.

With the stage increments L of gauss_stages.py, an iteration solves ΔL − h (G ⊗ J) ΔL = h b f − L
with G = diag(b) μ. In the eigenvectors of G this splits into one system of n numbers per pair of
eigenvalues (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., section
IV.8). The Jacobian J is evaluated at the start of this step or of an earlier step. It is not exact,
so the iteration converges linearly and continues to round-off, like fixed-point iteration.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...common.arrays import Array, read_only
from ..stepping.compiling import compiled
from ..stepping.intrinsics import SEEDS, call
from ..stepping.linear_systems import factor, factor_complex, finite_jacobian, solve, solve_complex
from ..stepping.run_state import MOST_STAGES, Run, Y, first_not_finite
from .gauss_stages import (
    BEST,
    MU,
    NO_SOLUTION,
    RATE,
    ROWS,
    SCALE,
    STAGE,
    B,
    multiply,
    tables,
    work_rows,
)

_ENTRY = 2 + 4 * MOST_STAGES  # number of floats per pair: the eigenvalue and its two eigenvectors
# Indices of the factorisations for whole steps, and for shorter steps to report times.
MAIN, SUB = 0, 1

_MOST = 50  # largest number of Newton iterations per stage solve
_STALLED = 0.5  # ratio of successive changes above which the iteration has stalled
_SLOW = 0.1  # ratio of successive changes above which the Jacobian is recomputed
# Changes relative to the largest absolute value of the state: the change that counts as round-off,
# and the largest change at which a stalled iteration counts as converged.
_SMALL, _SLACK = 1e-13, 1e-6


@cache
def pairs(stages: int) -> Array:
    """Return eigenvalue, right and left eigenvector of G for one eigenvalue of each conjugate pair.

    Rows (p, 2 + 4 MOST_STAGES): the eigenvalue λ, then the right eigenvector v and the left
    eigenvector w, each stored as its real and imaginary parts. A pair contributes twice the real
    part of its term. For a real eigenvalue, v is halved, so that the same formula holds.
    """
    method = tables(stages)
    G = method.b[:stages, None] * method.mu[:stages, :stages]
    values, right_vectors = np.linalg.eig(G)
    left_vectors = np.linalg.inv(right_vectors)
    table = np.zeros(((stages + 1) // 2, _ENTRY))
    indices = [k for k in range(stages) if values[k].imag > -1e-12]
    for entry, k in zip(table, indices, strict=True):
        is_real = abs(values[k].imag) < 1e-12
        v, w = right_vectors[:, k] * (0.5 if is_real else 1.0), left_vectors[k]
        entry[:2] = values[k].real, 0.0 if is_real else values[k].imag
        for block, values_of_stages in enumerate((v.real, v.imag, w.real, w.imag)):
            entry[2 + block * MOST_STAGES : 2 + block * MOST_STAGES + stages] = values_of_stages
    return read_only(table)


def newton_rows(stages: int, n: int) -> Array:
    """Allocate the work rows for n entries of the state, with space for Newton's method."""
    wide, p = _wide(n), (stages + 1) // 2
    numbers = p * _ENTRY + (2 * SEEDS + 2) * wide + 2 * (p + n + 2 * n * p) * wide
    work = work_rows(stages, n, numbers)
    table = pairs(stages)
    work.reshape(-1)[ROWS * work.shape[1] :][: table.size] = table.ravel()
    return work


@compiled
def _wide(n: int) -> int:
    return (n + SEEDS - 1) // SEEDS * SEEDS


@compiled
def prepare(run: Run, params: Array, work: Array, which: int, h: float) -> bool:
    """Factorise the linear systems of a step of length h, with the Jacobian at the state in row Y.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        which: Factorisation to compute, MAIN or SUB.
        h: Length of the step [s].
    Returns:
        Whether all linear systems are regular.
    """
    n, stages = run.n, run.stages
    wide, p = _wide(n), (stages + 1) // 2
    behind = work.reshape(-1)[ROWS * work.shape[1] :]
    at = p * _ENTRY + 2 * wide
    seeds, slopes = behind[at : at + SEEDS * wide], behind[at + SEEDS * wide :][: SEEDS * wide]
    pivots, matrix = _systems(behind, n, p, which)
    finite_jacobian(run, work[Y], params, seeds, slopes, matrix, 0, n)
    run.evaluations += wide // SEEDS
    for k in range(p):
        a, b = behind[k * _ENTRY], behind[k * _ENTRY + 1]
        real, imag = n + 2 * n * k, 2 * n + 2 * n * k
        for i in range(n):
            for j in range(n):
                slope = -h * matrix[i, j]
                matrix[real + i, j], matrix[imag + i, j] = a * slope, b * slope
            matrix[real + i, i] += 1.0
        if b == 0.0:
            if not factor(matrix, real, n, pivots[k]):
                return False
        elif not factor_complex(matrix, real, imag, n, pivots[k]):
            return False
    return True


@compiled
def _systems(behind: Array, n: int, p: int, which: int) -> tuple[Array, Array]:
    """Return the pivots, (p, wide), and the rows of Jacobian and systems, (n + 2 n p, wide)."""
    wide = _wide(n)
    size = (p + n + 2 * n * p) * wide
    block = behind[p * _ENTRY + (2 * SEEDS + 2) * wide + which * size :][:size]
    return block[: p * wide].reshape(p, wide), block[p * wide :].reshape(n + 2 * n * p, wide)


@compiled
def refine(
    run: Run, params: Array, work: Array, row: int, which: int, fresh: bool, h: float
) -> int:
    """Solve for the stage increments in `row` by Newton's method from a first guess.

    SCALE must contain the reciprocal of the largest absolute value (see `scale_by_largest`).

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        row: Row of the stage increments L.
        which: Factorisation to use, MAIN or SUB.
        fresh: Whether the factorisation was computed at this step. If not, it is recomputed when
            the iteration converges slowly.
        h: Length of the step [s].
    Returns:
        The number of iterations, or NO_SOLUTION.
    """
    n, lanes, stages = run.n, run.lanes, run.stages
    wide, p = _wide(n), (stages + 1) // 2
    behind = work.reshape(-1)[ROWS * work.shape[1] :]
    b, c = behind[p * _ENTRY :][:wide], behind[p * _ENTRY + wide :][:wide]
    pivots, matrix = _systems(behind, n, p, which)
    scale, previous, stalls, renewed = work[SCALE, 0], np.inf, 0, False
    for iteration in range(1, _MOST + 1):
        multiply(work, STAGE, Y, MU, row, n, lanes)
        call(run.address, work[STAGE], params, work[RATE])
        run.evaluations += stages
        for i in range(n):
            for j in range(stages):
                at = i * lanes + j
                work[RATE, at] = h * work[B, j] * work[RATE, at] - work[row, at]
                work[BEST, at] = 0.0
        if first_not_finite(work[RATE], n * lanes) >= 0:
            return NO_SOLUTION
        for k in range(p):
            table = behind[k * _ENTRY : (k + 1) * _ENTRY]
            v, vi = table[2:], table[2 + MOST_STAGES :]
            w, wi = table[2 + 2 * MOST_STAGES :], table[2 + 3 * MOST_STAGES :]
            for i in range(n):
                x = y = 0.0
                for j in range(stages):
                    x += w[j] * work[RATE, i * lanes + j]
                    y += wi[j] * work[RATE, i * lanes + j]
                b[i], c[i] = x, y
            if table[1] == 0.0:
                solve(matrix, n + 2 * n * k, n, pivots[k], b)
            else:
                solve_complex(matrix, n + 2 * n * k, 2 * n + 2 * n * k, n, pivots[k], b, c)
            for i in range(n):
                for j in range(stages):
                    work[BEST, i * lanes + j] += 2.0 * (v[j] * b[i] - vi[j] * c[i])
        total = 0.0
        for i in range(n):
            for j in range(stages):
                change = work[BEST, i * lanes + j]
                work[row, i * lanes + j] += change
                total += change * change
        size = np.sqrt(total) * scale
        if not size < np.inf:
            return NO_SOLUTION
        if size == 0.0:
            return iteration
        if size >= _STALLED * previous:
            stalls += 1
            if size <= _SMALL or (stalls > 1 and size <= _SLACK):
                return iteration
        if not (fresh or renewed) and size > _SMALL and size > _SLOW * previous:
            if not prepare(run, params, work, which, h):
                return NO_SOLUTION
            renewed, stalls = True, 0
        previous = size
    return NO_SOLUTION
