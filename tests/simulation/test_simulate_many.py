"""simulate_many: members agree with single simulations, and failures are isolated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pinred
from pinred.system.state_fields import State

NEAR: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-11}  # round-off times a short stretch


def test_members_agree_with_simulate() -> None:
    """With and without momentum; the bits do not depend on the number of threads."""
    system = pinred.load("falling_cat")
    rng = np.random.default_rng(0)
    x0, xdot0 = rng.uniform(-0.5, 0.5, (12, 3)), rng.normal(size=(12, 3))
    momentum = rng.normal(size=(12, 6)) * 0.01
    momentum[::3] = 0.0
    times = np.linspace(0.0, 2.0, 7)
    found = [
        pinred.simulate_many(
            system, x0=x0[some], xdot0=xdot0[some], momentum=momentum[some], times=times,
            threads=threads,
        )
        for some, threads in ((slice(None), 1), (slice(None), 3), (slice(None, None, -1), 2))
    ]  # fmt: skip
    assert all(len(many) == 12 and many.failures == () for many in found)
    for field in State.__dataclass_fields__:
        first, second, turned = (getattr(many.states, field) for many in found)
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(first, turned if field == "t" else turned[::-1])
    many = found[0]
    for i in range(12):
        one = pinred.simulate(system, x0=x0[i], xdot0=xdot0[i], momentum=momentum[i], times=times)
        for field in State.__dataclass_fields__:
            whole = getattr(many.states, field)
            np.testing.assert_array_equal(
                getattr(many[i], field), whole if field == "t" else whole[i]
            )
            np.testing.assert_allclose(getattr(many[i], field), getattr(one, field), **NEAR)


def test_caller_may_change_options_afterwards() -> None:
    """Scenes of members have the values of the call: arrays, lists and tables of them."""
    system = pinred.load("planar_chain5", lock=("joint3", "joint4", "joint5"))
    x0, xi0, times = np.full((3, 2), 0.1), np.full((3, 3), 0.3), np.array([0.0, 0.1])
    shared, springs = [0.2, 0.2], {"joint1": (2.0, 0.0)}
    many = pinred.simulate_many(
        system, x0=x0, xdot0=shared, springs=springs, times=times, members={"xi0": xi0}
    )
    for array in (x0, xi0, times):
        array[...] = 7.0
    shared[:], springs["joint1"] = [7.0, 7.0], (7.0, 0.0)
    scene = many[2].scene
    for values, stated in ((scene.x0, 0.1), (scene.xdot0, 0.2), (scene.xi0, 0.3)):
        np.testing.assert_array_equal(np.asarray(values), stated)
    assert scene.springs == {"joint1": (2.0, 0.0)}
    np.testing.assert_array_equal(many.t, [0.0, 0.1])


def test_methods_without_lanes_give_bits_of_simulate() -> None:
    """Members are integrated one after another."""
    system = pinred.load("planar_chain5")
    for method in ("Gauss(0.01)", "AdaptiveGauss"):
        many = pinred.simulate_many(system, seeds=range(3), times=[1.0], method=method)
        one = pinred.simulate(system, seed=2, times=[1.0], method=method)
        np.testing.assert_array_equal(many[2].q, one.q)


def test_seeds_give_random_states() -> None:
    """DOP853 is the default for many members."""
    system = pinred.load("planar_chain5")
    many = pinred.simulate_many(system, seeds=range(4), times=[1.0])
    one = pinred.simulate(system, seed=2, times=[1.0])
    assert (many[2].run.method, one.run.method) == ("DOP853", "AdaptiveGauss")
    np.testing.assert_allclose(many[2].q, one.q, atol=1e-8)
    same = pinred.simulate(system, seed=2, times=[1.0], method="DOP853")
    np.testing.assert_allclose(many[2].q, same.q, **NEAR)


def test_failure_does_not_affect_other_members() -> None:
    """The failed member is listed with its time."""
    system = pinred.load("coupled_planar")
    x0 = np.array([[0.0], [1.0], [0.0]])
    many = pinred.simulate_many(system, x0=x0, duration=100.0, springs={"hinge": (-1e6, 0.0)})
    assert [failure.member for failure in many.failures] == [1]
    assert 0.0 < many.failures[0].time < 100.0
    assert np.isfinite(many[0].q).all()
    assert np.isfinite(many[-1].q).all()
    with pytest.raises(pinred.IntegrationError, match=r"member 1 stopped at t = "):
        _ = many[1]
    assert np.isfinite(many.x[[0, 2]]).all()
    assert np.isfinite(many.x[1, many.t < many.failures[0].time]).all()
    assert np.isnan(many.pose[1, -1]).all()
    alone = pinred.simulate_many(system, x0=x0[:1], duration=100.0, springs={"hinge": (-1e6, 0.0)})
    np.testing.assert_array_equal(alone.x[0], many.x[0])


@pytest.mark.parametrize("method", ["DOP853", "Radau"])
def test_body_without_variables_is_simulated(method: str) -> None:
    """A body that only translates has no integrated variables."""
    cart = pinred.load("cartpole", lock=["pole_pivot"])
    many = pinred.simulate_many(cart, xi0=np.array([[1.0], [2.0]]), duration=2.0, method=method)
    np.testing.assert_allclose(many[1].pose[-1], [4.0])


def test_invalid_members_are_rejected() -> None:
    """Lengths that differ, and options without differences, are rejected."""
    system = pinred.load("coupled_planar")
    with pytest.raises(pinred.ShapeError, match="x0: 2, xdot0: 3"):
        pinred.simulate_many(system, x0=np.zeros((2, 1)), xdot0=np.zeros((3, 1)))
    with pytest.raises(pinred.ShapeError, match="none"):
        pinred.simulate_many(system, x0=[0.0])
    with pytest.raises(pinred.ShapeError, match="none, and one for all push"):
        pinred.simulate_many(system, duration=0.1, members={"push": np.zeros((3, 3, 3))})
    with pytest.raises(pinred.InputError, match="'push' cannot vary in these scenes"):
        pinred.simulate_many(system, duration=0.1, members={"push": np.zeros((3, 3))})
    with pytest.raises(pinred.InputError, match="no option 'speed'"):
        pinred.simulate_many(system, x0=np.zeros((2, 1)), speed=1.0)  # type: ignore[call-arg]
    with pytest.raises(pinred.InputError, match="not both"):
        pinred.simulate_many(system, seeds=[1], seed=2)


@pytest.mark.by_hand
@pytest.mark.parametrize("method", ["DOP853", "AdaptiveGauss"])
def test_progress_is_fraction_of_members(method: str) -> None:
    """Progress grows for all methods, and its exceptions end the call."""
    system = pinred.load("satellite_two_arms")
    parts: list[float] = []
    options = {"seeds": range(400), "duration": 60.0, "method": getattr(pinred, method)()}
    pinred.simulate_many(system, progress=parts.append, threads=2, **options)
    assert len(parts) > 1
    assert 0.0 <= parts[0] < parts[-1] <= 1.0
    assert parts == sorted(parts)
    # The part is a number of members.
    np.testing.assert_allclose(np.mod(400 * np.array(parts) + 0.5, 1.0), 0.5, atol=1e-9)

    def enough(part: float) -> None:
        raise KeyboardInterrupt(part)

    with pytest.raises(KeyboardInterrupt):
        pinred.simulate_many(system, progress=enough, **options)


def test_invalid_progress_is_rejected() -> None:
    """A value that is no function is rejected before the integration."""
    with pytest.raises(pinred.InputError, match="progress must be True or a function"):
        pinred.simulate_many(pinred.load("falling_cat"), seeds=[0], progress="bar")  # type: ignore[arg-type]


def test_members_that_end_before_all_report_times_are_nan() -> None:
    """Elroy's beanie moves at constant rate, so a terminal event at 0.3 rad comes at 0.3 / rate."""
    members = {"xdot0": np.array([[1.0], [0.1]])}
    stop = pinred.Event("x[0] - 0.3", "stop", terminal=True)
    many = pinred.simulate_many(
        pinred.load("elroys_beanie"),
        members=members, x0=[0.0], duration=1.0, times=[0.6], events=[stop],
    )  # fmt: skip
    assert many.failures == ()
    assert np.isnan(many.x[0]).all()
    np.testing.assert_allclose(many.x[1], [[0.06]], rtol=1e-12)
    assert many[0].ended_by == "stop"
