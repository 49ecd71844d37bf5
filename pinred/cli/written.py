"""The line that says where a command has written a file, and how large it is."""

from __future__ import annotations

from pathlib import Path


def written(path: Path) -> str:
    """Return that line."""
    return f"written to {path} ({path.stat().st_size / 1e3:.0f} kB)"
