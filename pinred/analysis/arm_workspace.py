"""Workspace of a free-floating arm: which distances from the centre of mass the hand reaches.

At zero momentum the centre of mass stands still, and the distance of the hand from it depends on
the shape alone.  Distances at which some shape is dynamically singular are path-dependent: whether
the hand gets through there depends on how it came.  Source: E. Papadopoulos, S. Dubowsky, "Dynamic
singularities in free-floating space manipulators", J. Dyn. Sys., Meas., Control 115 (1993).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array, freeze

_ON_A_LINE = 41  # shapes
_CLIMBED = 6  # of the lines' ends and shapes, from where the extremes of distance are looked for
_GAP = 4.0  # steps between samples that a range may jump


@dataclass(frozen=True)
class Workspace:
    """Distances of the hand from the centre of mass, at zero momentum the one fixed point.

    reach: (2,) least and greatest [m].  dependent: (K, 2) ranges in which a shape is singular, so
    that whether the hand gets through depends on the path.  independent: (L, 2) the others.
    """

    reach: Array
    dependent: Array
    independent: Array

    def __post_init__(self) -> None:
        freeze(self)


def workspace_of(
    radius: Callable[[Array], Array],
    slope: Callable[[Array], Array],
    determinants: Callable[[Array], Array],
    bounds: Array,
    samples: int,
    seed: int,
) -> Workspace:
    """Return the workspace within bounds (m, 2).

    radius, determinants: of shapes (N, m), (N,).  slope: of the radius at a shape (m,), (m,).
    samples: of each of one or two joints on a grid; lines through the box of more, of random
    directions, on which the determinant is followed.
    """
    paths = _grid(bounds, samples) if len(bounds) < 3 else _lines(bounds, samples, seed)
    shapes = paths.reshape(-1, len(bounds))
    r, det = (f(shapes).reshape(paths.shape[:-1]) for f in (radius, determinants))
    cross = np.sign(det[:, :-1]) != np.sign(det[:, 1:])
    a, b = det[:, :-1][cross], det[:, 1:][cross]
    p, q = r[:, :-1][cross], r[:, 1:][cross]
    singular = np.sort(p + a / (a - b) * (q - p))
    order = np.argsort(r.ravel())
    reach = np.array([
        _extreme(sign, shapes[some], radius, slope, bounds)
        for sign, some in ((1.0, order[:_CLIMBED]), (-1.0, order[-_CLIMBED:]))
    ])  # fmt: skip
    gap = _GAP * float(np.ptp(reach)) / samples
    dependent = _ranges(singular, gap)
    edges = [reach[0], *dependent.ravel(), reach[1]]
    free = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > gap]
    return Workspace(reach, dependent, np.array(free).reshape(-1, 2))


def _grid(bounds: Array, samples: int) -> Array:
    """Return the rows and columns of a grid as paths, (P, samples, m)."""
    axes = [np.linspace(low, high, samples) for low, high in bounds]
    shapes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return shapes[None] if len(bounds) == 1 else np.concatenate([shapes, np.swapaxes(shapes, 0, 1)])


def _lines(bounds: Array, samples: int, seed: int) -> Array:
    """Return straight paths between random places in the box, (samples, 41, m)."""
    rng = np.random.default_rng(seed)
    low, high = bounds.T
    start, end = low + (high - low) * rng.uniform(size=(2, samples, len(bounds)))
    share = np.linspace(0.0, 1.0, _ON_A_LINE)[:, None]
    return np.asarray(start[:, None] + share * (end - start)[:, None])


def _extreme(
    sign: float,
    starts: Array,
    radius: Callable[[Array], Array],
    slope: Callable[[Array], Array],
    bounds: Array,
) -> float:
    """Return the least (1) or greatest (−1) distance that descent from some shapes leads to."""
    from scipy.optimize import minimize

    found = [
        minimize(
            lambda x: (sign * float(radius(x[None])[0]), sign * slope(x)), start, jac=True,
            method="L-BFGS-B", bounds=bounds,
        ).fun
        for start in starts
    ]  # fmt: skip
    return float(sign * min(found))


def _ranges(values: Array, gap: float) -> Array:
    """Return the ranges (K, 2) that sorted values fill, with no hole larger than a gap."""
    if not len(values):
        return np.zeros((0, 2))
    cuts = np.flatnonzero(np.diff(values) > gap)
    starts, ends = np.append(0, cuts + 1), np.append(cuts, len(values) - 1)
    return np.stack([values[starts], values[ends]], axis=1)
