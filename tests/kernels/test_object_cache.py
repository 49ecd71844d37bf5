"""Tests of the kernel cache: it returns no damaged or foreign code and never raises an error."""

from __future__ import annotations

import multiprocessing
import os
import stat
import warnings
from pathlib import Path

import pytest

from pinred.common import object_cache
from pinred.common.errors import CacheWarning, InputError
from pinred.common.files import fingerprint
from pinred.common.object_cache import CacheEntry, ObjectCache, cache_key

KEY, OTHER = cache_key("one"), cache_key("two")
CODE = bytes(range(256)) * 9
HEADER = 8 + 4 + 64 + 8 + 32


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a missing folder in a missing parent."""
    return tmp_path / "deep" / "cache"


@pytest.fixture
def filled(folder: Path) -> tuple[ObjectCache, Path]:
    """Return a cache with one entry, and its file."""
    cache = ObjectCache(folder)
    cache.put(KEY, CODE)
    return cache, folder / f"{KEY}.{fingerprint()}.o"


def test_get_returns_what_put_wrote(folder: Path) -> None:
    """Objects are read unchanged, also by another ObjectCache."""
    cache = ObjectCache(folder)
    assert cache.get(KEY) is None
    assert cache.entries() == []
    assert cache.clear() == 0
    assert not folder.exists()
    cache.put(KEY, CODE)
    cache.put(OTHER, b"")
    assert ObjectCache(folder).get(KEY) == CODE
    assert cache.get(OTHER) == b""
    cache.put(KEY, b"new")
    assert cache.get(KEY) == b"new"
    assert [entry.size for entry in cache.entries()] == [HEADER, HEADER + 3]
    assert {entry.key for entry in cache.entries()} == {KEY, OTHER}
    assert cache.clear() == 2
    assert cache.get(KEY) is None
    assert list(folder.iterdir()) == []


def test_default_folder_is_environment_or_user_cache(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """PINRED_CACHE_DIR names the folder; otherwise the user's cache folder is used."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path / "named"))
    assert ObjectCache().folder == tmp_path / "named"
    assert ObjectCache(tmp_path / "given").folder == tmp_path / "given"
    monkeypatch.delenv("PINRED_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert ObjectCache().folder.name == "pinred"
    assert tmp_path in ObjectCache().folder.parents


def test_cache_key_distinguishes_parts() -> None:
    """A key distinguishes the division into parts, and text from bytes."""
    keys = [
        cache_key(*parts)
        for parts in [(), ("",), ("", ""), ("ab",), ("a", "b"), (b"ab",), ("b", "a"), ("é",)]
    ]
    assert len(set(keys)) == len(keys)
    assert all(len(key) == 64 and set(key) <= set("0123456789abcdef") for key in keys)
    assert cache_key("a", b"b") == cache_key("a", b"b")


def test_cache_rejects_invalid_keys_and_limits(folder: Path) -> None:
    """A key cannot name a file elsewhere, and a limit cannot be negative."""
    cache = ObjectCache(folder)
    for key in ("", "a" * 63, "../" + "a" * 61, "A" * 64, "a" * 64 + "\n", "a" * 63 + "/"):
        with pytest.raises(InputError, match="64 hexadecimal"):
            cache.get(key)
        with pytest.raises(InputError, match="64 hexadecimal"):
            cache.put(key, CODE)
    with pytest.raises(InputError, match="limit"):
        ObjectCache(folder, -1)


def test_entries_are_private(filled: tuple[ObjectCache, Path]) -> None:
    """Files have mode 0600 and the folder 0700."""
    _, file = filled
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700


def assert_rejected(cache: ObjectCache, file: Path, match: str) -> None:
    """Check that an entry is rejected with a warning, removed, and can be written again."""
    with pytest.warns(CacheWarning, match=match):
        assert cache.get(KEY) is None
    assert not os.path.lexists(file)
    assert cache.get(KEY) is None
    cache.put(KEY, CODE)
    assert cache.get(KEY) == CODE


# Positions in magic, version, key, length, signature, payload and its last byte.
@pytest.mark.parametrize("at", [0, 7, 8, 12, 75, 76, 83, 84, 115, HEADER, HEADER + 1000, -1])
@pytest.mark.parametrize("bit", [1, 128])
def test_get_rejects_entry_with_wrong_bit(
    filled: tuple[ObjectCache, Path], at: int, bit: int
) -> None:
    """A single wrong bit at any position invalidates the entry."""
    cache, file = filled
    data = bytearray(file.read_bytes())
    data[at] ^= bit
    file.write_bytes(data)
    assert_rejected(cache, file, KEY)


@pytest.mark.parametrize("length", [0, 1, HEADER - 1, HEADER, HEADER + 1, HEADER + 2303])
def test_get_rejects_truncated_entry(filled: tuple[ObjectCache, Path], length: int) -> None:
    """A truncated file is rejected."""
    cache, file = filled
    file.write_bytes(file.read_bytes()[:length])
    assert_rejected(cache, file, "truncated|length")


def test_get_rejects_foreign_entries(filled: tuple[ObjectCache, Path]) -> None:
    """Extra bytes, a foreign file, a later format and another key's object are rejected."""
    cache, file = filled
    data = file.read_bytes()
    file.write_bytes(data + b"x")
    assert_rejected(cache, file, "length")
    file.write_bytes(b"\x7fELF" + bytes(5000))
    assert_rejected(cache, file, "not written by pinred")
    file.write_bytes(data[:8] + (3).to_bytes(4, "little") + data[12:])
    assert_rejected(cache, file, "format is 3")
    cache.put(OTHER, CODE)
    (file.parent / f"{OTHER}.{fingerprint()}.o").rename(file)
    assert_rejected(cache, file, "another key")


def test_get_rejects_links_pipes_and_folders(
    filled: tuple[ObjectCache, Path], tmp_path: Path
) -> None:
    """A link to a valid entry is not followed, and a pipe does not block."""
    cache, file = filled
    target = tmp_path / "target"
    file.rename(target)
    file.symlink_to(target)
    assert_rejected(cache, file, KEY)
    assert target.read_bytes()[HEADER:] == CODE
    file.unlink()
    os.mkfifo(file)
    assert_rejected(cache, file, "regular file")
    file.unlink()
    file.mkdir()
    with pytest.warns(CacheWarning, match="regular file"):
        assert cache.get(KEY) is None
    with pytest.warns(CacheWarning, match="not stored"):
        cache.put(KEY, CODE)
    assert [child.name for child in file.parent.iterdir()] == [file.name]


def test_get_rejects_files_writable_by_others(filled: tuple[ObjectCache, Path]) -> None:
    """Files and folders are rejected; the folder causes one warning."""
    cache, file = filled
    file.chmod(0o620)
    assert_rejected(cache, file, "written by others")
    file.parent.chmod(0o777)
    with pytest.warns(CacheWarning, match=r"written by others \(mode 0777\)"):
        assert cache.get(KEY) is None
    cache.put(OTHER, CODE)
    assert ObjectCache(cache.folder).get(KEY) is None
    assert cache.entries() == []
    assert cache.clear() == 0
    file.parent.chmod(0o755)
    assert cache.get(KEY) == CODE
    assert cache.get(OTHER) is None


def test_get_rejects_files_of_other_users(
    filled: tuple[ObjectCache, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For another user, folder and files are foreign."""
    cache, file = filled
    monkeypatch.setattr(os, "geteuid", lambda: file.stat().st_uid + 1)
    with pytest.warns(CacheWarning, match="belongs to user"):
        assert cache.get(KEY) is None
    cache.put(OTHER, CODE)
    assert len(list(file.parent.iterdir())) == 1


def test_cache_in_unusable_folder_warns_once(tmp_path: Path) -> None:
    """A file instead of the folder, or above it, causes one warning and no error."""
    (tmp_path / "file").write_bytes(b"")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        cache = ObjectCache(folder)
        with pytest.warns(CacheWarning, match="not stored|not used"):
            cache.put(KEY, CODE)
        cache.put(KEY, CODE)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CacheWarning)
            assert cache.get(KEY) is None
            assert cache.clear() == 0
        assert cache.entries() == []


@pytest.mark.parametrize("call", ["write", "fsync", "replace", "open"])
def test_put_on_full_disk_keeps_old_entry(
    filled: tuple[ObjectCache, Path], call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failed write warns once, keeps the old entry, and leaves no temporary file."""
    cache, file = filled

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    real = os.open
    if call == "write":
        monkeypatch.setattr(os, "fdopen", full)
    elif call == "open":
        monkeypatch.setattr(
            os, "open", lambda *a, **k: full() if a[1] & os.O_CREAT else real(*a, **k)
        )
    else:
        monkeypatch.setattr(os, call, full)
    with pytest.warns(CacheWarning, match="No space left"):
        cache.put(KEY, b"new")
    cache.put(OTHER, b"new")
    monkeypatch.undo()
    assert [child.name for child in file.parent.iterdir()] == [file.name]
    assert cache.get(KEY) == CODE


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is forbidden to root")
def test_cache_without_permission(filled: tuple[ObjectCache, Path]) -> None:
    """A read-only folder is read; a folder without access is not used."""
    cache, file = filled
    file.parent.chmod(0o500)
    assert cache.get(KEY) == CODE
    with pytest.warns(CacheWarning, match="not stored"):
        cache.put(OTHER, CODE)
    file.parent.chmod(0o000)
    with pytest.warns(CacheWarning, match="not used"):
        assert cache.get(KEY) is None
    file.parent.chmod(0o700)


def test_put_removes_least_recently_used(folder: Path) -> None:
    """The total size stays within the limit; the last use counts, not the age."""
    keys = [cache_key(str(k)) for k in range(6)]
    cache = ObjectCache(folder, limit=3 * (HEADER + 100) + 50)
    for age, key in enumerate(keys[:3]):
        cache.put(key, bytes(100))
        os.utime(folder / f"{key}.{fingerprint()}.o", (1000.0 + age, 1000.0 + age))
    assert [entry.key for entry in cache.entries()] == keys[:3]
    assert cache.get(keys[0]) == bytes(100)
    assert [entry.key for entry in cache.entries()] == [keys[1], keys[2], keys[0]]
    cache.put(keys[3], bytes(100))
    assert {entry.key for entry in cache.entries()} == {keys[2], keys[0], keys[3]}
    cache.put(keys[4], bytes(250))
    assert keys[4] in {entry.key for entry in cache.entries()}
    assert sum(entry.size for entry in cache.entries()) <= cache.limit
    before = cache.entries()
    cache.put(keys[5], bytes(cache.limit))
    assert cache.entries() == before
    ObjectCache(folder, limit=0).put(keys[5], b"")
    assert cache.entries() == before


def test_put_lists_full_folder_rarely(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Few puts list the folder, and the total size stays within the limit."""
    listed: list[int] = []
    entries = object_cache._entries

    def counted(at: int) -> list[CacheEntry]:
        listed.append(at)
        return entries(at)

    monkeypatch.setattr(object_cache, "_entries", counted)
    limit = 120 * (HEADER + 100)
    for k in range(200):
        ObjectCache(folder, limit=limit).put(cache_key(str(k)), bytes(100))
        assert sum(file.stat().st_size for file in folder.iterdir()) <= limit
    assert len(listed) < 130
    assert sum(file.stat().st_size for file in folder.iterdir()) > 0.9 * limit


def test_put_removes_leftovers_and_keeps_foreign_files(filled: tuple[ObjectCache, Path]) -> None:
    """Temporary files of dead processes are removed; foreign files stay."""
    cache, file = filled
    left = file.parent / f".pinred-{'a' * 16}.tmp"
    stranger = file.parent / "notes.txt"
    for path in (left, stranger):
        path.write_bytes(b"x")
    assert len(cache.entries()) == 1
    cache.put(OTHER, CODE)
    assert not left.exists()
    left.write_bytes(b"x")
    assert cache.clear() == 2
    assert {path.name for path in file.parent.iterdir()} == {stranger.name}


def contend(folder: Path, seed: int) -> int:
    """Put, get and clear two keys many times; return the number of successful reads."""
    warnings.simplefilter("error")
    cache = ObjectCache(folder, limit=2**20)
    found = 0
    for k in range(150):
        key = (KEY, OTHER)[k % 2]
        if k % 37 == seed:
            cache.clear()
        cache.put(key, key.encode() * 500)
        code = cache.get(key)
        assert code is None or code == key.encode() * 500
        found += code is not None
        cache.entries()
    return found


@pytest.mark.slow
def test_concurrent_processes_see_complete_entries(folder: Path) -> None:
    """Processes that use the same keys see neither fractions nor warnings."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        found = pool.starmap(contend, [(folder, seed) for seed in range(2)])
    assert min(found) > 0
    assert not list(folder.glob(".*.tmp"))
    assert len(ObjectCache(folder).entries()) <= 2
