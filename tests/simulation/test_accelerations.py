"""Accelerations of motions against Pinocchio's ABA and RNEA, and against plans in closed form."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.scene.scene import Engine
from pinred.simulation.accelerations import Accelerations, accelerations

TIMES = np.linspace(0.0, 0.5, 6)
SIZE = 0.7  # of a robot [m]; it says how far a slide may move in a difference
AMPLITUDE, RATE = 0.3, 2.0


@cache
def free(name: str, engine: Engine) -> pinred.Trajectory:
    """A robot that nobody pushes."""
    system, rng = pinred.load(name), np.random.default_rng(3)
    return pinred.simulate(
        system, engine=engine, duration=0.5, rtol=1e-11, atol=1e-13,
        x0=rng.uniform(-1.0, 1.0, system.m), xdot0=rng.uniform(-1.0, 1.0, system.m),
        xi0=rng.uniform(-1.0, 1.0, system.r),
    )  # fmt: skip


def driven(told: str, longest: float = np.inf) -> pinred.Trajectory:
    """A cat whose first joint follows a plan.  longest: of the steps [s]."""
    system = pinred.load("falling_cat")
    plan = {system.shape_names[0]: pinred.signals.Expression(told)}
    method = pinred.DOP853(rtol=1e-11, atol=1e-13, max_step=longest)
    return pinred.simulate(system, prescribed=plan, momentum=0, duration=0.5, method=method)


def positions(traj: pinred.Trajectory, found: Accelerations) -> list[Array]:
    """Pinocchio's coordinates at each of the times."""
    states = found.states
    return [traj.system.model_q(*at) for at in zip(states.pose, states.x, strict=True)]


@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.parametrize("name", ["falling_cat", "cartpole", "coupled_planar"])
def test_accelerations_are_those_of_aba(name: str, engine: Engine) -> None:
    """To ten digits; and what two lengths of difference leave is no more than round-off."""
    traj = free(name, engine)
    found, model = accelerations(traj, TIMES, SIZE), traj.system.model
    data, none = model.createData(), np.zeros(model.nv)
    true = np.array([
        pin.aba(model, data, q, v, none)
        for q, v in zip(positions(traj, found), found.v, strict=True)
    ])  # fmt: skip
    size = np.abs(true).max()
    assert found.a == pytest.approx(true, abs=1e-10 * size)
    assert 0.1 * np.abs(found.a - true).max() < found.spread.max() < 2e-12 * size


def test_a_joint_on_a_plan_has_the_plans_and_the_base_the_rest() -> None:
    """The second derivative of a sine; the base is pushed by nobody, so RNEA gives nothing."""
    traj = driven(f"{AMPLITUDE}*sin({RATE}*t)")
    found, model = accelerations(traj, TIMES, SIZE), traj.system.model
    bend = -AMPLITUDE * RATE**2 * np.sin(RATE * TIMES)
    r = traj.system.r
    assert found.a[:, r] == pytest.approx(bend, abs=1e-9)
    data = model.createData()
    for q, v, a in zip(positions(traj, found), found.v, found.a, strict=True):
        pushes = np.delete(pin.rnea(model, data, q, v, a), r)
        assert pushes == pytest.approx(0.0, abs=1e-9)


def test_pace_counts_turns_in_radians_and_slides_in_sizes() -> None:
    """The rail of a cart counts for nothing, as nothing depends on where the cart is on it."""
    cart = accelerations(free("cartpole", "compiled"), TIMES, SIZE)
    assert cart.pace == pytest.approx(np.abs(cart.states.xdot[:, 0]), rel=1e-12)
    traj = free("falling_cat", "compiled")
    cat = accelerations(traj, TIMES, SIZE)
    turns = np.hstack([cat.states.xi[:, traj.system.group.linear :], cat.states.xdot])
    assert cat.pace == pytest.approx(np.abs(turns).sum(axis=1), rel=1e-12)
    slid = pinred.load(random_model("SE3", 2, 2))
    assert slid.units == ("m", "rad")
    traj = pinred.simulate(slid, seed=1, duration=0.5)
    found = accelerations(traj, TIMES, SIZE)
    rates = np.abs(np.hstack([found.states.xi[:, 3:], found.states.xdot]))
    rates[:, 3] /= SIZE
    assert found.pace == pytest.approx(rates.sum(axis=1), rel=1e-12)


@pytest.mark.parametrize("amplitude", [0.3, 0.001])
def test_pace_of_a_plan_that_turns_round(amplitude: float) -> None:
    """Where it stands still, its largest |ẍ| over its largest |ẋ| is the pace."""
    traj = driven(f"{amplitude}*cos(40*t)")
    times = np.linspace(0.0, 0.2, 9)
    found = accelerations(traj, times, SIZE)
    own = np.abs(np.hstack([found.states.xi[:, 3:], found.states.xdot])).sum(axis=1)
    pace = 40.0 * np.abs(np.cos(40.0 * times)).max() / np.abs(np.sin(40.0 * times)).max()
    knots = traj.motion.knots
    last = np.clip(np.searchsorted(knots, times), 1, len(knots) - 1)
    steps = 0.005 * 64.0 / (knots[last] - knots[last - 1])
    assert found.pace == pytest.approx(np.max([own, np.full(9, pace), steps], axis=0), rel=1e-9)
    assert found.a[:, traj.system.r] == pytest.approx(
        -(40.0**2) * amplitude * np.cos(40.0 * times), abs=1e-8 * amplitude * 40.0**2
    )


def test_a_plan_that_stands_still_has_no_pace() -> None:
    """Then the steps of the integrator say how far to look."""
    found = accelerations(driven("0.2", longest=0.01), TIMES, SIZE)
    assert np.isfinite(found.a).all()
    assert found.pace[1:] == pytest.approx(0.32 / 0.01, rel=0.01)
