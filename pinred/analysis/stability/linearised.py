"""The linearised reduced flow at a state: its matrix, eigenvalues, modes, and their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, freeze
from ...kernels.derived_code import jacobian_of
from ...simulation.compiled.compiled_flow import CompiledFlow
from .reduced_state import Leaf, leaf_of

_ROUND_OFF = 10.0  # times eps, of the matrix's norm; the error of its entries


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The linearised reduced flow δż = matrix δz; arrays are read-only.

    state: (k,) z, the reduced state without cyclic angles and time.  names: of its entries.
    matrix: (k, k), the exact Jacobian.  eigenvalues: (d,) on the leaf where the Casimirs are
    constant, largest growth first.  modes: (k, d) their eigenvectors, in columns.  errors: (d,) how
    far round-off may move each eigenvalue.
    """

    state: Array
    names: tuple[str, ...]
    matrix: Array
    eigenvalues: NDArray[np.complex128]
    modes: NDArray[np.complex128]
    errors: Array
    leaf: Leaf

    def __post_init__(self) -> None:
        freeze(self)

    def __str__(self) -> str:
        lines = ["growth [1/s]      frequency [rad/s]"]
        lines += [f"{value.real:+.6e}     {abs(value.imag):.6e}" for value in self.eigenvalues]
        return "\n".join(lines)


def linearised(flow: CompiledFlow, y: Array) -> Linearisation:
    """Return the linearised flow at a reduced state y (size,)."""
    matrix = jacobian_of(flow.kernel, y, flow.parameters)
    leaf = leaf_of(flow.kernel, y, _usual_rate(flow, y))
    kept = leaf.kept
    matrix = matrix[np.ix_(kept, kept)]
    on_leaf = leaf.restricted(matrix)
    values, left, right = eigen(on_leaf)
    error = eigenvalue_errors(left, right, _ROUND_OFF * np.finfo(float).eps * norm(on_leaf))
    return Linearisation(y[kept], leaf.names, matrix, values, leaf.outward(right), error, leaf)


def _usual_rate(flow: CompiledFlow, y: Array) -> float:
    """Return the largest rate at a state [rad/s]; where something acts, 1 rad/s at least."""
    kernel, sample = flow.kernel, flow.sample(0.0, y)
    turning = sample.xi[kernel.system.group.linear :]
    rate = max(float(np.abs(part).max(initial=0.0)) for part in (turning, sample.xdot))
    acts = bool(kernel.layout.gravity) or kernel.forces is not None
    return max(rate, 1.0) if acts or not rate else rate


def norm(matrix: Array) -> float:
    """Return the largest singular value, zero of an empty matrix."""
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def eigen(matrix: Array) -> tuple[NDArray[np.complex128], ...]:
    """Return eigenvalues (d,), largest real part first, and left and right vectors, in columns."""
    from scipy.linalg import eig

    if not matrix.size:
        none = np.zeros((0, 0), dtype=complex)
        return np.zeros(0, dtype=complex), none, none
    values, left, right = eig(matrix, left=True, right=True)
    order = np.lexsort((-values.imag, np.abs(values.imag), -np.round(values.real, 12)))
    return values[order], left[:, order], right[:, order]


def eigenvalue_errors(
    left: NDArray[np.complex128], right: NDArray[np.complex128], change: float
) -> Array:
    """Return how far a change of the matrix of this norm may move each eigenvalue.

    By their condition numbers |y||x|/|yᴴx|; of a defective pair, ±√ε, the two are as large.
    """
    if not right.size:
        return np.zeros(0)
    overlap = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    size = np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(change * size / overlap, np.sqrt(change) * 1e3 + change))
