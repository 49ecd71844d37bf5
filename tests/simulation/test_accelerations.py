"""Accelerations of motions against Pinocchio's ABA and RNEA, and against prescribed motions."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.judge.audit import Accelerations, accelerations
from pinred.scene.scene import Engine

TIMES = np.linspace(0.0, 0.5, 6)
SIZE = 0.7  # of a robot [m]; a slide moves by a fraction of it in a difference
AMPLITUDE, RATE = 0.3, 2.0


@cache
def free(name: str, engine: Engine) -> pinred.Trajectory:
    """Return the motion of a robot without forces."""
    system, rng = pinred.load(name), np.random.default_rng(3)
    return pinred.simulate(
        system, engine=engine, duration=0.5, rtol=1e-11, atol=1e-13,
        x0=rng.uniform(-1.0, 1.0, system.m), xdot0=rng.uniform(-1.0, 1.0, system.m),
        xi0=rng.uniform(-1.0, 1.0, system.r),
    )  # fmt: skip


def driven(formula: str, longest: float = np.inf) -> pinred.Trajectory:
    """Return the motion of a cat whose first joint follows a formula.

    longest: the longest step [s].
    """
    system = pinred.load("falling_cat")
    plan = {system.shape_names[0]: pinred.signals.Expression(formula)}
    method = pinred.DOP853(rtol=1e-11, atol=1e-13, max_step=longest)
    return pinred.simulate(system, prescribed=plan, momentum=0, duration=0.5, method=method)


def positions(traj: pinred.Trajectory, result: Accelerations) -> list[Array]:
    """Return Pinocchio's configurations at the times."""
    states = result.states
    return [traj.system.q(*at) for at in zip(states.pose, states.x, strict=True)]


@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.parametrize("name", ["falling_cat", "cartpole", "coupled_planar"])
def test_accelerations_agree_with_aba(name: str, engine: Engine) -> None:
    """They agree to ten digits, and the spread of two difference lengths is round-off."""
    traj = free(name, engine)
    result, model = accelerations(traj, TIMES, SIZE), traj.system.model
    data, none = model.createData(), np.zeros(model.nv)
    expected = np.array([
        pin.aba(model, data, q, v, none)
        for q, v in zip(positions(traj, result), result.v, strict=True)
    ])  # fmt: skip
    size = np.abs(expected).max()
    assert result.a == pytest.approx(expected, abs=1e-10 * size)
    assert 0.1 * np.abs(result.a - expected).max() < result.spread.max() < 2e-12 * size


def test_prescribed_joint_has_prescribed_acceleration() -> None:
    """The joint has the second derivative of its sine, and RNEA gives no force on the base."""
    traj = driven(f"{AMPLITUDE}*sin({RATE}*t)")
    result, model = accelerations(traj, TIMES, SIZE), traj.system.model
    bend = -AMPLITUDE * RATE**2 * np.sin(RATE * TIMES)
    r = traj.system.r
    assert result.a[:, r] == pytest.approx(bend, abs=1e-9)
    data = model.createData()
    for q, v, a in zip(positions(traj, result), result.v, result.a, strict=True):
        forces = np.delete(pin.rnea(model, data, q, v, a), r)
        assert forces == pytest.approx(0.0, abs=1e-9)


def test_pace_scales_slides_by_robot_size() -> None:
    """Turns count in radians, slides in robot sizes, and cyclic joints do not count."""
    cart = accelerations(free("cartpole", "compiled"), TIMES, SIZE)
    assert cart.pace == pytest.approx(np.abs(cart.states.xdot[:, 0]), rel=1e-12)
    traj = free("falling_cat", "compiled")
    cat = accelerations(traj, TIMES, SIZE)
    turns = np.hstack([cat.states.xi[:, traj.system.group.linear :], cat.states.xdot])
    assert cat.pace == pytest.approx(np.abs(turns).sum(axis=1), rel=1e-12)
    sliding = pinred.load(random_model("SE3", 2, 2))
    assert sliding.units == ("m", "rad")
    traj = pinred.simulate(sliding, seed=1, duration=0.5)
    result = accelerations(traj, TIMES, SIZE)
    rates = np.abs(np.hstack([result.states.xi[:, 3:], result.states.xdot]))
    rates[:, 3] /= SIZE
    assert result.pace == pytest.approx(rates.sum(axis=1), rel=1e-12)


@pytest.mark.parametrize("amplitude", [0.3, 0.001])
def test_pace_of_reversing_joint_is_ratio_of_rates(amplitude: float) -> None:
    """The pace of a prescribed joint at rest is its largest |ẍ| over its largest |ẋ|."""
    traj = driven(f"{amplitude}*cos(40*t)")
    times = np.linspace(0.0, 0.2, 9)
    result = accelerations(traj, times, SIZE)
    speeds = np.abs(np.hstack([result.states.xi[:, 3:], result.states.xdot])).sum(axis=1)
    pace = 40.0 * np.abs(np.cos(40.0 * times)).max() / np.abs(np.sin(40.0 * times)).max()
    step_ends = traj.motion.knots
    last = np.clip(np.searchsorted(step_ends, times), 1, len(step_ends) - 1)
    steps = 0.005 * 64.0 / (step_ends[last] - step_ends[last - 1])
    assert result.pace == pytest.approx(np.max([speeds, np.full(9, pace), steps], axis=0), rel=1e-9)
    assert result.a[:, traj.system.r] == pytest.approx(
        -(40.0**2) * amplitude * np.cos(40.0 * times), abs=1e-8 * amplitude * 40.0**2
    )


def test_pace_of_constant_joint_follows_steps() -> None:
    """The steps of the integrator limit the differences of a joint at rest."""
    result = accelerations(driven("0.2", longest=0.01), TIMES, SIZE)
    assert np.isfinite(result.a).all()
    assert result.pace[1:] == pytest.approx(0.32 / 0.01, rel=0.01)
