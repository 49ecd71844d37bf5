"""Scene files with several phases: motions, captures, releases and landings as one chain."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import Chain, InputError
from pinred.cli.command_line import main

REST = (0.0, 0.0, 0.0)
MISSION = """
robot = "chaser.urdf"
stops = { arm = [-0.3, 0.4, 0.5] }
[load]
group = "SE3"
gravity = [0, 0, 0]
[start]
x0 = { arm = 0.1 }
xdot0 = { arm = 0.7 }
[run]
duration = 1.0

[second]
robot = "rock.urdf"
[second.load]
group = "SE3"
gravity = [0, 0, 0]
[second.start]
pose0 = [0.1, 0.2, 0.3, 0, 0, 0, 1]
xi0 = [0, -0.2, 0, 0.3, 0.2, 0]

[[phases]]
capture = { at = "grip", onto = "rock", align = true }
[phases.run]
duration = 0.5

[[phases]]
[phases.run]
duration = 0.25
samples = 7
[phases.parameters]
drag = 5.0
[[phases.forces]]
kind = "torque"
function = { arm = "-drag*xdot['arm']" }

[[phases]]
release = { link = "rock" }
[phases.run]
duration = 0.5
[phases.second.run]
rtol = 1e-8
atol = 1e-10
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the mission and its robots."""
    chaser = pinred.Model("chaser").body("bus", mass=60.0, inertia=[6, 5, 7])
    chaser = chaser.hinge("arm", parent="bus", axis="z", at=(0.4, 0, 0), mass=4.0, inertia=0.2)
    chaser.fixed("grip", parent="arm", at=(0.5, 0, 0)).save(tmp_path / "chaser.urdf")
    rock = pinred.Model("rock").body("rock", mass=25.0, inertia=[2, 3, 4])
    rock.save(tmp_path / "rock.urdf")
    (tmp_path / "mission.toml").write_text(MISSION, encoding="utf-8")
    return tmp_path


def by_hand(folder: Path) -> Chain:
    """Return the same mission by calls."""
    chaser, rock = (
        pinred.load(folder / f"{name}.urdf", group="SE3", gravity=REST)
        for name in ("chaser", "rock")
    )
    stops: Any = {"arm": pinred.Stop(-0.3, 0.4, restitution=0.5)}
    first = pinred.simulate(chaser, x0={"arm": 0.1}, xdot0={"arm": 0.7}, duration=1.0, stops=stops)
    start: dict[str, Any] = {"pose0": [0.1, 0.2, 0.3, 0, 0, 0, 1], "xi0": [0, -0.2, 0, 0.3, 0.2, 0]}
    trial = pinred.simulate(rock, **start, duration=1.0)
    grip, link = (frame_at_end(*each) for each in ((first, "grip"), (trial, "rock")))
    pose = pin.SE3ToXYZQUAT(grip * link.inverse() * pin.XYZQUATToSE3(np.array(start["pose0"])))
    second = pinred.simulate(trial.scene, pose0=pose)
    capture = pinred.capture(first, second, at="grip", onto="rock", tolerance=1e-9)
    together = pinred.simulate(capture.system, **capture.start, duration=0.5)
    end = together(0.5)
    drag = pinred.forces.Torque(lambda s: {"arm": -5.0 * s.xdot["arm"]})
    braked = pinred.simulate(
        capture.system, pose0=end.pose, x0=end.x, xdot0=end.xdot, xi0=end.xi, forces=[drag],
        times=np.linspace(0.0, 0.25, 7),
    )  # fmt: skip
    release = pinred.release(braked, "rock")
    carrier, released = release.carrier, release.released
    apart = [
        pinred.simulate(carrier.system, **carrier.start, duration=0.5),
        pinred.simulate(released.system, **released.start, duration=0.5, rtol=1e-8, atol=1e-10),
    ]
    return pinred.chain([first, second], capture, together, braked, release, apart)


def frame_at_end(motion: pinred.Trajectory, name: str) -> pin.SE3:
    """Return the placement of a link at the end of a motion."""
    model, data = motion.system.model, motion.system.model.createData()
    pin.framesForwardKinematics(model, data, motion.q[-1])
    return data.oMf[model.getFrameId(name, pin.FrameType.BODY)].copy()


def test_file_with_phases_is_the_chain_of_the_same_calls(folder: Path) -> None:
    """Impacts at stops, times and states are those of simulate, capture, release and chain."""
    chain, expected = pinred.simulate_chain(folder / "mission.toml"), by_hand(folder)
    assert repr(chain) == repr(expected)
    np.testing.assert_array_equal(chain.t, expected.t)
    np.testing.assert_allclose(chain.q, expected.q, atol=1e-12)
    np.testing.assert_allclose(chain.v, expected.v, atol=1e-12)
    assert chain.impacts.joint == ("arm",)
    assert chain.phases[3].motions[1].scene.rtol == 1e-8
    assert pinred.compare(chain)


def test_run_command_simulates_all_phases(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command prints motions and impacts, and writes one recording; others refuse it."""
    monkeypatch.chdir(folder)
    assert main(["run", "mission.toml", "--validate"]) == 0
    assert "ok: chaser and rock, 4 phases" in capsys.readouterr().out
    assert main(["run", "mission.toml", "--out", "m.npz", "--explain"]) == 0
    text = capsys.readouterr().out
    for words in ("chaser captures rock", "chaser+rock opens at rock", "stops: arm",
                  "at t = 1.75 s"):  # fmt: skip
        assert words in text
    recording = pinred.read_recording("m.npz")
    assert recording.t[-1] == 2.25
    assert recording.impacts.joint == ("arm",)
    capsys.readouterr()
    for command, words in (
        (["sweep", "mission.toml"], "this file has several phases"),
        (["run", "mission.toml", "--parameters", "drag=1"], "--parameters: a file with several"),
        (["run", "mission.toml", "--checkpoint", "run.ckpt"], "--checkpoint: a file with several"),
        (["release", "mission.toml", "--link", "rock", "--duration", "1"], "of one motion"),
    ):
        assert main(command) == 2
        assert words in capsys.readouterr().err


HOPPER = """
robot = "hopper.urdf"
load = { group = "SE3" }
[start]
pose0 = [0, 0, 1, 0, 0, 0, 1]
xi0 = [0.2, 0, 0, 0.1, 0.5, 0]
[run]
duration = 2.0
[[events]]
function = "height['foot']"
terminal = true
direction = -1
[[phases]]
land = { frame = "foot" }
[phases.run]
duration = 0.2
"""


def test_file_with_a_landing_goes_on_in_stance(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The event ends the flight where the foot, by Pinocchio, is at the ground."""
    hopper = pinred.Model("hopper").body("trunk", mass=3.0, inertia=[0.1, 0.2, 0.3])
    hopper.fixed("foot", parent="trunk", at=[0, 0.05, -0.4]).save(folder / "hopper.urdf")
    path = folder / "hopper.toml"
    path.write_text(HOPPER, encoding="utf-8")
    chain = pinred.simulate_chain(path)
    (flight,), (stance,) = (phase.motions for phase in chain.phases)
    assert flight.ended_by == "event"
    assert abs(frame_at_end(flight, "foot").translation[2]) <= 1e-9
    assert stance.system.group.name == "SO2"
    assert main(["run", str(path), "--compare"]) == 0
    assert "verdict of the chain: PASSED" in capsys.readouterr().out
    picture = ["plot", str(path), "--kind", "energy", "--out", str(folder / "energy.png")]
    assert main(picture) == 0
    flat = HOPPER.replace('"foot" }', '"foot", contact = "flat" }')
    path.write_text(flat[: flat.index("[phases.run]")], encoding="utf-8")
    ended = pinred.simulate_chain(path)
    assert repr(ended).endswith("s, landing>")
    assert abs(ended.v[-1]).max() <= 1e-14  # a rigid body stands still
    assert pinred.compare(ended)
    path.write_text(flat, encoding="utf-8")
    with pytest.raises(InputError, match=r"line 14: phases\[0\]\.land: no motion keeps a flat"):
        pinred.simulate_chain(path)


def test_second_robot_moves_until_the_first_ends(folder: Path) -> None:
    """An event ends the first motion early, and the other one, too."""
    event = "\n[[events]]\nfunction = \"x['arm'] - 0.2\"\nterminal = true\n[second]"
    text = MISSION.replace("\n[second]", event).replace("stops = { arm = [-0.3, 0.4, 0.5] }", "")
    (folder / "mission.toml").write_text(text, encoding="utf-8")
    first, second = pinred.simulate_chain(folder / "mission.toml").phases[0].motions
    assert first.scene.end == second.scene.end < 1.0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("align = true", "align = false", r"line 23: phases\[0\]\.capture: .* do not coincide"),
        ('onto = "rock"', 'onto = "r"', r"phases\[0\]\.capture: onto: .*no link 'r'"),
        ('at = "grip", ', "", r"phases\[0\]\.capture: 'at' is missing"),
        ('{ link = "rock" }', '{ link = "bus" }', r"phases\[2\]\.release: .*is the root"),
        ('{ link = "rock" }', '{ link = "rock" }\nland = { frame = "grip" }', "land or release"),
        ("release", "landing", "unknown key \"landing\""),
        ("[[phases]]\nrelease", "[[phases]]\ncapture = { at = 'bus', onto = 'rock' }\n#",
         "a capture needs two robots, and 1 move"),
        ("capture = {", "release = { link = 'arm' }\n# {", "a release needs one robot, and 2 move"),
        ("drag = 5.0", '"arm.mass" = 5.0', r"phases\[1\]\.parameters\..*: a robot keeps"),
        ("xdot['arm']\"", "xdot['leg']\"", r"phases\[1\]\.forces\[0\]\.function\.arm: .*leg"),
        ("[phases.second.run]", "[phases.second.start]", "unknown key \"start\""),
        ("[run]\n", "[run]\noutputs = 'shape'\n", "run.outputs: a file with several phases"),
        ("[run]\n", "[run]\ncheckpoint = 'c'\n", "run.checkpoint: a file with several phases"),
        ("[[phases]]\ncapture", "[[phases]]\nrun.duration = 1\n[[phases]]\ncapture",
         "align: expected the two robots"),
        ("[second]", "[sweep]\nvary = { 'arm.mass' = [1, 2] }\n[second]", "give sweep or phases"),
    ],
)  # fmt: skip
def test_impossible_phase_is_refused_by_place(folder: Path, old: str, new: str, words: str) -> None:
    """The message names the file, the line, the key and what is wrong."""
    assert old in MISSION
    path = folder / "mission.toml"
    path.write_text(MISSION.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=words) as caught:
        pinred.simulate_chain(path)
    assert str(caught.value).startswith(f"{path}")


def test_files_of_one_and_of_several_phases_are_told_apart(folder: Path) -> None:
    """load_scene and simulate_chain name each other."""
    with pytest.raises(InputError, match="simulate_chain and `pinred run` simulate them"):
        pinred.load_scene(folder / "mission.toml")
    text = MISSION[: MISSION.index("[second]")]
    (folder / "one.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"has no tables \[\[phases\]\]"):
        pinred.simulate_chain(folder / "one.toml")
    head = MISSION[: MISSION.index("[[phases]]")]
    (folder / "two.toml").write_text(head, encoding="utf-8")
    with pytest.raises(InputError, match=r"second: a second robot needs \[\[phases\]\]"):
        pinred.simulate_chain(folder / "two.toml")


def test_capture_that_drives_a_joint_into_its_stop_stays_balanced(folder: Path) -> None:
    """A stop hit at the start of a phase belongs to it: energies, fit and comparison agree."""
    chaser, rock = (
        pinred.load(folder / f"{name}.urdf", group="SE3", gravity=REST)
        for name in ("chaser", "rock")
    )
    first = pinred.simulate(
        chaser, x0=[0.4 - 0.35], xdot0=[0.7], xi0=[0, 0, 0, 0.1, 0.2, 0.5], duration=0.5,
    )  # fmt: skip
    pose = pin.SE3ToXYZQUAT(frame_at_end(first, "grip"))
    speed = [0.0, 3.0, 0.0, 0.0, 0.0, 0.0]
    back = pinred.simulate(rock, pose0=pose, xi0=-np.array(speed), duration=0.5)(0.5)
    second = pinred.simulate(rock, pose0=back.pose, xi0=-back.xi, duration=0.5)
    capture = pinred.capture(first, second, at="grip", onto="rock")
    x0 = capture.instant.x
    assert capture.instant.xdot[0] > 0.0
    stops: Any = {"arm": (-0.3, float(x0[0]))}
    together = pinred.simulate(capture.system, **capture.start, duration=0.5, stops=stops)
    impacts = together.impacts
    assert impacts.t[0] == 0.0
    balance = together.energy_balance
    assert np.abs(balance.work[0]).max() == 0.0
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-10 * together.energy[0])
    chain = pinred.chain([first, second], capture, together)
    assert chain.impacts.t[0] == 0.5
    assert pinred.compare(chain)
