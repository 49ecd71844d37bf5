"""Curvature of the mechanical connection in body form.

    B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ

∂_α is the derivative along the frame of the shape, and c are the frame's structure constants.
Without balls they are zero, and ∂_α = ∂/∂x_α.

Two further routes compute it, and the tests compare them with this one: CasADi expressions
(`_curvature` in reduction/tree/casadi_reduction.py), and machine code for many shapes
(`ConnectionCode.curvature` in kernels/connection/connection_code.py).
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..lie.group import Group
from ..system.system import System


def compute_curvature(system: System, A: Array, dA: Array) -> Array:
    """Compute the curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ.

    Args:
        system: The system.
        A: Local connection, (r, m).
        dA: Derivative ∂A along the frame of the shape, (r, m, m), with the derivative index last.
    Returns:
        (r, m, m), antisymmetric in α, β, with B[:, α, β] = B_αβ.
    """
    B: Array = np.swapaxes(dA, 1, 2) - dA - bracket_term(system.group, A)
    return B - frame_term(system, A) if system.space.balls else B


def frame_term(system: System, A: Array) -> Array:
    """Compute the term c^γ_αβ A_γ of the curvature, (r, m, m)."""
    return np.asarray(np.einsum("ig,gab->iab", A, system.space.structure))


def bracket_term(group: Group, A: Array) -> Array:
    """Compute the term [A_α, A_β] of the curvature, (r, m, m)."""
    brackets: Array = np.einsum("aij,jb->iab", group.ad(A.T), A)
    return brackets
