"""Follower joints in figures and films."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import joint, link, robot, write

import pinred
from pinred.views.motion_source import labels_of
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.playback import playback, shape_panel

KINDS = ("base", "curvature", "energy", "error", "momentum", "phase", "poincare", "shape", "sphere")


@pytest.fixture
def hand(tmp_path: Path) -> pinred.System:
    """Load a wrist with two sliding fingers, the second at half the stroke, and a thumb on it."""
    slide = '<axis xyz="0 1 0"/>'
    text = robot(
        *(link(name) for name in ("base", "palm", "left", "right", "thumb")),
        joint("base", "palm"),
        joint("palm", "left", "prismatic", f'{slide}<mimic joint="palm-right" multiplier="-.5"/>'),
        joint("palm", "right", "prismatic", slide),
        joint("right", "thumb"),
    )
    return pinred.load(write(tmp_path, text))


def test_film_moves_followers(hand: pinred.System) -> None:
    """Placements are Pinocchio's with the follower at its coupled value."""
    traj = pinred.simulate(hand, seed=2, duration=0.5)
    shown = playback(traj, View(fps=20.0, ghost=True))
    model = hand.model
    data = model.createData()
    left_palm, right = (model.getJointId(f"palm-{side}") for side in ("left", "right"))
    shifted = []
    for k, t in enumerate(shown.t):
        q = pin.neutral(model)
        state = traj(t)
        q[:7] = state.pose
        for name, value in zip(hand.shape_names, state.x, strict=True):
            q[model.joints[model.getJointId(name)].idx_q] = value
        shifted.append(q[model.joints[right].idx_q])
        q[model.joints[left_palm].idx_q] = -0.5 * q[model.joints[right].idx_q]
        pin.forwardKinematics(model, data, q)
        place = data.oMi[left_palm].translation
        np.testing.assert_allclose(shown.placements[k, left_palm, :3], place, atol=1e-12)
    assert np.ptp(shifted) > 1e-3
    assert shown.ghost is not None
    assert shown.ghost.apart.max() < 1e-6


def test_labels_omit_followers(hand: pinred.System) -> None:
    """Names, units and branches are those of the shape."""
    labels = labels_of(hand)
    assert labels.joints == ("base-palm", "palm-right", "right-thumb")
    assert labels.units == ("rad", "m", "rad")
    assert labels.limbs == ((0, 1, 2),)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sampled
def test_all_figures_of_robot_with_followers(hand: pinred.System, kind: str) -> None:
    """Every kind of figure can be drawn."""
    traj = pinred.simulate(hand, seed=2, duration=0.5)
    options = {"direction": -1} if kind == "poincare" else {}
    assert pinred.plot(traj, kind, **options).axes


def test_shape_panel_of_robot_with_followers(hand: pinred.System) -> None:
    """The axes are the two joints that move most, with their units."""
    traj = pinred.simulate(hand, seed=2, duration=0.5)
    panel = shape_panel(hand, traj.x, traj.xdot, ("palm-right", "base-palm"))
    assert panel is not None
    assert panel.labels == ("palm-right [m]", "base-palm [rad]")
