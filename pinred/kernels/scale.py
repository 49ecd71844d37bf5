"""Disagreements that come of extreme units, told as what they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ..common.errors import KernelMismatch, ModelError
from ..system.scale import ill_scaled
from ..system.system import System


@contextmanager
def telling_scale(system: System) -> Iterator[None]:
    """Raise ModelError in the place of a KernelMismatch, if the system is ill-scaled."""
    try:
        yield
    except KernelMismatch as error:
        if words := ill_scaled(system):
            raise ModelError(words) from error
        raise
