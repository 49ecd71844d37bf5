"""Hairer's integrators by themselves: accuracy and evaluations, at times near and far apart."""

from __future__ import annotations

import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.verification.hairer import Hairer


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
