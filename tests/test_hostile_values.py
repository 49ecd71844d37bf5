"""Values and files beyond what a computer can represent give an error of pinred."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.laboratory.corpus.run_corpus import corpus

FILES: dict[str, bytes] = {
    "empty.csv": b"",
    "header.csv": b"t,a,b\n",
    "binary.csv": bytes(range(256)),
    "field.csv": b"t,a\n0," + b"1" * 200_000 + b"\n",
    "quotes.csv": b't,"' + b"a" * 200_000,
    "ragged.csv": b"t,a\n0,1\n1\n",
    "junk.npz": b"PK\x03\x04 not an archive",
    "text.npz": b"t,a\n0,1\n",
    "empty.npz": b"",
}
TENSORS: list[tuple[str, Callable[[], Any]]] = [
    ("length", lambda: pinred.Rod(1e200, 1.0, 1.0)),
    ("across", lambda: pinred.Rod(1e100, 1e300, 1.0)),
    ("semi_axes", lambda: pinred.Ellipsoid((1e200, 1e200, 1e200))),
    ("semi_axes", lambda: pinred.Ellipsoid((1e-200, 1e200, 1.0))),
    ("a, b", lambda: pinred.Ellipse(1e200, 1.0)),
]


@pytest.mark.parametrize("name", FILES)
def test_hostile_gait_file_raises_load_error(name: str, tmp_path: Path) -> None:
    """Damaged and incomplete recordings are reported with the file."""
    path = tmp_path / name
    path.write_bytes(FILES[name])
    with pytest.raises(pinred.LoadError, match=f"cannot read joint data from .*{name}"):
        pinred.Gait.read(path)


def test_damaged_archive_raises_load_error(tmp_path: Path) -> None:
    """One changed byte of compressed data is detected by its checksum."""
    path = tmp_path / "gait.npz"
    np.savez_compressed(path, t=np.linspace(0.0, 1.0, 50), x=np.zeros((50, 2)))
    data = bytearray(path.read_bytes())
    data[100] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(pinred.LoadError, match="cannot read joint data"):
        pinred.Gait.read(path)


def test_gait_is_not_read_from_a_pipe(tmp_path: Path) -> None:
    """A pipe without a writer would wait forever."""
    path = tmp_path / "pipe.csv"
    os.mkfifo(path)
    with pytest.raises(pinred.LoadError, match="not a regular file"):
        pinred.Gait.read(path)


@pytest.mark.parametrize(("name", "make"), TENSORS)
def test_tensor_that_is_not_finite_is_rejected(name: str, make: Callable[[], Any]) -> None:
    """Sizes of which a power overflows are named."""
    with pytest.raises(pinred.InputError, match=f"{name}.*: expected values whose"):
        make()


def test_inertia_parameters_that_overflow_are_rejected() -> None:
    """Log-Cholesky parameters are logarithms, so 1000 is beyond the range of numbers."""
    huge = {"front.log_cholesky": [1000.0, *[0.0] * 9]}
    with pytest.raises(pinred.InputError, match="log_cholesky' is too large"):
        pinred.simulate(pinred.load("falling_cat"), parameters=huge, duration=0.1)


@pytest.mark.parametrize("patience", [1e300, np.inf, np.nan, 0.0])
def test_patience_beyond_the_clock_is_rejected(patience: float) -> None:
    """The operating system cannot wait that long."""
    with pytest.raises(pinred.InputError, match="patience: expected positive seconds"):
        corpus([], patience=patience)
