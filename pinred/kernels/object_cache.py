"""Compiled objects on disk, so that a robot is compiled once and not once a day.

The machine code kept here runs with the rights of whoever loads it.  So nothing is read from
a folder or a file that anyone else could have written, no link is followed, and an entry
counts only if its header and its key agree and the user's own secret has signed all of it: what
somebody else has put there is compiled anew, never run.  A fault of the cache leads to a
CacheWarning and a recompilation, never to an error.
"""

from __future__ import annotations

import hmac
import os
import re
import stat
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import BinaryIO, NamedTuple

import llvmlite.binding as llvm
from platformdirs import user_cache_path

from ..common.errors import CacheWarning, InputError
from ..common.temporary import sweep, temporary
from ..common.version import __version__
from .signing_key import signing_key

LIMIT = 256 * 2**20  # bytes
_WRITERS = 8  # as many processes may fill what is free before any of them looks again

_VERSION = 2
_MAGIC = b"pinred\x00\n"
_HEADER = struct.Struct("<8sI64sQ")  # magic, version, key, length of the payload
_SIGNATURE = 32  # bytes: HMAC-SHA256 of header and payload, between them
_KEY = re.compile(r"[0-9a-f]{64}")
_ENTRY = re.compile(r"([0-9a-f]{64})\.o")
_OTHERS = stat.S_IWGRP | stat.S_IWOTH

_said: set[tuple[str, str]] = set()  # folders, and what has been said about them once
_room: dict[tuple[Path, int], int] = {}  # by folder and limit: to be written before the next look


class CacheEntry(NamedTuple):
    """One object on disk.  size: of its file [bytes].  last_use: [s] since the epoch."""

    key: str
    size: int
    last_use: float


class _DistrustError(Exception):
    """The reason why something in the cache is not used."""


def cache_key(*parts: bytes | str) -> str:
    """Return the key, 64 hexadecimal digits, of an object that depends on `parts`.

    It also depends on everything that decides what they are compiled to: the sources of the
    engine, the versions of pinred, CasADi and llvmlite, and the CPU.
    """
    digest = sha256()
    for part in (*parts, *_surroundings()):
        data = part.encode() if isinstance(part, str) else part
        digest.update(b"s" if isinstance(part, str) else b"b")
        digest.update(struct.pack("<Q", len(data)) + data)
    return digest.hexdigest()


@cache
def _surroundings() -> tuple[str | bytes, ...]:
    package = Path(__file__).parent.parent  # all that decides what is compiled, and nothing else
    folders = (package / "lie", package / "kernels", package / "reduction" / "tree")
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    sources = sha256(b"".join(path.read_bytes() for path in files))
    return (
        __version__,
        version("casadi"),
        version("llvmlite"),
        sources.digest(),
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
    )


class ObjectCache:
    """Objects in one folder; the least recently used are removed when they exceed a limit.

    folder: by default that of the environment variable PINRED_CACHE_DIR, or else the user's
    own for caches; made when it is first needed.  limit: of all entries together [bytes].

    Any number of threads and processes may use a folder at once.
    """

    def __init__(self, folder: Path | None = None, limit: int = LIMIT) -> None:
        """Name the folder; touch nothing yet.  Raises InputError if limit is negative."""
        if limit < 0:
            raise InputError(f"limit must be a number of bytes, zero or more, got {limit}")
        named = os.environ.get("PINRED_CACHE_DIR")
        self.folder = folder or (Path(named) if named else user_cache_path("pinred"))
        self.limit = limit

    def get(self, key: str) -> bytes | None:
        """Return the object of a key, or None if there is none that can be trusted.

        An entry that cannot be trusted is removed, with a CacheWarning.
        """
        name = _file_name(key)
        with self._open(make=False) as folder:
            if folder is None:
                return None
            try:
                return _read(folder, name, key)
            except FileNotFoundError:
                return None
            except (_DistrustError, OSError) as why:
                _remove(folder, name)
                problem = why
        _warn(f"'{self.folder / name}' is not used and removed: {problem}")
        return None

    def put(self, key: str, code: bytes) -> None:
        """Keep an object.  If that cannot be done, there is one CacheWarning and no error.

        Readers see the entry that was there before or this one, never a part.  An object
        larger than the limit is not kept.
        """
        name = _file_name(key)
        header = _HEADER.pack(_MAGIC, _VERSION, key.encode(), len(code))
        if len(header) + _SIGNATURE + len(code) > self.limit:
            return
        try:
            with self._open(make=True) as folder:
                if folder is not None:
                    entry = header + _signature(header, code) + code
                    _write(folder, name, entry)
                    self._trim(folder, len(entry))
        except OSError as error:
            self._say_once("write", f"compiled code is not kept in '{self.folder}': {error}")

    def entries(self) -> list[CacheEntry]:
        """Return the entries, the least recently used first."""
        with self._open(make=False) as folder:
            return [] if folder is None else _entries(folder)

    def clear(self) -> int:
        """Remove every entry and return how many there were."""
        with self._open(make=False) as folder:
            if folder is None:
                return 0
            sweep(folder)
            return sum(_remove(folder, f"{entry.key}.o") for entry in _entries(folder))

    def _trim(self, folder: int, written: int) -> None:
        """Remove entries above the limit; look at the folder only where it could be exceeded."""
        place = (self.folder, self.limit)
        _room[place] = _room.get(place, 0) - written
        if _room[place] >= 0:
            return
        entries = _entries(folder)
        total = sum(entry.size for entry in entries)
        # More than must go goes at once: a full folder is not listed at every put.
        enough = self.limit if total <= self.limit else self.limit - self.limit // 16
        for entry in entries:
            if total <= enough:
                break
            if _remove(folder, f"{entry.key}.o"):
                total -= entry.size
        _room[place] = (self.limit - total) // _WRITERS

    @contextmanager
    def _open(self, *, make: bool) -> Iterator[int | None]:
        """Yield a descriptor of the folder, so that the folder checked is the folder used.

        None if there is no folder or it cannot be trusted.  make: make it if it is missing,
        and raise OSError if that fails.
        """
        if make:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        try:
            folder = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except FileNotFoundError:
            yield None
            return
        except OSError as error:
            self._say_once("open", f"the cache '{self.folder}' is not used: {error}")
            yield None
            return
        try:
            why = _distrust(os.fstat(folder))
            if why:
                self._say_once(
                    "trust",
                    f"the cache '{self.folder}' is not used, it {why}; machine code is only "
                    "read where nobody else can write: chmod go-w, or set PINRED_CACHE_DIR",
                )
            elif above := _open_above(self.folder):
                self._say_once("above", f"the cache '{self.folder}' lies in {above}")
            yield None if why else folder
        finally:
            os.close(folder)

    def _say_once(self, kind: str, text: str) -> None:
        about = (str(self.folder), kind)
        if about not in _said:
            _said.add(about)
            _warn(text)


def _warn(text: str) -> None:
    """Warn whoever called the cache."""
    warnings.warn(text, CacheWarning, stacklevel=4)


def _file_name(key: str) -> str:
    if not _KEY.fullmatch(key):
        raise InputError(f"a key has 64 hexadecimal digits, as of cache_key, got {key!r}")
    return f"{key}.o"


def _distrust(status: os.stat_result) -> str:
    """Return why a file or folder could be someone else's work; nothing if it cannot be."""
    if status.st_uid != os.geteuid():
        return f"belongs to user {status.st_uid}"
    if status.st_mode & _OTHERS:
        return f"can be written by others (mode {stat.S_IMODE(status.st_mode):04o})"
    return ""


def _open_above(folder: Path) -> str:
    """Return which folder above could be put in another's place by others, or nothing.

    Where a folder is sticky, as /tmp is, others cannot move what is not theirs.
    """
    for above in folder.absolute().parents:
        with suppress(OSError):
            status = above.stat()
            everyone = status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX
            if everyone:
                return (
                    f"'{above}', where everyone can write (mode "
                    f"{stat.S_IMODE(status.st_mode):04o}): others can put a folder of theirs in "
                    "its place, whose entries are not used; set PINRED_CACHE_DIR to one of your own"
                )
    return ""


def _read(folder: int, name: str, key: str) -> bytes:
    """Return the payload of an entry, and note its use.

    Raises FileNotFoundError, or _DistrustError or OSError if it must not be used.
    """
    # A link is not followed; a pipe is not waited for.
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(name, flags, dir_fd=folder)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise _DistrustError("it is not a plain file")
        if why := _distrust(status):
            raise _DistrustError(f"it {why}")
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            payload = _checked(file, status.st_size, key)
        with suppress(OSError):
            os.utime(descriptor)
    finally:
        os.close(descriptor)
    return payload


def _checked(file: BinaryIO, size: int, key: str) -> bytes:
    """Return the payload of an open entry.  Raises _DistrustError unless all of it agrees."""
    head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        raise _DistrustError("it is cut off")
    magic, form, stored_key, length = _HEADER.unpack(head)
    if magic != _MAGIC:
        raise _DistrustError("it was not written by pinred")
    if form != _VERSION:
        raise _DistrustError(f"its format is {form}, not {_VERSION}")
    if stored_key != key.encode():
        raise _DistrustError("it holds the object of another key")
    if length != size - _HEADER.size - _SIGNATURE:
        raise _DistrustError("its length is not the one in its header")
    signature, payload = file.read(_SIGNATURE), file.read(length)
    if not hmac.compare_digest(signature, _signature(head, payload)):
        raise _DistrustError("its signature is not this user's, or it is damaged")
    return payload


def _signature(header: bytes, payload: bytes) -> bytes:
    return hmac.digest(signing_key(), header + payload, "sha256")


def _write(folder: int, name: str, data: bytes) -> None:
    """Write an entry under a temporary name, and rename it when it is complete on disk."""
    with temporary(folder, 0o600) as made:
        with os.fdopen(made.descriptor, "wb", closefd=False) as file:
            file.write(data)
            file.flush()
            os.fsync(made.descriptor)
        made.become(name)


def _remove(folder: int, name: str) -> bool:
    """Remove a file unless somebody else has; return whether that succeeded."""
    try:
        os.unlink(name, dir_fd=folder)
    except OSError:
        return False
    return True


def _files(folder: int, pattern: re.Pattern[str]) -> Iterator[tuple[str, os.stat_result]]:
    """Yield name and status of the files of one kind; those that vanish are left out."""
    with os.scandir(folder) as found:
        names = [item.name for item in found if pattern.fullmatch(item.name)]
    for name in names:
        with suppress(OSError):
            yield name, os.stat(name, dir_fd=folder, follow_symlinks=False)


def _entries(folder: int) -> list[CacheEntry]:
    entries = [
        CacheEntry(name.removesuffix(".o"), status.st_size, status.st_mtime_ns / 1e9)
        for name, status in _files(folder, _ENTRY)
    ]
    return sorted(entries, key=lambda entry: entry.last_use)
