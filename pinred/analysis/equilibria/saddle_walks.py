"""Walks from critical points to neighbours of the next lower and the next higher index.

Each critical point starts two walks along every principal direction of its Hessian. A walk along a
descending direction searches for a point with one negative curvature less, a walk along an
ascending direction for a point with one more. The steps are −Q |Λ|⁻¹ Qᵀ g, with the opposite sign
for the k lowest curvatures, so that critical points of index k attract. Walks reach points whose
basin random starts miss.
Source: J. Yin, L. Zhang, P. Zhang, "High-index optimization-based shrinking dimer method for
finding high-index saddle points", SIAM J. Sci. Comput. 41, 2019.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from .amended_energy import AmendedEnergy, Energies
from .points import Points, embedded, joined
from .search import iterated
from .shape_symmetries import Symmetry

_AWAY = 0.1  # first step of a walk [rad | m]
_SAME = 1e-9  # largest distance of equal starts
_FLAT = 1e-9  # smallest curvature used, as a fraction of the largest; smaller ones are replaced


def walks_from(
    points: Points, e: Energies, symmetries: Sequence[Symmetry], angles: NDArray[np.bool_]
) -> tuple[Points, NDArray[np.intp]]:
    """Return starts next to critical points, and the index that the walk from each start targets.

    Args:
        points: Critical points.
        e: Their energies.
        symmetries: Symmetries; of two starts that are images of each other, one is omitted.
        angles: Which active joints are periodic, (ma,).
    Returns:
        The starts, and the target number of negative curvatures of each, (N,).
    """
    values, vectors = np.linalg.eigh(e.hessian)
    index = (values < 0.0).sum(axis=1)
    starts, wanted = [], []
    for j in range(values.shape[1]):
        ahead = points.moved(_AWAY * vectors[:, :, j])
        behind = points.moved(-_AWAY * vectors[:, :, j])
        is_image = np.zeros(len(points), dtype=bool)
        for symmetry in symmetries:
            difference = embedded(symmetry(behind), angles) - embedded(ahead, angles)
            is_image |= np.abs(difference).max(axis=1, initial=0.0) <= _SAME
        starts += [ahead, behind[~is_image]]
        aim = index + np.where(values[:, j] < 0.0, -1, 1)
        wanted += [aim, aim[~is_image]]
    return joined(starts), np.concatenate(wanted).astype(np.intp)


def walk(
    energy: AmendedEnergy, starts: Points, wanted: NDArray[np.intp], J: float
) -> tuple[Points, Energies]:
    """Walk to critical points with given numbers of negative curvatures.

    Args:
        energy: The amended potential.
        starts: Starting points.
        wanted: Target number of negative curvatures, (N,).
        J: Momentum.
    Returns:
        The critical points to which walks converged, and their energies.
    """
    return iterated(energy, starts, J, lambda e, running: _step(e, wanted[running]))


def _step(e: Energies, wanted: NDArray[np.intp]) -> Array:
    """Return the steps that ascend along the `wanted` lowest curvatures, and descend otherwise."""
    values, vectors = np.linalg.eigh(e.hessian)
    components = (np.swapaxes(vectors, 1, 2) @ e.gradient[..., None])[..., 0]
    size = np.abs(values)
    floor = _FLAT * size.max(axis=1, keepdims=True)
    components = components / np.maximum(size, np.where(floor > 0.0, floor, 1.0))
    ascends = np.arange(values.shape[1]) < wanted[:, None]
    components = np.where(ascends, components, -components)
    return np.asarray((vectors @ components[..., None])[..., 0])
