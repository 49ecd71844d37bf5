"""Curvature of the mechanical connection: B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β], in body form.

Two further routes compute it, and the tests compare them with this one: CasADi expressions
(`_curvature` in reduction/tree/casadi_reduction.py), and machine code for many shapes
(`ConnectionCode.curvature` in kernels/connection/connection_code.py).
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..lie.group import Group


def compute_curvature(group: Group, A: Array, dA: Array) -> Array:
    """Compute the curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β].

    Args:
        group: Symmetry group.
        A: Local connection, (r, m).
        dA: Derivative ∂A, (r, m, m), with the derivative index last.
    Returns:
        (r, m, m), antisymmetric in α, β, with B[:, α, β] = B_αβ.
    """
    return np.swapaxes(dA, 1, 2) - dA - bracket_term(group, A)


def bracket_term(group: Group, A: Array) -> Array:
    """Compute the term [A_α, A_β] of the curvature, (r, m, m)."""
    brackets: Array = np.einsum("aij,jb->iab", group.ad(A.T), A)
    return brackets
