"""Conditions on time: the times at which they change, and the forces between these times."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred import InputError, Parameter
from pinred.forces import Torque
from pinred.forces.force_model import ForceModel
from pinred.forces.force_numbers import ForceInputs

Function = Callable[[ca.SX], Any]


def model_of(function: Function) -> ForceModel:
    """Return the model of a torque that is a function of time."""
    system = pinred.load("falling_cat")
    return ForceModel(system, [Torque(lambda s: {"bend": function(s.t)})], {})


def breaks(function: Function, end: float = 2.0) -> Any:
    """Return the times at which a torque is not smooth."""
    return model_of(function).breaks(end)


def test_pulse_breaks_are_its_ends_exactly() -> None:
    """The ends of a pulse are solved without round-off."""
    ends = breaks(lambda t: ca.if_else(t > 0.3, ca.if_else(t < 0.7, 6, 0), 0))
    assert ends.tolist() == [0.3, 0.7]


def test_conditions_outside_of_the_run_are_left_out() -> None:
    """Times before the start and after the end do not interrupt a run."""
    assert breaks(lambda t: ca.if_else(t > -1.0, 1, 0) + ca.sign(t - 3.0)).size == 0
    assert breaks(lambda t: ca.sin(t)).size == 0


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda t: ca.fabs(t - 0.4), [0.4]),
        (lambda t: ca.sign(t**2 - 0.25), [0.5]),
        (lambda t: ca.copysign(2.0, ca.cos(t)), [np.pi / 2.0]),
        (lambda t: ca.fmax(ca.sin(t), ca.cos(t)), [np.pi / 4.0]),
        (lambda t: ca.fmin(t, 1.0 / (t + 0.5)), [(np.sqrt(17.0) - 1.0) / 4.0]),
        (lambda t: ca.floor(3.0 * t), np.arange(1.0, 6.0) / 3.0),
        (lambda t: ca.ceil(ca.exp(t)), np.log(np.arange(2.0, 8.0))),
        (lambda t: ca.fmod(t, 0.3), 0.3 * np.arange(1.0, 7.0)),
        (lambda t: ca.remainder(t, 0.5), [0.25, 0.75, 1.25, 1.75]),
        (lambda t: ca.if_else(ca.fabs(t - 1.0) < 0.25, 1, 0), [0.75, 1.0, 1.25]),
        (lambda t: ca.if_else(ca.hypot(t, 1.0) > 1.5, 1, 0), [np.sqrt(1.25)]),
        (lambda t: ca.if_else(ca.log(t + 1e-3) > ca.sqrt(t) - 1.0, 1, 0), [1.0 - 2e-3]),
    ],
)
def test_breaks_equal_closed_forms(function: Function, expected: Any) -> None:
    """Each kind of condition changes where its closed form says."""
    if len(expected) == 1 and abs(expected[0] - 0.998) < 1e-12:
        root = breaks(function)  # ln(t + ε) = √t − 1 near t = 1
        assert np.abs(np.log(root + 1e-3) - np.sqrt(root) + 1.0).max() < 1e-14
        assert len(root) == 1
        return
    np.testing.assert_allclose(breaks(function), expected, rtol=0.0, atol=4e-15)


def test_pulse_width_modulation_has_two_breaks_in_each_period() -> None:
    """A condition on fmod changes with fmod, and once in between."""
    found = breaks(lambda t: ca.if_else(ca.fmod(t, 0.01) < 0.003, 1, -1))
    k = np.arange(200.0)
    expected = np.sort(np.concatenate([0.01 * k[1:], 0.01 * k + 0.003]))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14)


def test_nested_conditions_lose_no_break() -> None:
    """floor(7 |sin 3t|) changes at all whole values of 7 |sin 3t|, and has kinks at its zeros."""
    found = breaks(lambda t: ca.floor(7.0 * ca.fabs(ca.sin(3.0 * t))))
    fine = np.linspace(0.0, 2.0, 400_001)
    changes = np.flatnonzero(np.diff(np.floor(7.0 * np.abs(np.sin(3.0 * fine)))))
    for k in changes:
        assert ((found >= fine[k] - 1e-12) & (found <= fine[k + 1] + 1e-12)).any()
    # The kinks of |sin 3t| at π/3 are breaks; its peaks only touch the next whole number.
    assert len(found) == len(changes) + 1


def test_random_conditions_lose_no_sign_change() -> None:
    """Every sign change of a random argument on a fine grid has a break."""
    rng = np.random.default_rng(0)
    fine = np.linspace(0.0, 2.0, 20_001)
    counted = 0
    for _ in range(20):
        a, b, c, d = rng.uniform(-1.0, 1.0, 4)
        w = rng.uniform(1.0, 40.0)

        def g(t: Any, sin: Any, exp: Any, q: Any = (a, b, c, d, w)) -> Any:
            return q[0] * sin(q[4] * t) + q[1] * t * sin(9.0 * t + q[2]) + 0.3 * q[3] * exp(-t)

        found = breaks(lambda t, g=g: ca.if_else(g(t, ca.sin, ca.exp) > 0.0, 1, 0))  # type: ignore[misc]
        values = g(fine, np.sin, np.exp)
        changes = np.flatnonzero(values[1:] * values[:-1] < 0.0)
        counted += len(changes)
        for k in changes:
            assert ((found >= fine[k] - 1e-12) & (found <= fine[k + 1] + 1e-12)).any()
        assert np.abs(g(found, np.sin, np.exp)).max(initial=0.0) < 1e-12
    assert counted > 150


def test_equal_and_tangent_times_are_merged() -> None:
    """Two conditions at one time make one break; an argument that only touches zero makes none."""
    assert breaks(lambda t: ca.sign(t - 0.5) + ca.fabs(2.0 * t - 1.0)).tolist() == [0.5]
    touching = breaks(lambda t: ca.if_else((ca.sin(t) - 1.0) < 0.0, 1, 0))
    assert touching.size == 0
    crossing = breaks(lambda t: ca.sign((t - 0.7) ** 3 * ca.exp(t)))
    np.testing.assert_allclose(crossing, [0.7], atol=1e-5)


def test_argument_that_is_zero_for_a_while_has_no_breaks_there() -> None:
    """Only the times at which such an argument starts and ends to be zero are breaks."""
    found = breaks(lambda t: ca.sign(ca.fmax(t - 0.5, 0.0) * ca.fmin(t - 1.5, 0.0)))
    assert found.tolist() == [0.5, 1.5]


def test_undecidable_condition_is_refused() -> None:
    """An argument that is zero up to round-off has no times; too many times are an error, too."""
    with pytest.raises(InputError, match="cannot be decided"):
        breaks(lambda t: ca.sign((t + 1.0) ** 2 - t**2 - 2.0 * t - 1.0))
    with pytest.raises(InputError, match="times, more than 100000"):
        breaks(lambda t: ca.floor(1e6 * t))


def test_parameters_move_breaks() -> None:
    """Breaks follow the values of Parameters, with the derivatives of the closed form."""
    start, width = Parameter("start", 0.5), Parameter("width", 0.2)
    model = model_of(lambda t: ca.if_else(t > start, ca.if_else(t < start + 2 * width, 1, 0), 0))
    assert model.breaks(2.0).tolist() == [0.5, 0.9]
    moved = model.with_values({"start": 0.7})
    np.testing.assert_allclose(moved.breaks(2.0), [0.7, 1.1], rtol=0.0, atol=1e-15)
    slopes = moved.switching.slopes(np.append(moved.breaks(2.0), 2.0), moved.numbers)
    by_parameters = np.array([rows[0] @ moved.slopes for rows in slopes[:2]])
    assert [p.name for p in moved.parameters] == ["start", "width"]
    np.testing.assert_allclose(by_parameters, [[1.0, 0.0], [1.0, 2.0]], atol=1e-15)


@pytest.mark.parametrize(
    "function",
    [
        lambda t: ca.fabs(ca.sin(5.0 * t)) + ca.sign(t - 0.7) + ca.copysign(t, 1.0 - t),
        lambda t: ca.floor(3.0 * t) - ca.ceil(ca.sin(7.0 * t)) + ca.fmod(ca.sin(4.0 * t), 0.3),
        lambda t: ca.remainder(t, 0.3) + ca.fmax(ca.sin(t), ca.cos(3.0 * t)) * ca.fmin(t, 0.5),
        lambda t: ca.if_else(ca.logic_and(t > 0.4, ca.logic_not(t > 1.1)), 3, t) * (t != 0.9),
    ],
)
@pytest.mark.sampled
def test_forces_between_breaks_equal_the_written_ones(function: Function) -> None:
    """With conditions evaluated in the middle of a span, a force is the written one throughout."""
    model = model_of(function)
    system = pinred.load("falling_cat")
    t = ca.SX.sym("t")
    written = ca.Function("written", [t], [function(t)])
    ends = np.concatenate([[0.0], model.breaks(2.0), [2.0]])
    zeros, none = np.zeros(system.m), np.zeros(system.r)
    for start, stop in pairwise(ends.tolist()):
        numbers = model.numbers_from(start, 2.0)
        for time in start + (stop - start) * np.array([1e-6, 0.3, 0.9, 1.0 - 1e-6]):
            at = ForceInputs(time, zeros, zeros, none, none, numbers)
            expected = float(written(time))
            assert model.acting(at).torque[0] == pytest.approx(expected, rel=1e-13, abs=1e-13)
            assert model.acting_apart(at)[0][0] == pytest.approx(expected, abs=1e-15)
