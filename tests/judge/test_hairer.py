"""Hairer's codes: accuracy, evaluations at times near and far apart, errors, the smallest rates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import ode

from pinred.common.arrays import Array
from pinred.judge.hairer import Hairer


class Swing:
    """An oscillator of 1 rad/s, whose rate counts its calls."""

    calls = 0

    def __call__(self, _: float, y: Array) -> Array:
        """Return the rate of (x, ẋ)."""
        self.calls += 1
        return np.array([y[1], -y[0]])


def swing(method: str, times: Array, rate: Swing | None = None) -> Array:
    """Return the first entry at the times, from 1 at rest."""
    solver = Hairer(rate or Swing(), method, np.array([1.0, 0.0]), 0.0, 1e-12, 1e-14, 1e6)
    found = [solver.integrate(float(t)) for t in times]
    return np.array([y[0] for y in found if y is not None])


@pytest.mark.parametrize(("method", "stages"), [("dop853", 12), ("dopri5", 6)])
def test_near_times_take_one_step_each(method: str, stages: int) -> None:
    """Two evaluations in three are spared: the loop's own first steps are ten times too short."""
    rate, times = Swing(), np.linspace(0.005, 1.0, 200)
    np.testing.assert_allclose(swing(method, times, rate), np.cos(times), atol=1e-12)
    assert rate.calls <= 1.1 * (stages + 1) * len(times)


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_spans_of_all_lengths(method: str) -> None:
    """What is learned from short spans does not spoil long ones, nor the other way round."""
    spans = np.random.default_rng(5).choice([1e-9, 1e-3, 0.3, 20.0], 60)
    times = np.cumsum(spans)
    np.testing.assert_allclose(swing(method, times), np.cos(times), atol=3e-10)
    rate, near = Swing(), np.linspace(1e-3, 1.5, 1500)
    late = np.append(near, near[-1] + 20.0)  # a step may have become long, but never endless
    np.testing.assert_allclose(swing(method, late, rate)[-1], np.cos(late[-1]), atol=3e-11)


def test_a_far_time_takes_no_more_than_before() -> None:
    """Equal steps over a span are no shorter than those that the loop finds by itself."""
    alone, told = Swing(), Swing()
    swing("dop853", np.array([200.0]), alone)
    swing("dop853", np.linspace(2.0, 200.0, 100), told)
    assert told.calls <= 1.25 * alone.calls


METHODS = ["dop853", "dopri5"]


@pytest.mark.parametrize("method", METHODS)
def test_the_first_span_is_that_of_the_loop_alone(method: str) -> None:
    """Nothing has been learned yet: the same evaluations, and the same numbers to the last bit."""
    alone, told = Swing(), Swing()
    loop = ode(alone).set_integrator(method, rtol=1e-12, atol=1e-14, nsteps=10_000)
    loop.set_solout(lambda *_: 0)  # without one, calls are sometimes more
    loop.set_initial_value(np.array([1.0, 0.0]), 0.0)
    assert swing(method, np.array([7.0]), told)[0] == loop.integrate(7.0)[0]
    assert told.calls == alone.calls


@pytest.mark.parametrize("method", METHODS)
def test_an_error_comes_out(method: str) -> None:
    """Whatever it is, and nothing is asked for after it."""
    calls = []

    def rate(t: float, y: Array) -> Array:
        calls.append(t)
        if len(calls) > 30:
            raise LookupError("here")
        return -y

    solver = Hairer(rate, method, np.ones(1), 0.0, 1e-10, 1e-12, 9.0)
    with pytest.raises(LookupError, match="here"):
        solver.integrate(9.0)
    assert len(calls) == 31
    assert 0.0 < solver.t < 1.0  # the loop ends with the step


@pytest.mark.parametrize("method", METHODS)
def test_what_cannot_be_followed(method: str) -> None:
    """A pole: y = 1/(1 − t) ends at 1: there is no state beyond, and no warning."""
    solver = Hairer(lambda _, y: y**2, method, np.ones(1), 0.0, 1e-8, 1e-10, 2.0)
    half = solver.integrate(0.5)
    assert half == pytest.approx(2.0, rel=1e-6)
    assert solver.integrate(2.0) is None


@pytest.mark.parametrize("begin", [0.0, 10.0])
@pytest.mark.parametrize("time", [0.03, 1.0, 100.0])
@pytest.mark.parametrize("method", METHODS)
def test_the_smallest_rates(method: str, time: float, begin: float) -> None:
    """Those that would come to less than 1e-120 by the end, or within 1 s, count as none."""
    for part, moves in ((0.3, False), (3.0, True)):
        rate, end = part * 1e-120 / max(time, 1.0), begin + time

        def steady(_: float, y: Array, rate: float = rate) -> Array:
            return rate + 0.0 * y

        solver = Hairer(steady, method, np.zeros(1), begin, 1e-8, 1e-16, end)
        y = solver.integrate(end)
        assert y is not None
        assert y[0] == pytest.approx(rate * time if moves else 0.0, rel=1e-9, abs=0.0)
