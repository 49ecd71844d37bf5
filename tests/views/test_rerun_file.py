"""Recordings for rerun, read back with rerun's own reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cameras import sees, shape_balls

import pinred
from pinred.cli.command_line import main
from pinred.views.playback.rerun_file import ASPECT, FOV

pytest.importorskip("rerun")
FPS = 10.0
FRAMES = 101
Columns = dict[str, dict[str, Any]]  # {entity: {column: values}}


@pytest.fixture(scope="module")
def traj() -> pinred.Trajectory:
    """Return a long flight, which the camera follows."""
    return pinred.simulate(pinred.load("falling_cat"), duration=10.0)


def read(path: Path) -> tuple[Columns, Columns, Columns]:
    """Return the columns over time, the static columns, and those of the layout."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    (layout,) = reader.blueprints()
    moving, static, drawn = Columns(), Columns(), Columns()
    for chunks, store in ((reader.stream(), None), (reader.stream(store=layout), drawn)):
        for chunk in chunks.to_chunks():
            table = static if chunk.is_static else moving
            entry = (table if store is None else store).setdefault(chunk.entity_path, {})
            entry.update(chunk.to_record_batch().to_pydict())
    return moving, static, drawn


def test_recording_has_pinocchios_placements(traj: pinred.Trajectory, tmp_path: Path) -> None:
    """All frames and joints, energy and shape; the camera sees the robot at all times."""
    path = tmp_path / "cat.rrd"
    assert pinred.save_rrd(traj, path, fps=FPS, speed=1.0, sphere="base") == path.stat().st_size
    assert [*tmp_path.iterdir()] == [path]
    moving, static, layout = read(path)
    system, times = traj.system, np.linspace(0.0, 10.0, FRAMES)
    model, data = system.model, system.model.createData()
    states = traj(times)
    for joint in range(1, model.njoints):
        entity = f"/robot/{joint}\\ {model.names[joint]}"
        columns = moving[entity]
        seconds = [float(t) / 1e9 for t in np.asarray(columns["time"], dtype="m8[ns]").astype(int)]
        np.testing.assert_allclose(seconds, times, atol=1e-8)
        position = np.array(columns["Transform3D:translation"])[:, 0]
        quaternion = np.array(columns["Transform3D:quaternion"])[:, 0]
        for k, q in enumerate(states.q):
            pin.forwardKinematics(model, data, q)
            exact = data.oMi[joint]
            np.testing.assert_allclose(position[k], exact.translation, rtol=1e-6, atol=1e-6)
            turned = pin.Quaternion(quaternion[k] / np.linalg.norm(quaternion[k]))
            np.testing.assert_allclose(turned.matrix(), exact.rotation, atol=1e-6)
        faces = np.array(static[f"{entity}/0"]["Mesh3D:triangle_indices"][0])
        vertices = static[f"{entity}/0"]["Mesh3D:vertex_positions"][0]
        assert faces.max() == len(vertices) - 1
    energy = np.array(moving["/energy/energy"]["Scalars:scalars"])[:, 0]
    np.testing.assert_array_equal(energy, states.energy)
    bend = np.array(moving["/shape/bend"]["Scalars:scalars"])[:, 0]
    np.testing.assert_array_equal(bend, states.x[:, 0])
    check_camera(traj, moving, layout)


def test_overlays_have_stretches_and_opacities(tmp_path: Path) -> None:
    """The locked inertia is an ellipsoid of the composite inertia; flashes of impacts fade."""
    traj = pinred.simulate(
        pinred.load("falling_cat"), xdot0=[3.0, -2.0, 1.0], duration=1.0,
        stops={"bend": (-0.6, 0.6, 0.5)},
    )  # fmt: skip
    path = tmp_path / "cat.rrd"
    pinred.save_rrd(traj, path, fps=FPS)
    moving, static, _ = read(path)
    columns = moving["/overlays/locked\\ inertia"]
    matrices = np.array(columns["Transform3D:mat3x3"])[:, 0].reshape(-1, 3, 3).swapaxes(1, 2)
    model, data = traj.system.model, traj.system.model.createData()
    for k, q in enumerate(traj(np.linspace(0.0, 1.0, len(matrices))).q):
        pin.ccrba(model, data, q, np.zeros(model.nv))
        # A ball under the matrix S has the inertia m/5 (tr S² − S²).
        square = matrices[k] @ matrices[k]
        inertia = data.Ig.mass / 5.0 * (np.trace(square) * np.eye(3) - square)
        np.testing.assert_allclose(inertia, data.Ig.inertia, rtol=1e-5, atol=1e-5)
    tints = np.array(moving["/overlays/impact\\ at\\ bend/0"]["Mesh3D:albedo_factor"])[:, 0]
    times = np.sort(traj.impacts.t)
    for k, t in enumerate(np.linspace(0.0, 1.0, len(tints))):
        since = min([t - at for at in times if at <= t], default=np.inf)
        assert abs((int(tints[k]) & 255) - 255.0 * max(0.0, 1.0 - since / 0.25)) <= 0.51
    assert "/overlays/momentum\\ shaft/0" in static


def check_camera(traj: pinred.Trajectory, moving: Columns, layout: Columns) -> None:
    """Check that the 3D view, whose origin is the centre of mass, contains the robot."""
    (view,) = (v for v in layout.values() if v.get("ViewBlueprint:class_identifier") == [["3D"]])
    (eye,) = (entry for entry in layout.values() if "EyeControls3D:position" in entry)
    centres, radii, com = shape_balls(traj, np.linspace(0.0, 10.0, FRAMES))
    assert view["ViewBlueprint:space_origin"] == [["/centre\\ of\\ mass"]]
    origin = np.array(moving["/centre\\ of\\ mass"]["Transform3D:translation"])[:, 0]
    np.testing.assert_allclose(origin, com, rtol=1e-6, atol=1e-6)
    position, target = (
        np.array(eye[f"EyeControls3D:{name}"][0][0]) for name in ("position", "look_target")
    )
    for aspect in (ASPECT, 1.0, 2.0):
        assert sees(position, target, FOV, aspect, centres - com[:, None], radii)
    assert not sees(position, target, FOV, 0.2 * ASPECT, centres - com[:, None], radii)


def test_command_writes_a_recording_of_a_file(
    traj: pinred.Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A .npz file keeps its own times; an existing file survives an error."""
    motion, path = tmp_path / "cat.npz", tmp_path / "cat.rrd"
    traj.save(motion)
    assert main(["play", str(motion), "--out", str(path), "--no-meshes"]) == 0
    assert f"written to {path}" in capsys.readouterr().out
    count = len(pinred.read_recording(motion).t)
    assert len(read(path)[0]["/energy/energy"]["time"]) == count
    before = path.read_bytes()
    with pytest.raises(pinred.InputError, match="no shape panel"):
        pinred.save_rrd(traj, path, pair=("bend", "twist"))
    assert path.read_bytes() == before
