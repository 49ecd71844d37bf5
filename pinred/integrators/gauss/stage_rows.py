"""The work rows of a step of Gauss–Legendre collocation.

A stage row stores the value of entry i at stage j as number i·lanes + j. Kernels that evaluate
all stages at once use the same layout.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from .tables import lanes_of, tables

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
