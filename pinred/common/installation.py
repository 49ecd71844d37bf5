"""The installation: the version of pinred, and packages that are imported when they are needed."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from .errors import MissingPackageError

__version__ = "0.1.0"


def install_command(extra: str) -> str:
    """Return the command that installs an extra of pinred, from a release or from a checkout."""
    return f'pip install "pinred[{extra}]" (in a checkout: pip install ".[{extra}]")'


def optional_package(name: str, message: str) -> Any:
    """Return a module.  Raises MissingPackageError with a message if it is not installed."""
    try:
        return import_module(name)
    except ImportError as missing:
        raise MissingPackageError(message) from missing


def require_package(name: str, message: str) -> None:
    """Raise MissingPackageError with a message if a package is not installed; do not import it."""
    if find_spec(name) is None:
        raise MissingPackageError(message)
