"""Tests of signed cache entries: users who can write into the cache cannot run machine code."""

from __future__ import annotations

import hmac
import os
import stat
import warnings
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

import pytest

import pinred
from pinred.common import files as signing_keys
from pinred.common.errors import CacheWarning
from pinred.common.object_cache import _HEADER, _MAGIC, _SIGNATURE, _VERSION, ObjectCache, cache_key
from pinred.kernels.build import build_kernel
from pinred.simulation.plan import plan_of

KEY = cache_key("one")


@pytest.fixture(autouse=True)
def data_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Use a private data folder, in which the key is `pinred/cache_key`."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    signing_keys._load_key.cache_clear()
    yield tmp_path / "data"
    signing_keys._load_key.cache_clear()


def format_entry(payload: bytes, signature: bytes) -> bytes:
    """Return an entry in the file format of the cache."""
    return _HEADER.pack(_MAGIC, _VERSION, KEY.encode(), len(payload)) + signature + payload


def test_get_rejects_forged_entry(tmp_path: Path, data_home: Path) -> None:
    """Entries with a checksum, no signature or a wrong key are rejected; a signed one is read."""
    cache = ObjectCache(tmp_path / "cache")
    cache.put(KEY, b"mine")
    file = tmp_path / f"cache/{KEY}.{signing_keys.fingerprint()}.o"
    header, forged = _HEADER.pack(_MAGIC, _VERSION, KEY.encode(), 6), b"forged"
    for signature in (
        sha256(forged).digest(), sha256(header + forged).digest(), bytes(_SIGNATURE),
        hmac.digest(b"", header + forged, "sha256"),
    ):  # fmt: skip
        file.write_bytes(format_entry(forged, signature))
        with pytest.warns(CacheWarning, match="signature is not this user's"):
            assert cache.get(KEY) is None
        cache.put(KEY, b"mine")
        assert cache.get(KEY) == b"mine"
    key = (data_home / "pinred/cache_key").read_bytes()
    file.write_bytes(format_entry(forged, hmac.digest(key, header + forged, "sha256")))
    assert cache.get(KEY) == forged


def test_kernel_signed_by_other_key_is_compiled_silently(tmp_path: Path) -> None:
    """A kernel with a foreign signature is compiled again without a warning, and runs."""
    cat, cache = pinred.load("falling_cat"), ObjectCache(tmp_path / "cache")
    plan = plan_of(pinred.Scene(system=cat))
    structure = plan.structure(zero_momentum=False)
    build_kernel(cat, structure, cache=cache)
    (kept,) = cache.entries()
    (tmp_path / "data/pinred/cache_key").unlink()
    signing_keys._load_key.cache_clear()
    build_kernel(cat, structure, cache=cache)
    entries = cache.entries()
    assert [entry.key for entry in entries] == [kept.key] * 2
    assert kept.file in {entry.file for entry in entries}
    written = [(tmp_path / "cache" / entry.file).stat().st_ino for entry in entries]
    build_kernel(cat, structure, cache=cache)
    assert sorted(written) == sorted(
        (tmp_path / "cache" / entry.file).stat().st_ino for entry in cache.entries()
    )


def test_data_homes_sharing_a_cache_keep_their_entries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each home reads its own entry and leaves the other's; a damaged own entry is reported."""
    cache, homes = ObjectCache(tmp_path / "cache"), ("one", "two")
    for home in homes:
        monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / home))
        assert cache.get(KEY) is None
        cache.put(KEY, home.encode())
    for home in homes:
        monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / home))
        assert cache.get(KEY) == home.encode()
    file = tmp_path / "cache" / f"{KEY}.{signing_keys.fingerprint()}.o"
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    with pytest.warns(CacheWarning, match="it is damaged"):
        assert cache.get(KEY) is None
    assert not file.exists()
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "one"))
    assert cache.get(KEY) == b"one"
    assert cache.clear() == 1


def test_fingerprint_reveals_no_part_of_the_key() -> None:
    """The fingerprint is a digest under the key, and no substring of it."""
    key = signing_keys.signing_key()
    assert signing_keys.fingerprint() == hmac.digest(key, b"fingerprint", "sha256").hex()[:16]
    assert signing_keys.fingerprint() not in key.hex()


def test_signing_key_is_private_and_persistent(data_home: Path) -> None:
    """The key has mode 0600 in a folder of mode 0700 and is read by other processes."""
    key = signing_keys.signing_key()
    file = data_home / "pinred/cache_key"
    assert file.read_bytes() == key
    assert len(key) == 32
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
    assert os.listdir(file.parent) == ["cache_key"]
    signing_keys._load_key.cache_clear()
    assert signing_keys.signing_key() == key


@pytest.mark.parametrize("fault", ["readable", "short", "link"])
def test_signing_key_not_private_is_replaced(data_home: Path, fault: str) -> None:
    """A readable, short or linked key is replaced with a warning."""
    key = signing_keys.signing_key()
    file = data_home / "pinred/cache_key"
    if fault == "readable":
        file.chmod(0o644)
    elif fault == "short":
        file.write_bytes(key[:-1])
    else:
        file.rename(data_home / "other")
        file.symlink_to(data_home / "other")
    signing_keys._load_key.cache_clear()
    with pytest.warns(CacheWarning, match="was not private"):
        new = signing_keys.signing_key()
    assert new != key
    assert not file.is_symlink()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_signing_key_unwritable_folder_uses_temporary_key(data_home: Path, tmp_path: Path) -> None:
    """The temporary key causes a warning and serves this process."""
    data_home.write_bytes(b"a file where a folder should be")
    cache = ObjectCache(tmp_path / "cache")
    with pytest.warns(CacheWarning, match="cannot be stored in"):
        cache.put(KEY, b"mine")
    assert cache.get(KEY) == b"mine"
    signing_keys._load_key.cache_clear()  # as in another process
    with pytest.warns(CacheWarning, match="cannot be stored in") as caught:
        assert cache.get(KEY) is None
    assert len(caught) == 1
    cache.put(KEY, b"yours")
    assert [entry.size for entry in cache.entries()] == [_HEADER.size + _SIGNATURE + 5]


def test_cache_below_world_writable_folder_warns(tmp_path: Path) -> None:
    """One warning names the folder; a sticky folder causes none."""
    (tmp_path / "open/own").mkdir(parents=True)
    (tmp_path / "open").chmod(0o777)
    cache = ObjectCache(tmp_path / "open/own/cache")
    with pytest.warns(CacheWarning, match=r"is in '.*/open', where everyone can write"):
        cache.put(KEY, b"mine")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cache.get(KEY) == b"mine"
        (tmp_path / "open").chmod(0o1777)
        other = ObjectCache(tmp_path / "open/own/cache2")
        other.put(KEY, b"mine")
        assert other.get(KEY) == b"mine"
