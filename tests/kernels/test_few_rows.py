"""Steps with few work rows have the bits of steps in which each rate has a row of its own."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from stiff_kernels import kernel

from pinred.common.errors import NonFiniteState
from pinred.integrators.integrate import Solution as Run
from pinred.integrators.integrate import integrate
from pinred.integrators.integrate_many import integrate_many
from pinred.integrators.methods import DOP853, Explicit, Tsit5
from pinred.integrators.methods.method import stepper_of
from pinred.kernels.device.few_rows import Rows, stepper_with_few_rows

METHODS = [DOP853, Tsit5]


@kernel
def spreading(y: Any, p: Any, d: Any) -> None:
    """A clock, and a rate that is no number after half a second, which spreads to the others."""
    d[0], d[1], d[2], d[3] = 1.0 + p[0] * y[3], p[0] * y[1], ca.sqrt(0.5 - y[0]), y[2]


@kernel
def spring(y: Any, p: Any, d: Any) -> None:
    """A spring that hardens, five numbers so that rows are padded."""
    d[0], d[1], d[2] = y[1], -p[0] * y[0] - y[0] ** 3, ca.cos(y[0])
    d[3], d[4] = ca.sin(y[2]), y[3] * y[1]


def _with_few_rows(monkeypatch: pytest.MonkeyPatch, kind: type[Explicit]) -> None:
    monkeypatch.setattr(kind, "_stepper", stepper_with_few_rows)


def _solve(kind: type[Explicit], seed: int) -> Run:
    """Return a run with many report times inside steps, and with rejected steps."""
    rng = np.random.default_rng(seed)
    params, y0 = rng.uniform(1.0, 1e4, 1), rng.normal(size=5)
    times = np.linspace(0.0, 1.0, 301)
    return integrate(kind(rtol=1e-7, atol=1e-9), spring, params, y0, 1.0, times)


@pytest.mark.by_hand("Tsit5")
@pytest.mark.parametrize("kind", METHODS)
def test_few_rows_change_no_bit(kind: type[Explicit], monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows that are shared are dead when they are overwritten."""
    expected = [_solve(kind, seed) for seed in range(8)]
    assert max(run.rejected for run in expected) > 0
    _with_few_rows(monkeypatch, kind)
    for seed, one in enumerate(expected):
        found = _solve(kind, seed)
        assert np.array_equal(found.y, one.y)
        assert (found.steps, found.rejected) == (one.steps, one.rejected)
        assert found.evaluations == one.evaluations


@kernel
def spring_with_tangent(y: Any, p: Any, d: Any) -> None:
    """The spring, and its derivative along directions of the state and of the parameter."""
    spring_rates = y[1], -p[0] * y[0] - y[0] ** 3, ca.cos(y[0]), ca.sin(y[2]), y[3] * y[1]
    for i in range(5):
        d[i] = spring_rates[i]
    u = y[5:10]
    d[5], d[6] = u[1], -p[0] * u[0] - p[1] * y[0] - 3.0 * y[0] ** 2 * u[0]
    d[7], d[8], d[9] = -ca.sin(y[0]) * u[0], ca.cos(y[2]) * u[2], u[3] * y[1] + y[3] * u[1]


@pytest.mark.parametrize("kind", [DOP853])
def test_tangent_follows_the_steps_of_the_state(kind: type[Explicit]) -> None:
    """A large tangent changes no step, and is the derivative of the states at all times."""
    rng, times = np.random.default_rng(3), np.linspace(0.0, 1.0, 41)
    params, y0, along, force = rng.uniform(1.0, 1e3), rng.normal(size=5), rng.normal(size=5), 2e2
    method = kind(rtol=1e-9, atol=1e-11)

    def states(s: float) -> Run:
        return integrate(method, spring, [params + s * force], y0 + s * along, 1.0, times)

    one = states(0.0)
    slopes = 8.0 * (states(1e-4).y - states(-1e-4).y) - (states(2e-4).y - states(-2e-4).y)
    stepper = stepper_with_few_rows(method, tangent=True)
    for size in (1.0, 1e6):
        start = np.concatenate([y0, size * along])
        both = integrate_many(
            method, spring_with_tangent, [[params, size * force]], [start], 1.0, times,
            stepper=stepper,
        )  # fmt: skip
        assert (both.steps[0], both.rejected[0]) == (one.steps, one.rejected)
        np.testing.assert_allclose(both.y[0, :, :5], one.y, rtol=0, atol=1e-13)
        tangents = both.y[0, :, 5:] / size
        np.testing.assert_allclose(tangents, slopes / 12e-4, rtol=1e-7, atol=1e-5)


def _failure(kind: type[Explicit], start: float) -> tuple[int, float]:
    """Return entry and time of a failure."""
    with pytest.raises(NonFiniteState) as caught:
        integrate(kind(rtol=1e-6, atol=1e-8), spreading, [1.0], [start, 0.0, 0.0, 0.0], 3.0, [])
    assert caught.value.entry is not None
    return caught.value.entry, caught.value.time


@pytest.mark.parametrize("kind", METHODS)
def test_first_entry_that_is_not_finite_is_found_in_overwritten_rows(
    kind: type[Explicit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Later stages have such numbers in other entries, too."""
    starts = np.linspace(-0.5, 0.2, 30).tolist()
    expected = [_failure(kind, start) for start in starts]
    assert {entry for entry, _ in expected} == {2}
    _with_few_rows(monkeypatch, kind)
    assert [_failure(kind, start) for start in starts] == expected


@pytest.mark.parametrize(("kind", "rows", "fewer"), [(DOP853, 28, 19), (Tsit5, 16, 14)])
def test_rows_are_few(kind: type[Explicit], rows: int, fewer: int) -> None:
    """A step without dense output touches those before the first term of dense output."""
    assert len(stepper_of(kind()).work(6)) == rows
    assert len(stepper_with_few_rows(kind()).work(6)) == fewer
    assert Rows.of(kind.tableau()).first <= 12
