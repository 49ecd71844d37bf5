"""Folders in the format zarr 3 whose arrays name their dimensions, so that xarray reads them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .errors import InputError, OutputError
from .files import not_written
from .installation import install_command, optional_package
from .names import quoted_path


def import_zarr(path: Path, extra: str = "zarr") -> Any:
    """Return the package zarr.  Raises MissingPackageError with the command that installs it."""
    return optional_package(
        "zarr",
        f"{quoted_path(path)}: files of zarr need the package zarr: {install_command(extra)}",
    )


def array_name(name: str) -> str:
    """Return a name that zarr and CF conventions admit, without separators."""
    return name.replace("/", "_").replace(" ", "_")


def create_group(path: Path, attributes: Mapping[str, Any]) -> Any:
    """Create a zarr folder.

    Args:
        path: Path of the folder, which must not exist.
        attributes: Its attributes.
    Returns:
        The group.
    Raises:
        OutputError: The folder cannot be written.
        MissingPackageError: zarr is not installed.
    """
    zarr = import_zarr(path, "sweep")
    try:
        return zarr.create_group(str(path), zarr_format=3, attributes=dict(attributes))
    except OSError as error:
        raise OutputError(not_written(path, error)) from error


def open_group(path: Path, mode: str = "r") -> Any:
    """Return a zarr folder.  Raises MissingPackageError or InputError."""
    zarr = import_zarr(path, "sweep")
    try:
        return zarr.open_group(str(path), mode=mode)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{quoted_path(path)} is not a zarr folder: {error}") from None


def create_array(
    group: Any, name: str, dims: Sequence[str], attributes: Mapping[str, Any], **options: Any
) -> Any:
    """Create an array in a group, which is uncompressed by default.

    Args:
        group: The group.
        name: Name of the array.
        dims: Names of the dimensions.
        attributes: Attributes; empty texts are omitted.
        options: Options of zarr: shape, dtype, fill_value, chunks or data, and compressors.
    Returns:
        The array.
    """
    kept = {key: value for key, value in attributes.items() if value != ""}
    return group.create_array(
        name, dimension_names=list(dims), attributes=kept, **{"compressors": None, **options}
    )


def replace_folder(path: Path, write: Callable[[Path], None]) -> None:
    """Write a zarr folder under a temporary name, then replace the folder of the final name.

    Args:
        path: Final path; a zarr folder with this name is replaced.
        write: Function that writes a folder.
    Raises:
        InputError: Something else than a zarr folder has this name.
        OutputError: Writing fails; an older folder is unchanged.
    """
    if path.exists() and not (path / "zarr.json").exists():
        raise InputError(f"cannot write {quoted_path(path)}: it exists and is not a zarr folder")
    try:
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as parent:
            complete, old = Path(parent) / "complete", Path(parent) / "old"
            write(complete)
            if path.exists():
                path.rename(old)  # The temporary folder is removed with the old content.
            try:
                complete.rename(path)
            finally:
                if old.exists() and not path.exists():
                    old.rename(path)
    except OSError as error:
        raise OutputError(not_written(path, error)) from error
