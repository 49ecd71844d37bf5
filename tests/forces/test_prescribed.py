"""Prescribed joints: reconstruction, the torques of their drives, and their energy."""

from __future__ import annotations

from typing import Any

import aba
import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from forced_trees import tree
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from strategies import groups, seeds

import pinred
from pinred.common.arrays import Array
from pinred.forces import Damper, Spring, Torque, Wrench
from pinred.lie import GROUPS
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Expression, Fourier, Signal, Spline
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.pinocchio_engine import PinocchioFlow
from pinred.simulation.plan import plan_of
from pinred.system.find_robot_files import has_example_robots


def wave(k: int) -> Fourier:
    """A smooth plan, different for each joint."""
    return Fourier(0.2 - 0.1 * k, [0.1], [0.3 + 0.1 * k, -0.2], 2.0 + 0.3 * k)


def signals_of(scene: pinred.Scene) -> list[Signal]:
    """Return the motions of the prescribed joints."""
    return [signal for signal in scene.prescribed.values() if isinstance(signal, Signal)]


def accelerations(traj: pinred.Trajectory, driven: list[int], tau: Array, t: int) -> Array:
    """Return the acceleration (n,) at a report time, of the full model with prescribed joints."""
    model, r = traj.system.model, traj.system.r
    data = model.createData()
    q, v = traj.q[t], traj.v[t]
    H = np.triu(pin.crba(model, data, q))
    H = H + np.triu(H, 1).T
    fixed = r + np.array(driven)
    free = np.setdiff1d(np.arange(model.nv), fixed)
    signals = signals_of(traj.scene)
    a = np.empty(model.nv)
    a[fixed] = [float(s.acceleration(traj.t[t])) for s in signals]
    residual = tau - pin.nonLinearEffects(model, data, q, v) - H[:, fixed] @ a[fixed]
    a[free] = np.linalg.solve(H[np.ix_(free, free)], residual[free])
    return a


def drives(traj: pinred.Trajectory, driven: list[int], tau: Array, t: int) -> Array:
    """Return the torques of the drives at a report time, by pin.rnea on the full model."""
    model = traj.system.model
    a = accelerations(traj, driven, tau, t)
    full = pin.rnea(model, model.createData(), traj.q[t], traj.v[t], a) - tau
    return np.asarray(full[traj.system.r + np.array(driven)])


# Each subset and each group occurs in the other cases.
@pytest.mark.by_hand("driven1-SO3")
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize(
    "driven",
    [[2, 0], [0, 1, 2], *(pytest.param(k, marks=pytest.mark.by_hand) for k in ([0], [1, 2]))],
)
@pytest.mark.sampled(3)
def test_any_subset_of_prescribed_joints_equals_aba(group: str, driven: list[int]) -> None:
    """In any order, on both engines."""
    system = tree(group, 3, 5)
    names = system.shape_names
    plan = {names[k]: wave(k) for k in driven}
    scene = pinred.Scene(system=system, seed=4, duration=1.0, prescribed=plan, times=TIMES)
    traj = pinred.simulate(scene)
    other = pinred.simulate(scene, engine="pinocchio")
    for k, signal in zip(driven, plan.values(), strict=True):
        np.testing.assert_allclose(traj.x[:, k], signal.value(TIMES), rtol=0, atol=1e-13)
        np.testing.assert_allclose(traj.xdot[:, k], signal.rate(TIMES), rtol=0, atol=1e-12)
    q = full_motion(scene, driven)
    assert aba.max_difference(system.model, q, traj.q) < 1e-8
    assert aba.max_difference(system.model, q, other.q) < 1e-8


TIMES = np.linspace(0.0, 1.0, 11)


def full_motion(scene: pinred.Scene, driven: list[int]) -> Array:
    """Return Pinocchio's (T, nq) at TIMES, with the drive torques of pin.rnea."""
    system = scene.system
    model, data, r = system.model, system.model.createData(), system.r
    signals = signals_of(scene)
    driven_rows = r + np.array(driven)

    def tau(t: float, q: Array, v: Array) -> Array:
        H = np.triu(pin.crba(model, data, q))
        H = H + np.triu(H, 1).T
        a = np.empty(model.nv)
        free = np.setdiff1d(np.arange(model.nv), driven_rows)
        a[driven_rows] = [float(s.acceleration(t)) for s in signals]
        bias = pin.nonLinearEffects(model, data, q, v)
        a[free] = np.linalg.solve(
            H[np.ix_(free, free)], -(bias + H[:, driven_rows] @ a[driven_rows])[free]
        )
        torques = np.zeros(model.nv)
        torques[driven_rows] = pin.rnea(model, data, q, v, a)[driven_rows]
        return torques

    start = scene.start
    q0, v0 = system.q(start.pose, start.x), system.v(start.xi, start.xdot)
    return aba.integrate(model, q0, v0, TIMES, tau)[0]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("momentum", [False, True])
@pytest.mark.sampled(4)
def test_fully_prescribed_shape_is_reconstruction(momentum: bool, engine: Engine) -> None:
    """Only the orientation is integrated, by ξ = I⁻¹μ − A ẋ."""
    system = pinred.load("falling_cat")
    plan: dict[str, Signal] = {
        "bend": Expression("0.5*sin(2*t)"),
        "sway": wave(1),
        "twist": Spline(np.linspace(0, 1.6, 5), np.cos(np.arange(5.0))),
    }
    mu0 = np.array([0.0, 0.0, 0.0, 0.02, -0.01, 0.03]) * momentum
    scene = pinred.Scene(system=system, momentum=mu0, prescribed=plan, times=np.linspace(0, 1.6, 5))
    assert CompiledFlow.of_plan(plan_of(scene)).y0.size == 4 + 1  # and the clock
    assert PinocchioFlow(plan_of(scene)).y0.size == 4
    traj = pinred.simulate(scene, engine=engine)
    red, group = pinred.Reduction(system), system.group
    signals = [plan[name] for name in system.shape_names]
    J = group.spatial_momentum(group.identity(), mu0)

    def rate(t: float, g: Array) -> Array:
        t = min(t, 1.6)
        x = np.array([float(s.value(t)) for s in signals])
        xdot = np.array([float(s.rate(t)) for s in signals])
        pose = group.normalize(g)
        omega = np.linalg.solve(red.locked_inertia(x), group.Ad(pose).T @ J)
        return group.rate(pose, omega - red.local_connection(x) @ xdot)

    g0, poses = group.identity(), [group.identity()]
    for a, b in zip(traj.t[:-1], traj.t[1:], strict=True):  # the knots are among them
        g0 = solve_ivp(rate, (a, b), g0, method="DOP853", rtol=1e-10, atol=1e-11).y[:, -1]
        poses.append(group.normalize(g0))
    for g, h in zip(poses, traj.pose, strict=True):
        error = group.error(g, h)
        assert max(error.rotation, error.translation) < 1e-8
    if momentum and engine == "compiled":
        report = pinred.compare(traj)
        assert report.passed, str(report)


@pytest.mark.by_hand
@settings(max_examples=8)
@given(groups, seeds, st.integers(1, 4), st.data())
def test_driving_torques_equal_rnea(
    group: str, seed: int, joints: int, data: st.DataObject
) -> None:
    """Under gravity, forces and a wrench."""
    system = tree(group, joints, seed)
    names = system.shape_names
    driven = data.draw(st.lists(st.integers(0, joints - 1), min_size=1, unique=True))
    push = np.linspace(1.0, -0.5, system.r)
    forces = [
        Spring(names[0], 2.0, 0.3),
        Damper(names[-1], 0.4),
        Torque(lambda t, x, *_: {names[0]: ca.cos(3 * t) * x[-1]}),
        Wrench(push.tolist()),
    ]
    plan = {names[k]: wave(k) for k in driven}
    options: dict[str, Any] = {
        "seed": seed % 50,
        "prescribed": plan,
        "forces": forces,
        "duration": 0.5,
    }
    traj = pinred.simulate(system, times=[0.0, 0.2, 0.5], **options)
    other = pinred.simulate(system, times=[0.0, 0.2, 0.5], engine="pinocchio", **options)
    for t, time in enumerate(traj.t):
        tau = np.append(push, np.zeros(joints))
        x, xdot = traj.x[t], traj.xdot[t]
        tau[system.r] += np.cos(3 * time) * x[-1] - 2.0 * (x[0] - 0.3)
        tau[-1] -= 0.4 * xdot[-1]
        expected = drives(traj, driven, tau, t)
        scale = max(1.0, float(np.abs(expected).max()))
        for run in (traj, other):
            assert run.driving_torques[t] == pytest.approx(expected, abs=1e-7 * scale)
    balance = traj.energy_balance
    assert balance.labels[-1] == "prescribed joints"
    scale = max(1.0, float(np.abs(traj.energy).max()), float(np.abs(balance.work).max()))
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-7 * scale)
    shape = pinred.simulate(system, times=[0.0, 0.2, 0.5], outputs="shape", **options)
    np.testing.assert_allclose(shape.driving_torques, traj.driving_torques, atol=1e-6 * scale)


def test_torque_on_prescribed_joint_reduces_drive_torque() -> None:
    """The motion does not change."""
    system = pinred.load("falling_cat")
    plan = {name: wave(k) for k, name in enumerate(system.shape_names)}
    scene = pinred.Scene(system=system, momentum=0, prescribed=plan, duration=1.0, times=TIMES)
    bare = pinred.simulate(scene)
    pushed = pinred.simulate(scene, forces=[Torque({"sway": 0.7})])
    np.testing.assert_allclose(pushed.q, bare.q, rtol=0, atol=1e-12)
    less = pushed.driving_torques - bare.driving_torques
    np.testing.assert_allclose(less, np.tile([0.0, -0.7, 0.0], (11, 1)), atol=1e-12)
    expected = [drives(bare, [0, 1, 2], np.zeros(9), t) for t in range(11)]
    np.testing.assert_allclose(bare.driving_torques, expected, atol=1e-10)
    work = pushed.energy_balance.work
    np.testing.assert_allclose(work[:, 0], 0.7 * (bare.x[:, 1] - bare.x[0, 1]), atol=1e-10)
    np.testing.assert_allclose(pushed.energy_balance.residual, 0.0, atol=1e-10)


@pytest.mark.by_hand
@pytest.mark.parametrize("engine", ENGINES)
def test_splines_with_many_knots_equal_plan(engine: Engine) -> None:
    """A segment ends at each knot, and reported states at knots follow the motion."""
    system = pinred.load("planar_chain5")
    knots = np.linspace(0.0, 1.0, 51)
    rng = np.random.default_rng(3)
    plan = {
        "joint2": Spline(knots, 0.3 * np.sin(5 * knots) + 0.01 * rng.normal(size=51)),
        "joint4": Spline(knots[::5], np.cos(3 * knots[::5]), end="not-a-knot"),
    }
    plan = {system.shape_names[k]: s for k, s in zip((1, 3), plan.values(), strict=True)}
    scene = pinred.Scene(system=system, prescribed=plan, duration=1.0, times=knots)
    traj = pinred.simulate(scene, engine=engine)
    assert set(traj.motion.knots) >= set(knots)
    for k, signal in zip((1, 3), plan.values(), strict=True):
        np.testing.assert_allclose(traj.x[:, k], signal.value(knots), rtol=0, atol=1e-13)
    q0, v0 = traj.q[0], traj.v[0]
    model, data, entries = system.model, system.model.createData(), np.array([4, 6])

    def tau(t: float, q: Array, v: Array) -> Array:
        H = np.triu(pin.crba(model, data, q))
        H = H + np.triu(H, 1).T
        a, free = np.empty(8), np.setdiff1d(np.arange(8), entries)
        a[entries] = [float(s.acceleration(t)) for s in plan.values()]
        bias = pin.nonLinearEffects(model, data, q, v)
        a[free] = np.linalg.solve(H[np.ix_(free, free)], -(bias + H[:, entries] @ a[entries])[free])
        torques = np.zeros(8)
        torques[entries] = pin.rnea(model, data, q, v, a)[entries]
        return torques

    q, _ = aba.integrate(model, q0, v0, knots, tau, rtol=1e-10, stops=tuple(knots[1:-1]))
    assert aba.max_difference(model, q, traj.q) < 1e-7
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-7)
    expected = [drives(traj, [1, 3], np.zeros(8), t) for t in range(1, 50, 7)]
    np.testing.assert_allclose(traj.driving_torques[1:50:7], expected, atol=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(not has_example_robots(), reason="needs example-robot-data")
def test_solo12_in_free_fall_with_prescribed_legs() -> None:
    """The CoM path is a parabola; motion by ABA, torques by pin.rnea."""
    system = pinred.load("solo12")
    plan = {
        name: Fourier(0.3 * (-1) ** k, [0.1 * (k % 3)], [0.4], 0.8)
        for k, name in enumerate(system.shape_names)
    }
    xi0 = np.array([0.3, 0.1, 1.0, 0.5, -0.8, 0.4])
    traj = pinred.simulate(system, xi0=xi0, prescribed=plan, duration=0.2)
    model, data = system.model, system.model.createData()
    path = np.array([pin.centerOfMass(model, data, q).copy() for q in traj.q])
    pin.centerOfMass(model, data, traj.q[0], traj.v[0])
    t = traj.t[:, None]
    parabola = path[0] + data.vcom[0] * t + 0.5 * np.array([0, 0, -9.81]) * t**2
    np.testing.assert_allclose(path, parabola, atol=1e-12)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    expected = [drives(traj, list(range(12)), np.zeros(18), t) for t in range(0, 201, 20)]
    np.testing.assert_allclose(traj.driving_torques[::20], expected, atol=1e-9)
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8)
