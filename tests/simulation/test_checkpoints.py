"""Checkpoints: an interrupted run continues with the same bits, and other files are refused."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.common.errors import InputError
from pinred.forces import Command, Controller, Torque
from pinred.integrators.stepping import run_state
from pinred.integrators.stepping.run_state import LAYOUT
from pinred.simulation import checkpoint as checkpoint_module
from pinred.simulation.checkpoint import Checkpoint, read_checkpoint
from pinred.simulation.compiled import integrator

METHODS: list[Any] = [
    pinred.DOP853(1e-10, 1e-12),
    pinred.Tsit5(1e-7, 1e-9),
    pinred.AdaptiveGauss(1e-12, 1e-14),
    pinred.Radau(1e-8, 1e-10),
    pinred.RKMK4(0.01),
    pinred.Gauss(0.01, 4),
    pinred.Gauss(0.01, 16),
    pinred.Gauss(0.01, 6, solver="Newton"),
    pinred.Variational(0.005),
]


class Killed(BaseException):
    """The run ends as if its process was killed."""


@pytest.fixture(autouse=True)
def _frequent_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pause often enough for several saves in each run."""
    monkeypatch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 512)


def cat_scene(**options: Any) -> pinred.Scene:
    """Return a scene of 30 s of the falling cat."""
    settings: dict[str, Any] = {"seed": 3, "duration": 30.0, "times": [0.0, 3.3, 30.0]} | options
    return pinred.Scene(system=pinred.load("falling_cat"), **settings)


@contextmanager
def killed_after(monkeypatch: pytest.MonkeyPatch, saves: int) -> Iterator[list[int]]:
    """Save at every pause, and end the run after a number of saves; yield the list of saves."""
    write, done = Checkpoint._write, list[int]()

    def counted(self: Checkpoint, more: list[dict[str, Any]]) -> None:
        write(self, more)
        done.append(len(more))
        if len(done) == saves:
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "_write", counted)
        patch.setattr(checkpoint_module, "INTERVAL", 0.0)
        patch.setattr(checkpoint_module, "_SHARE", 0.0)
        yield done


def registers(path: Path) -> tuple[int, float, Any]:
    """Return the number of runs in a checkpoint, the start of its last part, and its registers."""
    runs = (read_checkpoint(path) or {})["runs"]
    part = runs[-1]["current"]
    run = part["run"].get("end", part["run"])["run"]
    return len(runs), part["start"], np.frombuffer(run, LAYOUT)


def place(path: Path) -> tuple[int, float, float]:
    """Return the number of runs in a checkpoint, the start of its last part, and its time."""
    runs, start, run = registers(path)
    return runs, start, run["t"].item()


def resumed(
    monkeypatch: pytest.MonkeyPatch, make: Callable[[], pinred.Scene], path: Path, **more: Any
) -> tuple[pinred.Trajectory, pinred.Trajectory]:
    """Return the trajectory without interruption, and of a run that was killed twice."""
    whole = pinred.simulate(make(), **more)
    reached = []
    for saves in (3, 2):
        with killed_after(monkeypatch, saves), pytest.raises(Killed):
            pinred.simulate(make(), checkpoint=path, **more)
        reached.append(place(path))
    assert reached[1] > reached[0]  # the second run has continued the first one
    return whole, pinred.simulate(make(), checkpoint=path, **more)


def check_equal(whole: pinred.Trajectory, other: pinred.Trajectory) -> None:
    """Check that two trajectories have the same bits, also between report times."""
    np.testing.assert_array_equal(whole.q, other.q)
    np.testing.assert_array_equal(whole.v, other.v)
    assert whole.run.steps == other.run.steps
    assert whole.run.evaluations == other.run.evaluations
    np.testing.assert_array_equal(whole.motion.knots, other.motion.knots)
    times = np.linspace(0.0, whole.scene.end, 23)
    np.testing.assert_array_equal(whole(times).q, other(times).q)


# Thinned runs, and runs with stops, resume Gauss methods.
@pytest.mark.by_hand("Gauss(step=0.01, order=4, solver='auto')")
@pytest.mark.parametrize(
    "method",
    [
        method if k in (0, 5) else pytest.param(method, marks=pytest.mark.by_hand)
        for k, method in enumerate(METHODS)
    ],
    ids=str,
)
def test_resumed_run_has_the_same_bits(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, method: Any
) -> None:
    """States, steps and dense output agree; a finished run is read without integration."""
    path = tmp_path / "run.ckpt"
    long = cat_scene(method=method, duration=60.0, times=[0.0, 3.3, 60.0])
    whole, other = resumed(monkeypatch, lambda: long, path)
    check_equal(whole, other)
    with killed_after(monkeypatch, 99) as saves:
        check_equal(whole, pinred.simulate(long, checkpoint=path))
    assert saves == [0]  # the finished run is read without a pause
    assert [file.name for file in tmp_path.iterdir()] == ["run.ckpt"]


def controlled(t: float, state: dict[str, Any], seen: Any) -> tuple[Any, dict[str, Any]]:
    """Return a thruster pulse of a PI controller whose state is changed in place."""
    state["sum"] += seen.x["bend"]
    state["noise"] = state["rng"].normal()
    torque = {"bend": -0.05 * seen.x["bend"] - 0.01 * state["sum"] + 0.01 * state["noise"]}
    return Command(torque, width=0.03 if t < 5.0 else None), state


def controlled_scene() -> pinred.Scene:
    """Return a scene with a stateful controller, an event in each turn, and a pulse."""
    state = {"sum": 0.0, "rng": np.random.default_rng(1), "noise": 0.0}
    force = Torque(lambda s: {"twist": ca.if_else(s.t > 4.321, 0.01, 0.0)})
    return cat_scene(
        duration=10.0,
        times=[0.0, 3.3, 10.0],
        forces=[Controller(controlled, 0.05, ("bend",), state0=state), force],
        events=[pinred.Event("x['sway']", "straight")],
    )


def test_resumed_run_with_controller_and_events_has_the_same_bits(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Pulses, the pickled state of the controller, its record and crossings continue."""
    whole, other = resumed(monkeypatch, controlled_scene, tmp_path / "run.ckpt")
    check_equal(whole, other)
    np.testing.assert_array_equal(whole.events["straight"].t, other.events["straight"].t)
    assert len(whole.events["straight"]) > 3
    assert len(whole.actions) == len(other.actions) == 200
    for action, same in zip(whole.actions, other.actions, strict=True):
        assert (action.t, action.torque, action.width) == (same.t, same.torque, same.width)
        np.testing.assert_array_equal(action.seen.mu, same.seen.mu)


def test_resumed_run_ends_at_the_same_event(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A terminal event in the middle of a run, and a run that is called again after it."""
    turned = pinred.Event("x['twist'] + 60.0", "turned", terminal=True)
    options = {"duration": 60.0, "times": [0.0, 60.0], "events": [turned], "rtol": 1e-12}
    make = partial(cat_scene, **options)
    path = tmp_path / "run.ckpt"
    whole, other = resumed(monkeypatch, make, path)
    assert whole.ended_by == other.ended_by == "turned"
    check_equal(whole, other)
    check_equal(whole, pinred.simulate(make(), checkpoint=path))


@pytest.mark.by_hand("Gauss(0.01, 4)")
@pytest.mark.parametrize("method", ["auto", "Gauss(0.01, 4)"])
def test_resumed_run_with_stops_equals_the_run_through_stops(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, method: str
) -> None:
    """Without a checkpoint, compiled code passes all stops at once."""
    force = Torque(lambda s: {"bend": 0.02 * ca.sign(ca.sin(s.t))})
    make = partial(cat_scene, forces=[force], method=method, times=[0.0, 30.0])
    check_equal(*resumed(monkeypatch, make, tmp_path / "run.ckpt"))


def test_resumed_run_is_integrated_again_with_more_stops(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A function of time that steps skip leads to a second run, in which the run is killed."""
    force = Torque(lambda s: {"bend": 0.5 * ca.exp(-(((s.t - 20.0) / 0.005) ** 2))})
    make = partial(cat_scene, forces=[force])
    whole, other = resumed(monkeypatch, make, tmp_path / "run.ckpt")
    check_equal(whole, other)
    assert len(whole.motion.segments) > 1


def test_resumed_thinned_run_has_the_same_bits(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A long run that stores few states keeps its copies."""
    monkeypatch.setattr(integrator, "STORED_BYTES", 0)
    force = Torque(lambda s: {"bend": ca.if_else(s.t > 14.0, 0.01, 0.0)})
    method = pinred.Gauss(0.01, 4)
    make = partial(cat_scene, method=method, duration=60.0, times=[3.3, 60.0], forces=[force])
    whole, other = resumed(monkeypatch, make, tmp_path / "run.ckpt")
    saved = read_checkpoint(tmp_path / "run.ckpt")
    assert saved is not None
    assert all("copies" in part["run"] for part in saved["runs"][0]["finished"])
    check_equal(whole, other)


# Thinned runs and runs with followers are tested one by one.
@pytest.mark.by_hand
def test_resumed_thinned_run_with_followers_has_the_same_bits(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Long segments continue with the state of the controller and the crossings."""
    monkeypatch.setattr(integrator, "STORED_BYTES", 0)

    def steer(t: float, state: dict[str, Any], seen: Any) -> tuple[Any, dict[str, Any]]:
        state["sum"] += np.sin(seen.x["bend"])
        return Command({"bend": -1e-4 * state["sum"]}, width=2.0 if t < 9.0 else None), state

    def make() -> pinred.Scene:
        controller = Controller(steer, 3.0, ("bend",), state0={"sum": 0.0})
        return cat_scene(
            method=pinred.Gauss(0.01, 4), forces=[controller],
            events=[pinred.Event("sin(x['sway'])", "straight")],
        )  # fmt: skip

    whole, other = resumed(monkeypatch, make, tmp_path / "run.ckpt")
    check_equal(whole, other)
    np.testing.assert_array_equal(whole.events["straight"].t, other.events["straight"].t)
    assert len(whole.events["straight"]) > 3
    assert len(whole.actions) == len(other.actions) == 10


def test_other_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Checkpoints of another scene, method or user, and damaged files are not used."""
    path = tmp_path / "run.ckpt"
    pinred.simulate(cat_scene(), checkpoint=path)
    for other in (cat_scene(seed=4), cat_scene(times=[30.0]), cat_scene(method="Tsit5")):
        with pytest.raises(InputError, match="another scene"):
            pinred.simulate(other, checkpoint=path)
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint_module, "_fingerprint_of_environment", lambda: "0" * 64)
        for other in (cat_scene(), cat_scene(seed=4)):
            with pytest.raises(InputError, match="for another CPU"):
                pinred.simulate(other, checkpoint=path)
    content = path.read_bytes()
    changed = content[:-100] + bytes([content[-100] ^ 1]) + content[-99:]
    for data, match in (
        (content[:-1], "truncated"),
        (content[: len(content) // 2], "truncated"),
        (changed, "damaged"),
        (b"", "not written as a checkpoint"),
        (b"important", "not written as a checkpoint"),
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match=match):
            pinred.simulate(cat_scene(), checkpoint=path)
        assert path.read_bytes() == data
    path.write_bytes(content)
    with monkeypatch.context() as patch:
        patch.setattr("pinred.simulation.checkpoint.signing_key", lambda: b"0" * 32)
        with pytest.raises(InputError, match="key of another data folder"):
            pinred.simulate(cat_scene(), checkpoint=path)


def test_unsuitable_checkpoints_are_refused(tmp_path: Path) -> None:
    """The reason is named: a state without pickle, the other engine, another suffix."""
    path = tmp_path / "run.ckpt"
    hold = Controller(lambda *args: ([0.0], args[1]), 0.1, ("bend",), state0=Unpicklable())
    with pytest.raises(InputError, match="state of controller that can be pickled"):
        pinred.simulate(cat_scene(forces=[hold]), checkpoint=path)
    with pytest.raises(InputError, match="compiled engine"):
        pinred.simulate(cat_scene(), engine="pinocchio", checkpoint=path)
    with pytest.raises(InputError, match=r"suffix must be \.ckpt"):
        pinred.simulate(cat_scene(), checkpoint=tmp_path / "run.npz")
    assert not list(tmp_path.iterdir())


class Unpicklable:
    """A state that can be copied, but not pickled."""

    def __reduce__(self) -> Any:
        raise TypeError("it has a thread")

    def __deepcopy__(self, memo: Any) -> Unpicklable:
        return self


SCENE = """
robot = "planar_chain5"
[start]
seed = 1
[run]
duration = {end}
times = [{end}]
method = {{ name = "RKMK4", step = 0.0005 }}
"""


PROGRAM = """
import sys
from pinred.cli.command_line import main
from pinred.simulation import checkpoint
checkpoint.INTERVAL = 0.05
sys.exit(main())
"""


@pytest.mark.slow
def test_interrupted_process_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After `kill -INT`, the same command continues, and its motion has the same bits."""
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.format(end=400.0))
    path = tmp_path / "run.ckpt"
    command = [sys.executable, "-c", PROGRAM, "run", str(scene), "--out", "out.npz"]
    command += ["--checkpoint", path.name]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60.0
    while not path.exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGINT)
    _, text = process.communicate(timeout=30.0)
    assert process.returncode == 130, text
    assert {file.name for file in tmp_path.iterdir()} == {"scene.toml", "run.ckpt"}
    steps = registers(path)[2]["steps"].item()
    assert 0 < steps < 800_000
    monkeypatch.chdir(tmp_path)
    assert main(command[3:]) == 0
    whole = pinred.simulate(pinred.load_scene(scene))
    np.testing.assert_array_equal(pinred.read_recording(tmp_path / "out.npz").q, whole.q)


def test_interrupted_run_with_joint_stops_continues_with_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parts that end at impacts, at rests and at the end are restored, and modes are repeated."""
    monkeypatch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 64)
    cat = pinred.load("falling_cat")
    restitution = zip(cat.shape_names, (0.0, 0.3, 0.6), strict=True)
    options: dict[str, Any] = {
        "x0": [0.1, 0.2, -0.1], "xdot0": [3.0, -3.0, 2.0], "xi0": [0.1, 0.2, 0.3, 0.1, 0.5, -0.2],
        "forces": [Torque(lambda *_: [0.05, 0.04, -0.02])], "duration": 0.6, "rtol": 1e-11,
        "stops": {name: pinred.Stop(-0.5, 0.5, e) for name, e in restitution},
    }  # fmt: skip
    path = tmp_path / "run.ckpt"
    whole, counts = pinred.simulate(cat, **options), []
    for saves in (4, 4):
        with killed_after(monkeypatch, saves), pytest.raises(Killed):
            pinred.simulate(cat, **options, checkpoint=path)
        counts.append(len((read_checkpoint(path) or {})["runs"][0]["finished"]))
    assert counts[1] > counts[0] > 0
    assert len(whole.motion.modes) >= 3
    for _ in range(2):  # the second one reads the checkpoint of a finished run
        other = pinred.simulate(cat, **options, checkpoint=path)
        np.testing.assert_array_equal(whole.q, other.q)
        np.testing.assert_array_equal(whole.v, other.v)
        assert whole.impacts.rows == other.impacts.rows
        assert whole.run.steps == other.run.steps
    stops = options["stops"] | {"bend": pinred.Stop(-0.5, 0.5, 0.1)}
    with pytest.raises(InputError, match="was written for another scene"):
        pinred.simulate(cat, **options | {"stops": stops}, checkpoint=path)
    hold = Controller(lambda *_: [0.0], 0.1, ("bend",))
    with pytest.raises(InputError, match="checkpoint: expected no controllers in a scene with"):
        pinred.simulate(cat, **options | {"forces": [hold]}, checkpoint=path)
