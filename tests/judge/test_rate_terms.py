"""Compiled kinematics and forces of the full state, against Pinocchio and numpy."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.forces.kinds import Damper, Torque
from pinred.judge.full_dynamics import condition_times
from pinred.judge.reference_solution import FullState


def case(robot: str, **options: Any) -> tuple[FullState, Array]:
    """Return the full dynamics of a robot, and a random state with quaternions of any length."""
    scene = pinred.Scene(system=pinred.load(robot), seed=0, times=[1.0], **options)
    full, start = FullState(scene), scene.start
    size = len(full.state(start.pose, start.x, start.xi, start.xdot))
    return full, np.random.default_rng(3).normal(size=size)


@pytest.mark.parametrize(
    "robot", ["falling_cat", "diver", "three_rods", "double_spherical_pendulum"]
)
def test_rate_equals_kinematics_and_aba(robot: str) -> None:
    """Balls, angles that Pinocchio stores as cosine and sine, and roots of several groups."""
    full, y = case(robot)
    model, first = full.system.model, len(y) - full.system.model.nv
    size, r, v = full.root.size, full.system.r, y[first:]
    q, h = full.q(y), 1e-5
    expected = pin.aba(model, model.createData(), q, v, np.zeros(model.nv))
    rate = full.rate(0.0, y)
    np.testing.assert_allclose(rate[first:], expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(rate[:size], full.root.rate(y[:size], v[:r]))
    ends = [full.q(y + step * rate) for step in (h, -h)]
    moved = [pin.integrate(model, q, step * v) for step in (h, -h)]
    np.testing.assert_allclose(ends[0] - ends[1], moved[0] - moved[1], rtol=0, atol=1e-13)


def test_rate_with_prescribed_joint_solves_equations_of_free_joints() -> None:
    """Inverse dynamics of the accelerations give the damper's torque in the free rows."""
    full, y = case("falling_cat", prescribed={"bend": "0.5*sin(2*t)"}, forces=[Damper("sway", 0.3)])
    model, t, first = full.system.model, 0.7, full.root.size + 3
    bend, sway = (full.system.shape_names.index(name) for name in ("bend", "sway"))
    rate = full.rate(t, y)
    planned = y.copy()
    planned[full.root.size + bend] = 0.5 * np.sin(2.0 * t)
    planned[first + 6 + bend] = np.cos(2.0 * t)
    v, a = planned[first:], rate[first:]
    assert a[6 + bend] == pytest.approx(-2.0 * np.sin(2.0 * t), rel=1e-14)
    np.testing.assert_array_equal(rate[full.root.size : first], v[6:])
    torque = pin.rnea(model, model.createData(), full.q(planned), v, a)
    expected = np.zeros(9)
    expected[6 + sway] = -0.3 * v[6 + sway]
    free = [k for k in range(9) if k != 6 + bend]
    size = np.abs(pin.crba(model, model.createData(), full.q(planned))).max() * np.abs(a).max()
    np.testing.assert_allclose(torque[free], expected[free], rtol=0, atol=1e-13 * size)


def test_momentum_that_is_not_set_makes_rates_nan(monkeypatch: pytest.MonkeyPatch) -> None:
    """A force that depends on more than the model says must not go unnoticed."""
    torque = Torque(lambda _t, _x, _xdot, mu: ca.vertcat(mu[3], 0.0, 0.0))
    scene = pinred.Scene(system=pinred.load("falling_cat"), seed=0, times=[1.0], forces=[torque])
    y = np.random.default_rng(3).normal(size=19)
    assert np.isfinite(FullState(scene).rate(0.0, y)).all()
    monkeypatch.setattr(scene.force_model, "sees_momentum", False)
    assert np.isnan(FullState(scene).rate(0.0, y)[10:]).all()


def test_parameters_are_copied() -> None:
    """A run changes its parameters in place, so it must not change the recorded ones."""
    full, y = case("falling_cat", forces=[Damper("sway", 0.3)])
    given = np.array([0.5])
    full.set_parameters(given)
    before = full.rate(0.0, y)
    given[:] = 0.7
    np.testing.assert_array_equal(full.rate(0.0, y), before)


def test_length_of_the_quaternion_has_no_effect_on_forces() -> None:
    """The integrator changes the length, but a force observes an attitude."""
    full, y = case("falling_cat", forces=[Torque(lambda s: ca.vertcat(s.pose[3], 0.0, 0.0))])
    longer = y.copy()
    longer[3:7] *= 2.5
    np.testing.assert_allclose(full.rate(0.0, longer)[10:], full.rate(0.0, y)[10:], rtol=1e-12)


def test_pulse_shorter_than_samples_is_found_between_stops() -> None:
    """The middle of each span is sampled, so a span that is one pulse is not missed."""
    centre, half = 0.40001, 1e-5  # samples are 6e-5 s apart, and none is within the pulse
    torque = Torque(lambda s: {"bend": ca.if_else((s.t - centre) ** 2 < half**2, 0.2, 0.0)})
    system = pinred.load("falling_cat")
    forces = pinred.Scene(system=system, forces=[torque], duration=1.0).force_model
    assert forces is not None
    ends = np.array([centre - half, centre + half])
    assert not condition_times(forces, np.array([1.0]), forces.numbers).size
    times = condition_times(forces, np.append(ends, 1.0), forces.numbers)
    np.testing.assert_allclose(times, ends, rtol=0.0, atol=1e-12)
