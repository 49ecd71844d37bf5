"""Phase portraits and Poincaré sections of ball joints, against prescribed rotation vectors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred import plots
from pinred.common.arrays import Array
from pinred.lie.rotations import quaternion_exp
from pinred.signals import Attitude
from pinred.views.plots.phase_space import section

_TWIST = np.array([2.0, -1.0, 2.0]) / 3.0


@pytest.fixture(scope="module")
def traj() -> pinred.Trajectory:
    """Return a diver whose hips follow w(t) beyond half a turn, also for a moment at |w| = π."""
    plan = {"hips": Attitude(["4*sin(2*t)", "0.3*t", 0.2])}
    return pinred.simulate(
        pinred.load("diver"), seed=1, duration=4.0, prescribed=plan, rtol=1e-10, atol=1e-12
    )


def crossings_of(traj: pinred.Trajectory) -> Array:
    """Return 0.3 t and its rate at the upward crossings of 4 sin 2t = 3.5."""
    t = 0.5 * (np.arcsin(0.875) + 2.0 * np.pi * np.arange(4))
    t = t[t < traj.t[-1]]
    return np.stack([0.3 * t, np.full_like(t, 0.3)], axis=1)


# The portrait of a ball and the section of hinges are drawn by default.
@pytest.mark.by_hand
def test_section_of_ball_equals_prescribed_motion(traj: pinred.Trajectory, tmp_path: Path) -> None:
    """Rotation vectors are unwrapped, and rates are their derivatives, also of recordings."""
    expected = crossings_of(traj)
    assert len(expected) == 2
    found = section(traj, 0, 3.5, 1, turns=False, shown=1)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    traj.save(tmp_path / "dive.npz")
    recording = pinred.read_recording(tmp_path / "dive.npz")
    read = section(recording, 0, 3.5, 1, turns=False, shown=1)
    np.testing.assert_allclose(read, expected, atol=1e-4)
    (axes,) = plots.poincare(traj, joints=["hips.x", "hips.y"], value=3.5).axes
    np.testing.assert_array_equal(axes.lines[0].get_xydata(), found)


def test_portrait_of_ball_draws_rotation_vector_and_its_potential(
    traj: pinred.Trajectory,
) -> None:
    """The path is (w, ẇ); the potential at a point is that of the shape with this vector."""
    figure = plots.phase(traj, joints=["hips.x"], limits=[(-1.0, 1.0)])
    top, portrait = figure.axes
    w, rate = portrait.lines[0].get_data()
    t = np.arcsin(np.clip(np.asarray(w) / 4.0, -1.0, 1.0))
    np.testing.assert_allclose(np.abs(rate), 8.0 * np.cos(t), atol=1e-6)
    x, values = (np.asarray(part) for part in top.lines[0].get_data())
    start = traj(0.0)
    red = pinred.Reduction(traj.system)
    for k in (0, 60, len(x) - 1):
        shape = np.array(start.x)
        shape[:4] = quaternion_exp(np.array([x[k], 0.0, 0.2]))
        field = red.grid(shape)
        mu = np.append(np.zeros(3), start.body_momentum[3:])
        mu[3:] -= np.cross(red.grid(start.x).com, start.body_momentum[:3])
        assert np.shape(field.amended_potential(mu)) == ()  # a single shape has a single value
        assert values[k] == pytest.approx(float(field.amended_potential(mu)), rel=1e-12)


def test_rates_of_rotation_vectors_equal_differences() -> None:
    """ẇ = J⁻¹σ, at a rotation vector longer than π."""
    space = pinred.load("falling_cat_ball").space
    w, sigma, h = 4.0 * _TWIST[None], np.array([[0.3, -0.2, 0.5]]), 1e-5
    q = quaternion_exp(w)
    sides = [space.chart(space.integrate(q, s * h * sigma), near=w) for s in (-1, 1)]
    expected = (sides[1] - sides[0]) / (2.0 * h)
    np.testing.assert_allclose(space.chart_rate(w, sigma), expected, atol=1e-9)


# test_phase_commands.py draws loops of balls about a centre.
@pytest.mark.by_hand
def test_coordinates_about_a_centre_are_rotation_vectors_from_it() -> None:
    """A plan of balls is drawn in the coordinates of its gait, which begin at zero."""
    system = pinred.load("falling_cat_ball")
    plan = pinred.reorient(system, [0.5, 0.0, 0.0], x0={"spine": [0.2, 0.1, 0.0]})
    joints = plots.loop(plan).axes[-2]
    drawn = np.array([line.get_ydata() for line in joints.lines]).T
    t = plan.trajectory.t
    assert drawn.shape == (len(t), 3)
    np.testing.assert_allclose(drawn[0], plan.gait.at(0.0)[0], atol=1e-12)
    assert plan.chart is not None
    shapes = plan.chart.shapes(drawn)
    signs = np.sign(np.sum(shapes * plan.trajectory.x, axis=1, keepdims=True))
    np.testing.assert_allclose(signs * shapes, plan.trajectory.x, atol=1e-12)
