"""Gravity on pivots and shapes: Lagrange's top in closed form, pinned chains against ABA."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import aba
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq
from strategies import seeds
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.scene.scene import ENGINES, Engine
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.pinocchio_engine import PinocchioFlow
from pinred.simulation.plan import plan_of

MASS, ARM, G = 2.0, 0.3, 9.81
C = 0.05  # about the axis
A = 0.08 + MASS * ARM**2  # across it, about the pivot
TORQUE = MASS * G * ARM
E3 = np.array([0.0, 0.0, 1.0])


def top() -> pinred.System:
    """Lagrange's top on a spherical joint."""
    model = pin.Model()
    model.name = "top"
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "pivot")
    moments = np.diag([0.08, 0.08, C])
    model.appendBodyToJoint(1, pin.Inertia(MASS, ARM * E3, moments), pin.SE3.Identity())
    model.gravity.linear = -G * E3
    return pinred.load(model)


def tilted(theta: float) -> Array:
    """The attitude whose axis is tilted about x, as a quaternion."""
    return np.array([np.sin(theta / 2), 0.0, 0.0, np.cos(theta / 2)])


def axis(pose: Array) -> Array:
    """The axis of the top in the fixed frame, (T, 3)."""
    return np.array([pin.Quaternion(g).matrix()[:, 2] for g in pose])


def cubic(theta: float, xi: Array) -> tuple[np.polynomial.Polynomial, Array]:
    """The f of u̇² = f(u), u = cos θ, and its roots; Goldstein, Classical Mechanics, §5.7."""
    u, P = np.cos(theta), np.polynomial.Polynomial
    R = pin.Quaternion(tilted(theta)).matrix()
    spin, upward = C * xi[2], (R @ (np.array([A, A, C]) * xi))[2]
    energy = 0.5 * (A * xi[0] ** 2 + A * xi[1] ** 2 + C * xi[2] ** 2) + TORQUE * u
    alpha, beta = (2 * energy - spin**2 / C) / A, 2 * TORQUE / A
    f = P([alpha, -beta]) * P([1, 0, -1]) - P([upward / A, -spin / A]) ** 2
    return f, np.sort(f.roots().real)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_nutation_has_range_and_period_of_cubic(engine: Engine) -> None:
    """The height cos θ oscillates between two roots of the cubic, with the period of the cubic."""
    theta, xi = 0.6, np.array([0.8, -0.5, 30.0])
    system = top()
    traj = pinred.simulate(
        system, pose0=tilted(theta), xi0=xi, times=np.linspace(0.0, 2.0, 1001), engine=engine
    )
    f, (low, high, beyond) = cubic(theta, xi)
    assert -1.0 < low < high < 1.0 < beyond
    u = axis(traj.pose)[:, 2]
    assert low - 1e-9 < u.min() < low + 4e-4
    assert high - 4e-4 < u.max() < high + 1e-9

    def slope(t: float) -> float:
        state = traj(t)
        R = pin.Quaternion(state.pose).matrix()
        return float((R @ np.cross(state.xi, E3))[2])

    signs = np.array([slope(t) for t in traj.t])
    np.testing.assert_allclose(signs**2, f(u), atol=1e-7)
    turns = [
        brentq(slope, traj.t[k], traj.t[k + 1], xtol=1e-13)
        for k in np.flatnonzero(np.diff(np.sign(signs)))
    ]
    # du/√f over half a period; u = middle + half sin s takes the roots out of it.
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    beta = 2 * TORQUE / A
    time = quad(lambda s: 1 / np.sqrt(beta * (beyond - middle - half * np.sin(s))), -np.pi / 2,
                np.pi / 2, epsabs=1e-13)[0]  # fmt: skip
    np.testing.assert_allclose(np.diff(turns), time, atol=1e-8)
    assert len(turns) == 3
    J, mu = traj.spatial_momentum, traj.body_momentum
    np.testing.assert_allclose(J[:, 2], J[0, 2], rtol=1e-9)
    np.testing.assert_allclose(mu[:, 2], C * xi[2], rtol=1e-12)
    assert np.ptp(J[:, 0]) > 1e-2
    np.testing.assert_allclose(traj.energy, traj.energy[0], rtol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("theta", [0.4, 2.2])
@pytest.mark.sampled
def test_steady_precession_has_slow_and_fast_rate(
    theta: float, sign: float, engine: Engine
) -> None:
    """A Ω² cos θ − C ω3 Ω + m g l = 0: the slow and the fast rate, above and below the pivot."""
    spin = 60.0
    root = np.sqrt((C * spin) ** 2 - 4 * A * TORQUE * np.cos(theta))
    rate = (C * spin + sign * root) / (2 * A * np.cos(theta))
    R = pin.Quaternion(tilted(theta)).matrix()
    xi = R.T @ (rate * E3) + (spin - rate * np.cos(theta)) * E3
    traj = pinred.simulate(top(), pose0=tilted(theta), xi0=xi, duration=1.0, engine=engine)
    seen = axis(traj.pose)
    np.testing.assert_allclose(seen[:, 2], np.cos(theta), atol=1e-8)
    angle = np.unwrap(np.arctan2(seen[:, 1], seen[:, 0]))
    np.testing.assert_allclose(angle - angle[0], rate * traj.t, atol=1e-8)


@pytest.mark.parametrize("part", [0.97, 1.03])
def test_sleeping_top_is_stable_above_critical_spin(part: float) -> None:
    """Upright it stays, and a perturbation grows only below (C ω3)² = 4 A m g l."""
    spin = part * np.sqrt(4 * A * TORQUE) / C
    still = pinred.simulate(top(), pose0=tilted(0.0), xi0=spin * E3, duration=3.0)
    np.testing.assert_allclose(axis(still.pose), np.broadcast_to(E3, (201, 3)), atol=1e-12)
    theta, xi = 1e-3, spin * E3
    traj = pinred.simulate(top(), pose0=tilted(theta), xi0=xi, duration=8.0)
    most = np.arccos(axis(traj.pose)[:, 2].min())
    low = cubic(theta, xi)[1][0]
    assert most == pytest.approx(np.arccos(low), rel=1e-2)
    assert (most < 0.02) if part > 1 else (most > 0.2)


def test_top_without_base_integrates_momentum_and_gravity_direction() -> None:
    """outputs="shape" integrates μ and Γ, 6 numbers for 7, and they are Rᵀ of J and gravity."""
    scene = pinred.Scene(
        system=top(), pose0=tilted(0.6), xi0=[0.8, -0.5, 30.0], rtol=1e-12, duration=0.5
    )
    every, scene = pinred.simulate(scene), replace(scene, outputs="shape")
    assert (
        CompiledFlow.of_plan(plan_of(scene)).y0.size == PinocchioFlow(plan_of(scene)).y0.size == 6
    )
    for engine in ENGINES:
        part = pinred.simulate(scene, engine=engine)
        y = part.motion.reduced(part.t)
        down = [pin.Quaternion(g).matrix().T @ -E3 for g in every.pose]
        np.testing.assert_allclose(y[:, :3], down, atol=1e-9)
        np.testing.assert_allclose(y[:, 3:], every.body_momentum, atol=1e-9)
        np.testing.assert_allclose(part.energy, every.energy, atol=1e-9)


def test_tiny_gravity_counts_as_zero() -> None:
    """The square of 1e-300 is zero: the top is free, and no division by zero occurs."""
    model = top().model.copy()
    model.gravity.linear = -1e-300 * E3
    system = pinred.load(model)
    scene = pinred.Scene(system=system, xi0=[0.1, 0.2, 5.0])
    traj = pinred.simulate(scene)
    assert CompiledFlow.of_plan(plan_of(scene)).y0.size == 4
    np.testing.assert_allclose(traj.spatial_momentum, traj.spatial_momentum[:1].repeat(201, 0))
    assert np.isfinite(traj.q).all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["cartpole", "double_spherical_pendulum"])
@pytest.mark.sampled(4)
def test_shapes_under_gravity_agree_with_aba(name: str, engine: Engine) -> None:
    """A cart-pole across gravity, pendulums about the vertical: a potential on the shape."""
    system = pinred.load(name)
    traj = pinred.simulate(system, duration=1.0, engine=engine)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    state = traj(np.array([0.0, 0.5, 1.0]))
    q, _ = aba.integrate(system.model, state.q[0], state.v[0], state.t)
    assert aba.max_difference(system.model, q, state.q) < 1e-8


def test_cartpole_frequency_follows_from_reduced_metric() -> None:
    """Small swings of the cart-pole: ω² = m g l / M(0)."""
    system = pinred.load("cartpole")
    traj = pinred.simulate(system, x0=[1e-6], momentum=0, duration=5.0, rtol=1e-12, atol=1e-18)
    w = np.sqrt(4.905 / (0.34 - 1.0 / 12.0))
    np.testing.assert_allclose(traj.x[:, 0], 1e-6 * np.cos(w * traj.t), atol=1e-15)


@pytest.mark.by_hand
@pytest.mark.slow
@settings(max_examples=6)
@given(seeds, st.integers(1, 3))
def test_pinned_trees_under_gravity_agree_with_aba(seed: int, joints: int) -> None:
    """Random trees on a ball joint, in any direction of gravity: both engines against ABA."""
    model = random_model("SO3", joints, seed)
    rng = np.random.default_rng(seed)
    model.gravity.linear = rng.normal(size=3) * 5.0
    system = pinred.load(model)
    scene = pinred.Scene(
        system=system, seed=seed % 1000, pose0=system.group.exp(rng.normal(size=3)), duration=0.6
    )
    traj = pinred.simulate(scene)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    other = pinred.simulate(scene, engine="pinocchio")
    allowed = max(1e-8, 10 * float(report.shape_bounds.max()))
    q, _ = aba.integrate(model, other.q[0], other.v[0], traj.t)
    assert aba.max_difference(model, q, other.q) < allowed
    assert other.momentum_balance.residual == pytest.approx(0.0, abs=1e-7)
    for engine in ENGINES:
        shape = pinred.simulate(scene, engine=engine, outputs="shape")
        np.testing.assert_allclose(shape.x, other.x, atol=allowed)
        np.testing.assert_allclose(shape.energy, other.energy, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("outputs", ["all", "shape"])
@pytest.mark.sampled
def test_pivot_at_centre_of_mass_moves_as_without_gravity(outputs: Any) -> None:
    """The motion is that without gravity, by every method, and ABA agrees."""
    light = pinred.load("rigid_body")
    heavy = pinred.load("rigid_body", gravity=(0.3, -2.0, 9.0))
    for method in ("auto", pinred.DOP853(), pinred.Variational(0.01), pinred.Gauss(0.01)):
        options: Any = {"seed": 1, "duration": 1.0, "outputs": outputs, "method": method}
        with_it = pinred.simulate(heavy, **options)
        np.testing.assert_array_equal(
            with_it.outputs.energy, pinred.simulate(light, **options).outputs.energy
        )
        if outputs == "all":
            np.testing.assert_array_equal(with_it.q, pinred.simulate(light, **options).q)
    if outputs == "all":
        assert pinred.compare(pinred.simulate(heavy, seed=1, duration=1.0)).passed
    readable = pinred.simulate(heavy, seed=1, duration=1.0, outputs=outputs, engine="pinocchio")
    np.testing.assert_allclose(readable.outputs.energy, with_it.outputs.energy, rtol=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_robot_balanced_on_raised_pivot_has_energy_of_height(engine: Any) -> None:
    """It moves as without gravity, and the energy of its height is −m g·p."""
    place, weight = np.array([0.3, -0.4, 1.2]), np.array([0.5, 0.3, -9.0])
    systems = []
    for gravity in (np.zeros(3), weight):
        model = pin.Model()
        model.addJoint(0, pin.JointModelSpherical(), pin.SE3(pin.exp3(place), place), "bearing")
        body = pin.Inertia(4.0, np.zeros(3), np.diag([0.2, 0.3, 0.4]))
        model.appendBodyToJoint(1, body, pin.SE3.Identity())
        wheel = model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "wheel")
        model.appendBodyToJoint(wheel, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3.Identity())
        model.gravity.linear = gravity
        systems.append(pinred.load(model))
    options: Any = {"seed": 1, "duration": 1.0, "engine": engine}
    light, heavy = (pinred.simulate(system, **options) for system in systems)
    np.testing.assert_allclose(heavy.q, light.q, atol=1e-7)
    np.testing.assert_allclose(heavy.energy, light.energy - 5.0 * place @ weight, rtol=1e-7)
    assert np.abs(heavy.momentum_balance.impulse).max() == 0.0
    assert pinred.compare(heavy).passed
    assert "direction of gravity" not in str(pinred.inspect(systems[1]))
    half = pinred.simulate(systems[1], parameters={"gravity": 0.5 * weight}, **options)
    np.testing.assert_allclose(half.energy, light.energy - 2.5 * place @ weight, rtol=1e-7)
    assert pinred.compare(half).passed
