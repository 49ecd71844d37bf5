"""Inertias of SDF links that no rigid body has: read as the file states them, or refused."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.errors import LoadError, ModelError, ModelWarning
from pinred.system import sdf_document
from pinred.system.independent_reader import second_reading
from pinred.system.read_sdf import read_sdf

pytest.importorskip("pydrake")
POSE = ".3 -.2 .1 .4 -.7 1.1"


def text_of(moments: str, mass: str = "<mass>2</mass>") -> str:
    """Return a robot of two links, of which the second has the moments xx, yy, zz, xy."""
    keys = ("ixx", "iyy", "izz", "ixy")
    words = "".join(f"<{k}>{v}</{k}>" for k, v in zip(keys, moments.split(), strict=False))
    inertia = f"<inertia>{words}</inertia>" if moments else ""
    return (
        '<sdf version="1.9"><model name="m"><link name="a"/>\n<link name="b"><inertial>'
        f'<pose>{POSE}</pose>{mass}{inertia}</inertial></link><joint name="j" type="revolute">'
        "<parent>a</parent><child>b</child><axis><xyz>0 0 1</xyz></axis></joint></model></sdf>"
    )


@pytest.mark.parametrize(
    "moments", ["1 2 9", ".1 .2 .3000001", ".1 .1 .5 .05", ".1 .2 .3", "0 .4 .1"]
)
def test_moments_are_those_of_the_file(moments: str, tmp_path: Path) -> None:
    """Numbers of the file, turned by its pose; an impossible distribution is a warning."""
    xx, yy, zz, xy = (float(word) for word in f"{moments} 0".split()[:4])
    file = np.array([[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, zz]])
    values = np.array([float(word) for word in POSE.split()])
    R = pin.rpy.rpyToMatrix(values[3:])
    path = tmp_path / "robot.sdf"
    path.write_text(text_of(moments), "utf-8")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        inertia = pinred.load(path).model.inertias[2]
    assert inertia.mass == pytest.approx(2.0, rel=1e-14)
    assert np.abs(inertia.lever - values[:3]).max() < 1e-14
    assert np.abs(inertia.inertia - R @ file @ R.T).max() < 1e-13 * np.abs(file).max()
    p = np.linalg.eigvalsh(file)
    impossible = p[2] > p[0] + p[1] + 1e-12
    told = [str(w.message) for w in caught if w.category is ModelWarning]
    assert len(told) == impossible
    assert all("triangle inequality" in message for message in told)
    if impossible:
        with pytest.raises(ModelError, match="strict"):
            pinred.load(path, strict=True)
        reading = second_reading(path)
        assert reading is not None
        assert "Drake replaces inertias that no body has, of b" in reading.unread


@pytest.mark.parametrize(
    ("moments", "mass", "words"),
    [
        ("-.1 .2 .3", "<mass>2</mass>", "line 2: link 'b' has principal moments of inertia -0.1"),
        (
            "-2e-9 .5 1",
            "<mass>2</mass>",
            "line 2: link 'b' has principal moments of inertia -2e-09",
        ),
        (".1 .1 .1 .5", "<mass>2</mass>", "line 2: link 'b' has principal moments of inertia -0.4"),
        (".1 .2 .25", "<mass>0</mass>", "line 2: link 'b' has mass 0 and moments"),
        (".1 .2 .25", "<mass>-1</mass>", "line 2: link 'b' has mass -1 and moments"),
        (".1 .2 x", "<mass>1</mass>", "line 2: <izz>: expected 1 finite number, got 'x'"),
    ],
)
def test_negative_inertia_is_refused(moments: str, mass: str, words: str, tmp_path: Path) -> None:
    """The message names line, link and numbers."""
    path = tmp_path / "robot.sdf"
    path.write_text(text_of(moments, mass), "utf-8")
    with pytest.raises(LoadError, match=words):
        read_sdf(path)


def test_inertia_that_drake_replaces_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If Drake replaces moments for another reason, the sum of the moments shows it."""
    path = tmp_path / "robot.sdf"
    path.write_text(text_of("1 2 9"), "utf-8")
    monkeypatch.setattr(vars(sdf_document)["_Reader"], "_added_moment", lambda *_: (0.0, 12.0))
    with pytest.raises(
        ModelError, match="link 'b' has moments of inertia with the sum 12, but Drake"
    ):
        read_sdf(path)


def test_small_difference_of_moments_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sum that differs by 4e-9 of its terms is no round-off; one of 4e-10 is."""
    path = tmp_path / "robot.sdf"
    path.write_text(text_of("1 1.5 2"), "utf-8")
    size = 4.5 + 2.0 * (0.09 + 0.04 + 0.01)
    monkeypatch.setattr(
        vars(sdf_document)["_Reader"], "_added_moment", lambda *_: (0.0, 4.5 + 4e-10 * size)
    )
    read_sdf(path)
    monkeypatch.setattr(
        vars(sdf_document)["_Reader"], "_added_moment", lambda *_: (0.0, 4.5 + 4e-9 * size)
    )
    with pytest.raises(ModelError, match="but Drake reads 4"):
        read_sdf(path)


def test_file_without_version_is_refused(tmp_path: Path) -> None:
    """The message names the element and the remedy."""
    path = tmp_path / "robot.sdf"
    path.write_text(text_of("1 1 1").replace(' version="1.9"', ""), "utf-8")
    with pytest.raises(LoadError, match=r"line 1: <sdf> has no valid version; state one"):
        read_sdf(path)
