"""Joints that follow others, in figures and films."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import joint, link, robot, write

import pinred
from pinred.views.playback.playback import playback
from pinred.views.playback.shape_panel import shape_panel
from pinred.views.playback.view import View
from pinred.views.plots.motion_labels import labels_of

KINDS = ("base", "curvature", "energy", "error", "momentum", "phase", "poincare", "shape", "sphere")


@pytest.fixture
def hand(tmp_path: Path) -> pinred.System:
    """A wrist and two fingers that slide apart, the second by half; a thumb on the second."""
    slide = '<axis xyz="0 1 0"/>'
    text = robot(
        *(link(name) for name in ("base", "palm", "left", "right", "thumb")),
        joint("base", "palm"),
        joint("palm", "left", "prismatic", f'{slide}<mimic joint="palm-right" multiplier="-.5"/>'),
        joint("palm", "right", "prismatic", slide),
        joint("right", "thumb"),
    )
    return pinred.load(write(tmp_path, text))


def test_films_move_followers(hand: pinred.System) -> None:
    """The placements are those of Pinocchio with the follower where its leader puts it."""
    traj = pinred.simulate(hand, seed=2, duration=0.5)
    seen = playback(traj, View(fps=20.0, ghost=True))
    model = hand.model
    data = model.createData()
    left, right = (model.getJointId(f"palm-{side}") for side in ("left", "right"))
    moved = []
    for k, t in enumerate(seen.t):
        q = pin.neutral(model)
        state = traj(t)
        q[:7] = state.pose
        for name, value in zip(hand.shape_names, state.x, strict=True):
            q[model.joints[model.getJointId(name)].idx_q] = value
        moved.append(q[model.joints[right].idx_q])
        q[model.joints[left].idx_q] = -0.5 * q[model.joints[right].idx_q]
        pin.forwardKinematics(model, data, q)
        place = data.oMi[left].translation
        np.testing.assert_allclose(seen.placements[k, left, :3], place, atol=1e-12)
    assert np.ptp(moved) > 1e-3
    assert seen.ghost is not None
    assert seen.ghost.apart.max() < 1e-6


def test_labels_and_limbs(hand: pinred.System) -> None:
    """Names, units and rows are those of the shape, without the follower between."""
    labels = labels_of(hand)
    assert labels.joints == ("base-palm", "palm-right", "right-thumb")
    assert labels.units == ("rad", "m", "rad")
    assert labels.limbs == ((0, 1, 2),)


@pytest.mark.parametrize("kind", KINDS)
def test_figures(hand: pinred.System, kind: str) -> None:
    """Every kind of figure can be drawn."""
    traj = pinred.simulate(hand, seed=2, duration=0.5)
    options = {"direction": -1} if kind == "poincare" else {}
    assert pinred.plot(traj, kind, **options).axes


def test_shape_panel(hand: pinred.System) -> None:
    """The two joints that move the most, with their own units."""
    traj = pinred.simulate(hand, seed=2, duration=0.5)
    panel = shape_panel(hand, traj.x, traj.xdot, ("palm-right", "base-palm"))
    assert panel is not None
    assert panel.labels == ("palm-right [m]", "base-palm [rad]")
