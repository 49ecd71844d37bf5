"""Files: tests of paths, atomic writing, the user's signing key, and zarr folders.

A process locks its temporary file while it writes.  The operating system releases the lock
when the process ends.  A temporary file that can be locked therefore belongs to no running process
and may be removed.

The key signs entries of the kernel cache.

Another user who can write into the cache can forge a checksum, but not a signature.  The key is
stored in the user's data folder, which no other user can read.

Folders in the format zarr 3 have arrays that name their dimensions, so that xarray reads them.
"""

from __future__ import annotations

import csv
import hmac
import io
import os
import re
import secrets
import stat
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any, BinaryIO

from platformdirs import user_data_path

from .errors import (
    CacheWarning,
    InputError,
    LoadError,
    OutputError,
    install_command,
    optional_package,
)
from .names import brief, quoted_path


def _mode(path: Path) -> int:
    """Return the mode of what has a name; 0 for nothing, and for invalid names."""
    try:
        return path.stat().st_mode
    except (OSError, ValueError):
        return 0


def is_file(path: Path) -> bool:
    """Return whether a path is a file; False for invalid file names."""
    return stat.S_ISREG(_mode(path))


def is_folder(path: Path) -> bool:
    """Return whether a path is a folder; False for invalid folder names."""
    return stat.S_ISDIR(_mode(path))


def is_special(path: Path) -> bool:
    """Return whether a path is a pipe, a device or a socket, whose reading may never end."""
    mode = _mode(path)
    return bool(mode) and not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def read_plain_file(path: Path, most: int) -> bytes | None:
    """Read a plain file.

    Args:
        path: Path of the file.
        most: Largest accepted size [bytes].
    Returns:
        The content; None if there is no such file, or if a folder, pipe or device has its name.
    Raises:
        LoadError: The file cannot be read, or is larger.
    """
    try:
        # Without O_NONBLOCK, opening a pipe would wait for its writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError):
        return None
    except OSError as error:
        raise LoadError(f"{quoted_path(path)} cannot be read: {error.strerror or error}") from None
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            return None
        with open(descriptor, "rb", closefd=False) as file:
            content = file.read(most + 1)
    except OSError as error:
        raise LoadError(f"{quoted_path(path)} cannot be read: {error.strerror or error}") from None
    finally:
        os.close(descriptor)
    if len(content) > most:
        raise LoadError(f"{quoted_path(path)} is larger than {most} bytes")
    return content


def lock_shared(folder: Path, clean: Callable[[], None]) -> int | None:
    """Take a lock on a folder that several processes may have, and that ends with the process.

    Args:
        folder: The folder.
        clean: Called before if no other process has the lock.
    Returns:
        An open descriptor, which has the lock until it is closed; None without file locks.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):
            _lock(descriptor, wait=False)
            clean()
        _lock(descriptor, wait=True, shared=True)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


_NAME = re.compile(r"\.pinred-[0-9a-f]{16}\.tmp")
# Windows lacks both flags.
_NO_LINKS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)


@dataclass(frozen=True)
class Temporary:
    """A new, locked temporary file.

    Attributes:
        folder: Descriptor of the folder that contains the file.
        name: Name of the file in this folder.
        descriptor: Descriptor of the open file.
    """

    folder: int
    name: str
    descriptor: int

    def become(self, name: str) -> None:
        """Rename the file to its final name.  Raises OSError."""
        os.replace(self.name, name, src_dir_fd=self.folder, dst_dir_fd=self.folder)


@contextmanager
def temporary(folder: int, mode: int = 0o666) -> Iterator[Temporary]:
    """Create a temporary file in a folder, and remove it at the end unless it was renamed.

    Args:
        folder: Descriptor of the folder.
        mode: Permissions of the file, before the process's umask applies.
    Yields:
        The file.
    Raises:
        OSError: The file cannot be created.
    """
    sweep(folder)
    while True:
        name = f".pinred-{secrets.token_hex(8)}.tmp"
        descriptor = os.open(
            name, os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_LINKS, mode, dir_fd=folder
        )
        with suppress(OSError):  # without file locks, `sweep` removes no files
            _lock(descriptor, wait=True)
        if os.fstat(descriptor).st_nlink:
            break
        os.close(descriptor)  # another process removed the file before it was locked
    try:
        yield Temporary(folder, name, descriptor)
    finally:
        with suppress(OSError):
            os.unlink(name, dir_fd=folder)
        os.close(descriptor)


def _lock(descriptor: int, *, wait: bool, shared: bool = False) -> None:
    """Lock a file.  Raises OSError if it is locked, or if the system has no such locks."""
    try:
        import fcntl
    except ImportError as missing:
        raise OSError("this system has no advisory file locks") from missing
    operation = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    fcntl.flock(descriptor, operation if wait else operation | fcntl.LOCK_NB)


def sweep(folder: int) -> None:
    """Remove temporary files of ended processes from a folder."""
    with suppress(OSError):
        readable = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=folder)
        try:
            names = [name for name in os.listdir(readable) if _NAME.fullmatch(name)]
        finally:
            os.close(readable)
        for name in names:
            _remove_if_unlocked(folder, name)


def remove_temporary_files(folder: Path) -> None:
    """Remove temporary files of ended processes from a folder and all folders in it."""
    for path in {file.parent for file in folder.rglob(".pinred-*.tmp")}:
        with suppress(OSError), _folder(path / "any") as descriptor:
            sweep(descriptor)


def _remove_if_unlocked(folder: int, name: str) -> None:
    with suppress(OSError):
        descriptor = os.open(name, os.O_RDWR | os.O_NONBLOCK | _NO_LINKS, dir_fd=folder)
        try:
            _lock(descriptor, wait=False)
            os.unlink(name, dir_fd=folder)
        finally:
            os.close(descriptor)


def not_written(path: object, error: OSError) -> str:
    """Return the message that a file cannot be written."""
    return f"cannot write {quoted_path(path)}: {error.strerror or error}"


DATA = (".npz", ".csv")
FIGURES = (".png", ".pdf", ".svg")
_PATH = getattr(os, "O_PATH", os.O_RDONLY)  # flag for opening folders, also without read permission


def check_path(
    path: str | Path, suffixes: Sequence[str] = DATA, folders: Sequence[str] = ()
) -> Path:
    """Check that a file can be written at a path.

    Args:
        path: Name of the file.
        suffixes: Allowed suffixes.
        folders: Suffixes of formats that are folders, so that an existing folder is admitted.
    Returns:
        The path.
    Raises:
        InputError: The name is invalid, its folder is missing, or another object has this name.
        OutputError: The folder or an existing file is read-only.
    """
    if not isinstance(path, (str, os.PathLike)) or not _is_name(path):
        raise InputError(f"path must be the name of a file, got {brief(path)}")
    path = Path(path)
    name = quoted_path(path)
    if path.suffix not in suffixes:
        raise InputError(f"cannot write {name}: the suffix must be {' or '.join(suffixes)}")
    try:
        if not path.parent.is_dir():
            raise InputError(f"cannot write {name}: there is no folder {quoted_path(path.parent)}")
        if path.exists() and not (path.suffix in folders and path.is_dir()):
            _check_old(path, name)
        # Try to write before a long simulation starts, so that it does not fail at its end.
        with _folder(path) as folder, temporary(folder):
            return path
    except OSError as error:
        raise OutputError(not_written(path, error)) from None


def _is_name(path: str | os.PathLike[str]) -> bool:
    """Return whether the file system has bytes for a name."""
    try:
        return b"\0" not in os.fsencode(path)
    except (TypeError, ValueError):
        return False


def _check_old(path: Path, name: str) -> None:
    """Reject a path whose existing file or folder is protected or must not be replaced."""
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise InputError(f"cannot write {name}: it is a folder")
    if not stat.S_ISREG(mode):
        file_type = "a FIFO" if stat.S_ISFIFO(mode) else "not a plain file"
        raise InputError(f"cannot write {name}: it is {file_type}, which a file would replace")
    # Check the mode: a rename would replace a read-only file, and root may write any file.
    if not mode & 0o222 or not os.access(path, os.W_OK):
        raise OutputError(f"cannot write {name}: the existing file is read-only")


@contextmanager
def _folder(path: Path) -> Iterator[int]:
    """Open the folder of a path and yield its descriptor."""
    folder = os.open(path.parent, _PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield folder
    finally:
        os.close(folder)


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file under a temporary name in its folder, then rename it.

    Temporary files of killed processes in this folder are removed.

    Args:
        path: Name of the file.
        write: Function that writes the content to a binary file.
    Raises:
        OutputError: The file cannot be written; an older file of this name is unchanged.
    """
    try:
        with _folder(path) as folder, temporary(folder) as file_at:
            with os.fdopen(file_at.descriptor, "wb", closefd=False) as file:
                write(file)
            file_at.become(path.name)
    except OSError as error:
        raise OutputError(not_written(path, error)) from error


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    """Write a table as a csv file.

    Args:
        path: Name of the file.
        columns: Names of the columns, in order.
        rows: Cells of each row by column name.
    Raises:
        OutputError: The file cannot be written.
    """
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_atomic(path, lambda file: file.write(text.getvalue().encode()))


TEMPORARY = "0" * 16  # fingerprint of a signing key that could not be stored
_KEY_NAME = "cache_key"
_LOCK = Lock()
_SIZE = 32  # length of the key [bytes]
_NOT_OWNERS = stat.S_IRWXG | stat.S_IRWXO


def signing_key() -> bytes:
    """Return the user's signing key, created at the first use.

    A key file that others can read or write is replaced with a CacheWarning.  If no key can be
    stored, a CacheWarning is issued and this process uses a temporary key.
    """
    with _LOCK:
        return _load_key(user_data_path("pinred"))[0]


def fingerprint() -> str:
    """Return 16 hexadecimal digits that identify the signing key without revealing it.

    All keys that could not be stored share the fingerprint TEMPORARY, so that processes without a
    stored key overwrite each other's entries instead of filling the cache.
    """
    key = signing_key()
    with _LOCK:
        is_stored = _load_key(user_data_path("pinred"))[1]
    return hmac.digest(key, b"fingerprint", "sha256").hex()[:16] if is_stored else TEMPORARY


@cache
def _load_key(path: Path) -> tuple[bytes, bool]:
    """Return the key, and whether it is stored in a folder."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            return _read_key(folder) or _create_key(folder, path), True
        finally:
            os.close(folder)
    except OSError as error:
        _warn(
            f"the key of the kernel cache cannot be stored in '{path}' "
            f"({error.strerror or error}), so other processes compile again; "
            "set XDG_DATA_HOME to a private folder"
        )
        return secrets.token_bytes(_SIZE), False


def _read_key(folder: int) -> bytes | None:
    """Return the key stored in a folder, or None if there is no private key file."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(_KEY_NAME, flags, dir_fd=folder)
    except FileNotFoundError:
        return None
    except OSError:  # the name is a symbolic link
        return None
    try:
        status = os.fstat(descriptor)
        private = status.st_uid == os.geteuid() and not status.st_mode & _NOT_OWNERS
        if not stat.S_ISREG(status.st_mode) or not private or status.st_size != _SIZE:
            return None
        return os.read(descriptor, _SIZE)
    finally:
        os.close(descriptor)


def _create_key(folder: int, path: Path) -> bytes:
    """Create a key in a folder; if another process was faster, return its key instead."""
    if os.access(_KEY_NAME, os.F_OK, dir_fd=folder, follow_symlinks=False):
        _warn(
            f"'{path / _KEY_NAME}' was not private: it is replaced, and kernels are compiled again"
        )
        os.unlink(_KEY_NAME, dir_fd=folder)
    with temporary(folder, 0o600) as file:
        os.write(file.descriptor, secrets.token_bytes(_SIZE))
        os.fsync(file.descriptor)
        with suppress(FileExistsError):  # another process was faster, and its key is used
            os.link(file.name, _KEY_NAME, src_dir_fd=folder, dst_dir_fd=folder)
    key = _read_key(folder)
    if key is None:
        raise OSError(f"'{_KEY_NAME}' in this folder is not a private file of this user")
    return key


def _warn(text: str) -> None:
    warnings.warn(text, CacheWarning, stacklevel=6)


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
