"""Momentum sphere: the conserved momentum in the axes of a body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.errors import InputError
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.page import page
from pinred.views.playback.playback import playback


def test_base_of_a_rigid_body_draws_the_polhode() -> None:
    """The path is the body momentum μ, and its energy ellipsoid contains it."""
    traj = pinred.simulate(pinred.load("rigid_body"), seed=1, duration=3.0)
    shown = playback(traj, View(sphere="base", fps=20.0))
    assert shown.sphere is not None
    path = shown.sphere.path
    np.testing.assert_allclose(np.linalg.norm(path, axis=1), 1.0, atol=1e-8)
    mu = traj(shown.t).body_momentum[:, -3:]
    lever = np.array(shown.system.model.inertias[1].lever)
    about_com = mu - np.cross(lever, traj(shown.t).body_momentum[:, :3])
    largest = np.linalg.norm(about_com, axis=1).max()
    np.testing.assert_allclose(path, about_com / largest, atol=1e-8)
    energy = np.einsum(
        "fi,ij,fj->f", path, np.linalg.inv(shown.system.model.inertias[1].inertia), path
    )
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)


def test_inner_body_sees_the_momentum_in_its_axes() -> None:
    """The path on a ball's body is the centroidal momentum of Pinocchio in that body's frame."""
    traj = pinred.simulate(pinred.load("diver"), seed=1, duration=0.5)
    shown = playback(traj, View(sphere="left_shoulder", fps=20.0))
    assert shown.sphere is not None
    assert shown.sphere.body == "left_shoulder"
    model = shown.system.model
    data, rows = model.createData(), []
    states = traj(shown.t)
    for q, v in zip(states.q, states.v, strict=True):
        pin.computeCentroidalMomentum(model, data, q, v)
        placement = data.oMi[model.getJointId("left_shoulder")]
        rows.append(placement.rotation.T @ data.hg.angular)
    expected = np.array(rows) / np.linalg.norm(rows, axis=1).max()
    np.testing.assert_allclose(shown.sphere.path, expected, atol=1e-9)
    assert np.ptp(shown.sphere.path, axis=0).max() > 0.1


def test_page_contains_balls_and_the_sphere() -> None:
    """The page has an entry for each ball joint, and the sphere on request only."""
    traj = pinred.simulate(pinred.load("diver"), seed=1, duration=0.1)
    plain, round_ = page(traj, View()), page(traj, View(sphere="base"))
    assert b'"balls": [2, 3, 4]' in plain
    assert b'"sphere": null' in plain
    assert b'"sphere": {"joint": 1, "body": "base"' in round_


@pytest.mark.parametrize(
    ("robot", "scene", "body", "message"),
    [
        ("diver", {"seed": 1}, "tail", "the bodies are named base, hips, left_shoulder"),
        ("three_rods", {"seed": 1}, "base", "needs a robot that turns in space"),
        ("diver", {"momentum": 0}, "hips", "the angular momentum is zero"),
    ],
)
def test_bodies_without_a_sphere_are_refused(
    robot: str, scene: dict[str, Any], body: str, message: str
) -> None:
    """Unknown bodies, planar robots and zero momentum are refused with the remedy."""
    traj = pinred.simulate(pinred.load(robot), duration=0.05, **scene)
    with pytest.raises(InputError, match=message):
        playback(traj, View(sphere=body))
