"""Many simulations at once: the bits of one at a time, and failures that stay apart."""

from __future__ import annotations

import numpy as np
import pytest

import pinred
from pinred.simulation.state import State


def test_many_are_one_at_a_time() -> None:
    """Bit for bit the states of `simulate`, on any number of threads, momentum zero or not."""
    system = pinred.load("falling_cat")
    rng = np.random.default_rng(0)
    x0, xdot0 = rng.uniform(-0.5, 0.5, (12, 3)), rng.normal(size=(12, 3))
    momentum = rng.normal(size=(12, 6)) * 0.01
    momentum[::3] = 0.0
    times = np.linspace(0.0, 2.0, 7)
    for threads in (1, 3):
        many = pinred.simulate_many(
            system, x0=x0, xdot0=xdot0, momentum=momentum, threads=threads, times=times
        )
        assert len(many) == 12
        assert many.failures == ()
        for i in range(12):
            one = pinred.simulate(
                system, x0=x0[i], xdot0=xdot0[i], momentum=momentum[i], times=times
            )
            for field in State.__dataclass_fields__:
                np.testing.assert_array_equal(getattr(many[i], field), getattr(one, field))


def test_seeds() -> None:
    """A random state each."""
    system = pinred.load("planar_chain5")
    many = pinred.simulate_many(system, seeds=range(4), duration=1.0)
    one = pinred.simulate(system, seed=2, duration=1.0)
    np.testing.assert_array_equal(many[2].q, one.q)


def test_a_failure_stays_apart() -> None:
    """The member that runs away is named, with its time; the others are as without it."""
    system = pinred.load("coupled_planar")
    x0 = np.array([[0.0], [1.0], [0.0]])
    many = pinred.simulate_many(system, x0=x0, duration=100.0, springs={"hinge": (-1e6, 0.0)})
    assert [failure.member for failure in many.failures] == [1]
    assert 0.0 < many.failures[0].time < 100.0
    assert np.isfinite(many[0].q).all()
    assert np.isfinite(many[-1].q).all()
    with pytest.raises(pinred.IntegrationError, match=r"member 1 stopped at t = "):
        _ = many[1]


def test_one_that_only_translates() -> None:
    """Nothing to integrate is no trouble."""
    cart = pinred.load("cartpole", lock=["pole_pivot"])
    many = pinred.simulate_many(cart, xi0=np.array([[1.0], [2.0]]), duration=2.0)
    np.testing.assert_allclose(many[1].pose[-1], [4.0])


def test_bad_members() -> None:
    """Lengths that differ, or nothing that varies, are refused."""
    system = pinred.load("coupled_planar")
    with pytest.raises(pinred.ShapeError, match="x0: 2, xdot0: 3"):
        pinred.simulate_many(system, x0=np.zeros((2, 1)), xdot0=np.zeros((3, 1)))
    with pytest.raises(pinred.ShapeError, match="none"):
        pinred.simulate_many(system, x0=[0.0])
    with pytest.raises(pinred.InputError, match="no option 'speed'"):
        pinred.simulate_many(system, x0=np.zeros((2, 1)), speed=1.0)  # type: ignore[call-arg]
    with pytest.raises(pinred.InputError, match="not both"):
        pinred.simulate_many(system, seeds=[1], seed=2)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["DOP853", "AdaptiveGauss"])
def test_progress_counts_members(method: str) -> None:
    """The part that is done grows, whatever takes the steps; what it raises ends the call."""
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


def test_progress_that_cannot_be_told() -> None:
    """What is no function is refused before any work."""
    with pytest.raises(pinred.InputError, match="progress must be True or a function"):
        pinred.simulate_many(pinred.load("falling_cat"), seeds=[0], progress="bar")  # type: ignore[arg-type]
