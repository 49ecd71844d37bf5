"""A flow for batches of vectors: values, forward derivatives, and backward passes.

Inputs, directions and covectors have leading axes (…, size) that are broadcast.  Values of a batch
run in SIMD lanes; one integration serves all directions and covectors of the same inputs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ...common.arrays import Array
from .flow_columns import Columns

FIRST_ORDER = "flows only have first derivatives, but a second derivative was requested"


class Batched:
    """A flow between vectors with leading axes.

    Attributes:
        columns: The flow between single vectors.
    """

    def __init__(self, columns: Columns) -> None:
        """Wrap a flow between single vectors."""
        self.columns = columns

    def value(self, columns: Sequence[Any]) -> Array:
        """Return the output for each of the inputs, (…, size)."""
        lead = _lead(columns)
        if not lead:
            return self.columns.value(*columns)
        rows = [a.reshape(-1, a.shape[-1]) for a in _wide(columns, lead)]
        return self.columns.values(*rows).reshape(*lead, self.columns.size)

    def along(self, columns: Sequence[Any], directions: Sequence[Any]) -> Array:
        """Return the derivatives along directions of the inputs, (…, size)."""
        lead = _lead([*columns, *directions])
        derivatives = np.zeros((*lead, self.columns.size))
        for place, inputs, seeds in _runs(columns, directions, lead):
            flat = [seed.reshape(-1, seed.shape[-1]) for seed in seeds]
            derivatives[place] = self.columns.jvp(inputs, flat).reshape(derivatives[place].shape)
        return derivatives

    def back(self, columns: Sequence[Any], covector: Any) -> list[Array]:
        """Return the derivatives of covector · output with respect to each input, (…, its size)."""
        lead = _lead([*columns, covector])
        slopes = [np.zeros((*lead, size)) for size in self.columns.sizes]
        for place, inputs, (seed,) in _runs(columns, [covector], lead):
            gradients = self.columns.vjp(inputs, seed.reshape(-1, seed.shape[-1]))
            for result, slope in zip(slopes, gradients, strict=True):
                result[place] = slope.reshape(result[place].shape)
        return slopes


def _lead(arrays: Sequence[Any]) -> tuple[int, ...]:
    return np.broadcast_shapes(*(a.shape[:-1] for a in arrays))


def _wide(arrays: Sequence[Any], lead: tuple[int, ...]) -> list[Any]:
    return [np.broadcast_to(a, (*lead, a.shape[-1])) for a in arrays]


def _runs(
    columns: Sequence[Any], seeds: Sequence[Any], lead: tuple[int, ...]
) -> Iterator[tuple[Any, list[Any], list[Any]]]:
    """Yield the result indices, the inputs, and the directions or covectors of each integration."""
    if 0 in lead:
        return
    shape = _lead(columns)
    shape = (1,) * (len(lead) - len(shape)) + shape
    columns, seeds = _wide(columns, shape), _wide(seeds, lead)
    for index in np.ndindex(shape):
        place = tuple(slice(None) if size == 1 else i for i, size in zip(index, shape, strict=True))
        yield place, [a[index] for a in columns], [a[place] for a in seeds]
