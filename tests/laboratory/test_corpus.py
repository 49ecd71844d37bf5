"""The corpus: classification of files, outcomes of trials, and detection of faults."""

from __future__ import annotations

import csv
import math
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin
import pytest
from commands import refused, run
from robot_texts import FLOATING, HINGE, MASS, body, joint, link, mjcf, robot

import pinred
from pinred import InputError, LoadError
from pinred.laboratory.corpus import run_corpus as workers
from pinred.laboratory.corpus import trial as trials
from pinred.laboratory.corpus.run_corpus import Corpus, Worker, corpus, find_descriptions
from pinred.laboratory.corpus.trial import (
    Description,
    Entry,
    differences,
    run_trial,
    why_not_due,
)
from pinred.system import independent_reader

QUICK = 0.05  # duration of motions [s]
ARM = f'<body name="arm">{HINGE}{MASS}</body>'
FIXED = mjcf(body(ARM))
SWINGING = mjcf(f'<body name="arm">{HINGE}{MASS}</body>')
LOOP = mjcf(body(ARM), "") .replace(
    "</mujoco>", '<equality><connect body1="arm" anchor="1 0 0"/></equality></mujoco>'
)  # fmt: skip
TWO = mjcf(body("<freejoint/>") + body(f"<freejoint/>{ARM}", "other"))
ROTORS = mjcf(body(f'<joint type="free" armature="1"/>{ARM}'))
LIFT = mjcf(body(f'<joint type="slide" armature="1"/>{ARM}'))
MIMIC = robot(
    *(link(name) for name in "abc"), joint("a", "b"),
    joint("b", "c").replace("<axis", '<mimic joint="a-b"/><axis'),
)  # fmt: skip
MASSLESS = robot(link("a"), link("b", 0), joint("a", "b"))

# text, outcome, category of the reason, whether it should work, chosen option
CASES = {
    "floats": (FLOATING, "passed", "", True, ""),
    "fixed": (FIXED, "passed", "", True, ""),
    "swings": (SWINGING, "without gravity", "", True, ""),
    "rotors": (ROTORS, "passed", "", True, ""),
    "lift": (LIFT, "without gravity", "", True, ""),
    "two": (TWO, "passed", "", True, "root=other"),
    "loop": (LOOP, "refused", "closed loop", False, ""),
    "mimic": (MIMIC, "passed", "", True, ""),
    "rotor": (
        FLOATING.replace("<limit", '<dynamics armature="3"/><limit'),
        "passed",
        "",
        True,
        "",
    ),
    "massless": (MASSLESS, "refused", "singular everywhere", False, ""),
    "broken": ("<robot><link", "refused", "not read", False, ""),
}


def write_robot(folder: Path, text: str, name: str = "robot") -> str:
    """Write a file and return its path."""
    suffix = "urdf" if text.startswith("<robot") else "xml"
    path = folder / f"{name}.{suffix}"
    path.write_text(text, encoding="utf-8")
    return str(path)


def description_of(file: str) -> Description:
    """Return the description of a file."""
    return Description(file, "urdf" if file.endswith("urdf") else "mjcf")


def test_quaternions_are_compared_with_the_reader_that_knows_them(tmp_path: Path) -> None:
    """MuJoCo ignores quat_xyzw, so only Pinocchio's reading counts."""
    text = FLOATING.replace('rpy="0.1 0.2 0.3"', 'quat_xyzw="0.5 0.5 0.5 0.5"')
    text = text.replace("<robot", '<robot version="1.1"')
    entry = run_trial(description_of(write_robot(tmp_path, text)), QUICK)
    assert (entry.outcome, entry.reader) == ("passed", "Pinocchio")
    assert "does not read the attribute quat_xyzw" in entry.second


@pytest.mark.by_hand("floats")
@pytest.mark.parametrize("case", CASES)
@pytest.mark.sampled
def test_trial_has_expected_outcome(case: str, tmp_path: Path) -> None:
    """Files that should work are recognised without pinred's readers."""
    text, outcome, about, due, choice = CASES[case]
    entry = run_trial(description_of(write_robot(tmp_path, text)), QUICK)
    assert (entry.outcome, entry.about, entry.due, entry.choice) == (outcome, about, due, choice)
    if entry.good:
        assert entry.aba <= entry.allowed
        assert max(entry.mass, entry.forces) < 1e-12
        assert entry.wall > entry.simulate > 0.0
    else:
        assert entry.reason


@pytest.mark.by_hand
def test_misread_mass_fails_against_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mass error of 1e-9 passes compare, which shares the model, but not MuJoCo."""

    def wrong(*arguments: Any, **options: Any) -> pinred.System:
        model = pinred.load(*arguments, **options).model.copy()
        last = model.inertias[model.njoints - 1]
        heavier = pin.Inertia(last.mass * (1.0 + 1e-9), last.lever, last.inertia)
        model.inertias[model.njoints - 1] = heavier
        return pinred.System(model)

    file = description_of(write_robot(tmp_path, FLOATING))
    monkeypatch.setattr(trials, "load", wrong)
    entry = run_trial(file, QUICK)
    assert (entry.outcome, entry.about) == ("FAILED", "MuJoCo reads it differently")
    assert "mass" in entry.reason


def test_second_reader_compares_balls(tmp_path: Path) -> None:
    """MuJoCo's quaternion is (w, x, y, z)."""
    head = '<body name="b" pos="0 0 1"><joint name="neck" type="ball" pos="0 .1 0"/>' + MASS
    file = write_robot(tmp_path, mjcf(body(f"<freejoint/>{head}</body>{ARM}")))
    result = differences(pinred.load(file), file, "mjcf", None)
    assert max(result["places"], result["mass"], result["forces"]) < 1e-12


@pytest.mark.filterwarnings("ignore::pinred.LeftOutWarning")
def test_second_reader_frees_a_base_without_a_name(tmp_path: Path) -> None:
    """Of two robots in the world, `root` names the second, which has no name, by its number."""
    robots = body(ARM) + body(ARM.replace('"', "'").replace("name='", "name='second ")).replace(
        ' name="base"', ""
    )
    file = write_robot(tmp_path, mjcf(robots))
    system = pinred.load(file, root="body3")
    result = differences(system, file, "mjcf", "body3")
    assert max(result["places"], result["mass"], result["forces"]) < 1e-12


@pytest.mark.parametrize("error", [0.0, 1e-8])
def test_second_reader_holds_joints_as_mujoco_does(error: float, tmp_path: Path) -> None:
    """An equality holds a joint with a reference; a wrong value of pinred's is detected."""
    held = '<body name="held" pos="0 0 .3"><joint name="k" axis="1 0 0" ref="20"/>' + MASS
    text = mjcf(body(f"<freejoint/>{held}</body>{ARM}")).replace(
        "</mujoco>", '<equality><joint joint1="k" polycoef="0.3 0 0 0 0"/></equality></mujoco>'
    )
    file = write_robot(tmp_path, text)
    value = math.radians(20.0) + 0.3 + error
    result = differences(pinred.load(file, lock={"k": value}), file, "mjcf", None)
    assert (result["mass"] < 1e-12) == (result["places"] < 1e-12) == (error == 0.0)
    locked = pinred.load(file).contents.locked
    assert locked is not None
    assert locked.frozen == pytest.approx({"k": value - error}, abs=1e-15)


@pytest.mark.parametrize("what", ["gravity", "axis", "place"])
def test_second_reader_detects_differences(what: str, tmp_path: Path) -> None:
    """Different gravity, axis or position of a joint is detected."""
    file = write_robot(tmp_path, mjcf(body(f"<freejoint/>{ARM}")))
    model = pinred.load(file).model.copy()
    if what == "gravity":
        model.gravity.linear *= 1.0 + 1e-6
    elif what == "place":
        model.jointPlacements[2].translation[0] += 1e-6
    else:
        model.jointPlacements[2].rotation = pin.exp3(1e-6 * model.gravity.linear)
    result = differences(pinred.System(model), file, "mjcf", None)
    assert max(result["places"], result["mass"], result["forces"]) > 1e-8
    right = differences(pinred.load(file), file, "mjcf", None)
    assert max(right["places"], right["mass"], right["forces"]) < 1e-13


def test_sdf_files_are_compared_with_drake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong mass is detected; files without motion, or that Drake rejects, are not due."""
    pytest.importorskip("pydrake")
    inertial = "<inertial><mass>2</mass></inertial>"
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in "ab")
    hinge = (
        '<joint name="j" type="revolute"><parent>a</parent><child>b</child>'
        "<axis><xyz>0 0 1</xyz></axis></joint>"
    )
    texts = {
        "arm": f'<sdf version="1.9"><model name="m">{links}{hinge}</model></sdf>',
        "fixed": f'<sdf version="1.9"><model name="m"><static>true</static>{links}</model></sdf>',
        "wrong": '<sdf version="1.9"><model name="m"><link/></model></sdf>',
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.sdf").write_text(text, encoding="utf-8")
    found = find_descriptions([tmp_path]).descriptions
    assert {item.kind for item in found} == {"sdf"}
    entries = {Path(entry.file).stem: entry for entry in (run_trial(d, QUICK) for d in found)}
    arm = entries["arm"]
    assert (arm.outcome, arm.reader, arm.due, arm.second) == (
        "passed",
        "Drake",
        True,
        "an SDF file",
    )
    assert [entries[name].outcome for name in ("fixed", "wrong")] == ["refused", "refused"]
    assert entries["fixed"].why_not == "nothing moves"
    assert "Drake does not open it" in entries["wrong"].why_not
    assert "sdf" in str(Corpus(tuple(entries.values())))

    class Wrong(independent_reader._Pair):
        def difference(self, rng: Any) -> float:
            return super().difference(rng) + 1e-6

    monkeypatch.setattr(independent_reader, "_Pair", Wrong)
    entry = run_trial(next(d for d in found if d.file.endswith("arm.sdf")), QUICK)
    assert (entry.outcome, entry.about) == ("FAILED", "Drake reads it differently")


def test_unexpected_exception_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An exception that is not pinred's has the outcome "error"."""

    def fails(*_: Any, **__: Any) -> None:
        raise IndexError("oops")

    monkeypatch.setattr(trials, "load", fails)
    entry = run_trial(description_of(write_robot(tmp_path, FLOATING)), QUICK)
    assert (entry.outcome, entry.reason) == ("error", "IndexError: oops")
    assert not Corpus((entry,)).passed


def test_files_are_classified_by_content(tmp_path: Path) -> None:
    """URDF, MJCF, fragments, templates, copies, and other files."""
    (tmp_path / "deep").mkdir()
    texts = {
        "a.urdf": " \n" + FLOATING, "deep/b.xml": FLOATING.replace('name="r"', 'name="q"'),
        "copy.urdf": " \n" + FLOATING, "c.xml": FIXED, "d.xml": "<mujocoinclude/>",
        "e.xml": "<mujoco><include file='c.xml'/></mujoco>", "f.xml": "<launch/>",
        "g.xacro": '<robot xmlns:xacro="x"><xacro:macro/><link name="a"/></robot>',
        "h.xml": "<mujoco><option/></mujoco>", "i.xml": "no xml", "j.txt": FLOATING,
    }  # fmt: skip
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    result = find_descriptions([tmp_path])
    kinds = {Path(item.file).name: (item.kind, item.included) for item in result.descriptions}
    assert kinds == {
        "a.urdf": ("urdf", False), "b.xml": ("urdf", False), "c.xml": ("mjcf", True),
        "e.xml": ("mjcf", False),
    }  # fmt: skip
    assert (result.fragments, result.macros, result.copies) == (2, 1, 1)
    with pytest.raises(LoadError, match="no such folder"):
        find_descriptions([tmp_path / "nowhere"])


def test_included_file_that_does_not_load_is_a_fragment(tmp_path: Path) -> None:
    """A file that another one includes counts as a fragment if it does not load alone."""
    fragment = write_robot(tmp_path, "<mujoco><worldbody><body/></worldbody></mujoco>", "part")
    entry = run_trial(replace(description_of(fragment), included=True), QUICK)
    assert entry.outcome == "fragment"
    assert "1 parts" in Corpus((entry,)).summary()


@pytest.mark.by_hand
def test_hanging_file_does_not_stop_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its process is killed at the time limit, or has crashed, and a new one continues."""
    monkeypatch.setattr(workers, "_serve", _slow_or_dead)
    monkeypatch.setattr(workers, "_WARM_UP", 20.0)
    with Worker(QUICK, 0.5) as worker:
        assert worker.run_trial(Description("dies", "urdf")).about == "crash"
        assert worker.run_trial(Description("good", "urdf")).outcome == "passed"
        late = worker.run_trial(Description("sleeps", "urdf"))
        assert (late.outcome, late.about) == ("stopped", "time is up")
        assert worker.run_trial(Description("good", "urdf")).outcome == "passed"


def _slow_or_dead(pipe: Any, *_: Any) -> None:
    while True:
        what = pipe.recv()
        if what.file == "dies":
            os._exit(11)
        time.sleep(1000.0 if what.file == "sleeps" else 0.0)
        pipe.send(Entry(what.file, what.kind, "passed"))


@pytest.mark.by_hand
def test_corpus_command_prints_and_writes_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It writes a csv row for each description and exits with 0 if nothing is wrong."""
    for name, case in (("a", "floats"), ("b", "swings"), ("c", "loop")):
        write_robot(tmp_path, CASES[case][0], name)
    csv_path = tmp_path / "table.csv"
    code, text, _ = run(
        capsys, "corpus", str(tmp_path), "--duration", "0.05", "--out", str(csv_path)
    )
    assert code == 0
    assert "of these, good" in text
    assert "100.0 %" in text
    assert "closed loop" in text
    with csv_path.open(encoding="utf-8") as file:
        rows = {Path(row["file"]).name: row for row in csv.DictReader(file)}
    outcomes = {name: row["outcome"] for name, row in rows.items()}
    assert outcomes == {"a.urdf": "passed", "b.xml": "without gravity", "c.xml": "refused"}
    assert float(rows["a.urdf"]["load"]) > 0.0


def test_corpus_rejects_empty_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No folders or names, a folder without robots, and invalid numbers."""
    assert "nothing to try" not in refused(capsys, "corpus")
    assert "no URDF, MJCF or SDF" in refused(capsys, "corpus", str(tmp_path))
    assert "no such folder" in refused(capsys, "corpus", str(tmp_path / "x"))
    with pytest.raises(InputError, match="positive"):
        corpus([tmp_path], duration=0.0)


def test_interrupted_corpus_keeps_entries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Entries before an interruption are on disk."""
    for name in "ab":
        write_robot(tmp_path, FLOATING.replace('name="r"', f'name="{name}"'), name)
    answers = iter([Entry("a", "urdf", "passed")])

    def next_answer(*_: Any) -> Entry:
        try:
            return next(answers)
        except StopIteration:
            raise KeyboardInterrupt from None

    monkeypatch.setattr(Worker, "run_trial", next_answer)
    csv_path = tmp_path / "out.csv"
    with pytest.raises(KeyboardInterrupt):
        corpus([tmp_path], out=csv_path)
    assert csv_path.read_text(encoding="utf-8").count("\n") == 2


def test_why_not_due_of_prefixed_and_singular_files(tmp_path: Path) -> None:
    """Files with undeclared XML prefixes are decided too."""
    prefixed = FLOATING.replace("</robot>", "<a:b/></robot>")
    assert why_not_due(write_robot(tmp_path, prefixed), "urdf") == ""
    assert why_not_due(write_robot(tmp_path, MASSLESS), "urdf") == "mass matrix singular"
    ball = mjcf(body('<body name="b"><joint type="ball"/>' + MASS + "</body>"))
    assert why_not_due(write_robot(tmp_path, ball), "mjcf") == ""
