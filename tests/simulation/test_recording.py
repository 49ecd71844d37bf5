"""Recordings: states read from files, their plots, and files that are rejected."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from figures import drawn, units
from scipy.spatial.transform import Rotation

import pinred
from pinred import plots, read_recording
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.playback import playback


@pytest.fixture(scope="module")
def cat() -> pinred.Trajectory:
    """Return the motion of the falling cat from its default initial state."""
    times = np.linspace(0.0, 3.0, 501)
    return pinred.simulate(pinred.load("falling_cat"), times=times)


@pytest.mark.parametrize("options", [{}, {"lock": {"sway": 0.4}, "gravity": [0.0, 0.0, -1.0]}])
def test_recording_plays_like_its_trajectory(tmp_path: Path, options: dict[str, Any]) -> None:
    """Playback is the same, with robot, locked joints and gravity."""
    system = pinred.load("falling_cat", **options)
    traj = pinred.simulate(system, seed=3, times=np.linspace(0.0, 1.0, 61))
    traj.save(tmp_path / "traj.npz")
    recording = read_recording(tmp_path / "traj.npz")
    np.testing.assert_array_equal(recording.system.gravity, system.gravity)
    recorded, simulated = playback(recording, View()), playback(traj, View())
    for name in ("t", "x", "placements", "com", "ellipsoid"):
        np.testing.assert_allclose(getattr(recorded, name), getattr(simulated, name), atol=1e-9)
    with pytest.raises(pinred.InputError, match="contains no forces"):
        playback(recording, View(ghost=True))
    traj = pinred.simulate(system, seed=3, times=[0.5])
    traj.save(tmp_path / "once.npz")
    with pytest.raises(pinred.InputError, match="contains only one time"):
        playback(read_recording(tmp_path / "once.npz"), View())


def test_robot_file_is_found_beside_recording(tmp_path: Path) -> None:
    """A robot file is loaded from the folder of the recording or from a given path only."""
    text = (pinred.system.find_robot_files.bundled_folder() / "falling_cat.urdf").read_text(
        encoding="utf-8"
    )
    for folder in ("here", "there", "motion"):
        (tmp_path / folder).mkdir()
    (tmp_path / "here/cat.urdf").write_text(text, encoding="utf-8")
    traj = pinred.simulate(pinred.load(tmp_path / "here/cat.urdf"), seed=0, duration=0.1)
    path = tmp_path / "motion/traj.npz"
    traj.save(path)
    (tmp_path / "here/cat.urdf").rename(tmp_path / "there/cat.urdf")
    with pytest.raises(pinred.LoadError, match=r"in another folder.*--robot"):
        _ = read_recording(path).system
    assert len(plots.shape(read_recording(path)).axes[0].lines) == 3  # This plot needs no robot.
    assert read_recording(path, str(tmp_path / "there/cat.urdf")).system.name == "cat"
    (tmp_path / "there/cat.urdf").rename(tmp_path / "motion/cat.urdf")
    assert read_recording(path).system.name == "cat"
    with pytest.raises(pinred.InputError, match="name the right robot"):
        read_recording(path, "solo12")


def test_recording_plots_like_its_trajectory(cat: pinred.Trajectory, tmp_path: Path) -> None:
    """Plots and units are the same; plots that need forces raise an error."""
    path = tmp_path / "cat.npz"
    cat.save(path)
    recording = read_recording(path)
    assert "'cat'" in repr(recording) or "falling_cat" in repr(recording)
    assert "501 times to 3 s" in repr(recording)
    for kind in ("shape", "base", "momentum", "energy", "curvature"):
        figure, expected = plots.plot(recording, kind), pinred.plot(cat, kind)
        assert figure.get_suptitle() == expected.get_suptitle()
        for ours, theirs in zip(figure.axes[:1], expected.axes[:1], strict=True):
            assert ours.get_ylabel() == theirs.get_ylabel()
            for line in theirs.lines:
                label = str(line.get_label())
                if label != "path":  # The path of a trajectory is finer.
                    np.testing.assert_array_equal(drawn(ours, label)[1], line.get_ydata())
    np.testing.assert_array_equal(drawn(plots.curvature(recording).axes[0], "path"), cat.x[:, :2].T)
    assert units(plots.shape(recording)) == ["shape [rad]"]
    assert units(plots.energy(recording))[1] == "change since start\n[J]"
    with pytest.raises(pinred.InputError, match=r"cat\.npz contains no forces"):
        plots.error(recording)  # type: ignore[arg-type]
    pinred.simulate(cat.system, duration=0.1, outputs="shape").save(path)
    assert len(plots.shape(read_recording(path)).axes[0].lines) == 3
    with pytest.raises(pinred.InputError, match=r"cat\.npz.*outputs='shape'"):
        plots.base(read_recording(path))
    assert "leaves out the base" in plots.phase(read_recording(path)).get_suptitle()


def test_phase_portrait_of_recording(tmp_path: Path) -> None:
    """The cartpole has V = −4.905 cos x; no potential is drawn if a spring acts."""
    system = pinred.load("cartpole")
    path = tmp_path / "traj.npz"
    pinred.simulate(system, duration=3.0).save(path)
    top, portrait = plots.phase(read_recording(path)).axes
    x, potential = drawn(top, "amended potential")
    np.testing.assert_allclose(potential, -4.905 * np.cos(x), atol=1e-12)
    assert portrait.get_xlabel() == "pole_pivot [rad]"
    sprung = pinred.simulate(system, duration=3.0, springs={"pole_pivot": (1.0, 0.3)})
    sprung.save(path)
    figure = plots.phase(read_recording(path))
    assert "does not store its forces" in figure.get_suptitle()
    (axes,) = figure.axes
    np.testing.assert_array_equal(drawn(axes, "path"), [sprung.x[:, 0], sprung.xdot[:, 0]])


def test_momentum_sphere_of_recording(tmp_path: Path) -> None:
    """Momenta agree with Pinocchio, and the level set is that of the nearest time."""
    path = tmp_path / "sat.npz"
    traj = pinred.simulate(pinred.load("satellite_two_arms"), times=np.linspace(0.5, 2.0, 16))
    traj.save(path)
    figure = plots.sphere(read_recording(path), when=1.12)
    axes: Any = figure.axes[0]
    model, data = traj.system.model, traj.system.model.createData()
    expected = np.empty((len(traj), 3))
    for k, (q, v) in enumerate(zip(traj.q, traj.v, strict=True)):
        pin.ccrba(model, data, q, v)
        expected[k] = Rotation.from_quat(q[3:7]).inv().apply(data.hg.angular)
    starts = np.array([line.get_data_3d() for line in axes.lines if line.get_label() == "start"])
    np.testing.assert_allclose(starts[0, :, 0], expected[0], atol=1e-11)
    assert "shape of t = 1.1 s" in figure.legends[0].get_texts()[0].get_text()
    with pytest.raises(pinred.InputError, match="between 0 and 2 s"):
        plots.sphere(read_recording(path), when=3.0)


def test_poincare_section_of_recording_converges(tmp_path: Path) -> None:
    """The dense output between reports is of order 4 in shape and 3 in rate."""
    system = pinred.load("double_spherical_pendulum")
    errors = []
    for count in (251, 1001):
        traj = pinred.simulate(system, times=np.linspace(0.0, 10.0, count))
        traj.save(tmp_path / "traj.npz")
        figures = (
            plots.poincare(traj, value=0.3),
            plots.poincare(read_recording(tmp_path / "traj.npz"), value=0.3),
        )
        exact, recorded = (np.asarray(f.axes[0].lines[0].get_xydata(), float) for f in figures)
        assert len(exact) > 3
        errors.append(float(np.abs(exact - recorded).max()))
    assert 0.0 < errors[1] < 1e-4
    assert 4**2.5 < errors[0] / errors[1] < 4**4.5


@pytest.mark.slow
def test_recording_of_model_names_no_robot(tmp_path: Path) -> None:
    """States are plotted; plots that need the robot ask for it."""
    model = pinred.load("falling_cat").model
    path = tmp_path / "traj.npz"
    start: dict[str, Any] = {"x0": [0.1, 0.2, 0.3], "xdot0": [1, 0, 0], "momentum": 0}
    pinred.simulate(pinred.load(model), **start, duration=0.5).save(path)
    recording = read_recording(path)
    assert units(plots.shape(recording)) == ["shape [rad | m]"]
    assert "robot of the file was not found" in plots.phase(recording).get_suptitle()
    for kind in ("sphere", "curvature"):
        with pytest.raises(pinred.LoadError, match=r"does not say where its robot.*--robot"):
            plots.plot(recording, kind)
    assert units(plots.shape(read_recording(path, "falling_cat"))) == ["shape [rad]"]
    top = pinred.simulate(pinred.load(pinred.load("rigid_body").model), seed=0, duration=0.5)
    top.save(path)
    assert len(plots.sphere(read_recording(path)).axes) == 1  # The file contains the momentum.


def test_other_files_are_rejected(tmp_path: Path) -> None:
    """The message states the file and the first problem."""
    path = tmp_path / "bad.npz"
    path.write_bytes(b"PK\x03\x04 no")
    with pytest.raises(pinred.LoadError, match=r"bad\.npz"):
        read_recording(path)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(pinred.LoadError, match="not a motion that pinred wrote"):
        read_recording(path)
    good: dict[str, Any] = {
        "robot": "r",
        "group": "SO2",
        "joints": ["a"],
        "t": [0.0, 1.0],
        "energy": [1.0, 1.0],
    }
    np.savez(path, **good, x=np.zeros((2, 2)), xdot=np.zeros((2, 1)))
    with pytest.raises(pinred.LoadError, match=r"'x' has shape \(2, 2\), expected \(2, 1\)"):
        read_recording(path)
    np.savez(path, **good, x=np.full((2, 1), np.nan), xdot=np.zeros((2, 1)))
    with pytest.raises(pinred.LoadError, match="not finite"):
        read_recording(path)


def test_damaged_recordings_are_rejected(tmp_path: Path) -> None:
    """Each kind of damage raises an error of pinred, and no code is executed."""
    traj = pinred.simulate(pinred.load("rigid_body"), duration=0.1)
    traj.save(tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as file:
        good = dict(file)
    mark = tmp_path / "mark"

    class Evil:
        def __reduce__(self) -> tuple[object, ...]:
            return Path.touch, (mark,)

    def refused(
        error: type[Exception],
        words: str,
        seen: Callable[[pinred.Recording], object] = lambda _: None,
        **changed: Any,
    ) -> None:
        arrays = {name: value for name, value in (good | changed).items() if value is not None}
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(error, match=words):
            seen(read_recording(tmp_path / "bad.npz"))

    refused(pinred.LoadError, "made of Python objects", q=np.array([Evil()], dtype=object))
    assert not mark.exists()
    pickle.loads(pickle.dumps(Evil()))
    assert mark.exists()  # it would have worked
    refused(pinred.LoadError, "has no array 'joints'", joints=None)
    refused(pinred.LoadError, "unknown group 'E3'", group="E3")
    refused(pinred.LoadError, "has no array 'x'", x=None)
    refused(pinred.LoadError, r"'xi' has shape \(201, 3\), expected \(201, 6\)", group="SE3")
    refused(pinred.LoadError, "'q' has entries that are not finite", q=np.nan * good["q"])
    refused(pinred.LoadError, "'xi' has entries", xi=good["xi"].astype(int))
    refused(pinred.LoadError, "'v' has shape", v=good["v"][:-1])
    refused(pinred.LoadError, "'q' has shape", q=good["q"][:, 0])
    refused(pinred.LoadError, "increasing", t=good["t"][::-1])
    refused(pinred.LoadError, r"'x' has shape .* expected \(201, 1\)", joints=np.array(["knee"]))
    # Only with the robot:
    refused(pinred.InputError, r"outputs='shape'", seen=lambda r: r.states, q=None)
    wrong: dict[str, Any] = {"seen": lambda recording: recording.system}
    refused(pinred.LoadError, "does not say where its robot", **wrong, source=np.array(""))
    refused(pinred.LoadError, "unknown robot 'nobody'", **wrong, source=np.array("nobody"))
    refused(pinred.LoadError, "cannot be loaded", **wrong, gravity=np.array(["a"]))
    refused(pinred.LoadError, "cannot be loaded", **wrong, lock_joints=np.array(["a"]))
    refused(pinred.InputError, "is not the configuration", **wrong, q=2.0 * good["q"])
    refused(pinred.InputError, "'q' has shape", **wrong, q=good["q"][:, :3])
    refused(
        pinred.InputError, r"group SO3 and the joints knee, but", **wrong,
        x=np.zeros((201, 1)), xdot=np.zeros((201, 1)), v=np.zeros((201, 4)),
        joints=np.array(["knee"]),
    )  # fmt: skip
    # Random damage raises an error of pinred, too.
    content, rng = (tmp_path / "good.npz").read_bytes(), np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(content)
        for at in rng.integers(len(content), size=4):
            damaged[at] ^= 1 << int(rng.integers(8))
        (tmp_path / "bad.npz").write_bytes(bytes(damaged[: rng.integers(1, len(content) + 1)]))
        with contextlib.suppress(pinred.PinredError):
            _ = read_recording(tmp_path / "bad.npz").system
    (tmp_path / "text.npz").write_text("hello")
    np.save(tmp_path / "array.npy", good["q"])
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    for name in ("text.npz", "array.npz", "gone.npz"):
        with pytest.raises(pinred.LoadError, match=name) as caught:
            read_recording(tmp_path / name)
        assert "pickle" not in str(caught.value)
        assert "context manager" not in str(caught.value)
