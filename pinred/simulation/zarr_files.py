"""Folders of arrays in the format of zarr, if that package is installed."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..common.errors import MissingPackageError, OutputError
from ..common.names import quoted_path


def write_zarr(path: Path, arrays: dict[str, Any]) -> None:
    """Write arrays to a zarr folder, which gets its name when it is complete.

    Args:
        path: Path of the folder, which must not exist.
        arrays: Arrays by name; texts become attributes of the folder.
    Raises:
        MissingPackageError: zarr is not installed.
        OutputError: Writing fails.
    """
    try:
        zarr = import_module("zarr")
    except ImportError:
        raise MissingPackageError(
            f"{quoted_path(path)}: files of zarr need the package zarr: pip install 'pinred[zarr]'"
        ) from None
    try:
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as parent:
            folder = Path(parent) / "complete"
            root = zarr.open_group(str(folder), mode="w")
            for name, array in arrays.items():
                if array.ndim and array.dtype.kind == "f":
                    root.create_array(name, data=array)
                else:  # Texts and their sizes.
                    root.attrs[name] = array.tolist()
            folder.rename(path)
    except OSError as error:
        raise OutputError(f"cannot write {quoted_path(path)}: {error.strerror or error}") from error
