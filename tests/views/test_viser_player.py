"""Page of viser: local access only, placements, camera and controls."""

from __future__ import annotations

import builtins
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cameras import sees, shape_balls
from commands import refused

import pinred
from pinred.cli.command_line import main
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.viser_player import FOV, ViserPlayer

FPS = 10.0


@pytest.fixture(scope="module")
def traj() -> pinred.Trajectory:
    """Return a long flight, which the camera follows."""
    return pinred.simulate(pinred.load("falling_cat"), duration=10.0)


@pytest.fixture(scope="module")
def player(traj: pinred.Trajectory) -> Iterator[ViserPlayer]:
    """Yield a player without a browser."""
    pytest.importorskip("viser")
    shown = ViserPlayer(traj, View(fps=FPS, sphere="base"))
    yield shown
    shown.close()


def listeners(port: int) -> set[str]:
    """Return the addresses that listen at a port, from the kernel's tables."""
    result = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            address, at = line.split()[1].split(":")
            if line.split()[3] == "0A" and int(at, 16) == port:
                result.add(address)
    return result


def test_viser_listens_on_loopback_only(player: ViserPlayer) -> None:
    """The default of viser is all interfaces."""
    assert listeners(player.server.get_port()) == {"0100007F"}
    assert player.url == f"http://127.0.0.1:{player.server.get_port()}/"


def test_placements_at_frames_are_pinocchios(player: ViserPlayer, traj: pinred.Trajectory) -> None:
    """World placements of all joints, below a root that keeps the centre of mass in place."""
    system = traj.system
    model, data = system.model, system.model.createData()
    times = np.linspace(0.0, 10.0, 101)
    assert player._follow.value
    handles = dict(zip(player._names, player._handles, strict=True))
    for k, q in enumerate(traj(times).q):
        player.seek(times[k])
        com = pin.centerOfMass(model, data, q)
        np.testing.assert_allclose(player._root.position, -com, atol=1e-12)
        for joint in range(1, model.njoints):
            handle = handles["robot", f"{joint} {model.names[joint]}"]
            np.testing.assert_allclose(handle.position, data.oMi[joint].translation, atol=1e-12)
            quaternion = pin.Quaternion(*handle.wxyz)
            np.testing.assert_allclose(
                quaternion.toRotationMatrix(), data.oMi[joint].rotation, atol=1e-12
            )
    player.seek(1e9)
    assert player._slider.value == 10.0


def test_overlays_are_deformed(player: ViserPlayer, traj: pinred.Trajectory) -> None:
    """The locked inertia is the ellipsoid of the composite inertia at the time."""
    system = traj.system
    model, data = system.model, system.model.createData()
    index = player._names.index(("overlays", "locked inertia"))
    (mesh,) = player._meshes[index]
    for t in (0.0, 3.3):
        player.seek(t)
        pin.ccrba(model, data, traj([t]).q[0], np.zeros(model.nv))
        # The ellipsoid's moments are m/5 (tr S² − S²), and its points satisfy |S⁻¹ p| = 1.
        square = 2.5 / data.Ig.mass * np.trace(data.Ig.inertia) * np.eye(3)
        square -= 5.0 / data.Ig.mass * data.Ig.inertia
        points = np.asarray(mesh.vertices, dtype=float)
        size = np.einsum("ij,ij->i", points @ np.linalg.inv(square), points)
        np.testing.assert_allclose(size, 1.0, atol=5e-3)  # interpolated between frames


@pytest.mark.parametrize("follow", [True, False])
def test_camera_sees_the_robot_at_all_times(
    player: ViserPlayer, traj: pinred.Trajectory, follow: bool
) -> None:
    """In square windows, and in narrow ones, for which browsers get a farther camera."""
    centres, radii, com = shape_balls(traj, np.linspace(0.0, 10.0, 201))
    player._follow.value = follow
    player._aim()
    initial = player.server.initial_camera
    shown = centres - com[:, None] if follow else centres
    assert initial.fov == FOV
    assert sees(initial.position, initial.look_at, FOV, 1.0, shown, radii)
    assert not sees(initial.position, initial.look_at, 0.3 * FOV, 1.0, shown, radii)
    narrow = SimpleNamespace(camera=SimpleNamespace(aspect=0.4))
    player._fit(narrow)
    where = narrow.camera.position, narrow.camera.look_at
    assert sees(*where, FOV, 0.4, shown, radii)
    distance = float(np.linalg.norm(initial.position - initial.look_at))
    assert initial.near < 0.1 * distance
    assert initial.far > 2.0 * distance


def test_motion_loops_or_pauses_at_its_end(player: ViserPlayer) -> None:
    """A slider that the user moves pauses, too."""
    player.pause()
    player.seek(9.0)
    player._advance(0.5)
    assert player._slider.value == 9.5
    player._advance(1.0)
    assert player._slider.value == 0.0
    player._loop.value = False
    player.play()
    player._advance(11.0)
    assert player._slider.value == 10.0
    assert not player._playing
    player._slide(SimpleNamespace(client=object(), target=SimpleNamespace(value=3.0)))
    assert player._time == 3.0
    player._loop.value = True


def test_wrong_options_are_rejected(
    traj: pinred.Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unknown viewers, taken ports, and options of other pages."""
    with pytest.raises(pinred.InputError, match="'pinred' or 'viser', got 'gepetto'"):
        pinred.play(traj, viewer="gepetto", show=False)
    assert "invalid choice" in refused_parse(capsys, "play", "a.toml", "--viewer", "gepetto")
    words = refused(capsys, "play", "a.toml", "--viewer", "viser", "--out", "a.html")
    assert "--viewer applies" in words
    pytest.importorskip("viser")
    with pytest.raises(pinred.InputError, match="no shape panel"):
        pinred.play(traj, viewer="viser", show=False, pair=("bend", "twist"))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(pinred.InputError, match=f"port {port} is taken"):
            pinred.play(traj, viewer="viser", show=False, port=port)


def refused_parse(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Return the message of a command line that the parser rejects."""
    with pytest.raises(SystemExit):
        main([*words])
    return capsys.readouterr().err


def test_missing_package_names_the_extra(
    traj: pinred.Trajectory, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Both extras."""
    load = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.split(".")[0] in ("viser", "rerun"):
            raise ImportError(name)
        return load(name, *rest)

    monkeypatch.setattr("pinred.common.errors.import_module", lambda name: without(name))
    with pytest.raises(pinred.MissingPackageError, match=r'pip install "pinred\[viser\]"'):
        pinred.play(traj, viewer="viser", show=False)
    with pytest.raises(pinred.MissingPackageError, match=r'pip install "pinred\[rerun\]"'):
        pinred.save_rrd(traj, tmp_path / "a.rrd")
    assert not [*tmp_path.iterdir()]
