"""Extremes of smooth functions: the largest samples, refined by local search."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...common.arrays import Array

_TOPS = 4  # largest samples of each function that are refined
_POINTS = 9  # points of the local grid
_ROUNDS = 10  # refinements, each four times finer


def find_extremes(values: Callable[[Array], Array], s: Array) -> tuple[Array, Array]:
    """Find the largest absolute values of m functions, also between samples.

    Args:
        values: Vectorised functions: s (N,) → (N, m).  They must be defined one sample interval
            beyond both ends.
        s: Increasing samples, (N,), fine enough that three consecutive samples enclose at most
            one maximum.
    Returns:
        Positions, (m,), and absolute values, (m,), of the maxima.
    """
    sampled = np.abs(values(s))
    tops = np.argpartition(sampled, -min(_TOPS, len(s)), axis=0)[-_TOPS:].T  # (m, tops)
    sample, sample_size = s[sampled.argmax(axis=0)], sampled.max(axis=0)
    column = np.arange(sampled.shape[1])
    position, sizes = s[tops], np.take_along_axis(sampled.T, tops, 1)
    step = float(np.diff(s).max())
    offsets = np.linspace(-1.0, 1.0, _POINTS)
    for _ in range(_ROUNDS):
        points = position[..., None] + step * offsets  # (m, tops, points)
        at_points = np.abs(values(points.ravel())).reshape(*points.shape, -1)
        at_points = at_points[column, ..., column]
        best = at_points.argmax(axis=2)[..., None]
        position = np.take_along_axis(points, best, 2)[..., 0]
        sizes = np.take_along_axis(at_points, best, 2)[..., 0]
        step *= 2.0 / (_POINTS - 1)
    first = sizes.argmax(axis=1)
    better = sizes[column, first] > sample_size
    refined = np.where(better, sizes[column, first], sample_size)
    return np.where(better, position[column, first], sample), refined
