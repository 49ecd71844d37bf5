"""Files that commands write: figures, and the message about a written file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NO_DATE: dict[str, dict[str, Any]] = {  # Without a date, the same figure gives the same file.
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to a .png, .pdf or .svg file; raise OutputError if that fails."""
    from ..common.files import write_atomic

    suffix = path.suffix
    write_atomic(
        path, lambda file: figure.savefig(file, format=suffix[1:], metadata=_NO_DATE[suffix])
    )


def describe_file(path: Path) -> str:
    """Return the message that a file was written, with its size."""
    return f"written to {path} ({path.stat().st_size / 1e3:.0f} kB)"
