"""Playback in a real browser: visible objects, motion, controls, requests."""

from __future__ import annotations

import io
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from headless_browser import Browser
from numpy.typing import NDArray
from PIL import Image
from played_robots import BY_HAND, OTHERS, ROBOTS

import pinred
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.page import Player
from pinred.views.playback.playback import playback

pytestmark = pytest.mark.browser
Picture = NDArray[np.int16]
ROOT = Path(__file__).parents[2]
SIZE = {"width": 900, "height": 760}


def show(screen: Browser, url: str) -> None:
    """Open a page and wait until it plays."""
    screen.open(url, **SIZE)
    screen.wait_for("window.pinred !== undefined")


def picture(screen: Browser) -> Picture:
    """Return a screenshot, (height, width, 3)."""
    image = Image.open(io.BytesIO(screen.screenshot())).convert("RGB")
    return np.asarray(image, dtype=np.int16)


def picture_at(screen: Browser, t: float) -> Picture:
    """Return a screenshot picture_at a time of the motion."""
    screen.run(f"pinred.seek({t})")
    return picture(screen)


def count_different(a: Picture, b: Picture) -> int:
    """Count the visibly different pixels."""
    return int((np.abs(a - b).max(axis=2) > 12).sum())


def has_colour(image: Picture, colour: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return the pixels has_colour a colour."""
    return np.asarray(np.abs(image - np.array(colour)).max(axis=2) < 12)


def switch(screen: Browser, **switches: bool) -> None:
    """Set the page's switches by name; `_` stands for a space."""
    for name, value in switches.items():
        box = f"document.getElementsByName({name.replace('_', ' ')!r})[0]"
        screen.run(f"{box}.checked === {str(value).lower()} || {box}.click()")


def complaints(screen: Browser) -> list[str]:
    """Return console messages, uncaught errors and log entries."""
    kinds = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
    return [str(event["params"]) for event in screen.events if event["method"] in kinds]


def requests(screen: Browser) -> list[str]:
    """Return all requested addresses except data in the page."""
    asked = [
        event["params"]["request"]["url"]
        for event in screen.events
        if event["method"] == "Network.requestWillBeSent"
    ]
    return [url for url in asked if not url.startswith(("data:", "blob:"))]


def test_complaints_and_requests_are_detected(screen: Browser, tmp_path: Path) -> None:
    """A page that logs, throws and requests other hosts is detected."""
    page = tmp_path / "bad.html"
    page.write_text(
        "<img src='http://192.0.2.1/a.png'><script>console.error('one');"
        "setTimeout(() => { throw new Error('two') });</script>"
    )
    screen.open(page.as_uri(), **SIZE)
    time.sleep(0.2)
    said = " ".join(complaints(screen))
    assert "one" in said
    assert "two" in said
    assert "http://192.0.2.1/a.png" in requests(screen)
    blank = picture(screen)
    assert count_different(blank, blank) == 0


def test_balls_and_momentum_sphere_are_drawn(screen: Browser, tmp_path: Path) -> None:
    """Markers are at the ball joints, and the arrow's tip is on the path of the sphere."""
    traj = pinred.simulate(pinred.load("diver"), seed=1, duration=1.0)
    path = tmp_path / "diver.html"
    pinred.save_html(traj, path, sphere="hips")
    show(screen, path.as_uri())
    shown = playback(traj, View(sphere="hips"))
    assert shown.sphere is not None
    screen.run("pinred.seek(0.5)")
    frame = int(np.argmin(np.abs(shown.t - 0.5)))
    for joint in (2, 3, 4):
        at = screen.run(f"pinred.node('Ball joints', '{joint}').position.toArray()")
        np.testing.assert_allclose(at, shown.placements[frame, joint, :3], atol=1e-5)
    # The arrow points along its own y axis; turn this direction into the axes of the sphere.
    tip = """(() => {
        const sphere = pinred.node('Momentum sphere', '<object>');
        const arrow = pinred.node('Momentum', '<object>');
        const up = sphere.position.clone().set(0, 1, 0).applyQuaternion(arrow.quaternion);
        return up.applyQuaternion(sphere.quaternion.clone().conjugate()).toArray();
    })()"""
    np.testing.assert_allclose(screen.run(tip), shown.sphere.path[frame], atol=1e-5)
    full = picture_at(screen, 0.5)
    switch(screen, Ball_joints=False)
    assert count_different(full, picture_at(screen, 0.5)) > 50
    switch(screen, Momentum_sphere=False)
    assert count_different(full, picture_at(screen, 0.5)) > 1000
    assert complaints(screen) == []


def test_gravity_arrow_points_along_acceleration(screen: Browser, tmp_path: Path) -> None:
    """The arrow of a tilted gravity points along the acceleration of the centre of mass."""
    diver = pinred.load("diver", gravity=(1.5, 0.7, -3.0))
    traj = pinred.simulate(diver, seed=1, duration=1.0)
    pinred.save_html(traj, tmp_path / "diver.html")
    show(screen, (tmp_path / "diver.html").as_uri())
    shown = picture_at(screen, 0.5)
    arrow = "pinred.node('Gravity', '<object>')"
    ends = [f"{arrow}.children[{k}].getWorldPosition({arrow}.position.clone())" for k in (0, 1)]
    along = np.array(screen.run(f"{ends[1]}.sub({ends[0]}).toArray()"))
    com = playback(traj, View()).com
    start, middle, end = com[[0, len(com) // 2, -1]]
    acceleration = 4.0 * (start - 2.0 * middle + end)  # exact for a parabola over one second
    # three.js turns its world by the camera's frame: y is up.
    x, y, z = acceleration / np.linalg.norm(acceleration)
    np.testing.assert_allclose(along / np.linalg.norm(along), [x, z, -y], atol=1e-5)
    label = screen.run("document.getElementsByName('Gravity')[0].parentNode.textContent")
    assert screen.run(f"{arrow}.children[2].isSprite")  # the letter g
    assert label.strip() == f"gravity: {np.linalg.norm(acceleration):.4g} m/s²"
    switch(screen, Gravity=False)
    assert count_different(shown, picture_at(screen, 0.5)) > 200
    assert complaints(screen) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["falling_cat", *OTHERS])
def test_saved_page_plays_offline(screen: Browser, tmp_path: Path, name: str) -> None:
    """It opens from disk, is not blank, plays, logs nothing, and requests nothing."""
    traj = pinred.simulate(pinred.load(name), **ROBOTS[name])
    path = tmp_path / "page.html"
    assert pinred.save_html(traj, path) == path.stat().st_size < 6e6
    show(screen, path.as_uri())
    first, began = picture(screen), screen.run("pinred.time")
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 200
    screen.wait_for(f"pinred.time > {began} + 0.3 || pinred.time < {began}")
    assert screen.run("pinred.playing")
    assert count_different(first, picture(screen)) > 500
    # The robot itself, without overlays: it is there, and turns.
    switch(screen, Grid=False, Shape=False, Momentum=False, Locked_inertia=False,
           Base_frame=False, CoM_trail=False)  # fmt: skip
    if traj.system.gravity.any():
        switch(screen, Gravity=False)
    early, late = picture_at(screen, 0.0), picture_at(screen, 0.9 * traj.scene.end)
    switch(screen, Robot=False)
    empty = picture_at(screen, 0.0)
    assert count_different(early, empty) > 1000
    assert count_different(early, late) > 1000
    # Its centre of mass is where something of it is drawn, or between its limbs.
    x, y = screen.run("pinred.project(['CoM trail', 'CoM', '<object>'])")
    table_rows, columns = np.nonzero(np.abs(early - empty).max(axis=2) > 12)
    assert table_rows.min() < y < table_rows.max()
    assert columns.min() < x < columns.max()
    # All of it is within the window.
    assert 0 < table_rows.min() < table_rows.max() < SIZE["height"] - 1
    assert 0 < columns.min() < columns.max() < SIZE["width"] - 1
    assert complaints(screen) == []
    assert requests(screen) == [path.as_uri()]


# Every run plays the same page from a file, and asks the server for it in test_playback_server.
@pytest.mark.by_hand
def test_served_page_plays(screen: Browser) -> None:
    """Only the page is requested."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=2.0)
    with pinred.play(traj, show=False, wait=False) as player:
        show(screen, player.url)
        first, began = picture(screen), screen.run("pinred.time")
        screen.wait_for(f"pinred.time > {began} + 0.3 || pinred.time < {began}")
        assert count_different(first, picture(screen)) > 500
        assert screen.run("document.getElementsByName('Gravity').length") == 0  # of a cat without
        assert complaints(screen) == []
        assert requests(screen) == [player.url]


@pytest.mark.parametrize("name", ["falling_cat", pytest.param("solo12", marks=BY_HAND)])
def test_scene_objects_have_pinocchio_placements(
    screen: Browser, tmp_path: Path, name: str
) -> None:
    """Joints, CoM, arrow and inertia, picture_at a frame and between frames."""
    system = pinred.load(name)
    traj = pinred.simulate(system, **ROBOTS[name])
    pinred.save_html(traj, tmp_path / "page.html", ghost=True)
    show(screen, (tmp_path / "page.html").as_uri())
    switch(screen, Ghost_beside=False)
    data = system.model.createData()
    for t in (0.0, 0.5, 1.2375, 2.0):
        screen.run(f"pinred.seek({t})")
        state = traj(t)
        pin.ccrba(system.model, data, state.q, state.v)
        pin.forwardKinematics(system.model, data, state.q)
        for i in range(1, system.model.njoints):
            for which in ("Robot", "Ghost"):
                node = f"pinred.node('{which}', '{i} {system.model.names[i]}')"
                place = np.array(screen.run(f"{node}.position.toArray()"))
                turn = np.array(screen.run(f"{node}.quaternion.toArray()"))
                np.testing.assert_allclose(np.linalg.norm(turn), 1.0, atol=1e-5)
                result = pin.XYZQUATToSE3(np.append(place, turn / np.linalg.norm(turn)))
                wanted = data.oMi[i].homogeneous
                np.testing.assert_allclose(result.homogeneous, wanted, atol=5e-4)
        dot = screen.run("pinred.node('CoM trail', 'CoM', '<object>').position.toArray()")
        np.testing.assert_allclose(dot, data.com[0], atol=5e-4)
        across = screen.run(
            "(() => { const o = pinred.node('Momentum', '<object>'), v = o.position.clone();"
            "return v.set(0, 1, 0).applyQuaternion(o.quaternion).toArray() })()"
        )
        spin = np.array(data.hg.angular)
        np.testing.assert_allclose(across, spin / np.linalg.norm(spin), atol=1e-5)


@pytest.mark.by_hand
def test_arrow_stays_still_on_screen(screen: Browser, tmp_path: Path) -> None:
    """The camera follows the CoM; the arrow's pixels stay while the cat's move."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=6.0)
    pinred.save_html(traj, tmp_path / "page.html")
    show(screen, (tmp_path / "page.html").as_uri())
    switch(screen, Grid=False, Shape=False, Locked_inertia=False, Base_frame=False,
           CoM_trail=False, Follow=True)  # fmt: skip
    times = np.linspace(0.0, 6.0, 5)
    with_robot = [picture_at(screen, t) for t in times]
    switch(screen, Robot=False)
    arrows = [has_colour(picture_at(screen, t), (213, 94, 0)) for t in times]
    assert arrows[0].sum() > 300
    table_rows, columns = np.nonzero(arrows[0][:, 300:])  # all of it is in sight
    assert 0 < table_rows.min() < table_rows.max() < SIZE["height"] - 60
    assert 0 < columns.min() < columns.max() < SIZE["width"] - 301
    for arrow, image in zip(arrows[1:], with_robot[1:], strict=True):
        assert (arrow != arrows[0])[60:-80, 300:].sum() < 0.02 * arrows[0].sum()
        assert count_different(image, with_robot[0]) > 1000
    # It is seen through the robot, too.
    assert (has_colour(with_robot[0], (213, 94, 0)) & arrows[0]).sum() > 0.95 * arrows[0].sum()
    # Without the camera going along, the arrow goes with the CoM.
    switch(screen, Follow=False)
    gone = (
        has_colour(picture_at(screen, 0.0), (213, 94, 0)),
        has_colour(picture_at(screen, 6.0), (213, 94, 0)),
    )
    assert (gone[0] & gone[1]).sum() < 0.5 * gone[0].sum()


@BY_HAND
def test_every_switch_toggles_an_overlay(screen: Browser, tmp_path: Path) -> None:
    """Each overlay disappears and reappears with its switch."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=2.0)
    pinred.save_html(traj, tmp_path / "page.html", ghost=True)
    show(screen, (tmp_path / "page.html").as_uri())
    before = picture_at(screen, 1.5)
    names = screen.run("[...document.querySelectorAll('#switches input')].map((box) => box.name)")
    assert names == ["Robot", "See-through", "Ghost", "Ghost beside", "Locked inertia", "Momentum",
                     "Base frame", "CoM trail", "Shape", "Grid", "Follow"]  # fmt: skip
    for name in names:
        was = screen.run(f"document.getElementsByName({name!r})[0].checked")
        switch(screen, **{name: not was})
        assert (
            count_different(picture_at(screen, 1.5)[:, 300:], before[:, 300:]) > 100
            or name == "Shape"
        )
        assert count_different(picture_at(screen, 1.5), before) > 150, name
        switch(screen, **{name: was})
        assert count_different(picture_at(screen, 1.5), before) < 30, name
    assert complaints(screen) == []


def test_controls(screen: Browser, tmp_path: Path) -> None:
    """Scrub bar, speed, loop, play, pause, and choice of the curvature component."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0)
    pinred.save_html(traj, tmp_path / "page.html", speed=0.25)
    show(screen, (tmp_path / "page.html").as_uri())
    assert screen.run("document.getElementById('speed').value") == "0.25"

    def turn(element: str, value: str, event: str) -> None:
        screen.run(
            f"(() => {{ const e = document.querySelector('{element}'); e.value = '{value}';"
            f"e.dispatchEvent(new Event('{event}')) }})()"
        )

    turn("#scrub", "500", "input")
    assert screen.run("[pinred.time, pinred.playing]") == [0.5, False]
    assert screen.run("document.getElementById('clock').textContent") == "0.50 of 1.00 s"
    first = picture(screen)
    turn("#panel select", "1", "change")
    changed = np.abs(picture(screen) - first).max(axis=2) > 12
    table_rows, columns = np.nonzero(changed)
    assert changed.sum() > 500
    assert columns.max() < 300
    assert table_rows.min() > 200
    # Without loop it stops picture_at the end, and play begins again.
    screen.run("document.getElementById('loop').click()")
    turn("#speed", "10", "change")
    screen.run("document.getElementById('play').click()")
    screen.wait_for("!pinred.playing")
    assert screen.run("pinred.time") == 1.0
    screen.run("document.getElementById('loop').click()")
    turn("#speed", "2", "change")
    screen.run("document.getElementById('play').click()")
    screen.run("window.turns = 0; window.was = 0; window.ticks = setInterval(() => {"
               " if (pinred.time < was) turns += 1; was = pinred.time }, 20)")  # fmt: skip
    screen.wait_for("turns > 1")
    assert complaints(screen) == []


@BY_HAND
def test_page_of_a_minute_is_small_and_fast(screen: Browser, tmp_path: Path) -> None:
    """60 s of the cat picture_at 60 fps: below 20 MB, ready in less than 5 s."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=60.0)
    assert pinred.save_html(traj, tmp_path / "page.html") < 20e6
    loaded = []
    for _ in range(3):  # the fastest of three, as others may be picture_at work on the machine
        show(screen, (tmp_path / "page.html").as_uri())
        assert screen.run("pinred.end") == 60.0
        loaded.append(screen.run("pinred.loaded"))
    assert min(loaded) < 5000.0


def test_robot_names_cannot_inject_scripts(screen: Browser, tmp_path: Path) -> None:
    """Names of the robot's file are shown as text."""
    text = (pinred.system.find_robot_files.bundled_folder() / "elroys_beanie.urdf").read_text(
        encoding="utf-8"
    )
    evil = (
        "&lt;/script>&lt;script>window.hit=1&lt;/script>&lt;img src=x onerror=window.hit=1> %BLOB%"
    )
    (tmp_path / "r.urdf").write_text(text.replace('"beanie"', f'"{evil}"'), encoding="utf-8")
    traj = pinred.simulate(pinred.load(tmp_path / "r.urdf", group="SO2"), seed=0, duration=0.5)
    assert "</script>" in traj.system.shape_names[0]
    pinred.save_html(traj, tmp_path / "page.html")
    show(screen, (tmp_path / "page.html").as_uri())
    assert screen.run("window.hit === undefined")
    assert complaints(screen) == []


# A saved page plays offline by default.
@pytest.mark.by_hand
def test_page_continues_without_player(screen: Browser) -> None:
    """An open page plays after its server has ended."""
    traj = pinred.simulate(pinred.load("elroys_beanie"), duration=1.0)
    player: Player = pinred.play(traj, show=False, wait=False)
    show(screen, player.url)
    player.close()
    began = screen.run("pinred.time")
    screen.wait_for(f"pinred.time > {began} + 0.1 || pinred.time < {began}")
    assert complaints(screen) == []
