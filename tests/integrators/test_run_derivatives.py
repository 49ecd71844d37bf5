"""Derivatives of runs with fixed steps, against CasADi and NumPy on the equations of the steps."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import legendre

from pinred.common.arrays import Array, read_only
from pinred.common.errors import InputError, NoConvergence
from pinred.common.machine_code import NativeCode, load_object
from pinred.integrators.integrate import Integration, Solution, integrate
from pinred.integrators.methods import DOP853, RKMK4, AdaptiveGauss, Gauss
from pinred.integrators.methods.method import Explicit
from pinred.integrators.run_derivatives import (
    SmoothField,
    refuse_without_derivatives,
    run_along,
    run_back,
)
from pinred.integrators.stepping.intrinsics import SEEDS
from pinred.kernels.machine.native import compile_object

N, P = 7, 3  # entries of the state, and parameters
QUATERNIONS = (1, 1)  # index of the first entry, and number
END = 0.9
Y0 = np.array([0.4, 0.3, -0.5, 0.2, 0.9, -0.8, 1.1])
PARAMS = read_only(np.array([0.7, -0.4, 1.3]))  # code is shipped for read-only inputs


@cache
def rate() -> ca.Function:
    """Return a vector field with a rotating quaternion; all entries depend on each other."""
    y, p = ca.SX.sym("y", N), ca.SX.sym("p", P)
    a, q, b, c = y[0], y[1:5], y[5], y[6]
    unit = q / ca.sqrt(ca.sumsqr(q))  # kernels use only the direction of the quaternion
    w = ca.vertcat(ca.sin(a) + p[1], b * unit[0], p[2] * ca.cos(c))
    turn = 0.5 * ca.vertcat(q[3] * w + ca.cross(q[:3], w), -ca.dot(q[:3], w))
    rates = ca.vertcat(p[0] * b * c, turn, ca.sin(a + 2.0 * unit[3]) - 0.3 * b, p[1] * a * unit[2])
    return ca.Function("rate", [y, p], [rates], {"cse": True})


@cache
def code(kind: str, lanes: int) -> NativeCode:
    """Compile the vector field, its derivative or its adjoint for several states at once."""
    y, p = ca.SX.sym("y", N), ca.SX.sym("p", P)
    v, w, out = ca.SX.sym("v", N), ca.SX.sym("w", P), rate()(y, p)
    inputs, wide, result = {
        "rate": ([y, p], (0,), out),
        # Many directions of one state, or many states with one direction each.
        "tangent": ([y, p, v, w], (2, 3), ca.jtimes(out, y, v) + ca.jtimes(out, p, w)),
        "tangents": ([y, p, v, w], (0, 2), ca.jtimes(out, y, v) + ca.jtimes(out, p, w)),
        "pair": (
            [y, p, v, w], (), ca.vertcat(out, ca.jtimes(out, y, v) + ca.jtimes(out, p, w))
        ),
        "adjoint": (
            [y, p, v], (0, 2), ca.vertcat(ca.jtimes(out, y, v, True), ca.jtimes(out, p, v, True))
        ),
    }[kind]  # fmt: skip
    function = ca.Function(kind, inputs, [ca.densify(result)], {"cse": True})
    wide_inputs = () if lanes == 1 else wide
    return load_object(compile_object(function, kind, wide=lanes, wide_inputs=wide_inputs), kind)


def field_of(method: Any) -> SmoothField:
    """Return the vector field with its derivatives, as a method takes them."""
    return SmoothField(
        address=code("rate", method.lanes).address,
        quaternions=QUATERNIONS,
        tangent=lambda: code("tangent", SEEDS).address,
        pair=lambda: code("pair", 1).address,
        adjoint=lambda: code("adjoint", 1).address,
        tangents=lambda lanes: code("tangents", lanes).address,
        adjoints=lambda lanes: code("adjoint", lanes).address,
    )


METHODS: tuple[Any, ...] = (
    DOP853(1e-6, 1e-6, max_step=0.25),
    Gauss(0.3, order=6),
    AdaptiveGauss(1e-11, 1e-13, max_step=0.25),
)
# Before the first step end, twice inside a step, at an end and after it, and at the end.
FRACTIONS = [0.0, 0.0, 0.07, 0.4, 0.4, 0.55, 1.0, 1.0]


def run_of(method: Any, *, stages: bool, inner: bool = True) -> Solution:
    """Return a run of some steps whose report times include step ends."""
    address = code("rate", method.lanes).address
    knots = integrate(method, address, PARAMS, Y0, END, [], QUATERNIONS).knots
    times = np.sort(np.concatenate([END * np.array(FRACTIONS), knots[1:3]])) if inner else knots
    read_only(times)
    solution = Integration(method, address, N, END, times, QUATERNIONS)(PARAMS, Y0, stages=stages)
    np.testing.assert_array_equal(solution.knots, knots)
    assert len(knots) >= 4
    assert (solution.stored.shape[1] > N) == stages
    return solution


def unit(y: Any) -> Any:
    """Normalise the quaternion of a CasADi state."""
    return ca.vertcat(y[:1], y[1:5] / ca.sqrt(ca.sumsqr(y[1:5])), y[5:])


def explicit_states(solution: Solution, y: ca.SX, p: ca.SX) -> list[ca.SX]:
    """Return the normalised states at all report times and the last step end, from y."""
    tableau, f = DOP853.tableau(), rate()
    weights, last = tableau.A[tableau.stages], tableau.stages
    knots, reports = solution.knots, []
    y = unit(y)
    for k, (start, end) in enumerate(pairwise(knots)):
        h, K = end - start, ca.SX(N, 0)
        for row in tableau.A:
            K = ca.horzcat(K, f(y + h * K @ row[: K.shape[1]], p))
        difference = K @ weights
        F = [difference, K[:, 0] - difference, 2.0 * difference - K[:, 0] - K[:, last]]
        F += [K @ row for row in tableau.dense]
        for time in solution.times:
            if start < time < end or (time == start and k == 0):
                x = (time - start) / h
                inner = ca.SX(N, 1)
                for i, term in reversed(list(enumerate(F))):  # F₀ + y (F₁ + x (F₂ + y (…)))
                    inner = term + (x if i % 2 else 1.0 - x) * inner
                reports.append(unit(y + h * x * inner))
            elif time == end:
                reports.append(unit(y + h * difference))
        y = unit(y + h * difference)
    return [*reports, y]


def explicit_derivatives(solution: Solution) -> tuple[Array, Array, Array]:
    """Return the states (T + 1, n), and their derivatives by y0 and by the parameters."""
    y, p = ca.SX.sym("y", N), ca.SX.sym("p", P)
    states = ca.vertcat(*explicit_states(solution, y, p))
    jacobians = [ca.densify(ca.jacobian(states, v)) for v in (y, p)]
    values = ca.Function("states", [y, p], [states, *jacobians])(Y0, PARAMS)
    out, by_y, by_p = (np.array(value).reshape(-1, N, value.shape[1]) for value in values)
    return out[..., 0], by_y, by_p


@cache
def _slopes() -> tuple[ca.Function, ca.Function]:
    y, p = ca.SX.sym("y", N), ca.SX.sym("p", P)
    normal = ca.Function("unit", [y], [unit(y), ca.densify(ca.jacobian(unit(y), y))])
    out = rate()(y, p)
    J, Jp = (ca.densify(ca.jacobian(out, v)) for v in (y, p))
    return ca.Function("slopes", [y, p], [out, J, Jp]), normal


def gauss_step(y: Array, D: Array, h: float, stages: int) -> tuple[Array, Array]:
    """Return the end of a Gauss step and its derivatives: Newton's method on all stages.

    D: derivatives of y, (n, n + p), of which the last p columns are by the parameters.
    """
    x, weights = legendre.leggauss(stages)
    c, b = 0.5 * (x + 1.0), 0.5 * weights
    # Collocation: the rows of A integrate all polynomials of degree < s exactly up to c.
    powers = np.arange(stages)
    A = (c[:, None] ** (powers + 1) / (powers + 1)) @ np.linalg.inv(c[:, None] ** powers)
    Y = np.tile(y, (stages, 1))
    for _ in range(30):
        values = [[np.array(v) for v in _slopes()[0](row, PARAMS)] for row in Y]
        f = np.array([value[0][:, 0] for value in values])
        matrix = np.eye(stages * N) - h * np.block(
            [[A[i, j] * values[j][1] for j in range(stages)] for i in range(stages)]
        )
        residual = Y - y - h * A @ f
        Y = Y - np.linalg.solve(matrix, residual.ravel()).reshape(stages, N)
    by_p = [np.hstack([np.zeros((N, N)), value[2]]) for value in values]
    right = np.vstack([
        D + h * sum(A[i, j] * by_p[j] for j in range(stages)) for i in range(stages)
    ])  # fmt: skip
    DY = np.linalg.solve(matrix, right).reshape(stages, N, N + P)
    slopes = [values[j][1] @ DY[j] + by_p[j] for j in range(stages)]
    return y + h * b @ f, D + h * sum(b[j] * slopes[j] for j in range(stages))


def gauss_derivatives(solution: Solution, stages: int) -> tuple[Array, Array, Array]:
    """Return what `explicit_derivatives` does; states inside a step end shorter steps."""

    def normalise(y: Array, D: Array) -> tuple[Array, Array]:
        out, slope = (np.array(value) for value in _slopes()[1](y))
        return out[:, 0], slope @ D

    y, D = normalise(Y0, np.eye(N, N + P))
    out, states = [], solution.states
    for time in solution.times[solution.times == 0.0]:
        assert time == 0.0
        out.append((y, D))
    for k, (start, end) in enumerate(pairwise(solution.knots)):
        y = states[k] if k else y
        within = solution.times[(solution.times > start) & (solution.times <= end)]
        out += [normalise(*gauss_step(y, D, time - start, stages)) for time in within]
        y, D = gauss_step(y, D, end - start, stages)
    out.append((y, D))  # the last step end is not normalised
    slopes = np.array([slope for _, slope in out])
    return np.array([state for state, _ in out]), slopes[..., :N], slopes[..., N:]


def expected_of(method: Any, solution: Solution) -> tuple[Array, Array, Array]:
    """Return states at report times and the end, and derivatives by state and parameters."""
    if isinstance(method, Explicit):
        return explicit_derivatives(solution)
    return gauss_derivatives(solution, method.stages)


@pytest.mark.by_hand
@pytest.mark.parametrize(
    ("method", "stages"),
    # Gauss's methods with equal steps store no stages.
    [*((method, False) for method in METHODS), (METHODS[0], True), (METHODS[2], True)],
)
def test_forward_and_backward_derivatives_are_exact(method: Any, stages: bool) -> None:
    """Those of all states, by initial state and parameters, with stored stages or without."""
    solution, field = run_of(method, stages=stages), field_of(method)
    states, by_y, by_p = expected_of(method, solution)
    along, along_p = np.eye(N, N + P), np.eye(N + P)[N:]
    found = run_along(
        method, field, PARAMS, Y0, solution.knots, solution.times, along, along_p, solution.states
    )
    np.testing.assert_allclose(found.y, states[:-1], rtol=0, atol=2e-13)
    np.testing.assert_allclose(found.end, states[-1], rtol=0, atol=2e-13)
    slopes = np.concatenate([by_y, by_p], axis=2)
    np.testing.assert_allclose(found.slopes, slopes[:-1], rtol=0, atol=2e-12)
    np.testing.assert_allclose(found.end_slopes, slopes[-1], rtol=0, atol=2e-12)
    rng = np.random.default_rng(1)
    v = rng.normal(size=(N + P, 1))
    alone = run_along(
        method, field, PARAMS, Y0, solution.knots, solution.times, v[:N], v[N:], solution.states
    )
    np.testing.assert_allclose(alone.y, states[:-1], rtol=0, atol=2e-13)
    np.testing.assert_allclose(alone.end, states[-1], rtol=0, atol=2e-13)
    np.testing.assert_allclose(alone.slopes, slopes[:-1] @ v, rtol=0, atol=4e-12)
    np.testing.assert_allclose(alone.end_slopes, slopes[-1] @ v, rtol=0, atol=4e-12)
    at_times, at_end = rng.normal(size=(len(solution.times), N)), rng.normal(size=N)
    kept = at_times.copy(), at_end.copy()
    back = run_back(method, field, solution, solution.times, at_end, at_times)
    np.testing.assert_array_equal(kept[0], at_times)
    np.testing.assert_array_equal(kept[1], at_end)
    covector = np.concatenate([at_times, at_end[None]])
    for value, slope in ((back.by_state, by_y), (back.by_parameters, by_p)):
        expected = np.tensordot(covector, slope, 2)
        np.testing.assert_allclose(value, expected, rtol=0, atol=2e-12)


@pytest.mark.by_hand
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_runs_without_directions_or_inner_reports(method: Any) -> None:
    """States need no tangent kernel; reports at step ends only; covectors of the end only."""
    solution, field = run_of(method, stages=False, inner=False), field_of(method)
    found = run_along(
        method, field, PARAMS, Y0, solution.knots, solution.times, np.zeros((N, 0)),
        np.zeros((P, 0)), solution.states,
    )  # fmt: skip
    states, by_y, by_p = expected_of(method, solution)
    np.testing.assert_allclose(found.y, states[:-1], rtol=0, atol=2e-13)
    assert found.slopes.shape == (len(solution.times), N, 0)
    assert found.end_slopes.shape == (N, 0)
    covector = np.random.default_rng(2).normal(size=N)
    back = run_back(method, field, solution, np.empty(0), covector, np.empty((0, N)))
    np.testing.assert_allclose(back.by_state, covector @ by_y[-1], rtol=0, atol=2e-12)
    np.testing.assert_allclose(back.by_parameters, covector @ by_p[-1], rtol=0, atol=2e-12)


def test_single_direction_equals_derivative_of_step_formulas() -> None:
    """DOP853 along one direction of state and parameters, with reports inside steps."""
    method = DOP853()
    solution = run_of(method, stages=False)
    states, by_y, by_p = expected_of(method, solution)
    v = np.random.default_rng(3).normal(size=(N + P, 1))
    found = run_along(
        method, field_of(method), PARAMS, Y0, solution.knots, solution.times, v[:N], v[N:]
    )
    slopes = np.concatenate([by_y, by_p], axis=2) @ v
    np.testing.assert_allclose(found.y, states[:-1], rtol=0, atol=2e-13)
    np.testing.assert_allclose(found.end, states[-1], rtol=0, atol=2e-13)
    np.testing.assert_allclose(found.slopes, slopes[:-1], rtol=0, atol=4e-12)
    np.testing.assert_allclose(found.end_slopes, slopes[-1], rtol=0, atol=4e-12)


def test_steps_without_a_solution_are_refused_with_their_time() -> None:
    """Steps of 40 s contract nothing: both passes name the start of the step."""
    method, field = Gauss(0.3, order=6), field_of(Gauss(0.3, order=6))
    solution = run_of(method, stages=False)
    knots = read_only(np.append(solution.knots[:-1], solution.knots[-2] + 40.0))
    with pytest.raises(NoConvergence, match=r"at t = 0\.6 s did not converge") as failure:
        run_along(
            method, field, PARAMS, Y0, knots, np.empty(0), np.eye(N), np.zeros((P, N)),
        )  # fmt: skip
    assert failure.value.time == 0.6
    with pytest.raises(NoConvergence, match=r"at t = 0\.6 s did not converge") as failure:
        run_back(
            method,
            field,
            replace(solution, _knots=knots),
            read_only(np.empty(0)),
            np.ones(N),
            np.empty((0, N)),
        )
    assert failure.value.time == 0.6
    np.testing.assert_array_equal(failure.value.state, solution.states[-2])
    with pytest.raises(InputError, match="the steps of RKMK4 have no derivatives"):
        refuse_without_derivatives(RKMK4(0.1))
