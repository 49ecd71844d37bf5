"""Names that may be those of files and folders: whether there are such."""

from __future__ import annotations

from pathlib import Path


def is_file(path: Path) -> bool:
    """Return whether there is such a file; what is no name of a file at all is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Return whether there is such a folder; what is no name of one at all is none."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False
