"""Runs in SIMD lanes are independent of each other and equal scalar runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from pinred.common.arrays import Array
from pinred.common.errors import InputError
from pinred.common.machine_code import NativeCode, load_object
from pinred.integrators.explicit.runge_kutta import Tableau
from pinred.integrators.integrate import integrate
from pinred.integrators.integrate_many import STATUS, Solutions, integrate_many
from pinred.integrators.lanes.integrate_in_lanes import integrate_in_lanes
from pinred.integrators.methods import DOP853, Tsit5
from pinred.integrators.methods.method import Explicit
from pinred.kernels.machine.native import compile_object

END, TIMES = 2.0, [0.0, 0.3, 0.3, 1.1, 2.0]
METHODS: tuple[Explicit, ...] = (DOP853(1e-9, 1e-11), Tsit5(1e-7, 1e-9))


@cache
def kernel(wide: int) -> NativeCode:
    """Compile sines of angles, a root that ends at t = p₀, a rotating quaternion, and a clock."""
    y, p = ca.SX.sym("y", 7), ca.SX.sym("p", 2)
    a, b, t, q = y[0], y[1], y[2], y[3:]
    w = ca.vertcat(ca.sin(a), p[1], ca.cos(b))
    turn = 0.5 * ca.vertcat(q[3] * w + ca.cross(q[:3], w), -ca.dot(q[:3], w))
    rate = ca.vertcat(ca.cos(a) * ca.sqrt(p[0] - t), ca.sin(3.0 * a + b), 1.0, turn)
    function = ca.Function("rate", [y, p], [rate], {"cse": True})
    wide_inputs = (0,) if wide == 1 else (0, 1)
    code = compile_object(function, "rate", wide=wide, wide_inputs=wide_inputs)
    return load_object(code, "rate")


def members(count: int) -> tuple[Array, Array]:
    """Return parameters and states; one angle is 1e7 rad, and one run becomes non-finite."""
    rng = np.random.default_rng(4)
    y0 = np.concatenate([rng.normal(size=(count, 2)), np.zeros((count, 5))], axis=1)
    y0[:, 3:] = rng.normal(size=(count, 4))
    params = np.column_stack([rng.uniform(5.0, 9.0, count), rng.normal(size=count)])
    y0[5, 0], params[2, 0] = 1e7, 0.5
    return params, y0


def run(method: Explicit, params: Array, y0: Array, threads: int = 1, lanes: int = 8) -> Solutions:
    """Run the members in SIMD lanes."""
    address = kernel(lanes).address
    return integrate_in_lanes(method, address, lanes, params, y0, END, TIMES, (3, 1), threads)


def assert_same(a: Solutions, rows: Any, b: Solutions) -> None:
    """Assert that some members of b equal those of a in every bit."""
    for name in ("y", "status", "end", "entry", "steps", "rejected", "evaluations"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name)[rows])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_member_is_independent_of_the_others(method: Explicit) -> None:
    """A member alone, in another order or on several threads has the same bits."""
    params, y0 = members(37)
    batch = run(method, params, y0)
    assert [STATUS[k] for k in batch.status.tolist()] == [
        "not finite" if k == 2 else "done" for k in range(37)
    ]
    assert abs(batch.end[2] - 0.5) < 1e-6
    assert batch.entry[2] == 0
    for k in (0, 2, 5, 30):
        assert_same(run(method, params[k : k + 1], y0[k : k + 1]), [k], batch)
    order = np.random.default_rng(0).permutation(37)
    assert_same(run(method, params[order], y0[order], threads=3), order, batch)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "lanes"),
    [(METHODS[0], 8), (METHODS[1], 8), pytest.param(METHODS[0], 16, marks=pytest.mark.by_hand)],
)
def test_lanes_equal_scalar_runs(method: Explicit, lanes: int) -> None:
    """Steps, trials and evaluations are equal, and states up to round-off."""
    params, y0 = members(21)
    in_lanes = run(method, params, y0, lanes=lanes)
    for k in set(range(21)) - {2}:
        one = integrate(method, kernel(1).address, params[k], y0[k], END, TIMES, (3, 1))
        np.testing.assert_allclose(in_lanes.y[k], one.y, rtol=0.0, atol=1e-12 * abs(y0[k]).max())
        counts = (in_lanes.steps[k], in_lanes.rejected[k], in_lanes.evaluations[k])
        assert counts == (one.steps, one.rejected, one.evaluations)
        norms = np.linalg.norm(in_lanes.y[k][:, 3:], axis=1)
        np.testing.assert_allclose(norms, 1.0, atol=4e-16)
    # What the failed one has reached is there, what it has not is nothing.
    assert np.isfinite(in_lanes.y[2, :3]).all()
    assert np.isnan(in_lanes.y[2, 3:]).all()


@pytest.mark.slow
def test_lanes_handle_limits_and_edge_cases() -> None:
    """Step limits, initially non-finite rates, no members, no times, and invalid widths."""
    method = METHODS[0]
    params, y0 = members(9)
    params[4] = np.nan
    few = integrate_in_lanes(DOP853(max_steps=3), kernel(8).address, 8, params, y0, END, [], (3, 1))
    assert [STATUS[k] for k in few.status.tolist()] == [
        "not finite" if k == 4 else "too many steps" for k in range(9)
    ]
    assert ((few.steps + few.rejected)[few.status != few.status[4]] == 3).all()
    assert few.entry[4] == 0
    assert few.evaluations[4] == 1
    assert few.y.shape == (9, 0, 7)
    assert run(method, params[:0], y0[:0]).ok.all()
    with pytest.raises(InputError, match="width must be one of"):
        run(method, params, y0, lanes=4)


@dataclass(frozen=True)
class Kutta(Explicit):
    """Kutta's method of order 3, with a stage and a term of its dense output: quick to compile."""

    about: ClassVar[str] = "a test"
    order: ClassVar[int] = 3
    dense_order: ClassVar[int] = 3

    @classmethod
    def tableau(cls) -> Tableau:
        """Return the coefficients."""
        return _tableau()


@cache
def _tableau() -> Tableau:
    A = np.zeros((5, 5))
    A[1, 0] = 0.5
    A[2, :2] = -1.0, 2.0
    A[3, :3] = np.array([1.0, 4.0, 1.0]) / 6.0
    A[4, [0, 2, 3]] = 0.3, 0.2, -0.1
    errors = np.array([[1.0, -2.0, 1.0, 0.0]]) / 6.0
    return Tableau(A, errors, np.array([[0.2, -0.1, 0.3, 0.1, -0.5]]))


@cache
def jump_kernel(wide: int) -> NativeCode:
    """Compile `kernel` with a jump of the first rate by p₂ at t = 0.7."""
    y, p = ca.SX.sym("y", 7), ca.SX.sym("p", 3)
    a, b, t, q = y[0], y[1], y[2], y[3:]
    w = ca.vertcat(ca.sin(a), p[1], ca.cos(b))
    turn = 0.5 * ca.vertcat(q[3] * w + ca.cross(q[:3], w), -ca.dot(q[:3], w))
    first = ca.cos(a) * ca.sqrt(p[0] - t) + p[2] * (t > 0.7)
    function = ca.Function("rate", [y, p], [ca.vertcat(first, ca.sin(3.0 * a + b), 1.0, turn)])
    wide_inputs = (0,) if wide == 1 else (0, 1)
    return load_object(compile_object(function, "rate", wide=wide, wide_inputs=wide_inputs), "rate")


def mixed_members(count: int) -> tuple[Array, Array, Array, Array]:
    """Return parameters, states, ends and report times; three of the members fail.

    Member 1 becomes non-finite on its way, member 5 at the start; member 9 meets a jump that no
    step passes.
    """
    params, y0 = members(count)
    params = np.column_stack([params, np.zeros(count)])
    y0[5, 0], params[2, 0] = 0.3, 6.0
    params[1, 0], params[5, 0], params[9, 2] = 0.9, np.nan, 1e16
    rng = np.random.default_rng(8)
    ends = rng.uniform(1.0, 2.0, count)
    times = np.sort(rng.uniform(0.0, 1.0, (count, 7)), axis=1) * ends[:, None]
    times[:, :2], times[:, -2:] = 0.0, ends[:, None]
    times[::3, -1] = np.inf
    times[::4, 3] = times[::4, 2]
    return params, y0, ends, times


QUICK = Kutta(1e-5, 1e-7)


@pytest.mark.by_hand
@pytest.mark.parametrize("method", [QUICK, Kutta(1e-5, 1e-7, max_steps=60, max_step=0.02)], ids=str)
def test_lanes_equal_scalar_batch_with_separate_ends_and_failures(method: Kutta) -> None:
    """States, outcomes and counts of all members, of which three fail, each in another way."""
    params, y0, ends, times = mixed_members(19)
    expected = integrate_many(method, jump_kernel(1).address, params, y0, ends, times, (3, 1), 1)
    found = integrate_in_lanes(
        method, jump_kernel(8).address, 8, params, y0, ends, times, (3, 1), 1
    )
    words = [STATUS[k] for k in expected.status.tolist()]
    assert words[5] == "not finite"
    if method.max_steps > 60:
        assert [words[k] for k in (1, 9)] == ["not finite", "step size underflow"]
        assert expected.entry[[1, 5]].tolist() == [0, 0]
        assert words.count("done") == 16
        assert expected.rejected.sum() > 20
    else:
        assert 2 < words.count("too many steps") < 18
    for name in ("status", "entry", "steps", "rejected", "evaluations"):
        # Round-off decides how many steps approach a singularity.
        rows = np.arange(19) != 1 if name in ("steps", "rejected", "evaluations") else slice(None)
        counts = [getattr(each, name)[rows] for each in (found, expected)]
        np.testing.assert_array_equal(counts[0], counts[1], err_msg=name)
    np.testing.assert_allclose(found.end, expected.end, rtol=1e-9)
    np.testing.assert_array_equal(np.isnan(found.y), np.isnan(expected.y))
    np.testing.assert_allclose(found.y, expected.y, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(found.times, times)


def test_lanes_follow_constant_rotation_at_all_report_times() -> None:
    """Both angles are at rest, so the body rotates about (1, p₁, 0) at a constant rate."""
    count = 11
    params, y0, ends, _ = mixed_members(count)
    params[:, 0], params[:, 2], y0[:, :2] = 4.0, 0.0, np.pi / 2.0
    params[:, 1] = np.linspace(-2.0, 2.0, count)
    times = np.linspace(0.0, 1.0, 23)[None] * ends[:, None]
    found = integrate_in_lanes(
        Tsit5(1e-9, 1e-11), jump_kernel(8).address, 8, params, y0, ends, times, (3, 1), 2
    )
    np.testing.assert_allclose(found.y[..., 2], times, atol=1e-13)
    for member in range(count):
        first = pin.Quaternion(y0[member, 3:] / np.linalg.norm(y0[member, 3:]))
        for time, y in zip(times[member], found.y[member], strict=True):
            turn = pin.Quaternion(pin.exp3(time * np.array([1.0, params[member, 1], 0.0])))
            q = (first * turn).coeffs()
            np.testing.assert_allclose(np.sign(q @ y[3:]) * y[3:], q, atol=1e-8)
