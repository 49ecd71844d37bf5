"""Disk cache of compiled object code, so that robots and integrators are compiled only once.

The cached machine code runs with the rights of the user who loads it.  Therefore the cache reads
no folder or file that another user could have written, and follows no links.  An entry is valid
only if its header and key agree and its signature was made with the user's signing key.  Code of
an invalid entry is never run; it is compiled again.  A fault of the cache causes a CacheWarning
and a recompilation, never an error.

While a thread does other work, other threads may compile an object that it will need, in parts.
The thread that needs the object compiles the parts that no other thread has begun, so it never
waits for a thread that has not started.

Several signing keys may share a folder, as containers with separate homes do.  The file name of an
entry contains a fingerprint of its signing key, so each key has its own entries.
"""

from __future__ import annotations

import hmac
import os
import re
import stat
import struct
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from hashlib import sha256
from importlib.metadata import version
from itertools import count
from pathlib import Path
from threading import Event, Lock, Thread, current_thread
from typing import BinaryIO, NamedTuple

import llvmlite.binding as llvm
from platformdirs import user_cache_path

from .errors import CacheWarning, InputError, __version__
from .files import TEMPORARY, fingerprint, signing_key, sweep, temporary
from .machine_code import LEVEL, code_level, cpu_target, spare_processors
from .waiting import notice_of_compiling

_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def find_distrust(status: os.stat_result) -> str:
    """Return why another user could have written a file or folder, or "" if none could."""
    if status.st_uid != os.geteuid():
        return f"belongs to user {status.st_uid}"
    if status.st_mode & _OTHERS:
        return f"can be written by others (mode {stat.S_IMODE(status.st_mode):04o})"
    return ""


def find_open_parent(folder: Path) -> str:
    """Return a warning about a parent folder that other users can replace, or "" without one.

    A folder with the sticky bit, such as /tmp, is safe: users cannot move each other's files there.
    """
    for above in folder.absolute().parents:
        with suppress(OSError):
            status = above.stat()
            if status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX:
                return (
                    f"'{above}', where everyone can write (mode "
                    f"{stat.S_IMODE(status.st_mode):04o}): others can replace the cache "
                    "folder, and its entries are then not used; set PINRED_CACHE_DIR to a "
                    "private folder"
                )
    return ""


_VERSION = 2
_MAGIC = b"pinred\x00\n"
_HEADER = struct.Struct("<8sI64sQ")  # magic, version, key, length of the payload
_SIGNATURE = 32  # bytes of the HMAC-SHA256 of header and payload, stored between them
ENTRY_HEAD = _HEADER.size + _SIGNATURE  # bytes of an entry before its payload


class DistrustError(Exception):
    """A cache entry cannot be trusted and must not be used; the message states the reason."""


def read_entry(folder: int, name: str, key: str) -> bytes:
    """Read the payload of an entry and update its time of use.

    Args:
        folder: Descriptor of the folder.
        name: Name of the entry's file.
        key: Key of the entry.
    Returns:
        The payload.
    Raises:
        FileNotFoundError: The entry does not exist.
        DistrustError: The entry must not be used.
    """
    # Do not follow symbolic links, and do not block on named pipes.
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(name, flags, dir_fd=folder)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise DistrustError("it is not a regular file")
        if why := find_distrust(status):
            raise DistrustError(f"it {why}")
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            payload = _verify(file, status.st_size, key)
        with suppress(OSError):
            os.utime(descriptor)
    finally:
        os.close(descriptor)
    return payload


def _verify(file: BinaryIO, size: int, key: str) -> bytes:
    """Return the payload of an open entry.  Raises DistrustError unless all checks pass."""
    head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        raise DistrustError("it is truncated")
    magic, form, stored_key, length = _HEADER.unpack(head)
    if magic != _MAGIC:
        raise DistrustError("it was not written by pinred")
    if form != _VERSION:
        raise DistrustError(f"its format is {form}, not {_VERSION}")
    if stored_key != key.encode():
        raise DistrustError("it contains the object of another key")
    if length != size - _HEADER.size - _SIGNATURE:
        raise DistrustError("its length differs from the length in its header")
    signature, payload = file.read(_SIGNATURE), file.read(length)
    if not hmac.compare_digest(signature, _signature(head, payload)):
        raise DistrustError("its signature is not this user's, or it is damaged")
    return payload


def _signature(header: bytes, payload: bytes) -> bytes:
    return hmac.digest(signing_key(), header + payload, "sha256")


def write_entry(folder: int, name: str, key: str, payload: bytes) -> None:
    """Write an entry under a temporary name, then rename it once it is complete on disk.

    Args:
        folder: Descriptor of the folder.
        name: Name of the entry's file.
        key: Key of the entry.
        payload: The payload.
    Raises:
        OSError: The file cannot be written.
    """
    head = _HEADER.pack(_MAGIC, _VERSION, key.encode(), len(payload))
    with temporary(folder, 0o600) as file_at:
        with os.fdopen(file_at.descriptor, "wb", closefd=False) as file:
            file.write(head + _signature(head, payload) + payload)
            file.flush()
            os.fsync(file_at.descriptor)
        file_at.become(name)


LIMIT = 256 * 2**20  # default maximum size of all entries [bytes]
_WRITERS = 8  # number of processes that may write at once without exceeding the limit

_KEY = re.compile(r"[0-9a-f]{64}")
# Key of the object, and fingerprint of the signing key; earlier versions wrote no fingerprint.
_ENTRY = re.compile(r"([0-9a-f]{64})(?:\.[0-9a-f]{16})?\.o")

_warned: set[tuple[str, str]] = set()  # (folder, kind) of each warning that was already issued
# Number of bytes that may be written before the folder is listed again, by folder and limit.
_room: dict[tuple[Path, int], int] = {}
_ahead: dict[tuple[Path, str], ObjectAhead] = {}  # objects by folder and key, until requested


class CacheEntry(NamedTuple):
    """Size and time of last use of one object on disk.

    Attributes:
        key: Key of the object.
        size: Size of the object's file [bytes].
        last_use: Time of the last use of the object, in seconds since the Unix epoch.
        file: Name of the object's file.
    """

    key: str
    size: int
    last_use: float
    file: str


def cache_key(*parts: bytes | str) -> str:
    """Compute the key of an object.

    The key also depends on the environment of the compilation: the sources of the engine, the
    versions of pinred, CasADi and llvmlite, the CPU that code is compiled for, and the level of
    optimisation.

    Args:
        parts: Values that identify the object.
    Returns:
        64 hexadecimal digits.
    """
    digest = sha256()
    cpu = cpu_target()
    level = () if code_level() == LEVEL else (f"level {code_level()}",)
    for value in (*parts, *_environment(), cpu.name, cpu.features, *level):
        data = value.encode() if isinstance(value, str) else value
        digest.update(b"s" if isinstance(value, str) else b"b")
        digest.update(struct.pack("<Q", len(data)) + data)
    return digest.hexdigest()


@cache
def _environment() -> tuple[str | bytes, ...]:
    package = Path(__file__).parent.parent  # the sources that determine the compiled code
    folders = (package / "lie", package / "kernels", package / "reduction" / "tree")
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    sources = sha256(b"".join(path.read_bytes() for path in files))
    return (
        __version__,
        version("casadi"),
        version("llvmlite"),
        sources.digest(),
        llvm.get_process_triple(),
    )


class ObjectCache:
    """A cache of objects in one folder, with a limit on the total size.

    If the limit is exceeded, the least recently used objects are removed.  Any number of threads
    and processes may use the same folder at once.

    Attributes:
        folder: The folder; by default the value of the environment variable PINRED_CACHE_DIR, or
            the user's cache folder if the variable is not set.  It is created at the first write.
        limit: Maximum total size of all entries [bytes].
    """

    def __init__(
        self, folder: Path | None = None, limit: int = LIMIT, *, silent: bool = False
    ) -> None:
        """Set the folder and the limit without accessing the disk.

        Args:
            folder: The folder, or None for the default.
            limit: Maximum total size of all entries [bytes].
            silent: Whether faults cause no warning.
        Raises:
            InputError: The limit is negative.
        """
        if limit < 0:
            raise InputError(f"limit must be a number of bytes, zero or more, got {limit}")
        named = os.environ.get("PINRED_CACHE_DIR")
        self.folder = folder or (Path(named) if named else user_cache_path("pinred"))
        self.limit, self._silent = limit, silent

    def compile_ahead(
        self,
        key: str,
        divide: Callable[[], Sequence[Part]],
        join: Callable[[Sequence[bytes]], bytes],
        what: str,
    ) -> None:
        """Let other threads compile a missing object, which the next `get` of this process returns.

        With one processor, nothing is compiled ahead.

        Args:
            key: Key of the object.
            divide: Returns functions that each compile one part, the longest first; none if there
                is no object.
            join: Returns the object of all parts.
            what: What the object is, for the notice of a user who waits.
        """
        if not spare_processors() or (self.folder, key) in _ahead or self._has_entry(key):
            return
        parts = divide()
        if not parts:
            return
        store = ObjectCache(self.folder, self.limit, silent=True).put
        ahead = _ahead[self.folder, key] = ObjectAhead(parts, join, partial(store, key), what)
        begin_ahead(ahead)

    def get(self, key: str) -> bytes | None:
        """Read an object, or return it if it was compiled ahead.

        An entry that cannot be trusted is removed with a CacheWarning.  Entries of other signing
        keys are neither read nor removed.

        Args:
            key: Key of the object.
        Returns:
            The object, or None if there is no trusted entry.
        """
        _check_key(key)
        ahead = _ahead.pop((self.folder, key), None)
        code = None if ahead is None else ahead.result()
        if ahead is not None and code is not None:
            if not ahead.is_stored:
                self.put(key, code)
            return code
        with self._open(make=False) as folder:
            if folder is None:
                return None
            name = _file_name(key)
            try:
                return read_entry(folder, name, key)
            except FileNotFoundError:
                return None
            except (DistrustError, OSError) as why:
                _remove(folder, name)
                problem = why
        if name.endswith(f"{TEMPORARY}.o"):  # each process has warned that it cannot store its key
            return None
        _warn(f"'{self.folder / name}' is not used and is removed: {problem}")
        return None

    def _has_entry(self, key: str) -> bool:
        """Return whether there is an entry, which may be invalid."""
        with self._open(make=False) as folder:
            return folder is not None and os.access(_file_name(key), os.F_OK, dir_fd=folder)

    def put(self, key: str, code: bytes) -> bool:
        """Write an object.

        Writing is atomic: readers see either the previous entry or the complete new entry.  An
        object larger than the limit is not written.  A failure causes a CacheWarning, not an error.

        Args:
            key: Key of the object.
            code: The object.
        Returns:
            Whether it was written.
        """
        _check_key(key)
        if ENTRY_HEAD + len(code) > self.limit:
            return False
        try:
            with self._open(make=True) as folder:
                if folder is None:
                    return False
                write_entry(folder, _file_name(key), key, code)
                self._trim(folder, ENTRY_HEAD + len(code))
        except OSError as error:
            self._warn_once("write", f"compiled code is not stored in '{self.folder}': {error}")
            return False
        return True

    def get_or_compile(self, key: str, compile_code: Callable[[], bytes], what: str) -> bytes:
        """Read an object; if it is missing, compile and write it.

        Args:
            key: Key of the object.
            compile_code: Function that compiles the object.
            what: What the object is, for the notice of a user who waits.
        Returns:
            The object.
        """
        code = self.get(key)
        if code is None:
            with notice_of_compiling(what):
                code = compile_code()
            self.put(key, code)
        return code

    def entries(self) -> list[CacheEntry]:
        """Return the entries, the least recently used first."""
        with self._open(make=False) as folder:
            return [] if folder is None else _entries(folder)

    def clear(self) -> int:
        """Remove all entries and return their number."""
        with self._open(make=False) as folder:
            if folder is None:
                return 0
            sweep(folder)
            return sum(_remove(folder, entry.file) for entry in _entries(folder))

    def _trim(self, folder: int, written: int) -> None:
        """Remove old entries above the limit; list the folder only if the limit may be exceeded."""
        folder_limit = (self.folder, self.limit)
        _room[folder_limit] = _room.get(folder_limit, 0) - written
        if _room[folder_limit] >= 0:
            return
        entries = _entries(folder)
        total = sum(entry.size for entry in entries)
        # Remove more than necessary, because listing a full folder at every put would be slow.
        target = self.limit if total <= self.limit else self.limit - self.limit // 16
        for entry in entries:
            if total <= target:
                break
            if _remove(folder, entry.file):
                total -= entry.size
        _room[folder_limit] = (self.limit - total) // _WRITERS

    @contextmanager
    def _open(self, *, make: bool) -> Iterator[int | None]:
        """Open and check the folder; all later accesses use its descriptor.

        Args:
            make: Whether to create a missing folder.
        Yields:
            A descriptor of the folder, or None if it is missing or cannot be trusted.
        Raises:
            OSError: The folder cannot be created.
        """
        if make:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        try:
            folder = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except FileNotFoundError:
            yield None
            return
        except OSError as error:
            self._warn_once("open", f"the cache '{self.folder}' is not used: {error}")
            yield None
            return
        try:
            why = find_distrust(os.fstat(folder))
            if why:
                self._warn_once(
                    "trust",
                    f"the cache '{self.folder}' is not used, it {why}; machine code is only "
                    "read where nobody else can write: chmod go-w, or set PINRED_CACHE_DIR",
                )
            elif above := find_open_parent(self.folder):
                self._warn_once("above", f"the cache '{self.folder}' is in {above}")
            yield None if why else folder
        finally:
            os.close(folder)

    def _warn_once(self, kind: str, text: str) -> None:
        about = (str(self.folder), kind)
        if about not in _warned and not self._silent:
            _warned.add(about)
            _warn(text)


def _warn(text: str) -> None:
    """Issue a CacheWarning that refers to the line which called the cache."""
    warnings.warn(text, CacheWarning, stacklevel=4)


def _check_key(key: str) -> None:
    if not _KEY.fullmatch(key):
        raise InputError(f"key: expected 64 hexadecimal digits, as from cache_key, got {key!r}")


def _file_name(key: str) -> str:
    """Return the name of an entry written with this user's signing key."""
    return f"{key}.{fingerprint()}.o"


def _remove(folder: int, name: str) -> bool:
    """Remove a file; return whether this process removed it."""
    try:
        os.unlink(name, dir_fd=folder)
    except OSError:
        return False
    return True


def _files(folder: int, pattern: re.Pattern[str]) -> Iterator[tuple[str, os.stat_result]]:
    """Yield name and status of the files that match; skip files deleted in the meantime."""
    with os.scandir(folder) as items:
        names = [item.name for item in items if pattern.fullmatch(item.name)]
    for name in names:
        with suppress(OSError):
            yield name, os.stat(name, dir_fd=folder, follow_symlinks=False)


def _entries(folder: int) -> list[CacheEntry]:
    entries = [
        CacheEntry(name[:64], status.st_size, status.st_mtime_ns / 1e9, name)
        for name, status in _files(folder, _ENTRY)
    ]
    return sorted(entries, key=lambda entry: entry.last_use)


Part = Callable[[], bytes]  # compiles one part


class ObjectAhead:
    """An object that several threads compile in parts.

    If another thread fails, there is no object.  The thread that needs it then compiles it alone,
    and raises the error.

    Attributes:
        is_stored: Whether another thread has stored the object.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        join: Callable[[Sequence[bytes]], bytes],
        store: Callable[[bytes], bool],
        what: str,
    ) -> None:
        """Set the functions that compile the object, without calling them.

        Args:
            parts: Functions that each compile one part, the longest first.
            join: Returns the object of all parts.
            store: Stores an object that no thread has requested yet; returns whether it is stored.
            what: What the object is, for the notice of a user who waits.
        """
        self.is_stored = False
        self._parts, self._join, self._store, self._what = parts, join, store, what
        self._lock, self._next, self._ended = Lock(), count(), Event()
        self._codes: dict[int, bytes] = {}
        self._is_requested = self._has_failed = False

    def help(self) -> None:
        """Compile parts until all are begun; for other threads than the one that needs the object.

        Whoever compiles the last part of an object that is not requested yet stores it, so that
        code which is never needed is compiled once per machine.
        """
        try:
            is_last = self._compile_parts()
            if is_last and not self._is_requested:
                self.is_stored = self._store(self._joined())
        except Exception:
            self._has_failed = True
            self._ended.set()

    def result(self) -> bytes | None:
        """Compile the parts that no thread has begun, wait for the others, and return the object.

        Returns:
            The object, or None if another thread could not compile its part.
        """
        self._is_requested = True
        with notice_of_compiling(self._what):
            self._compile_parts()
            self._ended.wait()
        return None if self._has_failed else self._joined()

    def _compile_parts(self) -> bool:
        """Compile parts until all are begun; return whether the last one ended here."""
        is_last = False
        while (k := next(self._next)) < len(self._parts):
            code = self._parts[k]()
            with self._lock:
                self._codes[k] = code
                is_last = len(self._codes) == len(self._parts)
        if is_last:
            self._ended.set()
        return is_last

    def _joined(self) -> bytes:
        return self._join([self._codes[k] for k in range(len(self._codes))])


_LOCK = Lock()
_waiting: deque[ObjectAhead] = deque()
_workers: list[Thread] = []  # they end when no object is waiting


def begin_ahead(ahead: ObjectAhead) -> None:
    """Let other threads compile an object, after those that are waiting already.

    Args:
        ahead: The object.
    """
    with _LOCK:
        _waiting.append(ahead)
        if len(_workers) >= spare_processors():
            return
        worker = Thread(target=_work, name="pinred compiles ahead")
        _workers.append(worker)
    try:
        worker.start()
    except RuntimeError:  # the process ends, or has too many threads
        with _LOCK:
            _workers.remove(worker)


def _work() -> None:
    """Compile objects until none is waiting."""
    while True:
        with _LOCK:
            if not _waiting:
                _workers.remove(current_thread())
                return
            ahead = _waiting[0]
        ahead.help()
        with _LOCK:
            if _waiting and _waiting[0] is ahead:
                _waiting.popleft()


def wait_for_workers() -> None:
    """Wait until the other threads have ended."""
    for worker in tuple(_workers):
        worker.join()


# A forked process would have the locks that another thread holds, but not the thread.
os.register_at_fork(before=wait_for_workers)
