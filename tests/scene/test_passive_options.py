"""The options `passive` and `friction` in Python, scene files and on the command line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.forces import Damper, Friction
from pinred.scene.parse_options import passive_left_out
from pinred.simulation.plan import plan_of
from pinred.simulation.simulate import explain_plan
from pinred.system.robot_file_contents import Contents

ROBOT = """<robot name="pair">
<link name="a"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<dynamics damping="0.4" friction="0.1"/></joint></robot>"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A file with a damper and friction at its one joint."""
    path = tmp_path / "pair.urdf"
    path.write_text(ROBOT, "utf-8")
    return path


FORMS = [
    ({}, "", []),
    ({"passive": True}, "passive = true\n", ["--passive"]),
    ({"friction": 0.05}, "friction = 0.05\n", ["--friction", "0.05"]),
    (
        {"passive": True, "friction": 0.05},
        "passive = true\nfriction = 0.05\n",
        ["--passive", "--friction", "0.05"],
    ),
]


@pytest.mark.parametrize(("options", "text", "words"), FORMS)
@pytest.mark.sampled
def test_passive_options_equal_explicit_forces(
    robot: Path, options: dict[str, Any], text: str, words: list[str], tmp_path: Path
) -> None:
    """Python, file and command line give the same bits as explicit forces."""
    system = pinred.load(robot)
    start: dict[str, Any] = {"x0": [0.1], "xdot0": [1.0]}
    times = np.linspace(0.0, 0.5, 6)
    traj = pinred.simulate(system, times=times, **start, **options)
    forces: list[Any] = [Damper("hinge", 0.4)] if "passive" in options else []
    forces += [Friction("hinge", 0.1, 0.05)] if "friction" in options else []
    written = pinred.simulate(system, times=times, forces=forces, **start)
    np.testing.assert_array_equal(traj.states.x, written.states.x)
    file = tmp_path / "scene.toml"
    file.write_text(
        f"robot = 'pair.urdf'\n{text}start = {{ x0 = [0.1], xdot0 = [1] }}\n"
        "run = { duration = 0.5, samples = 6 }\n",
        "utf-8",
    )
    np.testing.assert_array_equal(pinred.simulate(pinred.load_scene(file)).states.x, traj.states.x)
    out = tmp_path / "traj.npz"
    given = [str(robot), "--x0=0.1", "--xdot0=1", "--duration", "0.5", "--samples", "6", *words]
    assert main(["simulate", *given, "--out", str(out)]) == 0
    np.testing.assert_array_equal(np.load(out)["x"], traj.states.x)
    assert (np.load(out)["xdot"][-1] < 0.99) == bool(options)


@pytest.mark.slow
@pytest.mark.parametrize(("options", "text", "words"), FORMS[2:])
def test_left_out_passive_forces_are_reported_in_one_line(
    robot: Path,
    options: dict[str, Any],
    text: str,  # noqa: ARG001
    words: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In explain, in the report of compare and in the summary of a run."""
    scene = pinred.Scene(system=pinred.load(robot), xdot0=[1.0], duration=0.2, **options)
    left = scene.left_out
    assert bool(left) == (len(options) < 2)
    lines = explain_plan(plan_of(scene)).splitlines()
    assert (f"left out: {left}" in lines) == bool(left)
    assert any("left out" in line for line in lines) == bool(left)
    report = pinred.compare(pinred.simulate(scene))
    assert report.passed
    assert report.left_out == left
    assert ("leaves" in str(report)) == ("leaves" in report._repr_html_()) == bool(left)
    assert main(["compare", str(robot), "--xdot0=1", "--duration", "0.2", *words]) == 0
    assert (f"\n{left}\n" in capsys.readouterr().out) == bool(left)
    assert ("of the file" in scene._repr_html_()) == bool(options)


def test_passive_left_out_describes_forces_and_options() -> None:
    """The sentence names the forces and the options that make them act."""
    cat = pinred.load("falling_cat")
    assert passive_left_out(cat) == ""

    def said(*passive: Any, **options: Any) -> str:
        contents = Contents(passive=passive)
        return passive_left_out(pinred.System(cat.model, contents=contents), **options)

    spring, damper = pinred.forces.Spring("bend", 1.0), Damper("bend", 1.0)
    rub = Friction("bend", 1.0)
    assert said(spring) == "the file has 1 spring; the run leaves it out (passive=True uses it)"
    assert said(*12 * [damper], spring, spring) == (
        "the file has 12 dampers and 2 springs; the run leaves them out (passive=True uses them)"
    )
    assert said(damper, rub, rub, passive=True, who="a run") == (
        "the file has 2 joints with dry friction; a run leaves them out (friction=WIDTH uses them)"
    )
    assert said(damper, rub, friction=0.1) == (
        "the file has 1 damper; the run leaves it out (passive=True uses it)"
    )
    assert said(damper, rub, passive=True, friction=0.1) == ""


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"passive": 1}, "passive must be True or False, got 1"),
        ({"friction": True}, "friction must be the width"),
        ({"friction": 0.0}, "friction must be"),
        ({"friction": "much"}, "friction must be"),
        ({"friction": np.nan}, "friction must be"),
    ],
)
def test_invalid_passive_option_is_refused_by_name(options: dict[str, Any], said: str) -> None:
    """The message names the option."""
    with pytest.raises(pinred.InputError, match=re.escape(said)):
        pinred.Scene(system=pinred.load("falling_cat"), **options)


@pytest.mark.by_hand
def test_batch_with_passive_forces_matches_single_runs(robot: Path) -> None:
    """A batch gives the states of single runs."""
    system = pinred.load(robot)
    options: dict[str, Any] = {"passive": True, "friction": 0.1, "times": [0.5]}
    many = pinred.simulate_many(system, xdot0=np.array([[1.0], [2.0]]), **options)
    one = pinred.simulate(system, xdot0=[2.0], **options)
    np.testing.assert_allclose(many[1].x, one.states.x, rtol=1e-11)
