"""Entries of the cache are signed: who can write there cannot make machine code run."""

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
from pinred.common.errors import CacheWarning
from pinred.kernels import signing_key as signing_keys
from pinred.kernels.build import build_kernel
from pinred.kernels.object_cache import (
    _HEADER,
    _MAGIC,
    _SIGNATURE,
    _VERSION,
    ObjectCache,
    cache_key,
)
from pinred.simulation.plan import plan_of

KEY = cache_key("one")


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A home of its own, where the key is `pinred/cache_key`."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    signing_keys._load_key.cache_clear()
    yield tmp_path / "data"
    signing_keys._load_key.cache_clear()


def entry(payload: bytes, signature: bytes) -> bytes:
    """An entry in the form that is read."""
    return _HEADER.pack(_MAGIC, _VERSION, KEY.encode(), len(payload)) + signature + payload


def test_a_forged_entry_is_not_used(tmp_path: Path, home: Path) -> None:
    """With a checksum, with nothing, or signed by another key; with the right one it would be."""
    cache = ObjectCache(tmp_path / "cache")
    cache.put(KEY, b"mine")
    file = tmp_path / f"cache/{KEY}.o"
    header, forged = _HEADER.pack(_MAGIC, _VERSION, KEY.encode(), 6), b"forged"
    for signature in (
        sha256(forged).digest(), sha256(header + forged).digest(), bytes(_SIGNATURE),
        hmac.digest(b"", header + forged, "sha256"),
    ):  # fmt: skip
        file.write_bytes(entry(forged, signature))
        with pytest.warns(CacheWarning, match="signature is not this user's"):
            assert cache.get(KEY) is None
        cache.put(KEY, b"mine")
        assert cache.get(KEY) == b"mine"
    key = (home / "pinred/cache_key").read_bytes()
    file.write_bytes(entry(forged, hmac.digest(key, header + forged, "sha256")))
    assert cache.get(KEY) == forged


def test_a_forged_kernel_is_rebuilt(tmp_path: Path) -> None:
    """The one of another user (that is, of another key) is compiled anew, and runs."""
    cat, cache = pinred.load("falling_cat"), ObjectCache(tmp_path / "cache")
    plan = plan_of(pinred.Scene(system=cat))
    structure = plan.kind(zero_momentum=False).structure
    build_kernel(cat, structure, cache=cache)
    (kept,) = cache.entries()
    (tmp_path / "data/pinred/cache_key").unlink()
    signing_keys._load_key.cache_clear()
    with pytest.warns(CacheWarning, match="signature is not this user's"):
        build_kernel(cat, structure, cache=cache)
    assert [found.key for found in cache.entries()] == [kept.key]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build_kernel(cat, structure, cache=cache)


def test_the_key_is_private_and_stays(home: Path) -> None:
    """Mode 0600 in a folder of mode 0700; another process finds the same."""
    key = signing_keys.signing_key()
    file = home / "pinred/cache_key"
    assert file.read_bytes() == key
    assert len(key) == 32
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
    assert os.listdir(file.parent) == ["cache_key"]
    signing_keys._load_key.cache_clear()
    assert signing_keys.signing_key() == key


@pytest.mark.parametrize("fault", ["readable", "short", "link"])
def test_a_key_that_is_no_secret_is_replaced(home: Path, fault: str) -> None:
    """With a word."""
    key = signing_keys.signing_key()
    file = home / "pinred/cache_key"
    if fault == "readable":
        file.chmod(0o644)
    elif fault == "short":
        file.write_bytes(key[:-1])
    else:
        file.rename(home / "other")
        file.symlink_to(home / "other")
    signing_keys._load_key.cache_clear()
    with pytest.warns(CacheWarning, match="was not private"):
        new = signing_keys.signing_key()
    assert new != key
    assert not file.is_symlink()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_without_a_place_for_the_key(home: Path, tmp_path: Path) -> None:
    """It is made for this process, which is said; entries of this process still serve it."""
    home.write_bytes(b"a file where a folder should be")
    cache = ObjectCache(tmp_path / "cache")
    with pytest.warns(CacheWarning, match="cannot be kept in"):
        cache.put(KEY, b"mine")
    assert cache.get(KEY) == b"mine"


def test_a_cache_below_a_folder_of_everyone_is_told(tmp_path: Path) -> None:
    """Once, with the folder; not where it is sticky."""
    (tmp_path / "open/own").mkdir(parents=True)
    (tmp_path / "open").chmod(0o777)
    cache = ObjectCache(tmp_path / "open/own/cache")
    with pytest.warns(CacheWarning, match=r"lies in '.*/open', where everyone can write"):
        cache.put(KEY, b"mine")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cache.get(KEY) == b"mine"
        (tmp_path / "open").chmod(0o1777)
        other = ObjectCache(tmp_path / "open/own/cache2")
        other.put(KEY, b"mine")
        assert other.get(KEY) == b"mine"
