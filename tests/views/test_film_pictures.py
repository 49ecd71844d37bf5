"""Pictures of films equal screenshots of the page, although they leave out hidden triangles."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from played_robots import BY_HAND, OTHERS, ROBOTS
from robot_texts import joint, robot

import pinred
from pinred.views.playback.film import take_pictures
from pinred.views.playback.headless_browser import Browser

pytestmark = pytest.mark.browser
Picture = NDArray[np.int16]
SIZE = {"width": 640, "height": 480}
SHADOW = 6  # margin of cards [px]
# The renderer rounds corners in single precision. Then a triangle may cover a sample that it only
# touches in double precision.
MOST_DIFFERENT = 5  # number of pixels of 307 200
BACKGROUND = 2  # triangles of the background, whose rows films clear instead
TIMES = (0.31, 0.62)
OTHER_RENDERER = """
    const get = WebGL2RenderingContext.prototype.getParameter;
    WebGL2RenderingContext.prototype.getParameter = function (name) {
        return name === 0x9246 ? "another renderer" : get.call(this, name);
    };
"""


def open_page(screen: Browser, traj: pinred.Trajectory, path: Path) -> None:
    """Open the page of a motion as films do."""
    pinred.save_html(traj, path)
    screen.open(f"{path.as_uri()}#bare", **SIZE)
    screen.wait_for("window.pinred !== undefined")


def read(png: bytes) -> Picture:
    """Return the pixels of a picture, (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), dtype=np.int16)


def screenshot(screen: Browser, t: float) -> Picture:
    """Return a screenshot of the page at a time of the motion; all triangles are drawn."""
    screen.run(f"pinred.seek({t})")
    return read(screen.screenshot())


def card_boxes(screen: Browser) -> list[tuple[int, int, int, int]]:
    """Return left, top, right and bottom of the cards [px]."""
    cards = "['panel', 'bar'].map(i => document.getElementById(i).getBoundingClientRect())"
    boxes = screen.run(f"{cards}.map(b => [b.left, b.top, b.right, b.bottom])")
    return [tuple(row) for row in np.round(boxes).astype(int).tolist()]


def check_scene(film: Picture, shot: Picture, boxes: list[tuple[int, int, int, int]]) -> None:
    """Check that two pictures are equal outside the cards, except at a few pixels."""
    assert film.shape == shot.shape
    outside = np.ones(film.shape[:2], dtype=bool)
    for left, top, right, bottom in boxes:
        outside[top - SHADOW : bottom + SHADOW, left - SHADOW : right + SHADOW] = False
    assert (film != shot)[outside].any(axis=1).sum() <= MOST_DIFFERENT


def triangles(screen: Browser) -> int:
    """Return the number of triangles in the last picture."""
    return int(screen.run("pinred.triangles"))


@pytest.mark.parametrize("name", ["falling_cat", *OTHERS])
def test_pictures_of_films_equal_screenshots(screen: Browser, tmp_path: Path, name: str) -> None:
    """The scene has the same pixels; cards differ in their antialiased corners only."""
    traj = pinred.simulate(pinred.load(name), **ROBOTS[name])
    open_page(screen, traj, tmp_path / "page.html")
    boxes = card_boxes(screen)
    shots = [screenshot(screen, t) for t in TIMES]  # pictures hide the page
    whole = triangles(screen)
    for png, shot in zip(take_pictures(screen, TIMES), shots, strict=True):
        film = read(png)
        check_scene(film, shot, boxes)
        for left, top, right, bottom in boxes:
            card = (slice(top, bottom), slice(left, right))
            assert (np.abs(film[card] - shot[card]) > 2).any(axis=2).sum() < 100
    assert (np.abs(shots[0] - shots[1]).max(axis=2) > 12).sum() > 100
    assert triangles(screen) < whole * (0.3 if name in ("solo12", "talos") else 1.0)


def test_picture_at_unannounced_time_shows_that_time(screen: Browser, tmp_path: Path) -> None:
    """A scene that was rendered ahead for another time is not used."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0)
    open_page(screen, traj, tmp_path / "page.html")
    boxes = card_boxes(screen)
    pictures = {t: read(png) for t in TIMES for png in take_pictures(screen, [t])}
    for t, announced in ((0.31, 0.62), (0.31, 0.31), (0.62, 0.31)):
        url = screen.run(f"pinred.picture({t}, {announced})")
        shown = read(base64.b64decode(url.partition(",")[2]))
        check_scene(shown, pictures[t], boxes)


def bowl(path: Path, rings: int = 40, sides: int = 60) -> None:
    """Write an open mesh, whose inside shows the backs of its triangles."""
    turn = 2.0 * np.pi * np.arange(sides + 1) / sides
    radius = np.linspace(0.0, 0.4, rings + 1)[:, None]
    height = 3.0 * np.maximum(radius - 0.2, 0.0) + 0.0 * turn  # its bottom is flat
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    lines = ["solid bowl"]
    for corners in np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 9):
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x:.7g} {y:.7g} {z:.7g}" for x, y, z in corners.reshape(3, 3)]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid bowl"]))


@pytest.fixture(scope="module")
def bowl_motion(tmp_path_factory: pytest.TempPathFactory) -> pinred.Trajectory:
    """Simulate an open bowl on a hinge beside a ball in a transparent box."""
    folder = tmp_path_factory.mktemp("bowl")
    bowl(folder / "bowl.stl")
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1.2" izz="1.5" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>"
    )

    def visual(shape: str, colour: str, origin: str = "") -> str:
        return (
            f"<visual><origin {origin}/><geometry>{shape}</geometry><material name='{colour}'>"
            f"<color rgba='{colour}'/></material></visual>"
        )

    glass = visual('<box size=".3 .3 .3"/>', "0.2 0.4 0.9 0.4")
    ball = visual('<sphere radius=".1"/>', "0.9 0.2 0.1 1")
    mesh = f'<mesh filename="{(folder / "bowl.stl").as_posix()}"/>'
    # The renderer's depths are too coarse to tell the two bowls apart.
    shell = visual(mesh, "0.3 0.7 0.3 1") + visual(mesh, "0.9 0.1 0.1 1", 'xyz="0 0 2e-6"')
    file = folder / "bowl.urdf"
    file.write_text(
        robot(
            f'<link name="a">{inertia}{shell}</link>',
            f'<link name="b">{inertia}{ball}{glass}</link>',
            joint("a", "b"),
        )
    )
    return pinred.simulate(pinred.load(file, gravity=(0.0, 0.0, 0.0)), seed=3, duration=1.0)


def test_open_and_transparent_shapes_lose_no_pixels(
    screen: Browser, bowl_motion: pinred.Trajectory, tmp_path: Path
) -> None:
    """The inside of an open mesh, and an object in a transparent box, stay visible."""
    open_page(screen, bowl_motion, tmp_path / "page.html")
    boxes, times = card_boxes(screen), (0.0, 0.6)
    shots = [screenshot(screen, t) for t in times]
    whole = triangles(screen)
    for png, shot in zip(take_pictures(screen, times), shots, strict=True):
        check_scene(read(png), shot, boxes)
        assert triangles(screen) < whole
    screen.run("pinred.seek(0.3)")
    assert triangles(screen) == whole


@BY_HAND
def test_other_renderers_draw_all_triangles(
    screen: Browser, bowl_motion: pinred.Trajectory, tmp_path: Path
) -> None:
    """The positions of samples are known for one renderer only."""
    script = screen.call("Page.addScriptToEvaluateOnNewDocument", source=OTHER_RENDERER)
    try:
        open_page(screen, bowl_motion, tmp_path / "page.html")
    finally:
        screen.call("Page.removeScriptToEvaluateOnNewDocument", **script)
    screen.run("pinred.seek(0.4)")
    whole = triangles(screen)
    screen.run("pinred.picture(0.6)")
    assert triangles(screen) == whole - BACKGROUND
