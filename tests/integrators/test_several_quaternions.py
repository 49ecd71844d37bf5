"""States with several quaternions: heavy tops in one state, for every integrator."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pinred.common.arrays import Array, read_only
from pinred.common.errors import InputError
from pinred.common.machine_code import NativeCode, load_object
from pinred.integrators.integrate import Integration, Solution, integrate, integrate_parts
from pinred.integrators.integrate_many import integrate_many
from pinred.integrators.lanes.integrate_in_lanes import integrate_in_lanes
from pinred.integrators.methods import (
    DOP853,
    RKMK4,
    AdaptiveGauss,
    Explicit,
    Gauss,
    Method,
    Radau,
    Tsit5,
    Variational,
)
from pinred.integrators.methods.method import ErrorControl
from pinred.integrators.run_derivatives import SmoothField, run_along, run_back
from pinred.integrators.stepping import run_state
from pinred.integrators.stepping.intrinsics import SEEDS
from pinred.integrators.stepping.run_state import (
    TURN,
    Quaternions,
)
from pinred.integrators.stepping.step_loop import Stepper
from pinred.kernels.machine.native import compile_object

# A state contains an oscillator and a clock (3,), the body momenta of B tops (3 B,), and their
# quaternions (4 B,). The rows of three tops have no padding. Parameters of a top: inertias (3,),
# gravity force times the height of the centre of mass.
OTHERS, MARK = 3, 8.25e-77
TOPS = np.array([[1.0, 2.0, 3.0, 2.0], [0.7, 0.9, 0.5, -1.5], [1.5, 1.1, 2.2, 0.8]])
_rng = np.random.default_rng(5)
MOMENTA, ATTITUDES = _rng.normal(size=(3, 3)), Rotation.random(3, 7).as_quat()
LENGTHS = np.array([2.0, 0.3, -1.5])  # of the initial quaternions
END, TIMES = 1.2, np.array([0.0, 0.0, 0.11, 0.4, 0.403, 0.8, 1.2, 1.2])

METHODS: tuple[Method, ...] = (
    DOP853(1e-10, 1e-12),
    Tsit5(1e-9, 1e-11),
    RKMK4(0.01),
    Gauss(0.05, 6),
    Gauss(0.05, 6, "Newton"),
    AdaptiveGauss(1e-11, 1e-13),
    Radau(1e-8, 1e-10),
)
ADAPTIVE = tuple(method for method in METHODS if isinstance(method, ErrorControl))


def quaternions(bodies: int) -> Quaternions:
    """Return the position of the quaternions in a state."""
    return OTHERS + 3 * bodies, bodies


def state(tops: Any) -> tuple[Array, Array]:
    """Return initial state and parameters of some tops."""
    attitudes = LENGTHS[tops, None] * ATTITUDES[tops]
    y0 = np.concatenate([[0.3, -0.2, 0.0], MOMENTA[tops].ravel(), attitudes.ravel()])
    return y0, TOPS[tops].ravel()


def tops_of(y: Array) -> tuple[Array, Array]:
    """Return momenta (…, B, 3) and quaternions (…, B, 4) of states (…, n)."""
    bodies = (y.shape[-1] - OTHERS) // 7
    at = OTHERS + 3 * bodies
    return (
        y[..., OTHERS:at].reshape(*y.shape[:-1], bodies, 3),
        y[..., at:].reshape(*y.shape[:-1], bodies, 4),
    )


@cache
def code(kind: str, bodies: int, lanes: int) -> NativeCode:
    """Compile the vector field, or one of its derivatives, for several states at once."""
    n, count = OTHERS + 7 * bodies, 4 * bodies
    y, p, v, w = (ca.SX.sym(name, size) for name, size in zip("ypvw", (n, count) * 2, strict=True))
    rates: list[ca.SX] = [y[1], -y[0], ca.SX(1.0)]
    turns: list[ca.SX] = []
    for b in range(bodies):
        pi, q = y[OTHERS + 3 * b :][:3], y[OTHERS + 3 * bodies + 4 * b :][:4]
        omega, u = pi / p[4 * b :][:3], q / ca.norm_2(q)
        up = ca.vertcat(2 * (u[0] * u[2] - u[1] * u[3]), 2 * (u[1] * u[2] + u[0] * u[3]))
        rates.append(ca.cross(pi, omega) + p[4 * b + 3] * ca.vertcat(up[1], -up[0], 0.0))
        turns += [0.5 * (q[3] * omega + ca.cross(q[:3], omega)), -0.5 * ca.dot(q[:3], omega)]
    out = ca.vertcat(*rates, *turns)
    along = ca.jtimes(out, y, v) + ca.jtimes(out, p, w)
    back = ca.vertcat(ca.jtimes(out, y, v, True), ca.jtimes(out, p, v, True))
    inputs, wide, result = {
        "rate": ([y, p], (0,), out),
        "own": ([y, p], (0, 1), out),  # each state with its own parameters
        "slope": ([y, p, v], (2,), ca.jtimes(out, y, v)),
        "tangent": ([y, p, v, w], (2, 3), along),
        "tangents": ([y, p, v, w], (0, 2), along),
        "adjoint": ([y, p, v], (0, 2), back),
    }[kind]
    function = ca.Function(kind, inputs, [ca.densify(result)], {"cse": True})
    wide_inputs = () if lanes == 1 else wide
    return load_object(compile_object(function, kind, wide=lanes, wide_inputs=wide_inputs), kind)


def run(method: Method, tops: list[int]) -> Solution:
    """Integrate some of the tops in one state."""
    y0, params = state(tops)
    bodies = len(tops)
    return integrate(
        method, code("rate", bodies, method.lanes).address, params, y0, END, TIMES,
        quaternions(bodies), tangent=lambda: code("slope", bodies, SEEDS).address,
    )  # fmt: skip


def rate(y: Array, params: Array) -> Array:
    """Return the rates of states (…, n) with parameters (…, 4 B)."""
    pi, q = tops_of(y)
    numbers = params.reshape(*params.shape[:-1], -1, 4)
    omega, up = pi / numbers[..., :3], np.zeros_like(pi)
    square = np.sum(q * q, axis=-1)
    up[..., 0] = 2.0 * (q[..., 0] * q[..., 2] - q[..., 1] * q[..., 3]) / square
    up[..., 1] = 2.0 * (q[..., 1] * q[..., 2] + q[..., 0] * q[..., 3]) / square
    lever = np.cross(up, [0.0, 0.0, 1.0])
    turn = np.empty_like(q)
    turn[..., :3] = 0.5 * (q[..., 3:] * omega + np.cross(q[..., :3], omega))
    turn[..., 3] = -0.5 * np.sum(q[..., :3] * omega, axis=-1)
    moment = np.cross(pi, omega) + numbers[..., 3:] * lever
    clock = np.ones_like(y[..., 0])
    return np.concatenate(
        [
            np.stack([y[..., 1], -y[..., 0], clock], axis=-1),
            moment.reshape(*y.shape[:-1], -1),
            turn.reshape(*y.shape[:-1], -1),
        ],
        axis=-1,
    )


def by_scipy(y0: Array, params: Array, times: Array) -> Array:
    """Return states (T, …, n) from states (…, n) by SciPy, with unit quaternions."""
    each, where = np.unique(times, return_inverse=True)
    solution = solve_ivp(
        lambda _, y: rate(y.reshape(y0.shape), params).ravel(),
        (0.0, END), y0.ravel(), "DOP853", each, rtol=3e-14, atol=1e-15,
    )  # fmt: skip
    states = solution.y.T[where].reshape(len(times), *y0.shape)
    q = tops_of(states)[1]
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    at = y0.shape[-1] - 4 * q.shape[-2]
    return np.concatenate([states[..., :at], q.reshape(*states.shape[:-1], -1)], axis=-1)


@cache
def truth() -> Array:
    """Return the states of all tops at TIMES and at 15 equal times, (T, n)."""
    return by_scipy(*state([0, 1, 2]), np.concatenate([TIMES, np.linspace(0.0, END, 15)]))


def assert_unit(states: Array) -> None:
    """Assert that all quaternions of states have length one."""
    lengths = np.linalg.norm(tops_of(states)[1], axis=-1)
    np.testing.assert_allclose(lengths, 1.0, rtol=0, atol=5e-16)


# --- states --------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_tops_in_one_state_equal_scipy(method: Method) -> None:
    """At report times and in dense output, with initial quaternions of other lengths."""
    solution = run(method, [0, 1, 2])
    inside = solution.at(np.linspace(0.0, END, 15))
    assert_unit(solution.y)
    assert_unit(inside)
    bound = 5e-7 if isinstance(method, (Tsit5, Radau)) else 1e-8
    np.testing.assert_allclose(np.vstack([solution.y, inside]), truth(), rtol=0, atol=bound)
    np.testing.assert_array_equal(solution.states[0, :OTHERS], [0.3, -0.2, 0.0])


def split(states: Array) -> list[Array]:
    """Return the states of the single tops, each (T, OTHERS + 7), of states (T, n)."""
    pi, q = tops_of(states)
    return [np.column_stack([states[:, :OTHERS], pi[:, b], q[:, b]]) for b in range(pi.shape[1])]


@pytest.mark.parametrize("tops", [[0, 1], [0, 1, 2]], ids=["two", "three"])
@pytest.mark.parametrize(
    "method",
    [DOP853(100.0, 100.0, max_step=0.1), Tsit5(100.0, 100.0, max_step=0.1), RKMK4(0.02)],
    ids=str,
)
def test_equal_steps_of_several_tops_equal_separate_runs(method: Method, tops: list[int]) -> None:
    """With fixed steps, no top affects another: at step ends and in dense output."""
    together = run(method, tops)
    for b, states in zip(tops, split(together.y), strict=True):
        alone = run(method, [b])
        np.testing.assert_array_equal(alone.knots, together.knots)
        np.testing.assert_allclose(states, alone.y, rtol=0, atol=2e-14)


@pytest.mark.parametrize("method", [METHODS[3], METHODS[4]], ids=str)
def test_gauss_steps_of_several_tops_equal_separate_runs(method: Method) -> None:
    """Both solvers stop at round-off."""
    together = run(method, [0, 1, 2])
    for b, states in enumerate(split(together.y)):
        np.testing.assert_allclose(states, run(method, [b]).y, rtol=0, atol=1e-13)


# --- error control -------------------------------------------------------------------------


def turned(y0: Array, turns: Rotation) -> Array:
    """Rotate the attitudes of the tops in space."""
    pi, q = tops_of(y0)
    lengths = np.linalg.norm(q, axis=-1, keepdims=True)
    rotated = lengths * (turns * Rotation.from_quat(q)).as_quat()
    return np.concatenate([y0[:OTHERS], pi.ravel(), rotated.ravel()])


@pytest.mark.parametrize("method", ADAPTIVE, ids=str)
def test_steps_do_not_depend_on_attitudes(method: ErrorControl) -> None:
    """The scale of errors is the same for all entries of all quaternions: free tops."""
    y0, params = state([0, 1, 2])
    y0[OTHERS:12] *= 5.0
    params[3::4] = 0.0

    def knots(start: Array) -> Array:
        return integrate(
            method, code("rate", 3, method.lanes).address, params, start, END, [], quaternions(3),
            tangent=lambda: code("slope", 3, SEEDS).address,
        ).knots  # fmt: skip

    expected = knots(y0)
    for k in range(3):  # the attitude of one top becomes the identity
        turns = Rotation.from_quat(np.where(np.arange(3)[:, None] == k, ATTITUDES, [0, 0, 0, 1]))
        found = knots(turned(y0, turns.inv()))
        np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("method", "bound"),
    [(DOP853, 4.0), (Tsit5, 4.0), (Radau, 0.5), (AdaptiveGauss, 0.5)],
)
def test_angle_errors_of_symmetric_tops_follow_tolerance(
    method: type[ErrorControl], bound: float
) -> None:
    """R(t) = exp(t L/I₁) R₀ exp(t (1/I₃ − 1/I₁) L₃ e₃) for the momentum L in space."""
    y0, params = state([0, 1, 2])
    params[:] = np.column_stack([TOPS[:, 0], TOPS[:, 0], TOPS[:, 2], np.zeros(3)]).ravel()
    y0[OTHERS:12] *= 10.0
    for rtol in (1e-6, 1e-8):
        control = method(rtol, 1e-3 * rtol)
        solution = integrate(
            control, code("rate", 3, control.lanes).address, params, y0, END, [END],
            quaternions(3), tangent=lambda: code("slope", 3, SEEDS).address,
        )  # fmt: skip
        (pi, _), (_, q) = tops_of(y0), tops_of(solution.y[-1])
        first, I1, I3 = Rotation.from_quat(tops_of(y0)[1]), *TOPS[:, [0, 2]].T
        spin = np.outer((1 / I3 - 1 / I1) * pi[:, 2], [0.0, 0.0, 1.0])
        exact = Rotation.from_rotvec(END * first.apply(pi) / I1[:, None]) * first
        exact = exact * Rotation.from_rotvec(END * spin)
        angles = (exact.inv() * Rotation.from_quat(q)).magnitude()
        assert angles.max() < bound * rtol * solution.steps


def test_row_operations_treat_each_quaternion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Positions, error scales, and normalisation with rates; the other entries do not change."""
    for name, function in vars(run_state).copy().items():
        if hasattr(function, "py_func"):  # Python runs it
            monkeypatch.setattr(run_state, name, function.py_func)
    in_quaternion, entry_size = run_state.in_quaternion, run_state.entry_size
    y, rates = np.arange(1.0, 12.0), np.linspace(2.0, 3.0, 11)
    where: Quaternions = (2, 2)
    inside = [in_quaternion(i, where) for i in range(11)]
    assert inside == [2 <= i < 10 for i in range(11)]
    assert not any(in_quaternion(i, (0, 0)) for i in range(11))
    sizes = [entry_size(-y, i, where) for i in range(11)]
    assert sizes == [TURN if 2 <= i < 10 else y[i] for i in range(11)]
    expected, factors = y.copy(), np.ones(11)
    for k in (2, 6):
        factors[k : k + 4] = 1.0 / np.linalg.norm(y[k : k + 4])
    alone, both, scaled = y.copy(), y.copy(), rates.copy()
    run_state.unit_alone(alone, where)
    run_state.unit(both, scaled, where)
    np.testing.assert_allclose(alone, expected * factors, rtol=1e-15)
    np.testing.assert_array_equal(both, alone)
    np.testing.assert_allclose(scaled, rates * factors, rtol=1e-15)


# --- batches and parts ---------------------------------------------------------------------


def members(count: int) -> tuple[Array, Array]:
    """Return states and parameters of members with three tops."""
    rng, (y0, params) = np.random.default_rng(6), state([0, 1, 2])
    return y0 + 0.1 * rng.normal(size=(count, len(y0))), params * rng.uniform(
        0.9, 1.1, (count, len(params))
    )


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_batch_members_equal_single_runs(method: Method) -> None:
    """In every bit."""
    y0, params = members(3)
    address = code("rate", 3, method.lanes).address
    more: Any = {"tangent": lambda: code("slope", 3, SEEDS).address}
    batch = integrate_many(method, address, params, y0, END, TIMES, quaternions(3), 1, **more)
    for k in range(3):
        one = integrate(method, address, params[k], y0[k], END, TIMES, quaternions(3), **more)
        np.testing.assert_array_equal(batch.y[k], one.y)
        assert batch.steps[k] == one.steps


@pytest.mark.parametrize("method", [METHODS[0], METHODS[1]], ids=str)
def test_lanes_equal_single_runs(method: Explicit) -> None:
    """States up to round-off, and equal numbers of steps."""
    y0, params = members(11)
    batch = integrate_in_lanes(
        method, code("own", 3, 8).address, 8, params, y0, END, TIMES, quaternions(3), 1
    )
    assert_unit(batch.y)
    for k in range(11):
        one = integrate(
            method, code("rate", 3, 1).address, params[k], y0[k], END, TIMES, quaternions(3)
        )
        np.testing.assert_allclose(batch.y[k], one.y, rtol=0, atol=1e-12)
        assert (batch.steps[k], batch.rejected[k]) == (one.steps, one.rejected)


@pytest.mark.parametrize(
    "method",
    [
        m if isinstance(m, Explicit) else pytest.param(m, marks=pytest.mark.by_hand)
        for m in ADAPTIVE
    ],
    ids=str,
)
def test_parts_normalise_each_quaternion(method: ErrorControl) -> None:
    """Each part begins with unit quaternions, and the last one ends as an unbroken run."""
    y0, params = state([0, 1, 2])
    lengths = read_only(np.array([0.5, 0.4, 0.3]))
    parts = integrate_parts(
        method, code("rate", 3, method.lanes).address, read_only(np.tile(params, (3, 1))), y0,
        lengths, quaternions(3), tangent=lambda: code("slope", 3, SEEDS).address,
    )  # fmt: skip
    for k in (1, 2):
        assert_unit(parts[k].states[:1])
    end = parts[2].at([lengths[2]])[0]
    np.testing.assert_allclose(end, truth()[7], rtol=0, atol=5e-7)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_steppers_write_within_work_rows(method: Method, monkeypatch: pytest.MonkeyPatch) -> None:
    """Marks after the rows survive steps, reports inside steps, and later dense output."""
    allocated: list[Array] = []
    real = Stepper.work

    def with_marks(*asked: Any, **options: Any) -> Array:
        work = real(*asked, **options)
        larger = np.full((work.shape[0] + 2, work.shape[1]), MARK)
        larger[:-2] = work
        allocated.append(larger)
        return larger[:-2]

    monkeypatch.setattr(Stepper, "work", with_marks)
    run(method, [0, 1, 2]).at([0.05, 0.77])
    assert len(allocated) >= 2
    for work in allocated:
        assert (work[-2:] == MARK).all()


# --- derivatives ---------------------------------------------------------------------------

SMOOTH = (DOP853(1e-9, 1e-11, max_step=0.25), Gauss(0.1, 6), AdaptiveGauss(1e-11, 1e-13))


@cache
def differences() -> tuple[Array, Array]:
    """Return states of two tops (T, n), and central differences by (y0, params), (T, n, n + p)."""
    y0, params = state([0, 1])
    n, h = len(y0), 2e-5
    inputs = np.concatenate([y0, params])
    offsets = h * np.eye(len(inputs))
    moved = np.concatenate([inputs + offsets, inputs - offsets, inputs[None]])
    states = by_scipy(moved[:, :n], moved[:, n:], TIMES)
    plus, minus = states[:, : len(inputs)], states[:, len(inputs) : -1]
    return states[:, -1], np.moveaxis(plus - minus, 1, 2) / (2.0 * h)


@pytest.mark.parametrize("stages", [False, True], ids=["recomputed", "stored"])
@pytest.mark.parametrize("method", SMOOTH, ids=str)
def test_derivatives_equal_central_differences(method: Any, stages: bool) -> None:
    """Forward tangents against SciPy; backward covectors against the tangents, to round-off."""
    if stages and isinstance(method, Gauss):
        return  # stores no stages
    y0, params = state([0, 1])
    n, p = len(y0), len(params)
    field = SmoothField(
        address=code("rate", 2, method.lanes).address,
        quaternions=quaternions(2),
        tangent=lambda: code("tangent", 2, SEEDS).address,
        pair=lambda: code("tangent", 2, SEEDS).address,  # not called
        adjoint=lambda: code("adjoint", 2, 1).address,
        tangents=lambda lanes: code("tangents", 2, lanes).address,
        adjoints=lambda lanes: code("adjoint", 2, lanes).address,
    )
    integration = Integration(
        method, field.address, n, END, read_only(TIMES.copy()), quaternions(2)
    )
    solution = integration(read_only(params), y0, stages=stages)
    found = run_along(
        method, field, params, y0, solution.knots, solution.times, np.eye(n, n + p),
        np.eye(n + p)[n:], np.ascontiguousarray(solution.states),
    )  # fmt: skip
    states, slopes = differences()
    np.testing.assert_allclose(found.y, states, rtol=0, atol=2e-8)
    np.testing.assert_allclose(found.slopes, slopes, rtol=0, atol=2e-7)
    rng = np.random.default_rng(3)
    at_times, at_end = rng.normal(size=(len(TIMES), n)), rng.normal(size=n)
    back = run_back(method, field, solution, solution.times, at_end, at_times)
    expected = np.tensordot(at_times, found.slopes, 2) + at_end @ found.end_slopes
    np.testing.assert_allclose(back.by_state, expected[:n], rtol=0, atol=2e-11)
    np.testing.assert_allclose(back.by_parameters, expected[n:], rtol=0, atol=2e-11)


# --- invalid arguments ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "given", [(-1, 1), (-4, 2), (12, -1), (13, 3), (12, 4), (24, 1), 12, (12,), [12, 3], (12.0, 3)]
)
def test_positions_outside_of_state_are_rejected(given: Any) -> None:
    """Single runs and batches name the argument and its value."""
    y0, params = state([0, 1, 2])
    address = code("rate", 3, 1).address
    with pytest.raises(InputError, match=r"^quaternions: expected .* with 24 entries, got "):
        integrate(METHODS[0], address, params, y0, END, [], given)
    with pytest.raises(InputError, match=r"^quaternions: expected"):
        integrate_many(METHODS[0], address, params[None], y0[None], END, [], given)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_zero_quaternions_are_rejected_by_number(which: int) -> None:
    """The message names the quaternion and its entries."""
    y0, params = state([0, 1, 2])
    first = 12 + 4 * which
    y0[first : first + 4] = 0.0
    message = rf"^y0: .* zero for quaternion {which + 1} of 3, in entries {first} to {first + 3}\."
    with pytest.raises(InputError, match=message):
        integrate(METHODS[0], code("rate", 3, 1).address, params, y0, END, [], quaternions(3))
    states = np.stack([state([0, 1, 2])[0], y0])
    with pytest.raises(InputError, match=message):
        integrate_in_lanes(
            DOP853(), code("own", 3, 8).address, 8, np.tile(params, (2, 1)), states, END, [],
            quaternions(3),
        )  # fmt: skip


def test_variational_rejects_several_quaternions() -> None:
    """Before the run, in all entry points; one quaternion is allowed."""
    method, (y0, params) = Variational(0.1), state([0, 1])
    message = "^quaternions: expected at most one quaternion for Variational, got 2"
    with pytest.raises(InputError, match=message):
        integrate(method, code("rate", 2, 1).address, params, y0, END, [], quaternions(2))
    with pytest.raises(InputError, match=message):
        integrate_many(
            method, code("rate", 2, 1).address, params[None], y0[None], END, [], quaternions(2)
        )
    y0, params = state([0])
    assert integrate(
        method, code("rate", 1, 1).address, params, y0, END, [], quaternions(1)
    ).complete
