"""A flow of many columns at once: value, derivatives along directions, and back.

Columns, directions and covectors have leading axes (…, size), which broadcast.  Values of many
columns run in lanes; a run of one serves all directions and covectors that are its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ...common.arrays import Array
from .flow_columns import Columns

FIRST_ORDER = "flows have derivatives of first order only, and a second was asked for"


class Batched:
    """The batches of a Columns."""

    def __init__(self, columns: Columns) -> None:
        """Take a flow between columns."""
        self.columns = columns

    def value(self, columns: Sequence[Any]) -> Array:
        """Return the output of each column, (…, size)."""
        lead = _lead(columns)
        if not lead:
            return self.columns.value(*columns)
        rows = [a.reshape(-1, a.shape[-1]) for a in _wide(columns, lead)]
        return self.columns.values(*rows).reshape(*lead, self.columns.size)

    def along(self, columns: Sequence[Any], directions: Sequence[Any]) -> Array:
        """Return the derivatives along directions of the columns, (…, size)."""
        lead = _lead([*columns, *directions])
        out = np.zeros((*lead, self.columns.size))
        for place, own, rest in _runs(columns, directions, lead):
            flat = [part.reshape(-1, part.shape[-1]) for part in rest]
            out[place] = self.columns.jvp(own, flat).reshape(out[place].shape)
        return out

    def back(self, columns: Sequence[Any], covector: Any) -> list[Array]:
        """Return the derivatives of covector · output by each input, (…, its size)."""
        lead = _lead([*columns, covector])
        slopes = [np.zeros((*lead, size)) for size in self.columns.sizes]
        for place, own, (part,) in _runs(columns, [covector], lead):
            found = self.columns.vjp(own, part.reshape(-1, part.shape[-1]))
            for out, slope in zip(slopes, found, strict=True):
                out[place] = slope.reshape(out[place].shape)
        return slopes


def _lead(arrays: Sequence[Any]) -> tuple[int, ...]:
    return np.broadcast_shapes(*(a.shape[:-1] for a in arrays))


def _wide(arrays: Sequence[Any], lead: tuple[int, ...]) -> list[Any]:
    return [np.broadcast_to(a, (*lead, a.shape[-1])) for a in arrays]


def _runs(
    columns: Sequence[Any], rest: Sequence[Any], lead: tuple[int, ...]
) -> Iterator[tuple[Any, list[Any], list[Any]]]:
    """Yield the places of what each run serves, its columns, and what it serves."""
    if 0 in lead:
        return
    own = _lead(columns)
    own = (1,) * (len(lead) - len(own)) + own
    columns, rest = _wide(columns, own), _wide(rest, lead)
    for index in np.ndindex(own):
        place = tuple(slice(None) if size == 1 else i for i, size in zip(index, own, strict=True))
        yield place, [a[index] for a in columns], [a[place] for a in rest]
