"""Import of optional packages, only when they are needed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from .errors import MissingPackageError


def optional_package(name: str, message: str) -> Any:
    """Return a module.  Raises MissingPackageError with a message if it is not installed."""
    try:
        return import_module(name)
    except ImportError as missing:
        raise MissingPackageError(message) from missing
