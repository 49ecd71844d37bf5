"""The verdict on a relative equilibrium: stable, unstable or undecided, and its reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, FrozenArrays
from .linearisation import Linearisation, eigen, eigenvalue_errors, norm
from .second_variation import SecondVariation

Verdict: TypeAlias = Literal["stable", "unstable", "undecided"]
_SIGNIFICANT = 10.0  # growth rates above this multiple of their error count as unstable
_ROUND_OFF = 1e-14  # error of the matrix, relative to its norm
_NO_GROWTH = 1e-9  # largest growth of an undamped oscillation, relative to the norm


@dataclass(frozen=True, eq=False)
class Mode(FrozenArrays):
    """A mode δz = Re(amplitude e^{λt}) of the linearised reduced flow. Arrays are read-only.

    Amplitudes are scaled so that the largest shape amplitude is 1; if all shape
    amplitudes are zero, the largest entry is 1.

    Attributes:
        growth: Re λ [1/s].
        error: Error of λ [1/s].
        frequency: Im λ [rad/s].
        shape: Complex amplitudes of x, (m,), zero for joints that are not active.
        momentum: Complex amplitudes of π, (m,), zero for joints that are not active.
        base: Complex amplitudes of the base entries of the reduced state.
    """

    growth: float
    error: float
    frequency: float
    shape: NDArray[np.complex128]
    momentum: NDArray[np.complex128]
    base: NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Stability:
    """The stability of a relative equilibrium.

    Attributes:
        verdict: "stable" (definite second variation), "unstable" (a growth rate well above its
            error), or "undecided".
        growth: Largest Re λ [1/s]; zero if none is significant.
        growth_error: Error of the eigenvalue with the largest growth [1/s].
        frequencies: Frequencies of undamped oscillations, (k,) [rad/s], sorted.
        modes: Modes, one of each conjugate pair, largest growth first.
        index: Number of negative curvatures of the amended potential.
        dimension: Dimension of the family of equilibria.
        growing: Number of growing modes with real λ.
        damped_growth: For an undecided verdict, the largest ∂Re λ/∂c over all modes for a damper −c
            ẋ, by joint name.
    """

    verdict: Verdict
    growth: float
    growth_error: float
    frequencies: Array
    modes: tuple[Mode, ...]
    index: int
    dimension: int
    growing: int
    damped_growth: Mapping[str, float]


def assess_stability(
    linear: Linearisation, second: SecondVariation, active: tuple[int, ...], joints: tuple[str, ...]
) -> Stability:
    """Decide stability from the linearised flow and the second variation.

    Args:
        linear: Linearised flow at the equilibrium.
        second: Second variation of the amended potential.
        active: Indices of the active joints.
        joints: Names of all joints.
    Returns:
        The verdict, its reasons, and the modes.
    """
    leaf = linear.leaf
    on_leaf = leaf.restrict(linear.matrix)
    values, left, right = eigen(on_leaf)
    errors = eigenvalue_errors(left, right, _ROUND_OFF * norm(on_leaf))
    is_transverse = np.ones(len(values), dtype=bool)
    if second.dimension:  # Each direction of the family adds a double eigenvalue at zero.
        is_transverse[np.argsort(np.abs(values))[: 2 * second.dimension]] = False
    values, errors = values[is_transverse], errors[is_transverse]
    left, right = left[:, is_transverse], right[:, is_transverse]
    growths = values.real
    is_significant = growths > _SIGNIFICANT * errors
    unstable, top = bool(is_significant.any()), None
    if len(growths):
        top = int(np.argmax(np.where(is_significant, growths, -np.inf) if unstable else growths))
    verdict: Verdict = "unstable" if unstable else "stable" if second.definite else "undecided"
    modes = tuple(
        _mode(value, error, leaf.embed(vector), linear, active, len(joints))
        for value, error, vector in zip(values, errors, right.T, strict=True)
        if value.imag > 0.0 or (value.imag == 0.0 and value.real >= 0.0)
    )
    is_undamped = (values.imag > 0.0) & (
        np.abs(growths) <= _SIGNIFICANT * np.maximum(errors, _NO_GROWTH * norm(on_leaf))
    )
    return Stability(
        verdict=verdict,
        growth=float(growths[top]) if top is not None and is_significant[top] else 0.0,
        growth_error=float(errors[top]) if top is not None else 0.0,
        frequencies=np.sort(values.imag[is_undamped]),
        modes=modes,
        index=second.index,
        dimension=second.dimension,
        growing=int((is_significant & (values.imag == 0.0)).sum()),
        damped_growth=(
            _damped_growth(linear, values, left, right, active, joints)
            if verdict == "undecided"
            else {}
        ),
    )


def _mode(
    value: complex,
    error: float,
    amplitudes: NDArray[np.complex128],
    linear: Linearisation,
    active: tuple[int, ...],
    count: int,
) -> Mode:
    """Return one mode, scaled so that its largest shape amplitude is 1.

    Args:
        value: Eigenvalue [1/s].
        error: Error of the eigenvalue [1/s].
        amplitudes: Eigenvector, (k,).
        linear: Linearised flow.
        active: Indices of the active joints.
        count: Number of all joints.
    Returns:
        The mode.
    """
    shape, momentum = np.zeros((2, count), dtype=complex)
    shape_entries = amplitudes[linear.leaf.places]
    candidates = (
        shape_entries
        if np.abs(shape_entries).max(initial=0.0) > 1e-12 * np.abs(amplitudes).max()
        else amplitudes
    )
    scale = candidates[int(np.argmax(np.abs(candidates)))]
    amplitudes = amplitudes / scale
    shape[list(active)] = amplitudes[linear.leaf.places]
    momentum[list(active)] = amplitudes[linear.leaf.momenta]
    base = amplitudes[linear.leaf.momenta.stop :]
    return Mode(value.real, float(error), value.imag, shape, momentum, base.copy())


def _damped_growth(
    linear: Linearisation,
    values: NDArray[np.complex128],
    left: NDArray[np.complex128],
    right: NDArray[np.complex128],
    active: tuple[int, ...],
    joints: tuple[str, ...],
) -> dict[str, float]:
    """Compute the largest ∂Re λ/∂c for a damper −c ẋ at each active joint.

    Args:
        linear: Linearised flow.
        values: Eigenvalues, (d,).
        left: Left eigenvectors, one per column.
        right: Right eigenvectors, one per column.
        active: Indices of the active joints.
        joints: Names of all joints.
    Returns:
        Largest derivative over all modes, by joint name [1/s per N m s/rad].
    """
    leaf, growth_by_joint = linear.leaf, {}
    for i, k in enumerate(active):
        change = np.zeros_like(linear.matrix)
        change[leaf.momenta.start + i] = -linear.matrix[leaf.places.start + i]
        numerator = np.einsum("ij,ik,kj->j", left.conj(), leaf.restrict(change), right)
        eigenvalue_rates = numerator / np.einsum("ij,ij->j", left.conj(), right)
        growth_by_joint[joints[k]] = (
            float(eigenvalue_rates.real.max(initial=-np.inf)) if len(values) else 0.0
        )
    return growth_by_joint
