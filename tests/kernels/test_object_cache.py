"""The cache of machine code: nothing damaged or foreign comes out of it, nothing stops it."""

from __future__ import annotations

import multiprocessing
import os
import stat
import warnings
from pathlib import Path

import pytest

from pinred.common.errors import CacheWarning, InputError
from pinred.kernels import object_cache
from pinred.kernels.object_cache import CacheEntry, ObjectCache, cache_key

KEY, OTHER = cache_key("one"), cache_key("two")
CODE = bytes(range(256)) * 9
HEADER = 8 + 4 + 64 + 8 + 32


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder that does not exist yet, in one that does."""
    return tmp_path / "deep" / "cache"


@pytest.fixture
def filled(folder: Path) -> tuple[ObjectCache, Path]:
    """Return a cache with one entry, and its file."""
    cache = ObjectCache(folder)
    cache.put(KEY, CODE)
    return cache, folder / f"{KEY}.o"


def test_what_is_put_is_got(folder: Path) -> None:
    """Objects come back as they were, from another ObjectCache too."""
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


def test_default_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The environment names the folder, or else the user's own for caches is taken."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path / "named"))
    assert ObjectCache().folder == tmp_path / "named"
    assert ObjectCache(tmp_path / "given").folder == tmp_path / "given"
    monkeypatch.delenv("PINRED_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert ObjectCache().folder.name == "pinred"
    assert tmp_path in ObjectCache().folder.parents


def test_keys() -> None:
    """A key tells parts apart, and text from bytes."""
    keys = [
        cache_key(*parts)
        for parts in [(), ("",), ("", ""), ("ab",), ("a", "b"), (b"ab",), ("b", "a"), ("é",)]
    ]
    assert len(set(keys)) == len(keys)
    assert all(len(key) == 64 and set(key) <= set("0123456789abcdef") for key in keys)
    assert cache_key("a", b"b") == cache_key("a", b"b")


def test_bad_arguments(folder: Path) -> None:
    """A key that is none cannot name a file elsewhere; a limit is not negative."""
    cache = ObjectCache(folder)
    for key in ("", "a" * 63, "../" + "a" * 61, "A" * 64, "a" * 64 + "\n", "a" * 63 + "/"):
        with pytest.raises(InputError, match="64 hexadecimal"):
            cache.get(key)
        with pytest.raises(InputError, match="64 hexadecimal"):
            cache.put(key, CODE)
    with pytest.raises(InputError, match="limit"):
        ObjectCache(folder, -1)


def test_only_the_owner_may_read_and_write(filled: tuple[ObjectCache, Path]) -> None:
    """Files have mode 0600 and the folder 0700."""
    _, file = filled
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700


def rejected(cache: ObjectCache, file: Path, match: str) -> None:
    """Check that an entry is refused with a warning, removed, and can be made anew."""
    with pytest.warns(CacheWarning, match=match):
        assert cache.get(KEY) is None
    assert not os.path.lexists(file)
    assert cache.get(KEY) is None
    cache.put(KEY, CODE)
    assert cache.get(KEY) == CODE


# In the magic, the version, the key, the length, the checksum, the payload and its last byte.
@pytest.mark.parametrize("at", [0, 7, 8, 12, 75, 76, 83, 84, 115, HEADER, HEADER + 1000, -1])
@pytest.mark.parametrize("bit", [1, 128])
def test_one_wrong_bit(filled: tuple[ObjectCache, Path], at: int, bit: int) -> None:
    """One bit anywhere, and the entry is gone."""
    cache, file = filled
    data = bytearray(file.read_bytes())
    data[at] ^= bit
    file.write_bytes(data)
    rejected(cache, file, KEY)


@pytest.mark.parametrize("length", [0, 1, HEADER - 1, HEADER, HEADER + 1, HEADER + 2303])
def test_cut_off(filled: tuple[ObjectCache, Path], length: int) -> None:
    """A file that ends too early."""
    cache, file = filled
    file.write_bytes(file.read_bytes()[:length])
    rejected(cache, file, "cut off|length")


def test_too_long_foreign_and_of_another_format(filled: tuple[ObjectCache, Path]) -> None:
    """Bytes at the end, a file of something else, a format to come, another key's object."""
    cache, file = filled
    data = file.read_bytes()
    file.write_bytes(data + b"x")
    rejected(cache, file, "length")
    file.write_bytes(b"\x7fELF" + bytes(5000))
    rejected(cache, file, "not written by pinred")
    file.write_bytes(data[:8] + (3).to_bytes(4, "little") + data[12:])
    rejected(cache, file, "format is 3")
    cache.put(OTHER, CODE)
    (file.parent / f"{OTHER}.o").rename(file)
    rejected(cache, file, "another key")


def test_links_pipes_and_folders_are_not_read(
    filled: tuple[ObjectCache, Path], tmp_path: Path
) -> None:
    """No link is followed, though what it points to is in order; a pipe does not block."""
    cache, file = filled
    target = tmp_path / "target"
    file.rename(target)
    file.symlink_to(target)
    rejected(cache, file, KEY)
    assert target.read_bytes()[HEADER:] == CODE
    file.unlink()
    os.mkfifo(file)
    rejected(cache, file, "plain file")
    file.unlink()
    file.mkdir()
    with pytest.warns(CacheWarning, match="plain file"):
        assert cache.get(KEY) is None
    with pytest.warns(CacheWarning, match="not kept"):
        cache.put(KEY, CODE)
    assert [child.name for child in file.parent.iterdir()] == [file.name]


def test_what_others_can_write_is_not_trusted(filled: tuple[ObjectCache, Path]) -> None:
    """Neither a file nor a folder; of the folder it is said once."""
    cache, file = filled
    file.chmod(0o620)
    rejected(cache, file, "written by others")
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


def test_what_belongs_to_others_is_not_trusted(
    filled: tuple[ObjectCache, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seen by another user, folder and files are foreign."""
    cache, file = filled
    monkeypatch.setattr(os, "geteuid", lambda: file.stat().st_uid + 1)
    with pytest.warns(CacheWarning, match="belongs to user"):
        assert cache.get(KEY) is None
    cache.put(OTHER, CODE)
    assert len(list(file.parent.iterdir())) == 1


def test_folder_that_cannot_be_used(tmp_path: Path) -> None:
    """A file in the place of the folder or above it: one warning, no error."""
    (tmp_path / "file").write_bytes(b"")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        cache = ObjectCache(folder)
        with pytest.warns(CacheWarning, match="not kept|not used"):
            cache.put(KEY, CODE)
        cache.put(KEY, CODE)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CacheWarning)
            assert cache.get(KEY) is None
            assert cache.clear() == 0
        assert cache.entries() == []


@pytest.mark.parametrize("call", ["write", "fsync", "replace", "open"])
def test_full_disk(
    filled: tuple[ObjectCache, Path], call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What cannot be written is said once; what was there stays, and no part is left over."""
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
def test_folder_without_permission(filled: tuple[ObjectCache, Path]) -> None:
    """A folder that may only be read still serves; one that may not be entered does not."""
    cache, file = filled
    file.parent.chmod(0o500)
    assert cache.get(KEY) == CODE
    with pytest.warns(CacheWarning, match="not kept"):
        cache.put(OTHER, CODE)
    file.parent.chmod(0o000)
    with pytest.warns(CacheWarning, match="not used"):
        assert cache.get(KEY) is None
    file.parent.chmod(0o700)


def test_least_recently_used_goes_first(folder: Path) -> None:
    """The sum of all entries stays within the limit; use is what counts, not age."""
    keys = [cache_key(str(k)) for k in range(6)]
    cache = ObjectCache(folder, limit=3 * (HEADER + 100) + 50)
    for age, key in enumerate(keys[:3]):
        cache.put(key, bytes(100))
        os.utime(folder / f"{key}.o", (1000.0 + age, 1000.0 + age))
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


def test_a_full_folder_is_not_listed_at_every_put(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One put in some lists it, however full; the sum of all stays within the limit even so."""
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


def test_leftovers_and_strangers(filled: tuple[ObjectCache, Path]) -> None:
    """What a dead process began is removed by the next put; files that are none of ours stay."""
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
    """Put, get and clear two keys many times; return how often one was found."""
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
def test_processes_at_once(folder: Path) -> None:
    """Processes that put, get and clear the same keys never see a part, nor a warning."""
    with multiprocessing.get_context("spawn").Pool(4) as pool:
        found = pool.starmap(contend, [(folder, seed) for seed in range(4)])
    assert min(found) > 0
    assert not list(folder.glob(".*.tmp"))
    assert len(ObjectCache(folder).entries()) <= 2
