"""Impacts at joint stops in plots, playback and its ghost."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from headless_browser import Browser
from test_playback_in_browser import complaints, count_different, picture_at, show

import pinred
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.drawn_bodies import drawn_bodies
from pinred.views.playback.film import Frames
from pinred.views.playback.playback import playback
from pinred.views.playback.scene_nodes import frame, scene_nodes


@pytest.fixture(scope="module")
def bouncing_cat() -> pinred.Trajectory:
    """Return a motion with three impacts."""
    traj = pinred.simulate(
        pinred.load("falling_cat"), xdot0=[3.0, -2.0, 1.0], duration=1.0,
        stops={"bend": (-0.6, 0.6, 0.5), "sway": (-0.5, 0.5, 0.6)},
    )  # fmt: skip
    assert len(traj.impacts) == 3
    return traj


@pytest.mark.parametrize("kind", ["shape", "rates", "energy"])
@pytest.mark.sampled(3)
def test_plots_mark_the_times_of_impacts(
    bouncing_cat: pinred.Trajectory, tmp_path: Path, kind: str
) -> None:
    """Plots of motions and of their recordings have a line at each impact in every panel."""
    bouncing_cat.save(tmp_path / "motion.npz")
    for motion in (bouncing_cat, pinred.read_recording(tmp_path / "motion.npz")):
        for axes in pinred.plot(motion, kind).axes:
            (marks,) = (c for c in axes.collections if c.get_label() == "_impacts")
            times = [np.asarray(path.vertices)[0, 0] for path in marks.get_paths()]
            np.testing.assert_array_equal(times, bouncing_cat.impacts.times)
    free = pinred.simulate(pinred.load("falling_cat"), duration=0.1)
    assert not any(axes.collections for axes in pinred.plot(free, "shape").axes)


def test_playback_flashes_at_joints_and_its_ghost_hits_the_same_stops(
    bouncing_cat: pinred.Trajectory, tmp_path: Path
) -> None:
    """The page has time and joint of each impact; the full simulation bounces as well."""
    film = playback(bouncing_cat, View(fps=20.0, ghost=True))
    model, table = film.system.sorted_model, bouncing_cat.impacts
    np.testing.assert_array_equal(film.impacts[:, 0], table.t)
    assert [model.names[int(k)] for k in film.impacts[:, 1]] == list(table.joint)
    assert film.ghost is not None
    assert film.ghost.apart.max() < 1e-8
    page = tmp_path / "cat.html"
    pinred.save_html(bouncing_cat, page, fps=20.0)
    head = re.search(r'"impacts": (\[.*?\]\]|\[\])', page.read_text(encoding="utf-8"))
    assert head is not None
    assert json.loads(head[1]) == film.impacts.tolist()


@pytest.mark.browser
def test_browser_shows_a_flash_after_an_impact(
    bouncing_cat: pinred.Trajectory, tmp_path: Path, screen: Browser
) -> None:
    """The picture changes at once at an impact, while the robot hardly moves; there is no error."""
    page = tmp_path / "cat.html"
    pinred.save_html(bouncing_cat, page, fps=100.0)
    time = float(bouncing_cat.impacts.t[-1])
    show(screen, page.as_uri())
    earlier, before, after = (picture_at(screen, time + dt) for dt in (-2e-5, -1e-5, 1e-5))
    assert complaints(screen) == []
    assert count_different(before, after) > 3 * count_different(earlier, before) + 100


def test_films_show_a_flash_that_fades(bouncing_cat: pinred.Trajectory) -> None:
    """Orange pixels at an impact; a quarter of a second later at half speed, half as strong."""
    film = playback(bouncing_cat, View(fps=400.0))
    framing, bodies = frame(film, drawn_bodies(film.system)), drawn_bodies(film.system)
    nodes = {node.path[1]: node for node in scene_nodes(film, bodies, framing, 2.0)}
    for joint, times in {
        name: bouncing_cat.impacts.t[np.array(bouncing_cat.impacts.joint) == name]
        for name in set(bouncing_cat.impacts.joint)
    }.items():
        opacity = nodes[f"impact at {joint}"].opacity
        assert opacity is not None
        since = film.t[:, None] - np.sort(times)
        since = np.where(since >= 0.0, since, np.inf).min(axis=1)
        np.testing.assert_allclose(opacity, np.maximum(0.0, 1.0 - since / 0.5), atol=1e-12)
    t = float(bouncing_cat.impacts.t[-1])
    frames = Frames(bouncing_cat, View(fps=400.0), (320, 240))
    shots = [np.asarray(frames.draw(t + dt), dtype=np.int16) for dt in (-0.006, -0.003, 0.003)]
    earlier, later = (np.abs(a - b).max(axis=2) > 12 for a, b in pairwise(shots))
    assert later.sum() > 2 * earlier.sum() + 20
