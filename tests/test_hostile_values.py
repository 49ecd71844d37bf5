"""Values and files beyond what a computer can represent give an error of pinred."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hostile_calls
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


@pytest.mark.parametrize("every", [11, pytest.param(1, marks=pytest.mark.by_hand)])
def test_public_callables_raise_no_foreign_exceptions(every: int) -> None:
    """Values of a right kind that are empty, huge, ragged or unknown give errors of pinred."""
    faults, count = hostile_calls.faults(every, 3)
    assert not faults, "\n".join(faults[:20])
    assert count * every > 30_000


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("Flow.own", "name", "a"),
        ("Flow.casadi", "name", "/x"),
        ("Phase.in_words", "pose", ()),
        ("_SE3.turned", "v", ()),
        ("_SE3.turned_back", "attitude", 0),
        ("_SE3.about", "c", 1.5),
        ("pinred.Gait", "arcs", range(3)),
        ("pinred.phase_slopes", "pieces", hostile_calls.HUGE),
        ("pinred.signals.Attitude", "vector", np.zeros((3, 0))),
        ("Connection.in_section", "pose", int),
        ("Reduction.change_section", "h", int),
        ("Gait.samples", "count", hostile_calls.HUGE),
        ("pinred.flatness", "samples", hostile_calls.HUGE),
        ("Connection.seen_from", "link", "\ud800"),
        ("Trajectories.fields", "names", ["a"]),
        ("Grid.at", "u", [float("nan")]),
        ("Uniform.at", "u", ()),
        ("StepMap.linear", "t", 1e300),
        ("pinred.load", "lock", {"\ud800": 0.0}),
    ],
)
@pytest.mark.sampled(3)
def test_calls_that_were_tracebacks_are_refused_or_sensible(
    name: str, key: str, value: object
) -> None:
    """The trial of all callables contains these calls, or similar ones."""
    call = dict(hostile_calls.callables())[name]
    needed = {
        other: hostile_calls.valid()[other]
        for other, entry in hostile_calls.parameters_of(call).items()
        if entry.default is entry.empty and entry.kind is entry.POSITIONAL_OR_KEYWORD
    }
    assert hostile_calls.attempt(call, {**needed, key: value}) == ""
    # An unpatched callable that raises is noticed.
    assert hostile_calls.attempt(_fail, {"value": 1}) == "KeyError: 1"


def _fail(value: object) -> None:
    raise KeyError(value)
