"""The independent reader agrees with pinred's reading, and finds each planted fault by name."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import FLOATING, link, mjcf, robot, write
from test_urdf_words import bar, on

import pinred
from pinred import LoadError, ModelError
from pinred.laboratory.corpus.trial import Description, run_trial
from pinred.system import independent_reader, read_urdf
from pinred.system.copy_model import ModelBuilder
from pinred.system.independent_reader import differences, second_reading
from pinred.system.urdf_elements import reduced_text

LOSSES = '<dynamics damping="0.1" friction="2" armature="0.5"/>'
LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'
AT = '<origin xyz="0.1 0.2 0.3" rpy="0.3 0.1 0.2"/>'
TREE = robot(
    *(bar(name) for name in "abcdefg"),
    on("z", "a", "b", inside=f'{AT}<axis xyz="0 1 1"/>{LIMIT}{LOSSES}'),
    on("y", "b", "c", "planar", f'{AT}<axis xyz="1 0 1"/><dynamics damping="3" armature="0"/>'),
    on("x", "b", "d", "prismatic", f'{AT}<mimic joint="z"/>{LIMIT}{LOSSES}'),
    on("w", "a", "e", "continuous", AT),
    on("v", "e", "f", "fixed", AT),
    on("u", "f", "g", "floating", AT),
)  # fmt: skip


def test_readings_of_a_rich_file_agree(tmp_path: Path) -> None:
    """With followers, armature and a planar joint whose normal Pinocchio ignores."""
    reading = second_reading(write(tmp_path, TREE))
    assert reading is not None
    assert (reading.reader, reading.differences, reading.unread) == ("Pinocchio", (), "")


def models(folder: Path) -> tuple[pin.Model, pin.Model]:
    """Return two readings of the file without the planar joint."""
    path = write(folder, TREE.replace('"planar"', '"fixed"'))
    return read_urdf.read_urdf(path).model, pin.buildModelFromUrdf(str(path))


def index(model: pin.Model, name: str) -> int:
    """Return the index of the first rate of a joint."""
    return int(model.joints[model.getJointId(name)].idx_v)


def change(array: str, name: str, factor: float) -> Callable[[pin.Model], None]:
    """Return a fault that multiplies a number of a joint."""

    def plant(model: pin.Model) -> None:
        joint = model.joints[model.getJointId(name)]
        k = joint.idx_q if "Position" in array else joint.idx_v
        getattr(model, array)[k] *= factor

    return plant


def change_inertia(k: int, factor: float) -> Callable[[pin.Model], None]:
    """Return a fault that multiplies a dynamic parameter of the body of joint z."""

    def plant(model: pin.Model) -> None:
        i = model.getJointId("z")
        parameters = model.inertias[i].toDynamicParameters()
        parameters[k] *= factor
        model.inertias[i] = pin.Inertia.FromDynamicParameters(parameters)

    return plant


def move(model: pin.Model) -> None:
    """Move joint w by a tiny distance."""
    place = model.jointPlacements[model.getJointId("w")]
    place.translation = place.translation + np.array([0.0, 3e-9, 0.0])


FAULTS = {
    "mass": (change_inertia(0, 1 + 3e-9), "the body of joint 'z' has the mass"),
    "inertia": (change_inertia(4, 1 + 3e-8), "the body of joint 'z' has another inertia"),
    "placement": (move, "joint 'w': it has another placement"),
    "lower": (change("lowerPositionLimit", "z", 1 + 3e-9), "joint 'z': .* lowerPositionLimit"),
    "upper": (change("upperPositionLimit", "x", 1 + 3e-9), "joint 'x': .* upperPositionLimit"),
    "velocity": (change("upperVelocityLimit", "z", 0.0), "joint 'z': .* upperVelocityLimit"),
    "effort": (change("upperEffortLimit", "z", 1 + 3e-9), "joint 'z': .* upperEffortLimit"),
    "damping": (change("damping", "z", 1 + 3e-9), "joint 'z': .* damping"),
    "friction": (change("upperDryFrictionLimit", "z", 0.0), "joint 'z': .* upperDryFrictionLimit"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_planted_fault_is_found_by_name(case: str, tmp_path: Path) -> None:
    """Three times the bound is found, so a bound ten times larger fails."""
    own, other = models(tmp_path)
    assert list(differences(own, other)) == []
    plant, words = FAULTS[case]
    plant(own)
    found = list(differences(own, other))
    assert len(found) == 1
    assert re.search(words, found[0])


def built(joint: pin.JointModel, name: str = "j", *, on_root: bool = True) -> pin.Model:
    """Return a model of one or two bodies."""
    builder = ModelBuilder()
    first = builder.add_joint(0, pin.JointModelRX(), pin.SE3.Identity(), "i")
    builder.add_joint(first if on_root else 0, joint, pin.SE3.Identity(), name)
    model = builder.finish()
    for i in (1, 2):
        body = pin.Inertia(1.0, np.array([0.1, 0.2, 0.3]), np.diag([1.0, 2.0, 2.5]))
        model.appendBodyToJoint(i, body, pin.SE3.Identity())
    return model


def test_other_joints_are_found() -> None:
    """Missing joints, other carriers, types and axes, and motions that begin alike."""
    plain = built(pin.JointModelRY())
    slides = pin.JointModelComposite()
    for part in (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRUBZ()):
        slides.addJoint(part)
    for own, other, words in (
        (plain, built(pin.JointModelRY(), "k"), ["joint 'k' is not read", "'j' is read by pinred"]),
        (plain, built(pin.JointModelRY(), on_root=False), ["'j': it is on 'i' instead of 'univ"]),
        (plain, built(pin.JointModelRUBY()), ["of type RY instead of RUBY"]),
        (plain, built(pin.JointModelRZ()), ["another axis"]),
        (built(pin.JointModelPlanar()), built(slides), ["the mass matrix differs"]),
    ):
        found = list(differences(own, other))
        assert len(found) == len(words)
        assert all(word in phrase for word, phrase in zip(words, found, strict=True))


def test_files_that_pinocchio_refuses_are_not_compared(tmp_path: Path) -> None:
    """The reason is its message; other formats have no independent reader here."""
    reading = second_reading(write(tmp_path, FLOATING.replace('effort="1"', 'effort="-1"')))
    assert reading is not None
    assert reading.differences == ()
    assert "effort" in reading.unread
    assert second_reading(write(tmp_path, mjcf(""))) is None
    with pytest.raises(LoadError):
        second_reading(write(tmp_path, robot()))


@pytest.mark.parametrize(
    ("program", "words"),
    [("import os; os.abort()", "ended with code -6"), ("while True: pass", "more than 0.5 s")],
)
def test_crash_of_the_reader_is_no_crash_of_pinred(
    program: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader runs in a process of its own, with a time limit."""
    monkeypatch.setattr(independent_reader, "_PINOCCHIO", program)
    monkeypatch.setattr(independent_reader, "_SECONDS", 0.5 if "while" in program else 60.0)
    reading = second_reading(write(tmp_path, FLOATING))
    assert reading is not None
    assert words in reading.unread


@pytest.fixture
def lossy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pinred lose the attitudes of joints and links."""
    monkeypatch.setattr(
        read_urdf, "reduced_text", lambda robot: reduced_text(robot).replace("rpy", "was_rpy")
    )


@pytest.mark.usefixtures("lossy")
def test_strict_loading_refuses_a_misread_file_by_name(tmp_path: Path) -> None:
    """A path and a text are refused with the joint; without `strict` they load."""
    path = write(tmp_path, FLOATING)
    assert pinred.load(path).m == 1
    for source in ({"source": path}, {"text": FLOATING}):
        with pytest.raises(ModelError, match=r"strict=True: Pinocchio.*joint 'a-b' .*placement"):
            pinred.load(**source, strict=True)


def test_strict_loading_accepts_files_that_are_read_right(tmp_path: Path) -> None:
    """URDF as file, text and name; MJCF and models have no independent reader here."""
    pytest.importorskip("mujoco")
    assert pinred.load(write(tmp_path, FLOATING), strict=True).m == 1
    assert pinred.load(text=FLOATING, strict=True).m == 1
    assert pinred.load("three_rods", strict=True).m > 0
    body = '<body><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    assert pinred.load(text=mjcf(body), strict=True).m == 0
    assert pinred.load(pin.buildModelFromXML(robot(link("a"))), strict=True).m == 0


@pytest.mark.usefixtures("lossy")
def test_corpus_reports_a_misread_file(tmp_path: Path) -> None:
    """The row names the reader and the joint."""
    path = write(tmp_path, FLOATING)
    entry = run_trial(Description(str(path), "urdf"), 0.01)
    assert (entry.outcome, entry.reader) == ("FAILED", "Pinocchio")
    assert entry.about == "Pinocchio reads it differently"
    assert "joint 'a-b': it has another placement" in entry.reason
