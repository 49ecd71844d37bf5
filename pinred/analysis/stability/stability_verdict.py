"""The verdict on a relative equilibrium: stable, unstable or undecided, and its reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, FrozenArrays
from ...kernels.kernel import Layout
from ...system.coordinates import ShapeSpace
from ...system.joints import BALL
from .linearised_flow import Linearisation, eigen, eigenvalue_errors, norm
from .second_variation import SecondVariation

Verdict: TypeAlias = Literal["stable", "unstable", "undecided"]
_SIGNIFICANT = 10.0  # growth rates above this multiple of their error count as unstable
_ROUND_OFF = 1e-14  # error of the matrix, relative to its norm
_NEAR_ZERO = 1e-4  # largest split of a double eigenvalue at zero, relative to the norm
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
        shape: Complex amplitudes of x along the frame of the shape, (m,), zero for joints that are
            not active.
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
            ẋ, by joint name, or by axis for a ball.
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
    linear: Linearisation, second: SecondVariation, layout: Layout, space: ShapeSpace
) -> Stability:
    """Decide stability from the linearised flow and the second variation.

    Args:
        linear: Linearised flow at the equilibrium.
        second: Second variation of the amended potential.
        layout: Layout of the kernel of the flow.
        space: Manifold of the shape.
    Returns:
        The verdict, its reasons, and the modes.
    """
    leaf, entries = linear.leaf, _shape_entries(linear, layout)
    on_leaf = leaf.restrict(linear.matrix)
    values, left_vectors, right = eigen(on_leaf)
    errors = eigenvalue_errors(left_vectors, right, _ROUND_OFF * norm(on_leaf))
    is_transverse = np.ones(len(values), dtype=bool)
    if second.dimension:
        # Each direction of the family adds a double eigenvalue at zero.  If its symmetries do not
        # commute, as rotations of a spherical rotor, fewer eigenvalues are zero.
        nearest = np.argsort(np.abs(values))[: 2 * second.dimension]
        is_transverse[nearest] = np.abs(values[nearest]) > _NEAR_ZERO * norm(on_leaf)
    values, errors = values[is_transverse], errors[is_transverse]
    left_vectors, right = left_vectors[:, is_transverse], right[:, is_transverse]
    growths = values.real
    is_significant = growths > _SIGNIFICANT * errors
    unstable, top = bool(is_significant.any()), None
    if len(growths):
        top = int(np.argmax(np.where(is_significant, growths, -np.inf) if unstable else growths))
    verdict: Verdict = "unstable" if unstable else "stable" if second.definite else "undecided"
    modes = tuple(
        _mode(value, error, leaf.embed(vector), entries, space.m)
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
            _damped_growth(linear, values, left_vectors, right, entries, space.names)
            if verdict == "undecided"
            else {}
        ),
    )


@dataclass(frozen=True, eq=False)
class _ShapeEntries(FrozenArrays):
    """The active rates among the entries z of the reduced state.

    Attributes:
        rates: Indices of the active rates, (a,).
        displacements: Map from δz to displacements along the frame of the shape, (a, k).
        momenta: Indices in z of the momenta of the active rates, (a,).
        base: Index in z of the first entry of the base.
    """

    rates: NDArray[np.intp]
    displacements: Array
    momenta: NDArray[np.intp]
    base: int


def _shape_entries(linear: Linearisation, layout: Layout) -> _ShapeEntries:
    leaf, active = linear.leaf, layout.active
    rates, momenta = [*active, *layout.ball_v], [*range(leaf.momenta.start, leaf.momenta.stop)]
    displacements = np.zeros((len(rates), len(linear.state)))
    displacements[: len(active), leaf.places] = np.eye(len(active))
    first = len(active)
    for k, entries in enumerate(leaf.quaternions):
        momenta += range(leaf.momenta.stop + 3 * k, leaf.momenta.stop + 3 * k + 3)
        E = BALL.rate_map(linear.state[entries])
        displacements[first : first + 3, entries] = 4.0 * E.T
        first += 3
    base = leaf.quaternions[-1].stop if leaf.quaternions else leaf.momenta.stop
    return _ShapeEntries(
        np.array(rates, dtype=np.intp), displacements, np.array(momenta, dtype=np.intp), base
    )


def _mode(
    value: complex,
    error: float,
    amplitudes: NDArray[np.complex128],
    entries: _ShapeEntries,
    count: int,
) -> Mode:
    """Return one mode, scaled so that its largest shape amplitude is 1.

    Args:
        value: Eigenvalue [1/s].
        error: Error of the eigenvalue [1/s].
        amplitudes: Eigenvector, (k,).
        entries: Active rates among the entries of the reduced state.
        count: Number of all rates.
    Returns:
        The mode.
    """
    shape, momentum = np.zeros((2, count), dtype=complex)
    displacements = entries.displacements @ amplitudes
    candidates = (
        displacements
        if np.abs(displacements).max(initial=0.0) > 1e-12 * np.abs(amplitudes).max()
        else amplitudes
    )
    scale = candidates[int(np.argmax(np.abs(candidates)))]
    amplitudes = amplitudes / scale
    shape[entries.rates] = displacements / scale
    momentum[entries.rates] = amplitudes[entries.momenta]
    base = amplitudes[entries.base :]
    return Mode(value.real, float(error), value.imag, shape, momentum, base.copy())


def _damped_growth(
    linear: Linearisation,
    values: NDArray[np.complex128],
    left: NDArray[np.complex128],
    right: NDArray[np.complex128],
    entries: _ShapeEntries,
    names: tuple[str, ...],
) -> dict[str, float]:
    """Compute the largest ∂Re λ/∂c for a damper −c ẋ at each active joint.

    The active joints are at rest, so their rates change by the map of displacements times δż.

    Args:
        linear: Linearised flow.
        values: Eigenvalues, (d,).
        left: Left eigenvectors, one per column.
        right: Right eigenvectors, one per column.
        entries: Active rates among the entries of the reduced state.
        names: Names of all rates.
    Returns:
        Largest derivative over all modes, by joint name [1/s per N m s/rad].
    """
    leaf, growth_by_joint = linear.leaf, {}
    for i, k in enumerate(entries.rates.tolist()):
        change = np.zeros_like(linear.matrix)
        change[entries.momenta[i]] = -entries.displacements[i] @ linear.matrix
        numerator = np.einsum("ij,ik,kj->j", left.conj(), leaf.restrict(change), right)
        eigenvalue_rates = numerator / np.einsum("ij,ij->j", left.conj(), right)
        growth_by_joint[names[k]] = (
            float(eigenvalue_rates.real.max(initial=-np.inf)) if len(values) else 0.0
        )
    return growth_by_joint
