"""Which integrator a scene gets."""

from __future__ import annotations

from functools import lru_cache

from ..integrators.method import DOP853, Method
from ..scene import Scene


def method_of(scene: Scene) -> Method:
    """Return the integrator of a scene."""
    return scene.method or _dop853(*scene.tolerance)


@lru_cache(maxsize=64)
def _dop853(rtol: float, atol: float) -> DOP853:
    return DOP853(rtol=rtol, atol=atol)
