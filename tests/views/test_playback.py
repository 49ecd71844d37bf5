"""Playback numbers, against closed forms and sums over bodies."""

from __future__ import annotations

import base64
import gzip
import re
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image
from trees import random_model

import pinred
from pinred.common import waiting
from pinred.common.arrays import Array
from pinred.lie import GROUPS
from pinred.lie.rotations import rotation
from pinred.views.playback import film as films
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.drawn_bodies import drawn_bodies
from pinred.views.playback.film import write_frames, write_gif
from pinred.views.playback.playback import Playback, playback, shape_panel
from pinred.views.playback.scene_nodes import frame


def film(name: str, *, ghost: bool = False, fps: float = 60.0, **scene: Any) -> Playback:
    """Return the playback of a robot's simulation."""
    return playback(pinred.simulate(pinred.load(name), **scene), View(ghost=ghost, fps=fps))


def bodies(of: Playback) -> tuple[Array, Array, Array, Array]:
    """Return masses (n,), centres (F, n, 3), inertias (F, n, 3, 3) and world rotations."""
    inertias = [of.system.model.inertias[i] for i in range(1, of.system.model.njoints)]
    mass = np.array([inertia.mass for inertia in inertias])
    rotations = rotation(of.placements[:, 1:, 3:])
    lever = np.array([inertia.lever for inertia in inertias])
    centre = of.placements[:, 1:, :3] + np.einsum("fnij,nj->fni", rotations, lever)
    expected = np.array([inertia.inertia for inertia in inertias])
    return mass, centre, rotations @ expected @ np.swapaxes(rotations, -1, -2), rotations


@pytest.mark.parametrize("name", ["falling_cat", "solo12", "planar_chain5"])
def test_playback_equals_sums_over_bodies(name: str) -> None:
    """CoM, inertia ellipsoid and angular momentum are computed from drawn placements."""
    options: dict[str, Any] = {"seed": 1} if name == "solo12" else {}
    shown = film(name, fps=2000.0, duration=0.1, **options)
    mass, centre, inertia, rotations = bodies(shown)
    com = np.einsum("n,fni->fi", mass, centre) / mass.sum()
    np.testing.assert_allclose(shown.com, com, atol=1e-12)
    arm = centre - com[:, None]
    steiner = np.einsum("fni,fni->fn", arm, arm)[..., None, None] * np.eye(3)
    steiner = steiner - arm[..., :, None] * arm[..., None, :]
    locked = (inertia + mass[:, None, None] * steiner).sum(axis=1)
    # A homogeneous ellipsoid x = S u of mass m has the inertia m/5 (tr(S²) − S²).
    square = shown.ellipsoid @ shown.ellipsoid
    trace = np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    np.testing.assert_allclose(mass.sum() / 5.0 * (trace - square), locked, rtol=1e-9, atol=1e-12)
    # Velocities by central differences of the frames, half a millisecond apart.
    step = shown.t[2] - shown.t[0]
    speed = (arm[2:] - arm[:-2]) / step
    turning = (rotations[2:] - rotations[:-2]) / step @ np.swapaxes(rotations[1:-1], -1, -2)
    spin = np.stack([turning[..., 2, 1], turning[..., 0, 2], turning[..., 1, 0]], axis=-1)
    momentum = np.einsum("fnij,fnj->fi", inertia[1:-1], spin)
    momentum += np.einsum("n,fni->fi", mass, np.cross(arm[1:-1], speed))
    scale = np.abs(momentum).max()
    np.testing.assert_allclose(shown.momentum.vector[1:-1], momentum, atol=2e-5 * scale)


def test_arrow_is_constant_in_flight() -> None:
    """In a long flight in gravity the arrow's tail follows the parabola of the CoM."""
    shown = film("solo12", seed=2, duration=2.0)
    vector = shown.momentum.vector
    assert np.linalg.norm(vector[0]) > 1e-3
    np.testing.assert_allclose(vector, np.broadcast_to(vector[0], vector.shape), atol=1e-9)
    fall = shown.t[:, None] ** 2 * [0.0, 0.0, -9.81 / 2.0]
    straight = shown.com - fall
    even = straight[0] + (straight[-1] - straight[0]) * (shown.t / shown.t[-1])[:, None]
    np.testing.assert_allclose(straight, even, atol=1e-8)
    np.testing.assert_array_equal(shown.momentum.tail, shown.com)
    first, last = (rotation(shown.placements[k, 1, 3:]) for k in (0, -1))
    assert np.abs(first - last).max() > 0.3


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        # J = I (ξ + A ẋ): 3 (0.8 − 0.4/3); of the cart, 3 (0.3 − cos(1)/6 · 0.5) along its rail.
        ("elroys_beanie", [0.0, 0.0, 2.0]),
        ("cartpole", [0.9 - 0.25 * np.cos(1.0), 0.0, 0.0]),
        # Euler's top at rest in its frame: moments 1, 2, 2.5 times the body rates.
        ("rigid_body", [0.5, 1.4, 4.0]),
    ],
)
def test_arrow_in_closed_form(name: str, wanted: list[float]) -> None:
    """For one axis of rotation, one of translation, and a pivot."""
    np.testing.assert_allclose(film(name, duration=1.0).momentum.vector, [wanted] * 61, atol=1e-9)


@pytest.mark.by_hand("SE3-0")
@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("group", GROUPS)
def test_arrow_of_random_trees_is_constant(group: str, seed: int) -> None:
    """For tilted roots and branches out of plane, the arrow is the conserved momentum."""
    model = random_model(group, 4, seed)
    if group == "SO2":  # only there may the root have a rotor
        model.armature = np.array([0.5, *model.armature[1:]])
    system = pinred.load(model)
    shown = playback(pinred.simulate(system, seed=seed, duration=1.0), View(fps=20.0))
    vector = shown.momentum.vector
    scale = float(np.linalg.norm(vector[0]))
    assert scale > 1e-3
    assert np.abs(vector - vector[0]).max() < 1e-8 * max(1.0, scale)
    if group != "SE3":  # the tail too, but for what slides
        away = shown.momentum.tail - shown.momentum.tail[0]
        assert (np.abs(away).max() > 1e-3) == (GROUPS[group].linear > 0)
    mass, centre, _, _ = bodies(shown)
    np.testing.assert_allclose(shown.com, np.einsum("n,fni->fi", mass, centre) / mass.sum())


def test_zero_momentum_has_no_arrow() -> None:
    """Round-off is not drawn."""
    options: dict[str, Any] = {"x0": [0.5, 0.2, -0.3], "xdot0": [3.0, -2.0, 1.0], "momentum": 0}
    assert not film("falling_cat", duration=2.0, **options).momentum.vector.any()


def test_ghost_is_full_simulation() -> None:
    """It stays with an accurate motion and leaves an inaccurate one."""
    good = film("falling_cat", ghost=True, duration=2.0)
    assert good.ghost is not None
    assert good.ghost.apart.max() < 1e-9
    assert good.ghost.placements.shape == good.placements.shape
    bad = film("falling_cat", ghost=True, duration=2.0, method=pinred.RKMK4(0.2))
    assert bad.ghost is not None
    distance = np.linalg.norm((bad.ghost.placements - bad.placements)[..., :3], axis=2).max(axis=1)
    assert 1e-7 < distance.max() <= bad.ghost.apart.max() < 1e-1


def test_frames_follow_speed_and_fps(tmp_path: Path) -> None:
    """Invalid options are rejected."""
    traj = pinred.simulate(pinred.load("rigid_body"), duration=3.0)
    shown = playback(traj, View(speed=2.0, fps=20.0))
    np.testing.assert_allclose(shown.t, np.linspace(0.0, 3.0, 31))
    with pytest.raises(pinred.InputError, match=r"180001 frames are too many.*lower fps"):
        playback(traj, View(fps=60_000.0))
    for options, words in (
        ({"speed": 0.0}, "speed must be finite and above zero"),
        ({"pair": ["a", "a"]}, "pair must be the names of two joints"),
        ({"pair": "ab"}, "pair must be the names of two joints"),
        ({"pair": 3}, "pair must be the names of two joints, got 3"),
        ({"pair": [1, 2]}, "pair must be the names of two joints"),
        ({"gost": True}, "no option 'gost'; the options are ghost, speed"),
    ):
        with pytest.raises(pinred.InputError, match=words):
            pinred.save_html(traj, tmp_path / "a.html", **options)
    with pytest.raises(pinred.InputError, match=r"suffix must be \.html"):
        pinred.save_html(traj, tmp_path / "a.htm")
    for path in (None, 3, "a\0b.html"):
        with pytest.raises(pinred.InputError, match="path must be the name of a file, got"):
            pinred.save_html(traj, path)  # type: ignore[arg-type]
    shape = pinred.simulate(pinred.load("falling_cat"), duration=0.1, outputs="shape")
    with pytest.raises(pinred.InputError, match="outputs='all'"):
        playback(shape, View())


def test_panel_field_is_curvature() -> None:
    """Two chosen joints of the cat, the third frozen; compared with Pinocchio."""
    shown = film("falling_cat", duration=1.0)
    panel = shape_panel(shown.system, shown.x, shown.xdot, ("twist", "bend"))
    assert panel is not None
    assert panel.labels == ("twist [rad]", "bend [rad]")
    np.testing.assert_array_equal(panel.path, shown.x[:, [2, 0]])
    assert (panel.low < panel.path.min(axis=0)).all()
    assert (panel.high > panel.path.max(axis=0)).all()
    n = panel.field.shape[1]
    x = shown.x[0].copy()
    x[2] = panel.low[0] + (panel.high[0] - panel.low[0]) * 10 / (n - 1)
    x[0] = panel.low[1] + (panel.high[1] - panel.low[1]) * 40 / (n - 1)
    B = pinred.Reduction(shown.system).curvature(x)[:, 2, 0]
    names = ["shift along x", "shift along y", "shift along z", *map("turn about {}".format, "xyz")]
    for name, component in zip(panel.components, panel.field, strict=True):
        k = names.index(name.split(" [")[0])
        assert name.endswith("[m/(rad·rad)]" if k < 3 else "[rad/(rad·rad)]")
        np.testing.assert_allclose(component[10, 40], B[k], atol=1e-12)
    # Wheels spin at 15 to 30 rad/s: the hinge comes before them, and their waves are not drawn.
    wheels = film("reaction_wheel_satellite", duration=5.0)
    spun = shape_panel(wheels.system, wheels.x, wheels.xdot)
    assert spun is not None
    assert spun.labels[0] == "panel_hinge [rad]"
    assert (spun.components, spun.field.size) == ((), 0)
    one = film("elroys_beanie", duration=1.0)
    phase = shape_panel(one.system, one.x, one.xdot)
    assert phase is not None
    assert phase.labels[1] == "rate of beanie [rad/s]"
    np.testing.assert_array_equal(phase.path[:, 1], one.xdot[:, 0])
    with pytest.raises(pinred.InputError, match="no joint 'knee'; the joints are bend"):
        shape_panel(shown.system, shown.x, shown.xdot, ("knee", "bend"))


def test_shapes_have_placements_of_file() -> None:
    """With a locked joint and a free root, against Pinocchio's model of the file."""
    system = pinred.load("solo12", lock={"FL_HFE": 0.7, "HR_KFE": -0.4})
    assert system.origin is not None
    path = pinred.system.find_robot_files.example_robot("solo12").urdf
    raw = pin.buildModelFromUrdf(str(path))
    folders = [str(folder) for folder in path.resolve().parents]
    geometry = pin.buildGeomFromUrdf(raw, str(path), pin.GeometryType.VISUAL, package_dirs=folders)
    rng = np.random.default_rng(0)
    angles = dict(zip(system.shape_names, rng.uniform(-1.0, 1.0, system.m), strict=True))
    locked = dict(system.origin.lock)
    q = np.array([(angles | locked)[name] for name in list(raw.names)[1:]])
    data, place = raw.createData(), geometry.createData()
    pin.updateGeometryPlacements(raw, data, geometry, place, q)
    base = pin.XYZQUATToSE3(np.array([0.3, -0.2, 0.5, 0.5, 0.5, -0.5, 0.5]))
    ours = system.model.createData()
    pose = pin.SE3ToXYZQUAT(base)
    pin.forwardKinematics(system.model, ours, system.q(pose, list(angles.values())))
    drawn = drawn_bodies(system)
    assert (drawn.note, len(drawn.solids), len(drawn.meshes)) == ("", 17, 10)
    for solid, wanted in zip(drawn.solids, place.oMg, strict=True):
        result = ours.oMi[solid.joint] * pin.XYZQUATToSE3(solid.placement)
        np.testing.assert_allclose(result.homogeneous, (base * wanted).homogeneous, atol=1e-9)
    assert all(mesh.faces.max() < len(mesh.vertices) for mesh in drawn.meshes)


def test_ellipsoid_of_box_inertia() -> None:
    """A homogeneous box becomes the ellipsoid with √(5/3) times its half sides."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(3.0, 0.6, 0.4, 0.2), pin.SE3.Random())
    drawn = drawn_bodies(pinred.load(model))
    assert "without its file" in drawn.note
    sizes = sorted(next(solid.size for solid in drawn.solids if solid.kind == "ellipsoid"))
    np.testing.assert_allclose(sizes, np.sqrt(5.0 / 3.0) * np.array([0.1, 0.2, 0.3]), rtol=1e-9)
    capsules = [solid for solid in drawn_bodies(pinred.load("solo12"), meshes=False).solids
                if solid.kind == "capsule"]  # fmt: skip
    assert len(capsules) >= 12


def test_missing_meshes_are_reported(tmp_path: Path) -> None:
    """The motion is played, and the page states the reason."""
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
        'izz="1" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry><mesh '
        'filename="package://gone/gone.stl"/></geometry></visual></link></robot>'
    )
    drawn = drawn_bodies(pinred.load(tmp_path / "r.urdf"))
    assert drawn.note.startswith("bodies drawn from their inertias: ")
    assert "gone.stl" in drawn.note
    assert [solid.kind for solid in drawn.solids] == ["ellipsoid"]
    (tmp_path / "gone").mkdir()
    (tmp_path / "gone/gone.stl").write_text("solid nonsense")
    note = drawn_bodies(pinred.load(tmp_path / "r.urdf")).note
    assert note.startswith("bodies drawn from their inertias: 1 of its shapes cannot be drawn: ")
    assert "mesh 'package://gone/gone.stl' of link 'b' cannot be read: Could not load " in note
    assert "gone.stl Mesh with invalid primitive type: nonsense" in note
    assert ".cpp" not in note
    assert "line" not in note


def test_framing_contains_robot_and_path() -> None:
    """The robot is within the radius, its path within the span, the arrow seen sideways."""
    shown = film("falling_cat", duration=10.0)
    framing = frame(shown, drawn_bodies(shown.system))
    _, centre, _, _ = bodies(shown)
    assert np.linalg.norm(centre - shown.com[:, None], axis=2).max() < framing.radius < 0.6
    assert np.linalg.norm(shown.com - framing.middle, axis=1).max() < framing.span
    assert framing.follow
    np.testing.assert_allclose(np.linalg.norm(framing.eye), 1.0)
    arrow = shown.momentum.vector[0] / np.linalg.norm(shown.momentum.vector[0])
    assert abs(arrow @ framing.eye) < 0.15
    assert framing.grid[2] < shown.com[:, 2].min() - framing.radius
    np.testing.assert_array_equal(framing.normal, [0.0, 0.0, 1.0])
    fallen = film("solo12", seed=0, duration=2.0)  # 20 m down: a wall behind, all the way
    framing = frame(fallen, drawn_bodies(fallen.system))
    assert framing.normal[2] == 0.0
    assert ((fallen.com - framing.grid) @ framing.normal > framing.radius).all()
    assert framing.cell * framing.cells * framing.wide > np.ptp(fallen.com[:, 2])
    assert framing.cells < 50  # as many lines as that, squared
    swung = film("double_spherical_pendulum", duration=2.0)
    framing = frame(swung, drawn_bodies(swung.system))
    arm = np.linalg.norm(swung.com - swung.momentum.tail, axis=1).max()
    assert framing.radius + arm < framing.reach
    assert not frame(film("rigid_body"), drawn_bodies(pinred.load("rigid_body"))).follow


@pytest.mark.parametrize("gravity", [(1.5, 0.7, -3.0), (0.0, 0.0, 0.0)])
def test_framing_has_gravity_and_room_for_its_arrow(gravity: tuple[float, float, float]) -> None:
    """Gravity is the acceleration of the centre of mass; half its arrow ends within the picture."""
    traj = pinred.simulate(pinred.load("diver", gravity=gravity), momentum=[0.0] * 6, duration=1.0)
    shown = playback(traj, View(fps=2.0))
    framing = frame(shown, drawn_bodies(shown.system))
    acceleration = 4.0 * (shown.com[0] - 2.0 * shown.com[1] + shown.com[2])
    np.testing.assert_allclose(framing.gravity, acceleration, atol=1e-9)
    assert not shown.momentum.vector.any()  # its arrow would need more room than that of gravity
    assert np.linalg.norm(framing.gravity_at) + 0.25 * framing.radius <= framing.reach
    np.testing.assert_allclose(framing.gravity_at @ framing.eye, 0.0, atol=1e-12)


def colour_of(path: Path) -> Any:
    """Return the colour of the first pixel of a picture."""
    with Image.open(path) as image:
        return image.getpixel((0, 0))


RED, BLUE, OLD = (255, 0, 0), (0, 0, 255), (7, 7, 7)


def plain(path: Path, colour: tuple[int, int, int]) -> Image.Image:
    """Return a picture of one colour; write it unless the path is a folder."""
    image = Image.new("RGB", (2, 2), colour)
    if not path.is_dir():
        image.save(path)
    return image


def test_frames_are_written_all_or_none(tmp_path: Path) -> None:
    """A film that fails leaves existing files and none of its frames."""
    plain(tmp_path / "film_0000.png", OLD)

    def shots(fail: bool) -> Iterator[Image.Image]:
        yield plain(tmp_path, RED)
        assert colour_of(tmp_path / "film_0000.png") == OLD
        if fail:
            raise pinred.OutputError("the disk is gone")
        yield plain(tmp_path, BLUE)

    with pytest.raises(pinred.OutputError, match="is gone"):
        write_frames(tmp_path / "film.png", shots(fail=True))
    assert {path.name: colour_of(path) for path in tmp_path.iterdir()} == {"film_0000.png": OLD}
    assert write_frames(tmp_path / "film.png", shots(fail=False)) == 2
    assert {path.name: colour_of(path) for path in tmp_path.iterdir()} == {
        "film_0000.png": RED,
        "film_0001.png": BLUE,
    }


def test_failed_move_restores_old_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a folder with a frame's name, and for a disk error."""
    before = {"z_0000.png": OLD, "z_0001.png": BLUE, "z_00a1.png": OLD}
    for name, colour in before.items():
        plain(tmp_path / name, colour)
    (tmp_path / "z_0002.png").mkdir()

    def there() -> dict[str, Any]:
        return {path.name: colour_of(path) for path in tmp_path.iterdir() if path.is_file()}

    def shots(count: int) -> Iterator[Image.Image]:
        return (plain(tmp_path, RED) for _ in range(count))

    with pytest.raises(pinred.InputError, match=r"z_0002\.png': it is a folder"):
        write_frames(tmp_path / "z.png", shots(4))
    (tmp_path / "z_0002.png").rmdir()
    move = Path.replace

    def fails(path: Path, target: Path) -> Path:
        if (path.parent.name, path.name) == ("new", "z_0001.png"):
            raise OSError("the disk has gone")
        return move(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", fails)
        with pytest.raises(OSError, match="disk"):
            write_frames(tmp_path / "z.png", shots(4))
    assert there() == before
    # One frame would be followed by a second, which is of the film before.
    with pytest.raises(pinred.InputError, match=r"z_0001\.png' of a longer film"):
        write_frames(tmp_path / "z.png", shots(1))
    assert there() == before
    assert write_frames(tmp_path / "z.png", shots(3)) == 3
    assert there() == {f"z_000{k}.png": RED for k in range(3)} | {"z_00a1.png": OLD}


@pytest.mark.parametrize("fps", [50.0, 45.0, 30.0, 29.97, 25.0, 7.0, 0.5])
@pytest.mark.sampled
def test_gif_frames_keep_time(tmp_path: Path, fps: float) -> None:
    """Each frame starts within half a hundredth of a second of its time."""
    film = tmp_path / "film.gif"
    image = Image.new("RGB", (8, 8))
    pictures = []
    for k in range(100):
        image.putpixel((k % 8, k // 8 % 8), (40 + k, 200 - k, 90))
        pictures.append(image.copy())
    assert write_gif(film, iter(pictures), fps) == 100
    data, last = film.read_bytes(), []
    mark = data.find(b"!\xf9\x04")  # a graphic control extension, before each frame
    while mark >= 0:
        last.append(int.from_bytes(data[mark + 4 : mark + 6], "little"))
        mark = data.find(b"!\xf9\x04", mark + 8)
    assert min(last) >= 2  # browsers take less for ten
    np.testing.assert_allclose(np.cumsum(last), 100.0 / fps * np.arange(1, 101), atol=0.501)


def test_pages_are_small_and_contain_the_viewer(tmp_path: Path) -> None:
    """The cat over 10 s takes at most 0.7 MB; the viewer is packed, its licences are readable."""
    path = tmp_path / "cat.html"
    assert pinred.save_html(pinred.simulate(pinred.load("falling_cat"), duration=10.0), path) < 7e5
    text = path.read_text(encoding="utf-8")
    packed = re.search(r'id="viewer">([^<]*)<', text)
    assert packed is not None
    folder = find_spec("meshcat").submodule_search_locations[0]  # type: ignore[union-attr, index]
    viewer = Path(folder, "viewer/dist/main.min.js").read_bytes()
    assert gzip.decompress(base64.b64decode(packed[1])) == viewer
    assert "MIT" in text
    assert "connect-src" not in text
    assert "default-src 'none'" in text


def test_film_says_beforehand_how_long_it_takes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Once, from the time of five frames after the first; not for short films, nor if quiet."""
    monkeypatch.setattr(waiting, "_IS_QUIET", False)
    for pace, line in ((0.5, "pinred: the 100 frames of the film take about 47 s\n"), (0.01, "")):
        now = iter(np.arange(200.0) * pace * 5)
        parts: list[float] = []
        report = films._announcing(parts.append, 100, partial(next, now))
        for k in range(1, 101):
            report(k / 100)
        assert parts == [k / 100 for k in range(1, 101)]
        assert capsys.readouterr().err == line
    monkeypatch.setattr(waiting, "_IS_QUIET", True)
    now = iter(np.arange(200.0) * 2.5)
    report = films._announcing(None, 100, lambda: next(now))
    for k in range(1, 101):
        report(k / 100)
    assert capsys.readouterr().err == ""
