"""Tables of Gauss–Legendre collocation with s stages, of order 2s, padded to whole vectors.

E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section II.1.3.
The step is written in terms of L_j = h b_j f(Y_j): Y_i = y + Σ_j μ_ij L_j, y₁ = y + Σ_j L_j, with
μ_ij = a_ij / b_j. The method is symplectic and preserves quadratic invariants if
μ_ij + μ_ji = 1. Here this holds for the floating-point numbers, too (M. Antoñana, J. Makazaga,
A. Murua, Reducing and monitoring round-off error propagation for symplectic implicit
Runge–Kutta schemes, Numer. Algorithms 76 (2017) 861–880).

The work rows of a step contain the tables. A stage row stores the value of entry i at stage j as
number i·lanes + j. Kernels that evaluate all stages at once use the same layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ...common.arrays import Array, FrozenArrays

MOST_STAGES = 8


def lanes_of(stages: int) -> int:
    """Return the number of SIMD lanes for a number of stages, including idle lanes."""
    return 4 if stages <= 4 else 8


@dataclass(frozen=True)
class Tables(FrozenArrays):
    """Coefficients of the method, padded with zeros to w SIMD lanes.

    Attributes:
        mu: Coefficients μ_ij, (w, w).
        b: Weights b_j of the stage rates in the step end, (w,).
        c: Nodes c_j, the stage times as fractions of the step, (w,).
        last: Weights for which Σ_j last_j L_j is h times the highest Legendre coefficient of ẏ,
            (w,).
        bary: Barycentric weights of c, (w,).
    """

    mu: Array
    b: Array
    c: Array
    last: Array
    bary: Array


@cache
def tables(stages: int) -> Tables:
    """Return the tables of the method with a number of stages."""
    x, weights = legendre.leggauss(stages)
    P = legendre.legvander(x, stages)  # P_k(x_i), (s, s + 1)
    # ∫ from −1 to x of P_k is (P_{k+1} − P_{k−1}) / (2k + 1), and x + 1 for k = 0.
    integrals = np.column_stack(
        [x + 1.0, *((P[:, k + 1] - P[:, k - 1]) / (2 * k + 1) for k in range(1, stages))]
    )
    degree = np.arange(stages)
    mu = 0.5 * integrals @ ((2 * degree + 1) * P[:, :stages]).T
    for i in range(stages):
        mu[i, i] = 0.5
        for j in range(i):
            # 1 − a is exact in floating point if a is at least ½, which holds for one of the two
            # entries.
            big, small = ((i, j), (j, i)) if mu[i, j] >= 0.5 else ((j, i), (i, j))
            mu[small] = 1.0 - mu[big]
    c, lanes = 0.5 * (x + 1.0), lanes_of(stages)
    gaps = c[:, None] - c[None, :] + np.eye(stages)
    padded_mu = np.zeros((lanes, lanes))
    padded_mu[:stages, :stages] = mu

    def padded(row: NDArray[np.floating[Any]]) -> Array:
        return np.concatenate([row, np.zeros(lanes - stages)])

    return Tables(
        mu=padded_mu,
        b=padded(0.5 * weights),
        c=padded(c),
        last=padded((2 * stages - 1) * P[:, stages - 1]),
        bary=padded(1.0 / gaps.prod(axis=1)),
    )


# Rows of `work` after the two state rows. L, OLD, SUB: stage increments L_j = h b_j f(Y_j) of this
# step, of the previous step, and of the shorter step to a report time. CARRY: compensation of the
# sum over all steps. CHANGE and BEST: see `refreshment`. SCALE: weights of the changes in their
# norm. INFO: largest change that may be round-off, and the contraction of an iteration. MU to
# BARY: tables of the method.
CARRY, NEXT_CARRY, STAGE, RATE, L, OLD, SUB, CHANGE, BEST, SCALE = range(2, 12)
MU, GUESS, WITHIN, B, C, LAST, BARY, INFO = range(12, 20)
ROWS = 20


def work_rows(stages: int, n: int, behind: int) -> Array:
    """Allocate the work rows of a step and store the tables of the method in them.

    Args:
        stages: Number of stages.
        n: Number of entries of the state.
        behind: Number of additional floats after the rows, as workspace.
    Returns:
        The rows, (ROWS + …, stride).
    """
    lanes = lanes_of(stages)
    stride = max((n + 1) * lanes, lanes * lanes)
    work = np.zeros((ROWS + -(-behind // stride), stride))
    method = tables(stages)
    work[MU, : lanes * lanes] = method.mu.T.ravel()
    for row, values in (
        (B, method.b), (C, method.c), (LAST, method.last), (BARY, method.bary),
    ):  # fmt: skip
        work[row, :lanes] = values
    return work
