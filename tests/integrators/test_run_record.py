"""The record of a run: its step ends, their states, and what a run writes between them."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from pinred.common.arrays import Array
from pinred.common.errors import TooManySteps
from pinred.common.machine_code import NativeCode, load_object
from pinred.integrators.integrate import integrate
from pinred.integrators.integrate_many import integrate_many
from pinred.integrators.methods import Tsit5
from pinred.integrators.stepping.run_state import TURN, first_step_by_rate, new_run
from pinred.kernels.machine.native import compile_object

OMEGA, GROWTH, END = np.array([3.0, -1.0, 2.0]), 0.3, 7.0
Y0 = np.array([0.2, 0.4, -0.2, 0.6, -0.1, 1.0])


@cache
def kernel() -> NativeCode:
    """Compile a clock, a quaternion that turns at a constant rate, and a growing number."""
    y, p = ca.SX.sym("y", 6), ca.SX.sym("p", 3)
    q = y[1:5]
    turn = 0.5 * ca.vertcat(q[3] * p + ca.cross(q[:3], p), -ca.dot(q[:3], p))
    function = ca.Function("rate", [y, p], [ca.vertcat(1.0, turn, GROWTH * y[5])])
    return load_object(compile_object(function, "rate"), "rate")


def exact(times: Array) -> Array:
    """Return the states at times, (T, 6), with unit quaternions."""
    first = pin.Quaternion(Y0[1:5] / np.linalg.norm(Y0[1:5]))
    turned = [(first * pin.Quaternion(pin.exp3(t * OMEGA))).coeffs() for t in times]
    return np.column_stack([Y0[0] + times, turned, Y0[5] * np.exp(GROWTH * times)])


def assert_exact(states: Array, times: Array) -> None:
    """Assert that states are those of the solution; a quaternion and its negative are equal."""
    expected = exact(times)
    sign = np.sign(np.einsum("ti,ti->t", states[:, 1:5], expected[:, 1:5]))
    expected[:, 1:5] *= sign[:, None]
    np.testing.assert_allclose(states, expected, rtol=0, atol=1e-7)


def test_record_holds_all_step_ends_and_reproduces_reports() -> None:
    """Some 300 steps, of which the arrays first hold 127; all states, against the closed form."""
    times = np.sort(np.append(np.random.default_rng(0).uniform(0.0, END, 40), [0.0, 0.0, END]))
    run = integrate(Tsit5(1e-10, 1e-11), kernel().address, OMEGA, Y0, END, times, (1, 1))
    knots = run.knots
    assert run.steps == len(knots) - 1 > 256
    assert (knots[0], knots[-1]) == (0.0, END)
    assert (np.diff(knots) > 0.0).all()
    np.testing.assert_array_equal(run.states[0], Y0)  # as given, not normalised
    ends = np.array(run.states)
    lengths = np.linalg.norm(ends[:, 1:5], axis=1)
    np.testing.assert_allclose(lengths[1:], 1.0, atol=1e-9)
    ends[:, 1:5] /= lengths[:, None]
    assert_exact(ends, knots)
    assert_exact(run.y, times)
    np.testing.assert_array_equal(run.at(times), run.y)
    np.testing.assert_array_equal(run.at(times[::-1]), run.y[::-1])
    np.testing.assert_allclose(run.at(knots), ends, rtol=0, atol=3e-16)
    middles = 0.5 * (knots[1:] + knots[:-1])
    assert_exact(run.at(middles), middles)
    # A run that reports at these times writes the same bits, with the same steps.
    both = np.sort(np.concatenate([knots, middles]))
    again = integrate(Tsit5(1e-10, 1e-11), kernel().address, OMEGA, Y0, END, both, (1, 1))
    np.testing.assert_array_equal(again.knots, knots)
    np.testing.assert_array_equal(again.y, run.at(both))
    # A batch keeps no record.
    many = integrate_many(
        Tsit5(1e-10, 1e-11), kernel().address, OMEGA[None], Y0[None], END, both, (1, 1), 1
    )
    np.testing.assert_array_equal(many.y[0], again.y)
    assert (many.steps[0], many.rejected[0], many.evaluations[0]) == (
        again.steps, again.rejected, again.evaluations,
    )  # fmt: skip


def test_trials_are_counted_up_to_the_limit() -> None:
    """A run may take as many trials as it needs, and not one more."""
    run = integrate(Tsit5(1e-8, 1e-9), kernel().address, OMEGA, Y0, END, [], (1, 1))
    most = run.steps + run.rejected
    fine = integrate(
        Tsit5(1e-8, 1e-9, max_steps=most), kernel().address, OMEGA, Y0, END, [], (1, 1)
    )
    np.testing.assert_array_equal(fine.knots, run.knots)
    with pytest.raises(TooManySteps, match=f"its limit of {most - 1} steps") as failure:
        integrate(
            Tsit5(1e-8, 1e-9, max_steps=most - 1), kernel().address, OMEGA, Y0, END, [], (1, 1)
        )
    assert failure.value.time == run.knots[-2]


@pytest.mark.parametrize(("lanes", "count"), [(1, 0), (4, 1)])
def test_first_step_changes_state_by_fraction_of_its_size(lanes: int, count: int) -> None:
    """The RMS of rates over atol/rtol + |y|, with a quaternion's entries of one common size."""
    rng = np.random.default_rng(2)
    rate = rng.normal(size=6 * lanes)
    numbers = {"n": 6, "rtol": 1e-4, "atol": 3e-5, "t_end": 50.0, "max_step": 40.0}
    sizes = 0.3 + np.abs(Y0)
    if count:
        sizes[1:5] = 0.3 + TURN
    expected = 0.01 / np.sqrt(np.mean((rate[::lanes] / sizes) ** 2))

    function: Any = first_step_by_rate
    compiled = function.numba_object

    def step(rates: Array, **more: float) -> float:
        run = new_run(**(numbers | {"quaternions_at": 1, "quaternion_count": count} | more))
        # Compiled functions take registers of one run only from each other.
        return float(compiled(run[0], Y0, rates, lanes, 0.01))

    assert step(rate) == pytest.approx(expected, rel=1e-14)
    assert step(rate, max_step=0.5 * expected) == 0.5 * expected
    assert step(rate, t_end=0.5 * expected) == 0.5 * expected
    assert step(np.zeros(6 * lanes)) == 40.0
