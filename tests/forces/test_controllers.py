"""Feedback: PD and computed torque in closed form and by ABA, limits, sampled controllers."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import aba
import casadi as ca
import numpy as np
import pytest
from forced_trees import against_aba, tree

import pinred
from pinred.common.arrays import Array
from pinred.forces import PD, ComputedTorque, Controller, Damper, Limit, Spring, Torque
from pinred.lie import GROUPS
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Expression, Fourier, Signal, Spline

SATELLITE = pinred.load("satellite_two_arms")
ARMS = SATELLITE.shape_names
GOAL = np.array([1.0, -0.4, 0.8, 0.5, -0.6, -0.2])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("limit", ["hard", "smooth", pytest.param(None, marks=pytest.mark.by_hand)])
@pytest.mark.sampled(4)
def test_pd_equals_aba(limit: str | None, engine: Engine) -> None:
    """PD to a fixed shape and along a plan, within limits, against ABA under the same law."""
    most = dict(zip(ARMS, [0.5, 0.6, 0.7, 0.8, 0.9, 1.0], strict=True))
    bound = Limit(most, smooth=limit == "smooth") if limit else None
    plan: dict[str, Signal | float] = {n: float(g) for n, g in zip(ARMS, GOAL, strict=True)}
    plan[ARMS[2]] = Fourier(0.3, [], [0.5], 2.0)
    force = PD(plan, 4.0, {name: 2.0 + k for k, name in enumerate(ARMS)}, limit=bound)
    options: dict[str, Any] = {"duration": 1.0, "rtol": 1e-9, "atol": 1e-11}
    traj = pinred.simulate(SATELLITE, momentum=0, forces=[force], engine=engine, **options)
    size, kd = np.array(list(most.values())), 2.0 + np.arange(6.0)

    def torque(t: float, x: Array, xdot: Array) -> Array:
        goal, rate = GOAL.copy(), np.zeros(6)
        goal[2], rate[2] = 0.3 + 0.5 * np.sin(np.pi * t), 0.5 * np.pi * np.cos(np.pi * t)
        torque_demand = 4.0 * (goal - x) + kd * (rate - xdot)
        if limit == "smooth":
            return np.asarray(size * np.tanh(torque_demand / size))
        return np.clip(torque_demand, -size, size) if limit else torque_demand

    def tau(t: float, q: Array, v: Array) -> Array:
        return np.append(np.zeros(6), torque(t, q[7:], v[6:]))

    assert against_aba(traj, tau) < 1e-6
    model = traj.scene.force_model
    assert model is not None
    samples, numbers = traj.motion.samples(traj.t)
    acting = model.acting(samples.force_inputs(traj.t, numbers)).torque
    expected = [torque(t, x, v) for t, x, v in zip(traj.t, traj.x, traj.xdot, strict=True)]
    np.testing.assert_allclose(acting, expected, atol=1e-7)
    saturated = np.abs(acting) > 0.99 * size
    assert saturated.any() or limit is None
    if limit:
        assert (np.abs(acting) <= size).all()
    about = aba.momentum_about_com(SATELLITE.model, traj.q, traj.v)
    np.testing.assert_allclose(about, 0.0, atol=1e-12)


# PD control under limits is compared with ABA, and this judge passes a PD law on balls.
@pytest.mark.by_hand
@pytest.mark.slow
def test_compare_passes_with_pd() -> None:
    """With hard limits that are active."""
    plan = dict(zip(ARMS, GOAL.tolist(), strict=True))
    force = PD(plan, 4.0, 2.0, limit=Limit(0.7))
    report = pinred.compare(pinred.simulate(SATELLITE, duration=0.3, forces=[force]))
    assert report.passed, str(report)


def closed_form(error: float, rate: float, kp: float, kd: float, t: Array) -> Array:
    """Return e(t) of ë + kd ė + kp e = 0."""
    a, b = np.roots([1.0, kd, kp]).astype(complex)
    A = (rate - b * error) / (a - b)
    return np.asarray((A * np.exp(a * t) + (error - A) * np.exp(b * t)).real)


# Both engines run by default on other groups.
@pytest.mark.by_hand("R-compiled")
@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.sampled(8)
def test_computed_torque_error_equals_closed_form(group: str, engine: Engine) -> None:
    """ë + kd ė + kp e = 0 per joint, with springs, dampers, gravity and prescribed joints."""
    # About the vertical, gravity acts on the shape.
    pendulum = pinred.load("double_spherical_pendulum")
    system = pendulum if group == "SO2" else tree(group, 3, 2)
    if group == "SO3":
        system = pinred.load(system.model, gravity=(0.0, 0.0, 0.0))
    a, b, c = system.shape_names
    gains = {a: (9.0, 2.0), b: (16.0, 10.0), c: (25.0, 4.0)}
    plan: dict[str, Signal | float] = {
        a: Expression("0.4*sin(2*t)"), b: Fourier(0.1, [0.2], [], 1.5), c: -0.3
    }  # fmt: skip
    other_forces = [
        Spring(a, 3.0, 0.2),
        Damper(b, 0.5, to=c),
        Torque(lambda t, x, xdot, mu: {c: ca.sin(t) * x[0] + xdot[1] + mu[-1]}),
    ]
    driven: list[dict[str, Signal]] = [{}, {b: Fourier(0.0, [], [0.4], 2.0)}]
    for prescribed_joints in driven:
        kp, kd = ({n: g[i] for n, g in gains.items()} for i in (0, 1))
        references = {
            name: signal for name, signal in plan.items() if name not in prescribed_joints
        }
        traj = pinred.simulate(
            system, seed=3, duration=1.0, engine=engine, prescribed=prescribed_joints,
            forces=[ComputedTorque(references, kp, kd), *other_forces],
        )  # fmt: skip
        for k, name in enumerate(system.shape_names):
            if name in prescribed_joints:
                continue
            goal = plan[name]
            path = goal.value(traj.t) if isinstance(goal, Signal) else np.full(201, goal)
            start = goal.rate(0.0) if isinstance(goal, Signal) else 0.0
            error = traj.x[:, k] - path
            expected = closed_form(error[0], float(traj.xdot[0, k] - start), *gains[name], traj.t)
            np.testing.assert_allclose(error, expected, atol=1e-8)
    if engine == "compiled":
        np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-6)


def law(t: float, x: Array, xdot: Array) -> Array:
    """A controller that is no expression: integer steps and a switch."""
    torques = np.round(5.0 * (0.5 - x)) * 0.2 - 0.3 * np.sign(xdot)
    return np.asarray(torques if t < 0.5 else -torques)


@pytest.mark.parametrize("period", [0.1, 0.17, 5.0])
@pytest.mark.sampled
def test_controller_holds_torques_between_samples(period: float) -> None:
    """Called at k·period with the state, then constant: ABA with one solve per period."""
    system = SATELLITE
    model, data = system.model, system.model.createData()
    calls: dict[str, list[tuple[float, Array, Array, Array]]] = {}
    runs = {}
    for engine in ENGINES:
        samples: list[tuple[float, Array, Array, Array]] = []

        def control(t: float, x: Array, xdot: Array, mu: Array, samples: Any = samples) -> Array:
            samples.append((t, x, xdot, mu))
            return law(t, x, xdot)

        controller = Controller(control, period)
        runs[engine] = pinred.simulate(system, duration=1.0, forces=[controller], engine=engine)
        calls[engine] = list(samples)
    ends = np.append(period * np.arange(int(np.ceil(1.0 / period - 1e-9))), 1.0)
    q, v = runs["compiled"].q[0], runs["compiled"].v[0]
    for traj in runs.values():
        assert [t for t, *_ in calls[traj.run.engine]] == pytest.approx(ends[:-1], abs=1e-12)
    for k, (start, end) in enumerate(pairwise(ends)):
        tau = np.append(np.zeros(6), law(start, q[7:], v[6:]))
        for engine in ENGINES:
            _, x, xdot, mu = calls[engine][k]
            np.testing.assert_allclose(x, q[7:], atol=1e-7)
            np.testing.assert_allclose(xdot, v[6:], atol=1e-7)
            np.testing.assert_allclose(mu, aba.body_momentum(model, data, q, v), atol=1e-8)
        times = np.array([0.0, end - start])
        segment = aba.integrate(model, q, v, times, lambda *_, tau=tau: tau, rtol=1e-10)
        q, v = segment[0][-1], segment[1][-1]
        for traj in runs.values():
            assert aba.max_difference(model, q[None], traj(float(end)).q[None]) < 1e-6
    for traj in runs.values():
        np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8)


@pytest.mark.slow
def test_two_controllers_with_a_table() -> None:
    """Separate periods and joints, by names, and a table; compare passes."""
    system = pinred.load("planar_chain5")
    names = system.shape_names
    times: list[float] = []

    def first(t: float, x: Array, *_: Array) -> dict[str, float]:
        times.append(t)
        return {names[0]: -float(np.sign(x[0]))}

    forces = [
        Controller(first, 0.25, (names[0], names[2])),
        Controller(lambda *_: [0.3], 0.1, (names[1],), limit=Limit(0.2)),
        Torque({names[3]: Spline([0.0, 0.33, 1.0], [0.0, 0.5, 0.0])}),
    ]
    traj = pinred.simulate(system, duration=1.0, forces=forces)
    assert times == pytest.approx([0.0, 0.25, 0.5, 0.75])
    assert {0.1, 0.25, 0.33, 0.5} <= {round(float(t), 12) for t in traj.motion.knots}
    report = pinred.compare(traj)
    assert report.passed, str(report)
    work = traj.energy_balance.work[-1, 1]
    assert work == pytest.approx(0.2 * (traj.x[-1, 1] - traj.x[0, 1]), abs=1e-9)


# Controllers are compared with ABA and with closed forms of their recursions.
@pytest.mark.by_hand
def test_fast_controller_approaches_continuous_damper() -> None:
    """A thousand samples of a damper."""
    system = pinred.load("elroys_beanie")
    count = 0

    def damp(_t: float, _x: Array, xdot: Array, _mu: Array) -> Array:
        nonlocal count
        count += 1
        return -0.8 * xdot

    traj = pinred.simulate(system, duration=1.0, forces=[Controller(damp, 1e-3)])
    assert count == 1000
    assert traj.run.steps >= 1000
    # ẋ⁺ = ẋ (1 − c T/M) over each period, M = 2/3.
    expected = -0.4 * (1 - 0.8e-3 * 1.5) ** np.arange(0, 1001, 5)
    np.testing.assert_allclose(traj(np.linspace(0, 1, 201)).xdot[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("gives", "message"),
    [
        ([np.nan], r"1 finite torques \(beanie\), but returned \[nan\] at t = 0\.5 s"),
        ([1.0, 2.0], r"must return 1 finite torques"),
        (None, r"must return 1 finite torques"),
        ("up", "torque: expected .* got 'up'"),
        ({"nose": 1.0}, "returned a torque for 'nose' at t = 0.5 s; its joints are beanie"),
    ],
)
@pytest.mark.sampled
def test_invalid_controller_results_are_rejected(gives: Any, message: str, engine: Engine) -> None:
    """The message has the result and the time."""
    controller = Controller(lambda t, *_: [0.0] if t < 0.4 else gives, 0.5)
    with pytest.raises(pinred.InputError, match=message):
        pinred.simulate(pinred.load("elroys_beanie"), forces=[controller], engine=engine)


@pytest.mark.parametrize("engine", ENGINES)
def test_controller_exceptions_propagate(engine: Engine) -> None:
    """A user's exception is not replaced."""

    def fails(t: float, *_: Array) -> list[float]:
        if t > 0.7:
            raise KeyError("gain")
        return [0.0]

    with pytest.raises(KeyError, match="gain"):
        pinred.simulate(
            pinred.load("elroys_beanie"), forces=[Controller(fails, 0.25)], engine=engine
        )
