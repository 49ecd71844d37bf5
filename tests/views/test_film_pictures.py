"""Pictures of films: samples against closed forms, shapes against Pinocchio, files, and cameras."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cameras import sees, shape_balls
from numpy.typing import NDArray
from PIL import Image
from played_robots import OTHERS, ROBOTS
from robot_texts import joint, robot

import pinred
from pinred.common.arrays import Array
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.film import Frames, find_ffmpeg, write_gif
from pinred.views.playback.rasteriser import (
    SIDE,
    SMOOTH,
    UNLIT,
    average_samples,
    draw_mesh,
    draw_picture,
    draw_triangle,
)

Picture = NDArray[np.int16]
ROOT = Path(__file__).parents[2]
FOV = np.radians(30.0)
BLACK = 1 << 24  # a far sample
WHITE = np.array([255.0, 255.0, 255.0, 1.0])


def blank(rows: int, columns: int) -> NDArray[np.int64]:
    """Return black samples at a great distance."""
    return np.full((rows, columns), BLACK, dtype=np.int64)


def triangle(
    samples: NDArray[np.int64], points: Array, depths: Array, colour: Array, over: bool = False
) -> None:
    """Draw a triangle with corners at columns and rows, (3, 2)."""
    corners = np.column_stack([points, depths, np.ones(3)])
    draw_triangle(samples, corners, 0, 1, 2, colour, 1.0, over)


def test_triangle_covers_the_samples_inside() -> None:
    """Against the signs of the three half planes, at random corners, also outside the picture."""
    rng = np.random.default_rng(1)
    columns, rows = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    for _ in range(6):
        points = rng.uniform(-20.0, 80.0, (3, 2))
        samples = blank(40, 60)
        triangle(samples, points, np.full(3, 0.5), WHITE)
        signs = []
        for k in range(3):
            (x, y), (u, v) = points[k], points[(k + 1) % 3]
            signs.append(np.sign((u - x) * (rows - y) - (v - y) * (columns - x)))
        inside = np.abs(np.sum(signs, axis=0)) == 3
        np.testing.assert_array_equal(samples != BLACK, inside)


def test_neighbouring_triangles_cover_each_sample_once() -> None:
    """A fan of transparent triangles leaves no gap and blends no sample twice."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        middle = rng.uniform(20.0, 40.0, 2)
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
        ring = middle + 200.0 * np.column_stack([np.cos(angles), np.sin(angles)])
        samples = blank(60, 60)
        for k in range(9):
            corners = np.array([middle, ring[k], ring[(k + 1) % 9]])
            triangle(samples, corners, np.full(3, 0.5), np.array([200.0, 0.0, 0.0, 0.5]))
        if np.diff(angles, append=angles[0] + 2.0 * np.pi).max() < 2.5:  # the fan is closed
            assert set((samples >> 16 & 255).ravel().tolist()) == {100}


def test_nearer_triangle_hides_the_other_in_any_order() -> None:
    """Two crossing planes: at each sample, the colour of the larger inverse distance."""
    points = np.array([[-10.0, -10.0], [150.0, -10.0], [-10.0, 150.0]])
    slanted, level = np.array([0.1, 0.9, 0.1]), np.full(3, 0.4)
    red, blue = np.array([255.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 255.0, 1.0])
    pictures = []
    for order in ((0, 1), (1, 0)):
        samples = blank(40, 40)
        for k in order:
            triangle(samples, points, (slanted, level)[k], (red, blue)[k])
        pictures.append(samples & 0xFFFFFF)
    np.testing.assert_array_equal(pictures[0], pictures[1])
    depth = 0.1 + 0.8 * (np.arange(40) + 0.5 + 10.0) / 160.0
    expected = np.where(depth > 0.4, 255 << 16, 255)
    np.testing.assert_array_equal(pictures[0], np.broadcast_to(expected, (40, 40)))
    samples = blank(40, 40)
    triangle(samples, points, np.full(3, 0.9), blue)
    triangle(samples, points, np.full(3, 0.1), red)
    assert not (samples >> 16 & 255).any()
    triangle(samples, points, np.full(3, 0.1), red, over=True)
    assert (samples & 0xFFFFFF == 255 << 16).all()


def test_pixels_are_means_of_samples_and_pictures_blend() -> None:
    """Against NumPy, for random colours and opacities."""
    rng = np.random.default_rng(3)
    colours = rng.integers(0, 256, (8 * SIDE, 9 * SIDE, 3))
    places = np.array([1 << 16, 1 << 8, 1])
    samples, pixels = colours @ places + BLACK, np.empty((8, 9), dtype=np.int64)
    average_samples(samples, pixels)
    mean = colours.reshape(8, SIDE, 9, SIDE, 3).mean(axis=(1, 3))
    values = np.stack([pixels >> 16 & 255, pixels >> 8 & 255, pixels & 255], axis=-1)
    np.testing.assert_array_equal(values, np.floor(mean + 0.5))
    new = rng.integers(0, 256, (6, 5, 4))  # opacity first
    draw_picture(samples, new @ np.array([1 << 24, *places]), -2, 3)
    share, old = new[2:, :, :1] / 255.0, colours[:4, 3:8].astype(float)
    colours[:4, 3:8] = np.round(share * new[2:, :, 1:] + (1.0 - share) * old)
    np.testing.assert_array_equal(samples, colours @ places + BLACK)


def test_ball_has_the_silhouette_of_its_cone() -> None:
    """A sample shows the ball if its ray meets it; its brightness is that of two lamps."""
    from pinred.views.playback.drawn_bodies import Solid, solid_mesh, vertex_normals

    still = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    mesh = solid_mesh(Solid(0, "sphere", (1.0,), still, (1.0, 1.0, 1.0, 1.0)), ())
    points, faces = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)
    centre, focal = np.array([0.4, 5.0, -0.3]), 300.0
    world = np.column_stack([np.eye(3), centre])
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # right, down, ahead
    view = np.vstack([axes, np.zeros(3), [focal, 100.0, 80.0], [0.01, 0.0, 0.0]])
    columns, rows = np.meshgrid(np.arange(200) + 0.5, np.arange(160) + 0.5)
    rays = np.stack([(columns - 100.0) / focal, np.ones_like(rows), (80.0 - rows) / focal], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    distance = np.linalg.norm(np.cross(rays, centre), axis=-1)
    for kind in (UNLIT, SMOOTH):
        samples, corners = blank(160, 200), np.empty((len(points), 4))
        colour = np.array([200.0, 200.0, 200.0, 1.0])
        normals = vertex_normals(mesh)
        draw_mesh(
            samples, corners, points, normals, faces, world, np.eye(3), view, colour, kind, False
        )
        shown = samples != BLACK
        assert shown[distance < 0.98].all()  # the mesh is inside the ball
        assert not shown[distance > 1.0].any()
    bright = (samples & 255).astype(float)
    ahead = rays @ centre
    reach = ahead - np.sqrt(np.maximum(1.0 - distance**2, 0.0))
    normal = rays * reach[..., None] - centre
    key, fill = (normal @ lamp for lamp in ([0.51, 0.51, 0.69], [-0.68, -0.68, 0.27]))
    expected = 200.0 * (0.62 + 0.5 * np.maximum(key, 0.0) + 0.25 * np.maximum(fill, 0.0))
    np.testing.assert_allclose(bright[distance < 0.9], expected[distance < 0.9], rtol=0, atol=8.0)


def pixels(image: Image.Image) -> Picture:
    """Return the pixels of a picture, (height, width, 3)."""
    return np.asarray(image.convert("RGB"), dtype=np.int16)


def has_colour(image: Picture, colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return the pixels that are close to a colour."""
    return np.asarray(np.abs(image - colour).max(axis=2) < 40)


def bead(tmp_path: Path) -> pinred.System:
    """Return a robot with a small red ball on each of two links."""
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1.2" izz="1.5" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"
    )

    def ball(colour: str, radius: float) -> str:
        return (
            '<visual><origin xyz="0.5 0 0.6"/><geometry>'
            f'<sphere radius="{radius}"/></geometry><material name="{colour}">'
            f'<color rgba="{colour}"/></material></visual>'
        )

    file = tmp_path / "bead.urdf"
    file.write_text(
        robot(
            f'<link name="a">{inertia}{ball("1 0 1 1", 0.06)}</link>',
            f'<link name="b">{inertia}{ball("0 1 0 1", 0.06)}</link>',
            joint("a", "b"),
        )
    )
    return pinred.load(file, gravity=(0.0, 0.0, 0.0))


def test_shapes_are_where_pinocchio_puts_them(tmp_path: Path) -> None:
    """The middle of each ball in the picture is the projection of its position by Pinocchio."""
    system = bead(tmp_path)
    traj = pinred.simulate(system, seed=5, duration=1.0)
    frames = Frames(traj, View(fps=25.0), (640, 480))
    model, data = system.model, system.model.createData()
    for t in (0.0, 0.4, 0.81):  # the last one is between frames of the film
        picture, q = pixels(frames.draw(t)), traj([t]).q[0]
        com = pin.centerOfMass(model, data, q)
        placed = frames._camera
        shift = com if frames._framing.follow else 0.0
        ahead = placed.target - placed.position
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        above = np.cross(right, ahead)
        for joint_index, colour in ((1, (255, 0, 255)), (2, (0, 255, 0))):
            at = data.oMi[joint_index].act(np.array([0.5, 0.0, 0.6])) - placed.position - shift
            focal = 0.5 * 480 / np.tan(0.5 * FOV) / (at @ ahead)
            expected = np.array(frames._axis) + focal * np.array([at @ right, -(at @ above)])
            hue = picture / np.maximum(picture.max(axis=2, keepdims=True), 1)
            shown = (np.abs(hue - np.array(colour) / 255.0) < 0.25).all(axis=2)
            assert shown.sum() > 15
            rows, columns = np.nonzero(shown)
            np.testing.assert_allclose(
                [columns.mean() + 0.5, rows.mean() + 0.5], expected, rtol=0, atol=1.0
            )


@pytest.mark.parametrize("name", ["falling_cat", *OTHERS])
@pytest.mark.parametrize("size", [(320, 240), (960, 720)])
def test_camera_sees_the_robot_beside_the_cards(name: str, size: tuple[int, int]) -> None:
    """At all times; the shape panel is left out of small pictures."""
    traj = pinred.simulate(pinred.load(name), **ROBOTS[name])
    frames = Frames(traj, View(fps=10.0), size)
    assert (frames._panel is None) == (size == (320, 240))
    left, top, across, down = frames._free_area()
    middle = (left + 0.5 * across, top + 0.5 * down)
    np.testing.assert_allclose(frames._axis, middle)
    times = np.linspace(0.0, float(traj.t[-1]), 41)
    centres, radii, com = shape_balls(traj, times)
    shown = centres - com[:, None] if frames._framing.follow else centres
    fov = 2.0 * np.arctan(np.tan(0.5 * FOV) * down / size[1])  # of the free area
    placed = frames._camera
    assert sees(placed.position, placed.target, fov, across / down, shown, radii)
    assert not sees(placed.position, placed.target, 0.2 * fov, across / down, shown, radii)


def test_film_has_exact_number_of_frames(tmp_path: Path) -> None:
    """A film has a frame at each time, in order, of the requested size."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=0.5)
    assert pinred.save_film(traj, tmp_path / "film.png", fps=8, size=(160, 120)) == 5
    paths = sorted(tmp_path.iterdir())
    assert [path.name for path in paths] == [f"film_{k:04d}.png" for k in range(5)]
    shots = [pixels(Image.open(path)) for path in paths]
    assert {shot.shape[:2] for shot in shots} == {(120, 160)}
    assert all((np.abs(a - b).max(axis=2) > 12).sum() > 10 for a, b in pairwise(shots))
    drawn = Frames(traj, View(fps=8), (160, 120))
    np.testing.assert_array_equal(shots[3], pixels(drawn.draw(0.375)))


def test_gif_and_mp4_have_the_frames(tmp_path: Path) -> None:
    """The few colours of a gif are those of what is drawn; ffmpeg decodes all frames of an mp4."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=0.5)
    shots = [Frames(traj, View(fps=4), (320, 240)).draw(t) for t in (0.0, 0.25, 0.5)]
    assert write_gif(tmp_path / "film.gif", iter(shots), 4.0) == 3
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.size, film.n_frames) == ((320, 240), 3)  # type: ignore[attr-defined]
        shown = pixels(film)
    arrow = has_colour(pixels(shots[0]), (213, 94, 0))
    assert arrow.sum() > 50
    assert (np.abs(shown - pixels(shots[0]))[arrow].max(axis=1) < 40).mean() > 0.9
    try:
        encoder = find_ffmpeg()
    except pinred.InputError as error:
        pytest.skip(str(error))
    assert pinred.save_film(traj, tmp_path / "film.mp4", fps=4, size=(320, 240)) == 3
    decoded = subprocess.run(
        [encoder, "-i", str(tmp_path / "film.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True, check=True,
    )  # fmt: skip
    frames = np.frombuffer(decoded.stdout, dtype=np.uint8).reshape(3, 240, 320, 3)
    for frame, shot in zip(frames.astype(np.int16), shots, strict=True):
        assert np.abs(frame - pixels(shot)).mean() < 3.0


def test_options_and_gravity_add_objects() -> None:
    """A ghost, a momentum sphere and gravity have pixels of their colours, only if requested."""
    cat, free = (pinred.load("falling_cat", gravity=(0, 0, g)) for g in (-9.81, 0.0))
    falls, floats = (pinred.simulate(system, duration=0.5) for system in (cat, free))

    def count(traj: pinred.Trajectory, colour: tuple[int, int, int], **options: Any) -> int:
        picture = pixels(Frames(traj, View(fps=8, **options), (320, 240)).draw(0.25))
        return int(has_colour(picture, colour).sum())

    assert count(falls, (140, 81, 10)) > count(floats, (140, 81, 10)) + 20
    blue, purple = (0, 70, 130), (171, 51, 120)
    assert count(floats, blue, ghost=True) > count(floats, blue) + 20
    assert count(floats, purple, sphere="base") > count(floats, purple) + 3


@pytest.mark.by_hand
def test_sigterm_removes_unfinished_film(tmp_path: Path) -> None:
    """The process ends and removes its frames and folders."""
    printed = tmp_path / "out"
    printed.mkdir()
    (tmp_path / "scene.toml").write_text('robot = "falling_cat"\n[run]\nduration = 600.0\n')
    command = [sys.executable, "-m", "pinred", "play", "scene.toml", "--out", "out/film.png"]
    with (
        tempfile.TemporaryDirectory() as scratch,  # its name is short, as a socket's has to be
        subprocess.Popen(
            command,
            cwd=tmp_path,
            env=os.environ | {"TMPDIR": scratch, "PYTHONPATH": str(ROOT)},
        ) as process,
    ):
        try:
            until = time.monotonic() + 120.0
            while not list(printed.glob(".film.png.*/new/film_0001.png")):
                assert process.poll() is None
                assert time.monotonic() < until
                time.sleep(0.05)
            process.terminate()
            assert process.wait(30.0) == -signal.SIGTERM
        finally:
            process.kill()
        assert os.listdir(scratch) == []
    assert list(printed.iterdir()) == []
