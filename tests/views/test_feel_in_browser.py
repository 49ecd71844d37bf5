"""The page of `feel` in a real browser: mouse, keyboard, presets, momentum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from headless_browser import Browser

import pinred
from pinred.cli.command_line import main
from pinred.common.arrays import Array
from pinred.system.loops.kinematics import loop_values

pytestmark = pytest.mark.browser


def show(screen: Browser, path: Path, width: int = 900, height: int = 640) -> None:
    """Open a page and wait until it is drawn, which takes long in large windows."""
    screen.open(path.as_uri(), width=width, height=height)
    screen.wait_for("window.pinred !== undefined")


def complaints(screen: Browser) -> list[str]:
    """Return console messages, uncaught errors and log entries."""
    kinds = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
    return [str(event["params"]) for event in screen.events if event["method"] in kinds]


def mouse(screen: Browser, kind: str, x: float, y: float) -> None:
    """Send a mouse event at a point of the window [px]."""
    screen.call(
        "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1
    )


def press(screen: Browser, key: str, times: int = 1) -> None:
    """Press a key."""
    codes = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "Enter": 13}
    for _ in range(times):
        for kind in ("rawKeyDown", "keyUp"):
            screen.call(
                "Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=codes[key]
            )


def base(screen: Browser) -> Array:
    """Return the quaternion of the base."""
    return np.array(screen.run("pinred.pose.slice(3)"))


def rest(screen: Browser) -> None:
    """Wait until the robot has gone through all shapes."""
    screen.wait_for("pinred.resting")


def test_controls_have_names_for_screen_readers(screen: Browser, tmp_path: Path) -> None:
    """Each slider has the name of its joint, and its value with the unit; no control has none."""
    path = tmp_path / "cat.html"
    pinred.save_html(pinred.load("falling_cat"), path, feel=True)
    show(screen, path, 640, 480)
    nodes = screen.call("Accessibility.getFullAXTree")["nodes"]
    roles = ("slider", "combobox", "button", "checkbox")
    controls = [node for node in nodes if node["role"]["value"] in roles]
    names = [node["name"]["value"] for node in controls]
    assert all(names)
    assert {"bend", "sway", "twist", "size"} <= set(names)
    value = "document.querySelector('#sliders input').getAttribute('aria-valuetext')"
    assert screen.run(value) == "0°"


def test_mouse_and_keyboard_move_the_robot(screen: Browser, tmp_path: Path) -> None:
    """Sliders, a loop drawn by mouse, one by keys, and a preset; the page is small and silent."""
    path = tmp_path / "cat.html"
    assert main(["feel", "falling_cat", "--out", str(path)]) == 0
    assert path.stat().st_size < 1.9e6
    show(screen, path, 640, 480)
    # A slider by keyboard, there and back: the base turns, and turns back.
    screen.run("document.querySelector('#sliders input').focus()")
    press(screen, "ArrowRight", 10)
    screen.wait_for("Math.abs(pinred.shape[0] - 0.16) < 1e-9")  # keys arrive in several frames
    rest(screen)
    assert np.linalg.norm(base(screen)[:3]) > 1e-3
    press(screen, "ArrowLeft", 10)
    screen.wait_for("Math.abs(pinred.shape[0]) < 1e-9")
    rest(screen)
    np.testing.assert_allclose(base(screen), [0, 0, 0, 1], atol=1e-8)
    # A loop by mouse: the base ends where the phase says.
    x, y, width, height = screen.run(
        "(() => { const b = document.querySelector('#panel canvas').getBoundingClientRect();"
        "return [b.x, b.y, b.width, b.height] })()"
    )
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    points = np.column_stack(
        [x + width * (0.55 + 0.2 * np.cos(turn)), y + height * (0.45 + 0.2 * np.sin(turn))]
    )
    mouse(screen, "mousePressed", *points[0])
    rest(screen)
    start = base(screen)
    for point in points[1:-1]:
        mouse(screen, "mouseMoved", *point)
    mouse(screen, "mouseReleased", *points[-2])
    rest(screen)
    loop = screen.run("pinred.loop")
    assert loop["name"] == "your loop"
    change = np.array(pinred.lie.SO3.compose(pinred.lie.SO3.inverse(start), base(screen)))
    assert np.linalg.norm(change[:3]) > 0.05
    np.testing.assert_allclose(change, loop["phase"][3:], atol=1e-5)
    # A loop by keys.
    screen.run("document.querySelector('#panel canvas').focus()")
    press(screen, "Enter")
    for key in ("ArrowRight", "ArrowUp", "ArrowLeft", "ArrowDown"):
        press(screen, key, 4)
    press(screen, "Enter")
    rest(screen)
    assert np.linalg.norm(screen.run("pinred.loop.phase")[3:6]) > 1e-3
    # A preset repeats; there and back has no phase.
    screen.run("document.querySelector('#presets button:last-child').click()")
    assert np.linalg.norm(screen.run("pinred.loop.phase")[3:6]) < 1e-10
    screen.wait_for("pinred.loop.cycles > 0")
    assert "1 done" in screen.run("document.getElementById('phase').textContent")
    # Momentum turns the base of a still robot.
    screen.run("document.getElementById('reset').click()")
    screen.run("document.querySelector('#momentum input').click()")
    screen.wait_for("Math.hypot(...pinred.pose.slice(3, 6)) > 0.1")
    assert screen.run("pinred.shape") == [0.0, 0.0, 0.0]
    assert complaints(screen) == []


@pytest.mark.by_hand
@pytest.mark.parametrize("name", ["falling_cat_ball", "elroys_beanie"])
def test_balls_and_single_joints_are_shown(screen: Browser, tmp_path: Path, name: str) -> None:
    """The sliders of a ball move its rotation vector; one joint has no shape plane."""
    system = pinred.load(name)
    pinred.save_html(system, tmp_path / "page.html", feel=True)
    show(screen, tmp_path / "page.html", width=480)
    names = screen.run("[...document.querySelectorAll('#sliders span')].map((e) => e.textContent)")
    assert tuple(names) == system.shape_names
    side = "document.querySelector('#side > details')"
    screen.run(f"{side}.open || {side}.querySelector('summary').click()")
    screen.wait_for(f"{side}.open")
    screen.run("document.querySelector('#sliders input').focus()")
    press(screen, "ArrowRight", 5)
    rest(screen)
    assert screen.run("pinred.shape[0]") > 0.05
    assert np.linalg.norm(base(screen)[:3]) > 1e-3
    assert complaints(screen) == []


@pytest.mark.by_hand
def test_robots_with_loops_stop_at_dead_points(screen: Browser, tmp_path: Path) -> None:
    """The other joints follow, a slider stops where the loops end, and presets avoid the border."""
    system = pinred.load("gripper")
    pinred.save_html(system, tmp_path / "page.html", feel=True)
    show(screen, tmp_path / "page.html")
    screen.run("document.querySelector('#sliders input').focus()")
    press(screen, "ArrowRight", 5)
    rest(screen)
    assert screen.run("pinred.shape[0]") == pytest.approx(0.6 + 5 * np.pi / 100, abs=0.02)
    closed = np.array(screen.run("pinred.closed"))
    assert np.abs(loop_values(system, closed)).max() < 1e-14
    press(screen, "ArrowLeft", 90)
    rest(screen)
    assert screen.run("pinred.stopped")
    assert "Stopped" in screen.run("document.getElementById('stopped').textContent")
    closed = np.array(screen.run("pinred.closed"))
    assert np.abs(loop_values(system, closed)).max() < 1e-14
    screen.run("document.getElementById('reset').click()")
    screen.run("document.querySelector('#presets button').click()")
    assert screen.run("pinred.loop.name") == "circle"
    screen.wait_for("pinred.loop.cycles > 0")
    assert screen.run("pinred.stopped") == ""
    assert complaints(screen) == []


@pytest.mark.by_hand
@pytest.mark.parametrize("width", [480, 400, 320])
def test_only_one_card_is_open_in_narrow_cells(screen: Browser, tmp_path: Path, width: int) -> None:
    """Titles remain visible and do not overlap; opening one card folds the other."""
    pinred.save_html(pinred.load("three_rods"), tmp_path / "page.html", feel=True)
    show(screen, tmp_path / "page.html", width=width)
    is_open = "[...document.querySelectorAll('.card > details')].map((card) => card.open)"
    boxes = (
        "[...document.querySelectorAll('.card')].map((card) => card.getBoundingClientRect())"
        ".map((box) => [box.left, box.right, box.top, box.bottom])"
    )
    assert screen.run(is_open) == [False, True]
    for _ in range(2):
        cards = np.array(screen.run(boxes))
        assert (cards[:, :2] >= 0.0).all()
        assert (cards[:, :2] <= width).all()
        for a, b in ((0, 1), (0, 2), (1, 2)):
            apart = (cards[a, 1] <= cards[b, 0], cards[b, 1] <= cards[a, 0])
            above = (cards[a, 3] <= cards[b, 2], cards[b, 3] <= cards[a, 2])
            assert any((*apart, *above))
        title = "document.querySelector('#side summary')"
        height = screen.run(f"{title}.getBoundingClientRect().height")
        font = screen.run(f"parseFloat(getComputedStyle({title}).fontSize)")
        assert height < 2.0 * font  # one line
        screen.run("document.querySelector('#side summary').click()")
        screen.wait_for(f"!({is_open})[1]")
    assert complaints(screen) == []
