"""The verdict on a relative equilibrium: stable, unstable, or undecided, with what decides it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, freeze
from .linearised import Linearisation, eigen, eigenvalue_errors, norm
from .second_variation import SecondVariation

Verdict: TypeAlias = Literal["stable", "unstable", "undecided"]
_SURE = 10.0  # times its error, from where on a growth is one
_ROUND_OFF = 1e-14  # of the matrix's norm
_NO_GROWTH = 1e-9  # of the matrix's norm; swings that grow by less are pure


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode δz = Re(amplitude e^{λt}) of the linearised reduced flow.

    growth: Re λ [1/s], error: of it.  frequency: Im λ [rad/s].  shape, momentum: (m,) complex
    amplitudes of x and π of the joints, zero of those that do not swing.  base: of the base's own
    entries of the reduced state.  Its largest shape amplitude, or else the largest, is 1.
    """

    growth: float
    error: float
    frequency: float
    shape: NDArray[np.complex128]
    momentum: NDArray[np.complex128]
    base: NDArray[np.complex128]

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Stability:
    """The stability of a relative equilibrium.

    verdict: "stable" (definite second variation), "unstable" (a growth beyond its error), or
    "undecided".  growth, growth_error: the largest Re λ [1/s].  frequencies: (k,) of pure swings,
    sorted [rad/s].  modes: one of each pair, largest growth first.  index: negative curvatures of
    the amended potential.  growing: number of real growing modes.  damped_growth: of an undecided
    one, the growth that each joint's damper brings, per damping coefficient, largest of all modes.
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


def judge(
    linear: Linearisation, second: SecondVariation, active: tuple[int, ...], joints: tuple[str, ...]
) -> Stability:
    """Return the stability that linearised flow and second variation show.

    active: indices of the joints in the reduced state.  joints: names of all.
    """
    leaf = linear.leaf
    on_leaf = leaf.restricted(linear.matrix)
    values, left, right = eigen(on_leaf)
    errors = eigenvalue_errors(left, right, _ROUND_OFF * norm(on_leaf))
    kept = np.ones(len(values), dtype=bool)
    if second.dimension:  # of each family direction a double zero
        kept[np.argsort(np.abs(values))[: 2 * second.dimension]] = False
    values, errors = values[kept], errors[kept]
    left, right = left[:, kept], right[:, kept]
    growths = values.real
    sure = growths > _SURE * errors
    top = int(np.argmax(np.where(sure, growths, -np.inf))) if sure.any() else None
    if top is None and len(growths):
        top = int(np.argmax(growths))
    unstable = bool(sure.any())
    verdict: Verdict = "unstable" if unstable else "stable" if second.definite else "undecided"
    modes = tuple(
        _mode(value, error, leaf.outward(vector), linear, active, len(joints))
        for value, error, vector in zip(values, errors, right.T, strict=True)
        if value.imag > 0.0 or (value.imag == 0.0 and value.real >= 0.0)
    )
    swings = (values.imag > 0.0) & (
        np.abs(growths) <= _SURE * np.maximum(errors, _NO_GROWTH * norm(on_leaf))
    )
    return Stability(
        verdict=verdict,
        growth=float(growths[top]) if top is not None and sure[top] else 0.0,
        growth_error=float(errors[top]) if top is not None else 0.0,
        frequencies=np.sort(values.imag[swings]),
        modes=modes,
        index=second.index,
        dimension=second.dimension,
        growing=int((sure & (values.imag == 0.0)).sum()),
        damped_growth=(
            _damped(linear, values, left, right, active, joints) if verdict == "undecided" else {}
        ),
    )


def _mode(
    value: complex,
    error: float,
    vector: NDArray[np.complex128],
    linear: Linearisation,
    active: tuple[int, ...],
    count: int,
) -> Mode:
    shape, momentum = np.zeros((2, count), dtype=complex)
    places = vector[linear.leaf.places]
    whole = places if np.abs(places).max(initial=0.0) > 1e-12 * np.abs(vector).max() else vector
    size = whole[int(np.argmax(np.abs(whole)))]
    vector = vector / size
    shape[list(active)] = vector[linear.leaf.places]
    momentum[list(active)] = vector[linear.leaf.momenta]
    base = vector[linear.leaf.momenta.stop :]
    return Mode(value.real, float(error), value.imag, shape, momentum, base.copy())


def _damped(
    linear: Linearisation,
    values: NDArray[np.complex128],
    left: NDArray[np.complex128],
    right: NDArray[np.complex128],
    active: tuple[int, ...],
    joints: tuple[str, ...],
) -> dict[str, float]:
    """Return the largest ∂Re λ/∂c by the coefficient c of a damper −c ẋ at each active joint."""
    leaf, out = linear.leaf, {}
    for i, k in enumerate(active):
        change = np.zeros_like(linear.matrix)
        change[leaf.momenta.start + i] = -linear.matrix[leaf.places.start + i]
        moved = np.einsum("ij,ik,kj->j", left.conj(), leaf.restricted(change), right)
        rate = moved / np.einsum("ij,ij->j", left.conj(), right)
        out[joints[k]] = float(rate.real.max(initial=-np.inf)) if len(values) else 0.0
    return out
