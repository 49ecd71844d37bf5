"""The linearised reduced flow at a state: its matrix, eigenvalues, modes and their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...kernels.evaluate import evaluate
from ...kernels.state_jacobian import jacobian_of
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.sample import Sample
from .reduced_state import Leaf, leaf_of

_ROUND_OFF = 10.0  # error of the Jacobian, in units of machine epsilon times its norm


@checks_arguments
@dataclass(frozen=True, eq=False)
class Linearisation(FrozenArrays):
    """The linearised reduced flow δż = matrix δz. Arrays are read-only.

    Attributes:
        state: Reduced state z without cyclic angles and time, (k,).
        names: Names of the entries of z; with closed loops, π is the impetus.
        matrix: Exact Jacobian of the reduced flow, (k, k).
        eigenvalues: Eigenvalues on the leaf where the Casimirs are constant, (d,) [1/s], largest
            growth first.
        modes: Eigenvectors, (k, d), one per column.
        errors: Largest effect of round-off on each eigenvalue, (d,) [1/s].
        leaf: Tangent space of the leaf at the state.
    """

    state: Array
    names: tuple[str, ...]
    matrix: Array
    eigenvalues: NDArray[np.complex128]
    modes: NDArray[np.complex128]
    errors: Array
    leaf: Leaf

    def __str__(self) -> str:
        lines = ["growth [1/s]      frequency [rad/s]      (negative growth: decay)"]
        lines += [f"{value.real:+.6e}     {abs(value.imag):.6e}" for value in self.eigenvalues]
        return "\n".join(lines)


def linearised(flow: CompiledFlow, y: Array) -> Linearisation:
    """Linearise the flow at a reduced state y (size,)."""
    sample = flow.sample(0.0, y)
    leaf = leaf_of(flow.kernel, y, sample.x, _usual_rate(flow, sample))
    indices = leaf.indices
    if leaf.gauge is None:
        matrix = jacobian_of(flow.kernel, y, flow.parameters)[np.ix_(indices, indices)]
    else:
        at, parameters = y.copy(), np.ascontiguousarray(flow.parameters)
        rates = evaluate(flow.kernel.rate.address, parameters, y[None], len(y))[0]
        at[indices], shear = leaf.gauge.at_rest(sample.x, y[indices], rates[indices])
        matrix = jacobian_of(flow.kernel, at, flow.parameters)[np.ix_(indices, indices)]
        matrix = np.linalg.solve(shear, matrix @ shear)
    on_leaf = leaf.restrict(matrix)
    values, left, right = eigen(on_leaf)
    error = eigenvalue_errors(left, right, _ROUND_OFF * np.finfo(float).eps * norm(on_leaf))
    return Linearisation(y[indices], leaf.names, matrix, values, leaf.embed(right), error, leaf)


def _usual_rate(flow: CompiledFlow, sample: Sample) -> float:
    """Return the largest rate at a state [rad/s], at least 1 rad/s under gravity or forces."""
    kernel = flow.kernel
    angular_velocity = sample.xi[kernel.system.group.linear :]
    rate = max(float(np.abs(rates).max(initial=0.0)) for rates in (angular_velocity, sample.xdot))
    has_forces = bool(kernel.layout.gravity) or kernel.forces is not None
    return max(rate, 1.0) if has_forces or not rate else rate


def norm(matrix: Array) -> float:
    """Return the largest singular value of a matrix, or 0 for an empty matrix."""
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def eigen(matrix: Array) -> tuple[NDArray[np.complex128], ...]:
    """Return the eigenvalues (d,), largest real part first, and left and right eigenvectors.

    The eigenvectors are columns.
    """
    from scipy.linalg import eig

    if not matrix.size:
        empty = np.zeros((0, 0), dtype=complex)
        return np.zeros(0, dtype=complex), empty, empty
    values, left, right = eig(matrix, left=True, right=True)
    order = np.lexsort((-values.imag, np.abs(values.imag), -np.round(values.real, 12)))
    return values[order], left[:, order], right[:, order]


def eigenvalue_errors(
    left: NDArray[np.complex128], right: NDArray[np.complex128], change: float
) -> Array:
    """Bound the change of each eigenvalue under a perturbation of the matrix.

    The bound uses the condition numbers |y||x|/|yᴴx|. Eigenvalues of a
    defective pair move by ±√ε, so the bound is limited to this order.

    Args:
        left: Left eigenvectors y, one per column.
        right: Right eigenvectors x, one per column.
        change: Norm ε of the perturbation.
    Returns:
        Bounds of the changes, (d,).
    """
    if not right.size:
        return np.zeros(0)
    overlap = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    size = np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(change * size / overlap, np.sqrt(change) * 1e3 + change))
