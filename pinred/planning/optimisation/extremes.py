"""True extremes of smooth functions of time: the greatest of many samples, and what lies beside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...common.arrays import Array

_TOPS = 4  # samples of each function beside which is looked
_BESIDE = 9  # places at once
_ROUNDS = 10  # each four times as fine


def greatest(values: Callable[[Array], Array], s: Array) -> tuple[Array, Array]:
    """Return the places (m,) and sizes (m,) at which m functions are greatest in size.

    values: s (N,) → (N, m).  s: (N,) increasing places, fine enough that no two maxima lie between
    three of them; values exist as far beyond them as they lie apart.
    """
    sampled = np.abs(values(s))
    tops = np.argpartition(sampled, -min(_TOPS, len(s)), axis=0)[-_TOPS:].T  # (m, tops)
    at, most = s[sampled.argmax(axis=0)], sampled.max(axis=0)
    own = np.arange(sampled.shape[1])
    place, sizes = s[tops], np.take_along_axis(sampled.T, tops, 1)
    step = float(np.diff(s).max())
    beside = np.linspace(-1.0, 1.0, _BESIDE)
    for _ in range(_ROUNDS):
        tried = place[..., None] + step * beside  # (m, tops, beside)
        found = np.abs(values(tried.ravel())).reshape(*tried.shape, -1)[own, ..., own]
        best = found.argmax(axis=2)[..., None]
        place = np.take_along_axis(tried, best, 2)[..., 0]
        sizes = np.take_along_axis(found, best, 2)[..., 0]
        step *= 2.0 / (_BESIDE - 1)
    first = sizes.argmax(axis=1)
    better = sizes[own, first] > most
    return np.where(better, place[own, first], at), np.where(better, sizes[own, first], most)
