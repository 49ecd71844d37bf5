"""The Jacobian of a kernel and small linear systems, for Newton's method.

A matrix occupies consecutive rows of an array. LAPACK is not used, because for matrices of this
size its threads spend more time on synchronisation than on the solution.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from .compiling import compiled
from .intrinsics import SEEDS, call, call_tangent
from .run_state import Run

_STEP = 1e-5  # step of central differences, relative to the size of an entry


@compiled
def jacobian(
    tangent: int,
    y: Array,
    params: Array,
    seeds: Array,
    slopes: Array,
    matrix: Array,
    first: int,
    n: int,
) -> None:
    """Compute the Jacobian ∂ẏ/∂y of a kernel in n rows of an array.

    Args:
        tangent: Address of the tangent kernel.
        y: State, (n,).
        params: Parameters, (p,).
        seeds: Contiguous workspace for n SEEDS numbers.
        slopes: Contiguous workspace for n SEEDS numbers.
        matrix: Array of the rows. A row has at least n numbers, rounded up to a multiple of SEEDS.
        first: First row to fill.
        n: Number of entries of the state.
    """
    directions, derivatives = seeds.reshape(-1), slopes.reshape(-1)
    for start in range(0, n, SEEDS):
        directions[: n * SEEDS] = 0.0
        for j in range(min(SEEDS, n - start)):
            directions[(start + j) * SEEDS + j] = 1.0
        call_tangent(tangent, y, params, directions, derivatives)
        for i in range(n):
            for j in range(SEEDS):
                matrix[first + i, start + j] = derivatives[i * SEEDS + j]


@compiled
def finite_jacobian(
    run: Run,
    y: Array,
    params: Array,
    seeds: Array,
    slopes: Array,
    matrix: Array,
    first: int,
    n: int,
) -> None:
    """Compute a Jacobian as `jacobian` does, with differences where derivatives are not finite.

    Derivatives may overflow where values do not: 1/cosh(1e3) is zero, its derivative is NaN.

    Args:
        run: Registers of the run.
        y: State, (n,).
        params: Parameters, (p,).
        seeds: Contiguous workspace for n SEEDS numbers.
        slopes: Contiguous workspace for n SEEDS numbers.
        matrix: Array of the rows; see `jacobian`.
        first: First row to fill.
        n: Number of entries of the state.
    """
    jacobian(run.tangent, y, params, seeds, slopes, matrix, first, n)
    is_finite = True
    for i in range(n):
        for j in range(n):
            is_finite = is_finite and abs(matrix[first + i, j]) < np.inf
    if is_finite:
        return
    moved, rates = seeds.reshape(-1)[:n], slopes.reshape(-1)
    before, after = rates[:n], rates[n : 2 * n]
    for j in range(n):
        for i in range(n):
            moved[i] = y[i]
        step = _STEP * (abs(y[j]) + run.atol / run.rtol)
        moved[j] = y[j] - step
        call(run.address, moved, params, before)
        moved[j] = y[j] + step
        call(run.address, moved, params, after)
        for i in range(n):
            if not abs(matrix[first + i, j]) < np.inf:
                matrix[first + i, j] = (after[i] - before[i]) / (2.0 * step)
    run.evaluations += 2 * n


@compiled
def factor(matrix: Array, first: int, n: int, pivots: Array) -> bool:
    """Factorise a matrix in place by Gaussian elimination with row pivoting.

    Args:
        matrix: Array of the rows.
        first: First row.
        n: Size of the matrix.
        pivots: Pivots, (n,), output.
    Returns:
        Whether the matrix is regular.
    """
    for k in range(n):
        best, size = k, abs(matrix[first + k, k])
        for i in range(k + 1, n):
            if abs(matrix[first + i, k]) > size:
                best, size = i, abs(matrix[first + i, k])
        if not 0.0 < size < np.inf:
            return False
        pivots[k] = best
        top, other = matrix[first + k], matrix[first + best]
        if best != k:
            for j in range(n):
                top[j], other[j] = other[j], top[j]
        inverse = 1.0 / top[k]
        for i in range(k + 1, n):
            row = matrix[first + i]
            multiplier = row[k] * inverse
            row[k] = multiplier
            if multiplier != 0.0:
                for j in range(k + 1, n):
                    row[j] -= multiplier * top[j]
    return True


@compiled
def solve(matrix: Array, first: int, n: int, pivots: Array, b: Array) -> None:
    """Replace b (n,) by the solution of a system factored by `factor`.

    Args:
        matrix: Array of the rows.
        first: First row of the factors.
        n: Size of the matrix.
        pivots: Pivots of the factorisation, (n,).
        b: Right-hand side, changed in place.
    """
    for k in range(n):
        best = int(pivots[k])
        if best != k:
            b[k], b[best] = b[best], b[k]
    for i in range(n):
        row, total = matrix[first + i], b[i]
        for j in range(i):
            total -= row[j] * b[j]
        b[i] = total
    for i in range(n - 1, -1, -1):
        row, total = matrix[first + i], b[i]
        for j in range(i + 1, n):
            total -= row[j] * b[j]
        b[i] = total / row[i]


@compiled
def factor_complex(matrix: Array, real: int, imag: int, n: int, pivots: Array) -> bool:
    """Factorise a complex matrix in place, like `factor`.

    Args:
        matrix: Array of the rows.
        real: First row of the real part.
        imag: First row of the imaginary part.
        n: Size of the matrix.
        pivots: Pivots, (n,), output.
    Returns:
        Whether the matrix is regular.
    """
    for k in range(n):
        best, size = k, -1.0
        for i in range(k, n):
            square = matrix[real + i, k] ** 2 + matrix[imag + i, k] ** 2
            if square > size:
                best, size = i, square
        if not 0.0 < size < np.inf:
            return False
        pivots[k] = best
        top_r, top_i = matrix[real + k], matrix[imag + k]
        if best != k:
            other_r, other_i = matrix[real + best], matrix[imag + best]
            for j in range(n):
                top_r[j], other_r[j] = other_r[j], top_r[j]
                top_i[j], other_i[j] = other_i[j], top_i[j]
        inverse_r, inverse_i = top_r[k] / size, -top_i[k] / size
        for i in range(k + 1, n):
            row_r, row_i = matrix[real + i], matrix[imag + i]
            r = row_r[k] * inverse_r - row_i[k] * inverse_i
            c = row_r[k] * inverse_i + row_i[k] * inverse_r
            row_r[k], row_i[k] = r, c
            if r != 0.0 or c != 0.0:
                for j in range(k + 1, n):
                    row_r[j] -= r * top_r[j] - c * top_i[j]
                    row_i[j] -= r * top_i[j] + c * top_r[j]
    return True


@compiled
def solve_complex(
    matrix: Array, real: int, imag: int, n: int, pivots: Array, b: Array, c: Array
) -> None:
    """Replace b + i c (n,) by the solution of a system factored by `factor_complex`.

    Args:
        matrix: Array of the rows.
        real: First row of the real part.
        imag: First row of the imaginary part.
        n: Size of the matrix.
        pivots: Pivots of the factorisation, (n,).
        b: Real part of the right-hand side, changed in place.
        c: Imaginary part of the right-hand side, changed in place.
    """
    for k in range(n):
        best = int(pivots[k])
        if best != k:
            b[k], b[best] = b[best], b[k]
            c[k], c[best] = c[best], c[k]
    for i in range(n):
        row_r, row_i, r, s = matrix[real + i], matrix[imag + i], b[i], c[i]
        for j in range(i):
            r -= row_r[j] * b[j] - row_i[j] * c[j]
            s -= row_r[j] * c[j] + row_i[j] * b[j]
        b[i], c[i] = r, s
    for i in range(n - 1, -1, -1):
        row_r, row_i, r, s = matrix[real + i], matrix[imag + i], b[i], c[i]
        for j in range(i + 1, n):
            r -= row_r[j] * b[j] - row_i[j] * c[j]
            s -= row_r[j] * c[j] + row_i[j] * b[j]
        x, y = row_r[i], row_i[i]
        square = x * x + y * y
        b[i], c[i] = (r * x + s * y) / square, (s * x - r * y) / square
