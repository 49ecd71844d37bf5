"""Dense output of Hairer's dop853: accuracy within steps, number of evaluations, recorded steps."""

from __future__ import annotations

import numpy as np
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.judge.reference_integrators import Hairer
from pinred.judge.reference_solution import FINEST, FullState

END = 20.0


class Oscillator:
    """An oscillator of 1 rad/s, a tenth of whose rates depends on time; it records the times."""

    def __init__(self) -> None:
        """Start recording."""
        self.times: list[float] = []

    def __call__(self, t: float, y: Array) -> Array:
        """Return the rate of (x, ẋ)."""
        self.times.append(t)
        return np.array([y[1], -y[0]]) + 0.1 * np.array([-np.sin(t) - y[1], y[0] - np.cos(t)])


def solver(rate: Oscillator, rtol: float) -> Hairer:
    """Return an initial value problem of an oscillation that starts at 1."""
    return Hairer(rate, "dop853", np.array([1.0, 0.0]), 0.0, rtol, 1e-2 * rtol, END)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12, FINEST[0]])
def test_dense_output_is_as_accurate_as_steps(rtol: float) -> None:
    """Errors within steps are at most four times those of the steps' ends."""
    problem, times = solver(Oscillator(), rtol), np.linspace(0.03, END, 400)
    end = problem.integrate(END, times.tolist())
    dense = problem.dense()
    assert end is not None
    assert dense is not None
    exact = np.array([np.cos(times), -np.sin(times)]).T
    at_ends = dense(dense.ends) - np.array([np.cos(dense.ends), -np.sin(dense.ends)]).T
    assert np.abs(dense(times) - exact).max() < 4.0 * np.abs(at_ends).max() + 1e-15
    assert np.abs(dense(times) - exact).max() < 4.0 * rtol + 1e-15
    np.testing.assert_allclose(dense(np.array([END]))[0], end, rtol=0.0, atol=1e-15)


def test_dense_output_costs_three_evaluations_a_step() -> None:
    """They are made only in steps with targets; the steps are those of a run without targets."""
    alone, dense = Oscillator(), Oscillator()
    solver(alone, 1e-10).integrate(END)
    problem = solver(dense, 1e-10)
    problem.integrate(END, [3.0, 3.001, 15.0, END])
    assert dense.times == alone.times
    steps = problem.dense()
    assert steps is not None
    assert len(steps.starts) == 3
    for target, a, b in zip([3.0, 15.0, END], steps.starts, steps.ends, strict=True):
        assert a < target <= b
    assert len(dense.times) == len(alone.times) + 9


def test_dense_output_covers_the_last_span_only() -> None:
    """Targets at the start of a span belong to the span before it."""
    problem = solver(Oscillator(), 1e-10)
    assert problem.dense() is None
    problem.integrate(1.0, [0.3])
    problem.integrate(END, [1.0, 2.0])
    dense = problem.dense()
    assert dense is not None
    assert (dense.starts >= 1.0).all()
    np.testing.assert_allclose(dense(np.array([2.0]))[0, 0], np.cos(2.0), atol=1e-10)
    problem.integrate(END + 1.0)
    assert problem.dense() is None


def test_run_at_many_times_costs_little_more_than_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without dense output, 1000 times cost at least 12 000 evaluations."""
    scene = pinred.simulate(pinred.load("falling_cat"), duration=2.0).scene
    calls, rate = [], FullState.rate

    def counted(full: FullState, t: float, y: Array) -> Array:
        calls.append(t)
        return rate(full, t, y)

    monkeypatch.setattr(FullState, "rate", counted)
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    end = full.run(y0, np.array([2.0]), 1e-10, 1e-12)
    alone = len(calls)
    motion = full.run(y0, np.linspace(0.0, 2.0, 1001), 1e-10, 1e-12)
    assert len(calls) - alone < 1.3 * alone
    np.testing.assert_allclose(motion.q[-1], end.q[-1], rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(motion.x[0], start.x)
