"""Gauss's methods: tables against closed forms, measured orders, preserved structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import sqrt
from typing import Any

import casadi as ca
import numpy as np
import pytest
from orbits import kepler_orbit
from orders import ROBOTS, errors_at_the_end, fit_order

import pinred
from pinred import DOP853, AdaptiveGauss, Gauss
from pinred.common.arrays import Array
from pinred.common.errors import NoConvergence, NonFiniteState, TooManySteps
from pinred.common.machine_code import NativeCode, load_object
from pinred.integrators.implicit import gauss_fixed_step as gauss
from pinred.integrators.implicit.gauss_stages import tables
from pinred.integrators.integrate import Solution, integrate
from pinred.integrators.integrate_many import integrate_many
from pinred.integrators.stepping import run_state
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.kernels import build
from pinred.kernels.build import tangent_of, wide_rate
from pinred.kernels.kernel import Kernel
from pinred.kernels.machine.native import compile_object
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of

ORDERS = (2, 4, 6, 8)


@cache
def code(name: str, lanes: int) -> NativeCode:
    """Compile a vector field at several states at once."""
    y, p = ca.SX.sym("y", 4), ca.SX.sym("p", 1)
    r3 = ca.power(y[0] ** 2 + y[1] ** 2, 1.5)
    fields = {
        "kepler": ca.vertcat(y[2], y[3], -p * y[0] / r3, -p * y[1] / r3),
        "edge": ca.vertcat(1.0, p, 0.0, ca.sqrt(0.5 - y[0])),
        "stiff": ca.vertcat(-p * (y[0] - ca.cos(y[3])), 0.0, 0.0, 1.0),
        "spring": ca.vertcat(y[1] * (1.0 + p * y[0]), -y[0], 0.0, 0.0),
    }
    function = ca.Function("f", [y, p], [ca.densify(fields[name])])
    return load_object(compile_object(function, "f", wide=lanes), "f")


def run(name: str, method: Any, y0: Any, end: float, times: Any = None, p: float = 1.0) -> Solution:
    """Integrate one of the fields above."""
    address = code(name, method.lanes).address
    return integrate(method, address, [p], y0, end, [end] if times is None else times)


ORBIT = kepler_orbit(0.3, np.zeros(1))[0]


def test_tables_of_one_to_three_stages_equal_closed_forms() -> None:
    """The midpoint rule, and Hammer and Hollingsworth's and Kuntzmann's tables."""
    (one,) = tables(1).mu[:1, 0]
    assert (one, tables(1).c[0], tables(1).b[0]) == (0.5, 0.5, 1.0)
    r = sqrt(3) / 6
    two = np.array([[1 / 4, 1 / 4 - r], [1 / 4 + r, 1 / 4]])
    np.testing.assert_allclose(tables(2).mu[:2, :2] * tables(2).b[:2], two, atol=1e-16)
    r = sqrt(15)
    three = [
        [5 / 36, 2 / 9 - r / 15, 5 / 36 - r / 30],
        [5 / 36 + r / 24, 2 / 9, 5 / 36 - r / 24],
        [5 / 36 + r / 30, 2 / 9 + r / 15, 5 / 36],
    ]
    np.testing.assert_allclose(tables(3).mu[:3, :3] * tables(3).b[:3], three, atol=2e-16)


@pytest.mark.parametrize("stages", range(1, 9))
def test_tables_satisfy_collocation_and_symplectic_conditions(stages: int) -> None:
    """Powers are integrated exactly; the symplectic condition holds in every bit."""
    table = tables(stages)
    mu, b, c = table.mu[:stages, :stages], table.b[:stages], table.c[:stages]
    for k in range(stages):
        np.testing.assert_allclose((mu * b) @ c**k, c ** (k + 1) / (k + 1), atol=1e-15)
    for k in range(2 * stages):
        assert b @ c**k == pytest.approx(1 / (k + 1), abs=1e-15)
    assert (mu + mu.T == 1.0).all()
    highest = np.polynomial.legendre.Legendre.basis(stages - 1, domain=[0, 1])
    assert table.last[:stages] @ (b * (3.0 * highest(c))) == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("robot", ["double_spherical_pendulum", "falling_cat"])
@pytest.mark.sampled(4)
def test_gauss_has_its_order(robot: str, order: int) -> None:
    """Order in shape and attitude together, against ABA on the full state."""
    counts = {2: [60, 90, 130, 190], 4: [30, 42, 60, 85], 6: [14, 18, 24, 32], 8: [12, 15, 18, 22]}
    make_method: Callable[[float], Gauss] = lambda step: Gauss(step, order)  # noqa: E731
    errors = np.hypot(*errors_at_the_end(robot, make_method, counts[order]))
    orders = fit_order(errors.tolist(), [1 / count for count in counts[order]])
    assert orders == pytest.approx(Gauss(0.1, order).order, abs=0.3)


@pytest.mark.parametrize("order", [2, 6, 16])
def test_dense_output_has_order_of_method(order: int) -> None:
    """States inside steps are as accurate as those at step ends."""
    step = {2: 0.01, 6: 0.1, 16: 0.5}[order]
    end, times = 20 * step, np.linspace(0.0, 20 * step, 41)
    solution = run("kepler", Gauss(step, order), ORBIT, end, times)
    error = np.abs(solution.y - kepler_orbit(0.3, times)).max(axis=1)
    assert error[1::2].max() < 2.0 * error[::2].max() + 1e-14
    np.testing.assert_allclose(solution.at(times[::-1]), solution.y[::-1], rtol=0, atol=1e-13)
    assert solution.steps == 20
    assert solution.method.dense_order == order


@pytest.mark.by_hand("2", "6", "12")
@pytest.mark.parametrize("order", [2, 4, 6, 8, 12])
def test_kepler_orbits_keep_momentum_and_energy(order: int) -> None:
    """Over 1000 orbits angular momentum stays at round-off and the energy error does not grow."""
    steps = {2: 200, 4: 60, 6: 40, 8: 30, 12: 20}[order]
    orbits = 1000
    end = 2 * np.pi * orbits
    times = np.linspace(0.0, end, orbits * 8 + 1)
    y = run("kepler", Gauss(2 * np.pi / steps, order), ORBIT, end, times).y
    turning = y[:, 0] * y[:, 3] - y[:, 1] * y[:, 2]
    assert np.abs(turning / turning[0] - 1).max() < 2e-14
    energy = (y[:, 2] ** 2 + y[:, 3] ** 2) / 2 - 1 / np.hypot(y[:, 0], y[:, 1])
    error = np.abs(energy - energy[0]).reshape(-1)[1:].reshape(10, -1).max(axis=1)
    assert error[-1] < 1.2 * error[0] + 1e-14
    # DOP853 with as large an error in its energy drifts.
    loose = DOP853(rtol=1e-4, atol=1e-6)
    other = integrate(loose, code_alone().address, [1.0], ORBIT, end, times).y
    energy = (other[:, 2] ** 2 + other[:, 3] ** 2) / 2 - 1 / np.hypot(other[:, 0], other[:, 1])
    drift = np.abs(energy - energy[0])[1:].reshape(10, -1).max(axis=1)
    assert drift[-1] > 5 * drift[0]


@cache
def code_alone() -> NativeCode:
    """Compile Kepler's field at one state."""
    y, p = ca.SX.sym("y", 4), ca.SX.sym("p", 1)
    r3 = ca.power(y[0] ** 2 + y[1] ** 2, 1.5)
    rate = ca.vertcat(y[2], y[3], -p * y[0] / r3, -p * y[1] / r3)
    return load_object(compile_object(ca.Function("f", [y, p], [rate]), "f"), "f")


def flow_of(robot: str, method: Any, **options: Any) -> CompiledFlow:
    """Return the flow of a robot's scene."""
    system = pinred.load(robot)
    return CompiledFlow.of_plan(
        plan_of(pinred.Scene(system=system, times=[1.0], method=method, **options))
    )


def integrate_state(flow: CompiledFlow, method: Any, y0: Array, end: float) -> Array:
    """Integrate a reduced state with a method."""
    quaternions, address = flow.kernel.layout.quaternions, flow.address(method)
    solution = integrate(method, address, flow.parameters, y0, end, [end], quaternions)
    return np.asarray(solution.y[0])


def jacobian(f: Callable[[Array], Array], at: Array) -> Array:
    """Return the derivative of f by central differences of order four."""
    columns = []
    for k in range(len(at)):
        e = np.zeros(len(at))
        e[k] = 1e-3
        columns.append(
            (8 * (f(at + e) - f(at - e)) - (f(at + 2 * e) - f(at - 2 * e))) / (12 * e[k])
        )
    return np.transpose(columns)


def test_gauss_map_is_symplectic_at_zero_momentum() -> None:
    """DᵀJD = J for the map of (x, π). DOP853's map is not symplectic."""
    flow = flow_of("cartpole", Gauss(0.2, 4), seed=2)
    layout = flow.kernel.layout
    m = len(layout.active)

    def defect(method: Any) -> float:
        D = jacobian(lambda y: integrate_state(flow, method, y, 1.0), flow.y0)[: 2 * m, : 2 * m]
        J = np.block([[np.zeros((m, m)), np.eye(m)], [-np.eye(m), np.zeros((m, m))]])
        return float(np.abs(D.T @ J @ D - J).max())

    assert defect(Gauss(0.2, 2)) < 1e-8
    assert defect(Gauss(0.2, 4)) < 1e-8
    assert defect(DOP853(rtol=1e3, atol=1e3, max_step=0.5)) > 1e-7


def poisson(pi_count: int, mu: Array) -> Array:
    """Return the structure of (x, π, μ): canonical, and {μ_a, μ_b} = −ε_abc μ_c."""
    n = 2 * pi_count
    B = np.zeros((n + 3, n + 3))
    B[:pi_count, pi_count:n] = np.eye(pi_count)
    B[pi_count:n, :pi_count] = -np.eye(pi_count)
    a, b, c = mu
    B[n:, n:] = [[0, -c, b], [c, 0, -a], [-b, a, 0]]
    return B


def test_gauss_map_is_poisson_with_momentum() -> None:
    """D B(z) Dᵀ = B(φ(z)) for z = (x, π, μ) by the lift, and |μ| is constant."""
    method = Gauss(0.25, 2)
    flow = flow_of("coupled_spatial", method, seed=4)
    layout = flow.kernel.layout
    assert flow.kernel.structure.lifted
    m, (at, _) = len(layout.active), layout.quaternions
    spin = flow.parameters[:3]

    def momentum(q: Array) -> Array:
        # q̄ J q, written out with numpy's matrices
        x, y, z, w = q
        R = np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), w * w - x * x + y * y - z * z, 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z],
            ]
        )
        return np.asarray(R.T @ spin)

    def reduced(y: Array) -> Array:
        return np.concatenate([y[: 2 * m], momentum(y[at : at + 4])])

    # Tangents of the reduced space, lifted: a change of μ is a turn of q, or of its length.
    y0 = flow.y0
    lift = jacobian(reduced, y0)
    D = jacobian(lambda y: raw_step(flow, method, y, 0.5), y0)
    y1 = raw_step(flow, method, y0, 0.5)
    down = jacobian(reduced, y1) @ D @ np.linalg.pinv(lift)
    before, after = reduced(y0), reduced(y1)
    np.testing.assert_allclose(
        down @ poisson(m, before[2 * m :]) @ down.T, poisson(m, after[2 * m :]), atol=2e-8
    )
    length = np.linalg.norm
    assert length(after[2 * m :]) == pytest.approx(length(before[2 * m :]), rel=1e-14)


def raw_step(flow: CompiledFlow, method: Gauss, y0: Array, end: float) -> Array:
    """Integrate a reduced state whose quaternion has any length."""
    solution = integrate(method, flow.address(method), flow.parameters, y0, end, [end])
    y1: Array = solution.y[0]
    return y1


def test_lifted_field_scales_with_quaternion_length() -> None:
    """At s q the lifted field has s² times the μ and s times the q̇; at |q| = 1 it is unchanged."""
    method = Gauss(0.1, 4)
    lifted, plain = (
        flow_of("satellite_two_arms", m, seed=1, momentum=None) for m in (method, "auto")
    )
    at, _ = lifted.kernel.layout.quaternions
    for s in (0.7, 1.0, 1.6):
        y = lifted.y0.copy()
        y[at : at + 4] *= s
        parameters = plain.parameters.copy()
        parameters[:3] *= s * s
        expected = plain.kernel.evaluate_rate(plain.y0, parameters)
        expected[at : at + 4] *= s
        rates = lifted.kernel.evaluate_rate(y, lifted.parameters)
        np.testing.assert_allclose(rates, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.by_hand("1e-09-solo12")
@pytest.mark.sampled
@pytest.mark.parametrize("robot", [*ROBOTS, "satellite_two_arms", "solo12", "rigid_body"])
@pytest.mark.parametrize("tolerance", [1e-5, 1e-9, 1e-13])
def test_adaptive_gauss_error_follows_tolerance(robot: str, tolerance: float) -> None:
    """Errors of AdaptiveGauss against ABA on the full state."""
    system = pinred.load(robot)
    end = ROBOTS.get(robot, 1.0)
    method = AdaptiveGauss(rtol=tolerance, atol=tolerance / 100)
    traj = pinred.simulate(system, seed=3, times=[end / 2, end], method=method)
    scene = traj.scene
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    truth = full.run(y0, scene.report_times, 2e-14, 1e-15)
    errors = full.distance(truth, FullMotion(x=traj.x, q=traj.q))
    error = max(errors.shape.max(), errors.rotation.max(), errors.position.max())
    assert error < 300 * tolerance + 3e-12
    assert traj.run.method == "AdaptiveGauss"


def test_order_16_on_kepler_orbits() -> None:
    """The error falls with the sixteenth power of the step, fixed or by tolerance."""
    start, end = kepler_orbit(0.6, np.zeros(1))[0], 20.0
    truth = kepler_orbit(0.6, np.array([end]))[0]
    steps = [28, 32, 36, 42, 48]
    errors = []
    for count in steps:
        solution = run("kepler", Gauss(end / count, 16), start, end)
        errors.append(float(np.abs(solution.y[0] - truth).max()))
    assert fit_order(errors, [1 / n for n in steps]) == pytest.approx(16, abs=1.5)
    counts, errors = [], []
    for tolerance in 10.0 ** -np.arange(4.0, 12.0):
        method = AdaptiveGauss(tolerance, tolerance / 100)
        solution = run("kepler", method, start, end)
        counts.append(1 / solution.steps)
        errors.append(float(np.abs(solution.y[0] - truth).max()))
    assert fit_order(errors, counts) > 12  # DOP853: 8


@pytest.mark.parametrize("robot", ["falling_cat", "rigid_body"])
@pytest.mark.parametrize("rtol", [1e-2, 1e-4, 1e-6])
def test_long_step_is_split_for_dense_output(robot: str, rtol: float) -> None:
    """A step without a good first guess has no solution, so it is split."""
    system = pinred.load(robot)
    traj = pinred.simulate(system, method=AdaptiveGauss(rtol, rtol / 100))
    times = np.random.default_rng(0).uniform(0.0, traj.t[-1], 2000)
    exact = pinred.simulate(system, times=np.unique(times), rtol=1e-12)
    states = traj(np.unique(times))
    assert np.abs(states.q - exact.q).max() < 100 * rtol
    assert np.abs(states.v - exact.v).max() < 1000 * rtol


def test_pauses_do_not_change_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that pauses at every step and enlarges its arrays gives the same bits."""
    for method in (Gauss(0.1), AdaptiveGauss(1e-9, 1e-11)):
        times = np.linspace(0, 6, 17)
        uninterrupted = run("kepler", method, ORBIT, 6.0, times)
        with monkeypatch.context() as patch:
            patch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 1)
            fractions: list[float] = []
            address = code("kepler", method.lanes).address
            again = integrate(method, address, [1.0], ORBIT, 6.0, times, progress=fractions.append)
        assert (again.y == uninterrupted.y).all()
        assert (again.states == uninterrupted.states).all()
        assert len(fractions) >= uninterrupted.steps


@pytest.mark.parametrize("tolerance", [1e-3, 1e-9, 1e-13])
def test_report_times_do_not_change_steps(tolerance: float) -> None:
    """Steps equal those of a run without reports, to the last bit."""
    method = AdaptiveGauss(tolerance, tolerance / 100)
    alone, many = (run("kepler", method, ORBIT, 20.0, np.linspace(0, 20, k)) for k in (1, 201))
    assert (alone.knots == many.knots).all()
    assert (alone.states == many.states).all()


def test_batch_members_equal_single_runs() -> None:
    """Members equal single runs to the last bit; a failing member does not affect others."""
    rng = np.random.default_rng(5)
    y0 = kepler_orbit(0.3, rng.uniform(0, 6, 5))
    y0[2, 0] = 0.0
    y0[2, 1] = 1e-9  # falls into the centre
    y0[2, 2:] = 0.0
    for method in (Gauss(0.1), AdaptiveGauss(1e-9, 1e-11, max_steps=300)):
        address = code("kepler", method.lanes).address
        batch = integrate_many(method, address, np.ones((5, 1)), y0, 3.0, [1.0, 3.0], threads=2)
        assert batch.ok.tolist() == [True, True, False, True, True]
        for k in (0, 1, 3, 4):
            alone = integrate(method, address, [1.0], y0[k], 3.0, [1.0, 3.0])
            assert (batch.y[k] == alone.y).all()


def test_failures_raise_specific_errors() -> None:
    """Unsolved steps, non-finite rates and too many steps have their own errors."""
    with pytest.raises(NoConvergence, match="use shorter steps") as stopped:
        run("stiff", Gauss(0.1), [1.0, 0.0, 0.0, 0.0], 1.0, p=1e3)
    assert stopped.value.time == 0.0
    with pytest.raises(NonFiniteState, match="number 3"):
        run("edge", Gauss(0.1), np.zeros(4), 1.0)
    with pytest.raises(NonFiniteState, match="number 3"):
        run("edge", AdaptiveGauss(), np.zeros(4), 1.0)
    with pytest.raises(TooManySteps):
        run("kepler", AdaptiveGauss(max_steps=3), ORBIT, 30.0)
    orders: list[Any] = [5, 6.0, True, "6"]
    for order in orders:
        with pytest.raises(pinred.InputError, match="order must be one of 2, 4"):
            Gauss(0.1, order)
    solver: Any = ["auto"]
    with pytest.raises(pinred.InputError, match="solver must be one of auto"):
        Gauss(0.1, 6, solver)
    for step in (1e-13, 1e-300, 5e-324):
        with pytest.raises(pinred.InputError, match="Choose a longer step"):
            run("kepler", Gauss(step), ORBIT, 1.0)


@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("start", [(1.0, 0.0), (0.0, 1.0), (1.0, 1e-9)])
@pytest.mark.parametrize("coupling", [0.0, 1e-12, 1e-6, 1e-3])
def test_steps_from_rest_converge_to_round_off(
    order: int, start: tuple[float, float], coupling: float
) -> None:
    """Positions and momenta change alternately, so one iteration without change is not the last."""
    x0, v0 = start
    method = tables(order // 2)
    mu, b = method.mu[: order // 2, : order // 2], method.b[: order // 2]
    for h in (0.01, 0.03, 0.3):
        x, v = np.full(len(b), x0), np.full(len(b), v0)
        for _ in range(100):
            dx, dv = h * b * v * (1.0 + coupling * x), -h * b * x
            x, v = x0 + mu @ dx, v0 + mu @ dv
        result = run("spring", Gauss(h, order), [x0, v0, 0.0, 0.0], h, p=coupling).y[0, :2]
        np.testing.assert_allclose(result, [x0 + dx.sum(), v0 + dv.sum()], rtol=0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "rate"), [(4, 16.0), (4, 24.0), (4, 26.0), (6, 32.0), (16, 80.0)]
)
def test_slow_iterations_converge_to_round_off(order: int, rate: float) -> None:
    """Changes decrease in waves; step ends and dense output equal the linear solution."""
    times, h = np.linspace(0.0, 1.0, 333), 0.1
    method = Gauss(h, order, "fixed point")
    solution = run("stiff", method, [1.0, 0.0, 0.0, 0.0], 1.0, times, p=rate)
    table, s = tables(order // 2), order // 2
    A, b, c = table.mu[:s, :s] * table.b[:s], table.b[:s], table.c[:s]

    def integrate_state(k: int, length: float) -> float:
        y, t = solution.states[k, 0], solution.states[k, 3]
        f = -rate * (y - np.cos(t + length * c))
        return float(y + length * b @ np.linalg.solve(np.eye(s) + length * rate * A, f))

    before = np.minimum(np.searchsorted(solution.knots, times, side="right") - 1, 9)
    exact = [integrate_state(k, t - solution.knots[k]) for k, t in zip(before, times, strict=True)]
    for y in (solution.y, solution.at(times)):
        np.testing.assert_allclose(y[:, 0], exact, rtol=0, atol=3e-13)
    ends = [integrate_state(k, h) for k in range(10)]
    np.testing.assert_allclose(solution.states[1:, 0], ends, rtol=0, atol=3e-13)


@pytest.mark.by_hand
def test_unsolved_dense_output_raises() -> None:
    """The result is an error instead of NaN."""
    solution = replace(run("kepler", Gauss(0.1), ORBIT, 1.0), params=np.array([np.nan]))
    assert (solution.at([0.0, 0.5]) == solution.states[[0, 5]]).all()
    with pytest.raises(NoConvergence, match=r"t = 0.55 s, inside a step.*shorter") as stopped:
        solution.at([0.95, 0.55])
    assert (stopped.value.state == solution.states[5]).all()


def test_stiff_decay_shortens_steps() -> None:
    """Where the iteration does not converge, the step is shortened."""
    solution = run("stiff", AdaptiveGauss(1e-9, 1e-11), [1.0, 0.0, 0.0, 0.0], 0.5, p=200.0)
    t, k = 0.5, 200.0
    exact = (k * k * np.cos(t) + k * np.sin(t)) / (k * k + 1) + np.exp(-k * t) / (k * k + 1)
    assert solution.y[0, 0] == pytest.approx(exact, abs=1e-8)


@pytest.mark.slow
def test_wide_kernels_are_validated() -> None:
    """All lanes agree with Pinocchio's equations of motion."""
    for robot in ("falling_cat", "solo12"):
        flow = flow_of(robot, Gauss(0.1), seed=2)
        for lanes in (4, 8):
            assert wide_rate(flow.kernel, lanes) is wide_rate(flow.kernel, lanes)


@pytest.mark.parametrize("make", [lambda k: wide_rate(k, 4), tangent_of])
def test_two_threads_share_compiled_code(
    make: Callable[[Kernel], NativeCode], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second thread uses the code of the first, which may already be running."""
    system = pinred.load("coupled_planar")
    kernel = CompiledFlow.of_plan(plan_of(pinred.Scene(system=system, seed=1, times=[1.0]))).kernel
    codes: list[NativeCode] = []

    def load(code: bytes, name: str) -> NativeCode:
        monkeypatch.undo()
        codes.append(make(kernel))  # what another thread does meanwhile
        return load_object(code, name)

    monkeypatch.setattr(build, "load_object", load)
    assert make(kernel) is codes[0]
    assert make(kernel) is codes[0]


def test_gauss_attributes_state_its_properties() -> None:
    """Name, order, adaptivity and symplecticity."""
    assert (Gauss(0.1, 6).name, Gauss(0.1, 6).symplectic, Gauss(0.1, 6).adaptive) == (
        "Gauss6",
        True,
        False,
    )
    assert (AdaptiveGauss().symplectic, AdaptiveGauss().adaptive) == (False, True)
    assert Gauss(0.1)._stepper().loops is gauss.LOOPS
