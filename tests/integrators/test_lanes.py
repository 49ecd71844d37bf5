"""Runs in SIMD lanes are independent of each other and equal scalar runs."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.common.errors import InputError
from pinred.integrators.integrate import integrate
from pinred.integrators.integrate_many import STATUS, Solutions
from pinred.integrators.lanes.integrate_in_lanes import integrate_in_lanes
from pinred.integrators.methods import DOP853, Tsit5
from pinred.integrators.methods.method import Explicit
from pinred.kernels.machine.native import NativeCode, compile_object, load_object

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
    return integrate_in_lanes(method, address, lanes, params, y0, END, TIMES, 3, threads)


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
        one = integrate(method, kernel(1).address, params[k], y0[k], END, TIMES, 3)
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
    few = integrate_in_lanes(DOP853(max_steps=3), kernel(8).address, 8, params, y0, END, [], 3)
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
