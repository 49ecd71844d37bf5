"""The view of the camera: visibility of the robot at any window size, and of the grid."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from headless_browser import Browser
from numpy.typing import NDArray
from PIL import Image

import pinred

pytestmark = pytest.mark.browser
CARDS = (
    "[...document.querySelectorAll('.card, .dg.main')].map((card) => card.getBoundingClientRect())"
    ".filter((c) => c.width > 0).map((c) => [c.left, c.right, c.top, c.bottom])"
)
COM = "pinred.project(['CoM trail', 'CoM', '<object>'])"
TIP = "pinred.project(pinred.node('Momentum', '<object>').children[1])"
CAMERA = "pinred.node('Cameras', 'default', 'rotated', '<object>').matrixWorld.elements"
SHAPE = "document.querySelector('#panel details')"


def show(screen: Browser, path: Path, width: int, height: int, *, bare: bool = False) -> None:
    """Open a page, wait until it plays, and stop it at its start."""
    screen.open(path.as_uri(), width=width, height=height)
    screen.wait_for("window.pinred !== undefined")
    if bare:
        screen.run(
            "document.querySelectorAll('.card, .dg').forEach((c) => c.style.display = 'none')"
        )
        screen.run("dispatchEvent(new Event('resize'))")
    screen.run("pinred.seek(0)")


def resize(screen: Browser, width: int, height: int) -> None:
    """Change the window size, and wait until the page has it."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    screen.call("Emulation.setDeviceMetricsOverride", **size)
    screen.wait_for(f"innerWidth === {width} && innerHeight === {height}")
    screen.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def assert_visible(screen: Browser, width: int, height: int) -> list[list[float]]:
    """Raise AssertionError if the CoM or the tip of the arrow is behind a card."""
    result = [screen.run(COM), screen.run(TIP)]
    cards = screen.run(CARDS)
    assert cards
    for x, y in result:
        assert 0 < x < width
        assert 0 < y < height
        for left, right, top, bottom in cards:
            assert not (left < x < right and top < y < bottom), (
                x,
                y,
                left,
                right,
                top,
                bottom,
            )
    return result


@pytest.fixture(
    scope="module", params=["falling_cat", pytest.param("solo12", marks=pytest.mark.by_hand)]
)
def page(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page of a robot, 2 s long."""
    seed: dict[str, Any] = {"seed": 0} if request.param == "solo12" else {}
    path = tmp_path_factory.mktemp("page") / "page.html"
    pinred.save_html(pinred.simulate(pinred.load(request.param), duration=2.0, **seed), path)
    return path


@pytest.mark.parametrize(
    ("width", "height", "shape"),
    [
        (800, 500, False),
        (500, 900, True),
        *(
            pytest.param(*size, marks=pytest.mark.by_hand)
            for size in ((900, 640, False), (900, 760, True), (1300, 700, True))
        ),
    ],
)
def test_cards_do_not_cover_robot(
    screen: Browser, page: Path, width: int, height: int, shape: bool
) -> None:
    """Centre of mass and arrow are next to the cards; the panel folds in small windows."""
    show(screen, page, width, height)
    assert screen.run(f"{SHAPE}.open") == shape
    assert (
        screen.run("document.querySelector('#panel summary').offsetWidth") > 50
    )  # it has not vanished
    for t in (0.0, 0.7, 2.0):
        screen.run(f"pinred.seek({t})")
        com, tip = assert_visible(screen, width, height)
        assert np.hypot(*np.subtract(com, tip)) > 0.15 * min(width, height)
    if (width, height) == (800, 500):  # whoever wants the panel gets it, and all else beside it
        screen.run(f"{SHAPE}.querySelector('summary').click()")
        assert screen.run("document.getElementById('panel').offsetWidth") > 200
        assert_visible(screen, width, height)
        resize(screen, 820, 500)
        assert screen.run(f"{SHAPE}.open")
        assert_visible(screen, 820, 500)


@pytest.mark.by_hand
def test_resizing_keeps_camera_of_user(screen: Browser, page: Path) -> None:
    """A resized window is framed again, unless the user has moved the camera."""
    show(screen, page, 1300, 900)
    first = screen.run(CAMERA)
    resize(screen, 800, 500)
    assert_visible(screen, 800, 500)
    assert screen.run(CAMERA) != first
    resize(screen, 1300, 900)
    np.testing.assert_allclose(screen.run(CAMERA), first, atol=1e-9)
    for category, x in (("mousePressed", 800), ("mouseMoved", 900), ("mouseReleased", 900)):
        screen.call(
            "Input.dispatchMouseEvent", type=category, x=x, y=400, button="left", clickCount=1,
            buttons=0 if category == "mouseReleased" else 1,
        )  # fmt: skip
    screen.run("pinred.seek(0)")
    rotated = screen.run(CAMERA)
    assert np.abs(np.subtract(rotated, first)).max() > 0.05
    resize(screen, 800, 500)
    np.testing.assert_allclose(screen.run(CAMERA), rotated, atol=1e-9)


def grid_pixels_by_quarter(screen: Browser, t: float) -> NDArray[np.int64]:
    """Count the pixels in each quarter of the picture that change with the grid."""
    pictures = []
    for _ in range(2):
        screen.run("document.getElementsByName('Grid')[0].click()")
        screen.run(f"pinred.seek({t})")
        image = Image.open(io.BytesIO(screen.screenshot())).convert("RGB")
        pictures.append(np.asarray(image, dtype=np.int16))
    visible = np.abs(pictures[0] - pictures[1]).max(axis=2) > 12
    height, width = visible.shape
    return np.asarray(visible.reshape(2, height // 2, 2, width // 2).sum(axis=(1, 3)).ravel())


@pytest.mark.parametrize(
    ("name", "seed"),
    [pytest.param("solo12", 0, marks=pytest.mark.by_hand), ("falling_cat", None)],
)
@pytest.mark.by_hand
def test_grid_is_visible_at_all_times(
    screen: Browser, tmp_path: Path, name: str, seed: int | None
) -> None:
    """In a fall of 18 km and a slanted climb, the wall is visible at start and end."""
    path = tmp_path / "page.html"
    traj = pinred.simulate(pinred.load(name), seed=seed, duration=60.0)
    pinred.save_html(traj, path, fps=10, meshes=False)
    show(screen, path, 800, 600, bare=True)
    first = grid_pixels_by_quarter(screen, 0.0)
    assert first.min() > 400
    for t in (31.7, 60.0):
        assert grid_pixels_by_quarter(screen, t).min() > 0.5 * first.min()
    # A camera that stands still sees all of the way, on squares that are as much larger.
    screen.run("document.getElementsByName('Follow')[0].click()")
    assert grid_pixels_by_quarter(screen, 60.0).sum() > 400


@pytest.mark.slow
def test_grid_has_no_gaps(screen: Browser, tmp_path: Path) -> None:
    """Lines near the camera are drawn although they continue behind it."""
    path = tmp_path / "page.html"
    pinred.save_html(pinred.simulate(pinred.load("falling_cat"), duration=20.0), path)
    show(screen, path, 800, 600, bare=True)
    assert grid_pixels_by_quarter(screen, 10.0)[2:].min() > 2800


def test_field_has_colour_bar(screen: Browser, page: Path) -> None:
    """Above the field there is a bar from blue (−max) to orange (+max)."""
    show(screen, page, 900, 760)
    data = screen.run(
        "[...document.querySelector('#panel canvas').getContext('2d')"
        ".getImageData(0, 17, 520, 1).data]"
    )
    entries = np.reshape(data, (520, 4))[:, :3]
    blue, orange = (
        np.flatnonzero(np.abs(entries - colour).max(axis=1) < 8)
        for colour in ([0, 114, 178], [213, 94, 0])
    )
    assert len(blue) > 0
    assert len(orange) > 0
    assert 64 < blue.max() < orange.min() < 400
