"""Radau IIA: order against ABA, stiff systems against SciPy, failures, and its derivative."""

from __future__ import annotations

import signal
import threading
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from aba import kinematics
from numpy.polynomial import Polynomial
from orders import fit_order
from scipy.integrate import solve_ivp
from scipy.integrate._ivp import radau as book
from stiff_kernels import kernels

import pinred
from pinred import DOP853, Radau
from pinred.common.arrays import Array, read_only
from pinred.common.errors import (
    InputError,
    KernelMismatch,
    NonFiniteState,
    StepSizeUnderflow,
    TooManySteps,
)
from pinred.forces import PD, Damper, Limit, Torque
from pinred.integrators import integrate as drive
from pinred.integrators.implicit import radau_iia
from pinred.integrators.integrate import Solution, integrate
from pinred.integrators.integrate_many import STATUS, integrate_many
from pinred.integrators.stepping import linear_systems, run_state
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.kernels import build as tangent
from pinred.kernels.build import jacobian_of, tangent_of
from pinred.kernels.machine import native
from pinred.signals import Fourier
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of

# Python runs the solution of linear systems; machine code of Radau contains it.
_SYSTEMS: Any = linear_systems
factor, solve = _SYSTEMS.factor.py_func, _SYSTEMS.solve.py_func
factor_complex, solve_complex = _SYSTEMS.factor_complex.py_func, _SYSTEMS.solve_complex.py_func


def _pol(y: Any, p: Any, d: Any) -> None:
    d[0], d[1] = y[1], p[0] * (1.0 - y[0] * y[0]) * y[1] - y[0]


def _pol_slope(y: Any, p: Any, v: Any, d: Any) -> None:
    for j in range(8):
        a, b = v[j], v[8 + j]
        d[j] = b
        d[8 + j] = (-2.0 * p[0] * y[0] * y[1] - 1.0) * a + p[0] * (1.0 - y[0] * y[0]) * b


def _power(y: Any, p: Any, d: Any) -> None:
    d[0] = p[0] * y[0] ** p[1]


def _power_slope(y: Any, p: Any, v: Any, d: Any) -> None:
    for j in range(8):
        d[j] = p[0] * p[1] * y[0] ** (p[1] - 1.0) * v[j]


def _edge(y: Any, p: Any, d: Any) -> None:  # noqa: ARG001
    d[0], d[1], d[2] = 1.0, 0.0, ca.sqrt(0.5 - y[0])


def _edge_slope(y: Any, p: Any, v: Any, d: Any) -> None:  # noqa: ARG001
    for j in range(8):
        d[j], d[8 + j], d[16 + j] = 0.0, 0.0, -0.5 / ca.sqrt(0.5 - y[0]) * v[j]


def _sloped(y: Any, p: Any, d: Any) -> None:
    d[0] = -p[0] * y[0]


def _sloped_slope(y: Any, p: Any, v: Any, d: Any) -> None:  # noqa: ARG001
    for j in range(8):
        d[j] = -p[0] * p[1] * v[j]


def _servo(y: Any, p: Any, d: Any) -> None:
    d[0], d[1] = -p[0] * (y[0] - ca.cos(y[1])), 1.0


def _servo_slope(y: Any, p: Any, v: Any, d: Any) -> None:
    for j in range(8):
        d[j], d[8 + j] = -p[0] * (v[j] + ca.sin(y[1]) * v[8 + j]), 0.0


POL, POL_SLOPE = kernels(_pol, _pol_slope)
POWER, POWER_SLOPE = kernels(_power, _power_slope)
EDGE, EDGE_SLOPE = kernels(_edge, _edge_slope)
SLOPED, SLOPED_SLOPE = kernels(_sloped, _sloped_slope)
SERVO, SERVO_SLOPE = kernels(_servo, _servo_slope)
TIMES = np.array([0.0, 0.0, 0.3, 0.301, 1.0, 2.5, 2.5, 4.0])


def pol(method: Radau, times: Any, end: float = 4.0, mu: float = 1e4, **more: Any) -> Solution:
    """Integrate Van der Pol's oscillator from (2, 0)."""
    return integrate(method, POL, [mu], [2.0, 0.0], end, times, tangent=POL_SLOPE, **more)


# --- the derivative ------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 7, 8, 9, 30])
def test_linear_systems_equal_lapack(n: int) -> None:
    """Real and complex systems; a singular one is detected."""
    rng = np.random.default_rng(n)
    wide = -(-n // 8) * 8
    matrix_rows = np.zeros((2 * n + 1, wide))
    matrix_rows[1:] = rng.normal(size=(2 * n, wide))
    A, B, b, c = (
        matrix_rows[1 : n + 1, :n].copy(),
        matrix_rows[n + 1 :, :n].copy(),
        *rng.normal(size=(2, n)),
    )
    both = np.linalg.solve(A + 1j * B, b + 1j * c)
    one, x, y, pivots = matrix_rows.copy(), b.copy(), c.copy(), np.zeros(n)
    assert factor(one, 1, n, pivots)
    solve(one, 1, n, pivots, x)
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-10, atol=1e-12)
    x = b.copy()
    assert factor_complex(matrix_rows, 1, n + 1, n, pivots)
    solve_complex(matrix_rows, 1, n + 1, n, pivots, x, y)
    np.testing.assert_allclose(x + 1j * y, both, rtol=1e-10, atol=1e-12)
    matrix_rows[:, 0] = 0.0
    assert not factor(matrix_rows.copy(), 1, n, pivots)
    assert not factor_complex(matrix_rows, 1, n + 1, n, pivots)
    matrix_rows[:, 0] = np.nan
    assert not factor(matrix_rows.copy(), 1, n, pivots)
    assert not factor_complex(matrix_rows, 1, n + 1, n, pivots)


def test_elimination_avoids_small_pivots() -> None:
    """Small real or imaginary pivots would cost all digits; zeros cost nothing."""
    for first, below, last in ((1e-20, 1, 1j), (0, 1, 1), (1e-20j, 1, 1j), (2, 1j, 1)):
        M = np.array([[first, 1.0, 0.0], [below, 1.0, 2.0], [0.0, 3.0, last]])
        b, pivots = np.array([1.0, 2.0, 3.0]), np.zeros(3)
        exact = np.linalg.solve(M, b)
        matrix_rows = np.zeros((6, 8))
        matrix_rows[:3, :3], matrix_rows[3:, :3] = M.real, M.imag
        x, y = b.copy(), np.zeros(3)
        assert factor_complex(matrix_rows, 0, 3, 3, pivots)
        solve_complex(matrix_rows, 0, 3, 3, pivots, x, y)
        np.testing.assert_allclose(x + 1j * y, exact, rtol=1e-14, atol=1e-14)
        matrix_rows = np.zeros((3, 8))
        matrix_rows[:, :3] = M.real + M.imag
        x = b.copy()
        assert factor(matrix_rows, 0, 3, pivots)
        solve(matrix_rows, 0, 3, pivots, x)
        exact = np.linalg.solve(M.real + M.imag, b)
        np.testing.assert_allclose(x, exact, rtol=1e-14, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["planar_chain5", "coupled_spatial", "solo12"])
@pytest.mark.sampled
def test_kernel_derivative_equals_aba_derivatives(robot: str) -> None:
    """The derivative along the motion equals that of ABA."""
    system = pinred.load(robot)
    scene = pinred.Scene(system=system, seed=4)
    flow = CompiledFlow.of_plan(plan_of(scene))
    rate = flow.kernel.evaluate_rate(flow.y0, flow.parameters)
    J = jacobian_of(flow.kernel, flow.y0, flow.parameters)
    m, r, start = system.m, system.r, scene.start
    v = np.concatenate([start.xi, start.xdot])
    q = system.q(start.pose, start.x)
    data = system.model.createData()
    aba = pin.aba(system.model, data, q, v, np.zeros(system.n))
    np.testing.assert_allclose(rate[:m], start.xdot, atol=1e-11)
    np.testing.assert_allclose((J @ rate)[:m], aba[r:], atol=1e-9 * max(1.0, abs(aba).max()))
    by_q, by_v, _ = pin.computeABADerivatives(system.model, data, q, v, np.zeros(system.n))
    jerk = (by_q @ v + by_v @ aba)[r:]
    h = 1e-4

    def bend(s: float) -> Array:
        y = flow.y0 + s * rate + 0.5 * s * s * (J @ rate)
        rates = flow.kernel.evaluate_rate(y, flow.parameters)
        return (jacobian_of(flow.kernel, y, flow.parameters) @ rates)[:m]

    slope = (8.0 * (bend(h) - bend(-h)) - (bend(2 * h) - bend(-2 * h))) / (12.0 * h)
    np.testing.assert_allclose(slope, jerk, atol=1e-6 * max(1.0, abs(jerk).max()))


def test_kernel_derivative_with_forces_equals_differences() -> None:
    """Time, prescribed joints, limits and parameters, against differences of the rates."""
    system = pinred.load("falling_cat")
    scene = pinred.Scene(
        system=system,
        seed=2,
        prescribed={"sway": Fourier(0.0, [0.3], [0.1], 2.0)},
        forces=[
            PD({"twist": Fourier(0.1, [0.2], [0.0], 3.0)}, kp=2.0, kd=0.1, limit=Limit(0.5)),
            Torque(lambda t, x, xdot, mu: {"bend": -0.1 * mu[-1] * x[0] * xdot[0] * t}),
        ],
    )
    flow = CompiledFlow.of_plan(plan_of(scene))
    y = flow.y0 + 0.1
    J = jacobian_of(flow.kernel, y, flow.parameters)
    h = 1e-5
    for j in range(len(y)):
        step = h * (np.arange(len(y)) == j)
        ends = [flow.kernel.evaluate_rate(y + s * step, flow.parameters) for s in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), J[:, j], atol=1e-7)


def test_wrong_derivative_is_rejected(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A relative error of 1e-5 is detected."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
    right = native.compile_object

    def wrong(function: Any, name: str, *args: Any, **options: Any) -> bytes:
        import casadi as ca

        if name != "tangent":
            return right(function, name, *args, **options)
        y, p, v = (ca.SX.sym(s, function.size1_in(k)) for k, s in enumerate("ypv"))
        value = function(y, p, v)
        value *= 1.00001
        return right(ca.Function(name, [y, p, v], [value]), name, **options)

    monkeypatch.setattr(tangent, "compile_object", wrong)
    kernel = CompiledFlow.of_plan(
        plan_of(pinred.Scene(system=pinred.load("falling_cat"), seed=1))
    ).kernel
    with pytest.raises(KernelMismatch, match="column 0 is off"):
        tangent_of(kernel)


# --- accuracy ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "robot", ["double_spherical_pendulum", "falling_cat", "satellite_two_arms"]
)
@pytest.mark.sampled
def test_radau_has_order_5(robot: str) -> None:
    """Order in shape and attitude against ABA, in dense output and at step ends."""
    system = pinred.load(robot)
    tolerances, ends = np.geomspace(1e-8, 1e-12, 9), (0.8, 1.0, 1.2)
    steps, errors = np.zeros(len(tolerances)), np.zeros((2, len(tolerances)))
    for end in ends:
        times = np.append(end * np.linspace(0.7, 0.8, 11), end)
        scene = pinred.Scene(system=system, seed=3, times=times)
        full, start = FullState(scene), scene.start
        y0 = full.state(start.pose, start.x, start.xi, start.xdot)
        truth = full.run(y0, times, 2e-14, 1e-15)
        for k, rtol in enumerate(tolerances.tolist()):
            traj = pinred.simulate(replace(scene, method=Radau(rtol, 0.01 * rtol)))
            assert traj.run.method == "Radau"
            error = full.distance(truth, FullMotion(x=traj.x, q=traj.q))
            both = np.hypot(error.shape, error.rotation)
            assert both.max() < 30.0 * rtol
            steps[k] += traj.run.steps
            errors[0, k] += both[-1]
            errors[1, k] += both[:-1].max()
    assert Radau.order == Radau.dense_order == 5
    for step_errors in errors:
        order = fit_order(step_errors.tolist(), (1.0 / steps).tolist())
        assert order == pytest.approx(5.0, abs=0.25)


def test_hard_springs_need_few_steps() -> None:
    """A damped chain with joints of 1e8 N·m/rad, against SciPy on the full state."""
    system, hard, damping = pinred.load("planar_chain5"), 1e8, 1e5
    names = system.shape_names[2:]
    scene = pinred.Scene(
        system=system,
        x0=[0.5, 0.0, 0.0, 0.0, 0.0],
        xdot0=[0.0, 1.0, 0.0, 0.0, 0.0],
        times=[0.1, 0.3],
        springs=dict.fromkeys(names, (hard, 0.0)),
        forces=[Damper(name, damping) for name in names],
        method=Radau(1e-9, 1e-11),
    )
    traj = pinred.simulate(scene)
    model, start, nq = system.model, scene.start, system.model.nq
    data, q_rate = model.createData(), kinematics(model)

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        q, v = pin.normalize(model, y[:nq]), y[nq:]
        tau = np.zeros(system.n)
        x = np.array([q[at] for _, at in system.plain])[-3:]
        x = x if len(system.angles) == 0 else np.arctan2(q[-5::2], q[-6::2])
        tau[-3:] = -hard * x - damping * v[-3:]
        return np.concatenate([q_rate(y[:nq], v), pin.aba(model, data, q, v, tau)])

    y0 = np.concatenate([system.q(start.pose, start.x), start.xi, start.xdot])
    reference = solve_ivp(rate, (0.0, 0.3), y0, "Radau", [0.1, 0.3], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(traj.v, reference.y[nq:].T, atol=1e-7)
    q = np.array([pin.normalize(model, column) for column in reference.y[:nq].T])
    assert (
        max(abs(pin.difference(model, a, b)).max() for a, b in zip(q, traj.q, strict=True)) < 1e-7
    )
    assert traj.run.steps < 150
    explicit = DOP853(1e-6, 1e-8, max_steps=100 * traj.run.steps)
    with pytest.raises(TooManySteps):
        pinred.simulate(replace(scene, method=explicit))


@pytest.mark.by_hand
@pytest.mark.slow
def test_van_der_pol_equals_scipy() -> None:
    """The stiff oscillator of the book over its jump."""
    end, mu = 1.5, 1e3  # in the book's scaling, ε = 1e-6, it jumps at 0.8 mu
    times = mu * np.array([0.5, end])

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        return np.array([y[1], mu * (1.0 - y[0] ** 2) * y[1] - y[0]])

    def slope(t: float, y: Array) -> Array:  # noqa: ARG001
        return np.array([[0.0, 1.0], [-2.0 * mu * y[0] * y[1] - 1.0, mu * (1.0 - y[0] ** 2)]])

    exact = solve_ivp(
        rate, (0.0, times[-1]), [2.0, 0.0], "Radau", times, rtol=1e-12, atol=1e-14, jac=slope
    ).y.T
    run = integrate(Radau(1e-9, 1e-11), POL, [mu], [2.0, 0.0], times[-1], times, tangent=POL_SLOPE)
    np.testing.assert_allclose(run.y, exact, rtol=1e-6)
    assert run.steps < 1200


@pytest.mark.parametrize(("power", "start"), [(20.0, 30.0), (50.0, 100.0), (60.0, 100.0)])
def test_step_is_shortened_when_newton_converges_slowly(power: float, start: float) -> None:
    """By the criterion of Hairer and Wanner (IV.8), with Butcher's matrix."""
    rtol, atol, most = 1e-3, 1.0, 7
    scale, rate = start + atol / rtol, -(start ** (1.0 - power))

    def f(y: Array) -> Array:
        return np.asarray(rate * y**power)

    h = 0.01 * scale / start
    tolerance = 0.1 * rtol ** (2.0 / 3.0)  # of an estimate of order 3
    k = np.arange(3)
    A = book.C[:, None] ** (k + 1) / (k + 1) @ np.linalg.inv(book.C[:, None] ** k)
    newton = np.eye(3) - h * rate * power * start ** (power - 1.0) * A
    Z, sizes, ratios = np.zeros(3), [], []
    while True:
        change = np.linalg.solve(newton, h * A @ f(start + Z) - Z)
        Z += change
        sizes.append(np.sqrt(np.mean((book.TI @ change / (tolerance * scale)) ** 2)))
        if len(sizes) > 1:
            ratios.append(sizes[-1] / sizes[-2])
            quotient = np.prod(ratios[-2:]) ** (1.0 / len(ratios[-2:]))
            remaining = quotient / (1.0 - quotient) * sizes[-1]
            assert remaining > 0.03
            still = remaining * quotient ** (most - 1 - len(sizes)) / 0.03
            if still >= 1.0:
                break
    cut = 0.8 * still ** (-1.0 / (4 + most - 1 - len(sizes)))
    batch = integrate_many(
        Radau(rtol, atol, max_steps=2), POWER, [[rate, power]], [[start]], 1e3, [],
        tangent=POWER_SLOPE,
    )  # fmt: skip
    assert (batch.rejected[0], batch.steps[0]) == (1, 1)
    assert batch.end[0] == pytest.approx(cut * h, rel=1e-10)


# --- bits, ends and failures ---------------------------------------------------------------


def test_pauses_and_dense_output_do_not_change_results() -> None:
    """States recomputed from stored steps have the same bits."""
    uninterrupted = pol(Radau(), TIMES)
    times = np.sort(np.concatenate([TIMES, np.linspace(0.0, 4.0, 501), uninterrupted.knots]))
    once = pol(Radau(), times)
    fractions: list[float] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 1)
        patch.setattr(drive, "_FIRST_KNOTS", 1)
        paused = pol(Radau(), TIMES, progress=fractions.append)
    assert len(fractions) > uninterrupted.steps
    for other in (paused, once):
        assert np.array_equal(uninterrupted.states, other.states)
        assert (uninterrupted.steps, uninterrupted.rejected) == (other.steps, other.rejected)
    assert uninterrupted.evaluations == paused.evaluations
    assert np.array_equal(uninterrupted.y, paused.y)
    shuffled = np.random.default_rng(0).permutation(len(times))
    assert np.array_equal(uninterrupted.at(times[shuffled]), once.y[shuffled])
    assert np.array_equal(once.at(TIMES), uninterrupted.y)
    assert np.array_equal(uninterrupted.y[[0, -1]], uninterrupted.states[[0, -1]])


def test_dense_output_on_a_robot() -> None:
    """With a quaternion, through the simulation."""
    system = pinred.load("falling_cat")
    traj = pinred.simulate(
        system, seed=3, duration=1.0, method=Radau(), times=np.linspace(0, 1, 33)
    )
    other = pinred.simulate(system, seed=3, duration=1.0, method=Radau(), times=[0.0, 1.0])
    assert np.array_equal(other(traj.t).q, traj.q)
    np.testing.assert_allclose(np.linalg.norm(traj.pose[:, 3:], axis=1), 1.0, rtol=1e-15)


def test_dense_output_equals_filtered_polynomial() -> None:
    """The stage polynomial with filtered corrections of ẏ and ÿ; differences replace a lost J."""
    x = np.linspace(0.05, 0.95, 19)
    for rate in (1.0, 1e3):
        run = integrate(
            Radau(1e-4, 1e-8), SLOPED, [rate, 1.0], [1.0], 3.0, [], tangent=SLOPED_SLOPE
        )
        lengths = np.diff(run.knots)
        assert rate * lengths.max() > (100.0 if rate > 1.0 else 0.2)
        for k, h in enumerate(lengths.tolist()):
            t, z = run.knots[k] + x * h, -rate * h
            start, end = run.states[k : k + 2, 0]
            nodes = np.append(0.0, book.C)
            P = Polynomial.fit(nodes, np.append(0.0, run.stored[k + 1, 1:]), 3, domain=[0.0, 1.0])
            passed = 1.0 - (1.0 - 1.0 / (1.0 - z / book.MU_REAL)) ** 3
            slope = passed * (z * start - P.deriv(1)(0.0))
            bend, last = passed**2 * (z**2 * np.array([start, end]) - P.deriv(2)([0.0, 1.0]))
            added = x * (1 - x) ** 3 * (1 + 3 * x) * slope
            added += 0.5 * x**2 * (1 - x) ** 3 * bend + 0.5 * x**3 * (1 - x) ** 2 * last
            size = 1e-11 * max(abs(start), abs(end)) * max(1.0, abs(z))
            np.testing.assert_allclose(run.at(t)[:, 0], start + P(x) + added, atol=size)
            for lost in (np.inf, np.nan):
                params = read_only(np.array([rate, lost]))  # like those of a run
                other = replace(run, params=params).at(t)[:, 0]
                np.testing.assert_allclose(other, start + P(x) + added, atol=10.0 * size)


def _pulse(y: Any, p: Any, d: Any) -> None:
    d[0], d[1] = 1.0 / ca.cosh(p[0] * (y[1] - 1.0)) - y[0], 1.0


def _pulse_slope(y: Any, p: Any, v: Any, d: Any) -> None:
    c = ca.cosh(p[0] * (y[1] - 1.0))
    rate = -p[0] * ca.sinh(p[0] * (y[1] - 1.0)) / (c * c)  # inf/inf far from the pulse
    for j in range(8):
        d[j] = rate * v[8 + j] - v[j]
        d[8 + j] = 0.0


PULSE, PULSE_SLOPE = kernels(_pulse, _pulse_slope)


def test_derivatives_that_overflow_do_not_stop_steps() -> None:
    """1/cosh(1e3) is zero and its derivative NaN: states at and inside steps, against SciPy."""
    at = np.linspace(0.0, 2.0, 41)
    run = integrate(
        Radau(1e-8, 1e-10, max_step=2e-3), PULSE, [1e3], [0.5, 0.0], 2.0, at, tangent=PULSE_SLOPE
    )
    assert len(run.knots) < 1200
    with np.errstate(over="ignore"):
        exact = solve_ivp(
            lambda t, y: 1.0 / np.cosh(1e3 * (t - 1.0)) - y,
            (0.0, 2.0), [0.5], "DOP853", at, rtol=1e-12, atol=1e-14, max_step=1e-3,
        )  # fmt: skip
    np.testing.assert_allclose(run.y[:, 0], exact.y[0], rtol=0, atol=1e-7)


def test_dense_output_of_signals_needs_max_step() -> None:
    """In closed form; inside long steps it is accurate only with `max_step`."""
    rate, t = 1e8, np.linspace(0.5, 10.0, 97)

    def exact(t: Array) -> Array:
        return np.asarray((rate**2 * np.cos(t) + rate * np.sin(t)) / (rate**2 + 1.0))

    def run(max_step: float) -> Solution:
        method = Radau(1e-6, 1e-6, max_step=max_step)
        return integrate(method, SERVO, [rate], [1.0, 0.0], 10.0, [], tangent=SERVO_SLOPE)

    for max_step, bounds in ((np.inf, (1e-2, 1.0)), (0.1, (0.0, 1e-5))):
        traj = run(max_step)
        assert abs(traj.states[:, 0] - exact(traj.knots)).max() < 1e-5
        least, most = bounds
        assert least <= abs(traj.at(t)[:, 0] - exact(t)).max() < most


def test_batch_members_equal_single_runs() -> None:
    """For any number of threads; a failing member does not affect others."""
    rng = np.random.default_rng(1)
    y0, params = rng.normal(size=(9, 2)), 10.0 ** rng.uniform(0.0, 5.0, size=(9, 1))
    params[4] = np.nan
    for threads in (1, 3):
        many = integrate_many(
            Radau(), POL, params, y0, 4.0, TIMES, threads=threads, tangent=POL_SLOPE
        )
        assert many.ok.tolist() == [k != 4 for k in range(9)]
        assert STATUS[int(many.status[4])] == "not finite"
        for k in np.flatnonzero(many.ok).tolist():
            one = integrate(Radau(), POL, params[k], y0[k], 4.0, TIMES, tangent=POL_SLOPE)
            assert np.array_equal(many.y[k], one.y)
    system = pinred.load("falling_cat")
    several = pinred.simulate_many(system, seeds=range(3), duration=0.5, method=Radau())
    for k in range(3):
        alone = pinred.simulate(system, seed=k, duration=0.5, method=Radau())
        assert np.array_equal(several[k].x, alone.x)


def test_failures_raise_specific_errors() -> None:
    """A blow-up, a non-finite rate, too many steps, no derivative."""
    with pytest.raises(StepSizeUnderflow, match="singular") as blown:
        integrate(Radau(), POWER, [1.0, 2.0], [1.0], 3.0, [], tangent=POWER_SLOPE)
    assert blown.value.time == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(NonFiniteState, match="number 2 is not finite") as edge:
        integrate(Radau(), EDGE, [], [0.0, 0.0, 0.0], 3.0, [], tangent=EDGE_SLOPE)
    assert edge.value.entry == 2
    assert 0.5 - 1e-6 < edge.value.time <= 0.5
    with pytest.raises(NonFiniteState) as start:
        integrate(Radau(), EDGE, [], [1.0, 0.0, 0.0], 3.0, [], tangent=EDGE_SLOPE)
    assert (start.value.entry, start.value.time) == (2, 0.0)
    with pytest.raises(TooManySteps, match="max_steps") as many:
        pol(Radau(max_steps=5), [])
    assert 0.0 < many.value.time < 4.0
    steps = pol(Radau(), []).steps
    assert pol(Radau(max_steps=10**6, max_step=0.01), []).steps > max(steps, 399)
    with pytest.raises(InputError, match="Radau needs the derivative of the kernel"):
        integrate(Radau(), POL, [1.0], [2.0, 0.0], 1.0, [])
    for wrong in ({"rtol": 0.0}, {"atol": -1.0}, {"max_steps": 0}, {"max_step": np.nan}):
        with pytest.raises(InputError):
            Radau(**wrong)


@pytest.mark.parametrize("t_end", [1e-300, 1e-15])
def test_tiny_end_time_hardly_moves_state(t_end: float) -> None:
    """The run takes few steps."""
    run = integrate(Radau(), POWER, [1.0, 1.0], [1.0], t_end, [0.0, t_end], tangent=POWER_SLOPE)
    assert run.knots[-1] == t_end
    assert abs(run.y - 1.0).max() < 2e-15


def test_equilibrium_takes_few_steps() -> None:
    """A state at rest stays at rest."""
    run = integrate(Radau(), POWER, [1.0, 1.0], [0.0], 1e3, [1e3], tangent=POWER_SLOPE)
    assert run.y.tolist() == [[0.0]]
    assert run.steps < 5


def test_ctrl_c_interrupts_soon() -> None:
    """KeyboardInterrupt leaves the run within a short time."""
    main = threading.main_thread().ident
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        timer = threading.Timer(0.1, signal.pthread_kill, (main, signal.SIGINT))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            pol(Radau(max_steps=10**7, max_step=1e-6), [], end=10.0)
        timer.join()
    finally:
        signal.signal(signal.SIGINT, before)


def test_coefficients_are_those_of_scipy() -> None:
    """All bits are equal; SciPy's module is not imported, because it loads slowly."""
    assert tuple(book.C) == (radau_iia.C1, radau_iia.C2, 1.0)
    errors = (radau_iia.E1, radau_iia.E2, radau_iia.E3)
    assert errors == tuple(book.E)
    assert radau_iia.GAMMA == book.MU_REAL
    assert complex(radau_iia.ALPHA, radau_iia.BETA) == book.MU_COMPLEX
    assert np.array_equal(radau_iia.T, book.T)
    assert np.array_equal(radau_iia.T_INVERSE, book.TI)
