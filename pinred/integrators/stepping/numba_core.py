"""The modules `types` and `cgutils` of numba, loaded when the generator of an intrinsic uses them.

Shipped code runs without numba, which need not be installed.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType


def __getattr__(name: str) -> ModuleType:
    """Return a module of numba.core.  Raises AttributeError if there is none of the name."""
    if name.startswith("_"):
        raise AttributeError(name)
    return import_module(f"numba.core.{name}")
