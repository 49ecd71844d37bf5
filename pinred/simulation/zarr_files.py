"""Arrays as a folder of zarr, where that is installed."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..common.errors import MissingPackageError, OutputError
from ..common.plain_names import quoted_path


def write_zarr(path: Path, arrays: dict[str, Any]) -> None:
    """Write a folder of arrays, text as its attributes, under another name until it is whole.

    Raises MissingPackageError without zarr, OutputError if writing fails.
    """
    try:
        zarr = import_module("zarr")
    except ImportError:
        raise MissingPackageError(
            f"{quoted_path(path)}: files of zarr need the package zarr: pip install 'pinred[zarr]'"
        ) from None
    try:
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            whole = Path(folder) / "whole"
            root = zarr.open_group(str(whole), mode="w")
            for name, array in arrays.items():
                if array.ndim and array.dtype.kind == "f":
                    root.create_array(name, data=array)
                else:  # text and what it is of
                    root.attrs[name] = array.tolist()
            whole.rename(path)
    except OSError as error:
        raise OutputError(f"cannot write {quoted_path(path)}: {error.strerror or error}") from error
