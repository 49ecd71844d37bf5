"""Directions as tangents take them, SEEDS at once, and back."""

from __future__ import annotations

from ...common.arrays import Array
from .compiling import compiled
from .kernel_call import SEEDS


@compiled
def to_lanes(along: Array, out: Array) -> None:
    """Fill out (B, n SEEDS) with directions (n, N), SEEDS of them at once."""
    for k in range(along.shape[0]):
        for j in range(along.shape[1]):
            out[j // SEEDS, k * SEEDS + j % SEEDS] = along[k, j]


@compiled
def from_lanes(lanes: Array, out: Array) -> None:
    """Fill out (n, N) with the directions that `to_lanes` has spread."""
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[k, j] = lanes[j // SEEDS, k * SEEDS + j % SEEDS]
