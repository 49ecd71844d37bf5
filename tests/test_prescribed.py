"""Joints that follow a plan: against ABA, against RNEA, and by the connection alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from scipy.integrate import solve_ivp
from strategies import Case, cases

import pinred
from pinred.arrays import Array
from pinred.catalogue import has_example_robots
from pinred.engine.flow import CompiledFlow
from pinred.forces import Damper, Spring
from pinred.rotations import quaternion_product, rotation
from pinred.signals import Fourier, Signal, Spline


def swing(k: int) -> Fourier:
    """A plan for a joint, another for every k."""
    return Fourier(0.1 * k, [0.2, -0.05 * k], [0.3, 0.1], 1.0 + 0.3 * k)


def forward(model: pin.Model, q: Array, v: Array, tau: Array, driven: list[int], a: Array) -> Array:
    """Accelerations (n,) of a model where those of some joints are given, by its mass matrix."""
    data = model.createData()
    upper = pin.crba(model, data, q)
    H = np.triu(upper) + np.triu(upper, 1).T
    free = [k for k in range(model.nv) if k not in driven]
    out = np.empty(model.nv)
    out[driven] = a
    rest = (tau - pin.nonLinearEffects(model, data, q, v))[free] - H[np.ix_(free, driven)] @ a
    out[free] = np.linalg.solve(H[np.ix_(free, free)], rest)
    return out


@settings(max_examples=8)
@given(cases(2, 4))
def test_drives_of_random_trees(case: Case) -> None:
    """Any group, every second joint planned, a spring and a damper: drives as RNEA has them."""
    system = case.system
    names = system.shape_names
    plan: dict[str, Signal] = {name: swing(k) for k, name in enumerate(names[::2])}
    spring, damper = Spring(names[-1], 2.0, 0.3), Damper(names[1], 0.4)
    traj = pinred.simulate(
        system, x0=case.x, xdot0=case.xdot, xi0=case.xi, pose0=case.pose, duration=0.5,
        times=np.linspace(0.0, 0.5, 7), prescribed=plan, forces=[spring, damper],
    )  # fmt: skip
    report = pinred.compare(traj)
    assert report.passed, str(report)
    driven = [system.r + names.index(name) for name in plan]
    assert traj.driving_torques.shape == (7, len(driven))
    for k, t in enumerate(traj.t):
        tau = np.zeros(system.n)
        tau[system.n - 1] -= 2.0 * (traj.x[k, -1] - 0.3)
        tau[system.r + 1] -= 0.4 * traj.xdot[k, 1]
        planned = np.array([signal.acceleration(t) for signal in plan.values()])
        np.testing.assert_allclose(
            traj.x[k, ::2], [float(signal.value(t)) for signal in plan.values()], atol=1e-12
        )
        a = forward(system.model, traj.q[k], traj.v[k], tau, driven, planned)
        data = system.model.createData()
        whole = pin.rnea(system.model, data, traj.q[k], traj.v[k], a) - tau
        scale = max(1.0, float(np.abs(whole).max()))
        np.testing.assert_allclose(whole[driven], traj.driving_torques[k], atol=1e-9 * scale)
        np.testing.assert_allclose(np.delete(whole, driven), 0.0, atol=1e-9 * scale)


@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
def test_all_joints_planned(engine: Any) -> None:
    """Only the orientation is integrated, and it is what ξ = I⁻¹μ − A ẋ makes of it."""
    system = pinred.load("falling_cat")
    red = pinred.Reduction(system)
    plan: dict[str, Signal] = {name: swing(k) for k, name in enumerate(system.shape_names)}
    for options, size in (({"momentum": 0}, 4), ({"xi0": [0, 0, 0, 0.3, -0.2, 0.4]}, 4)):
        scene = pinred.Scene(system=system, prescribed=plan, duration=2.0, **options)
        assert len(CompiledFlow(scene).y0) == size + 1  # and the time
        traj = pinred.simulate(scene, engine=engine)
        J = red.group.Ad(traj.pose[0])[3:, 3:] @ _about_com(red, traj, 0)

        def rate(t: float, q: Array, J: Array = J) -> Array:
            x = np.array([float(s.value(t)) for s in plan.values()])
            xdot = np.array([float(s.rate(t)) for s in plan.values()])
            q = q / np.linalg.norm(q)
            mu = np.append(np.zeros(3), rotation(q).T @ J)
            xi = np.linalg.solve(red.locked_inertia(x), mu) - red.local_connection(x) @ xdot
            return 0.5 * quaternion_product(q, np.append(xi[3:], 0.0))

        found = solve_ivp(rate, (0, 2.0), traj.pose[0, 3:], "DOP853", rtol=1e-12, atol=1e-13)
        expected = found.y[:, -1] / np.linalg.norm(found.y[:, -1])
        assert abs(float(expected @ traj.pose[-1, 3:])) == pytest.approx(1.0, abs=1e-14)
        np.testing.assert_allclose(
            traj.pose[-1, 3:] * np.sign(expected @ traj.pose[-1, 3:]), expected, atol=1e-9
        )


def _about_com(red: pinred.Reduction, traj: pinred.Trajectory, k: int) -> Array:
    """Angular momentum about the centre of mass in the body's frame."""
    mu, com = traj.body_momentum[k], red.at(traj.x[k]).com
    return np.asarray(mu[3:] - np.cross(com, mu[:3]))


def test_a_plan_with_many_knots() -> None:
    """Integration stops at every knot of a spline, where its third derivative jumps."""
    system = pinred.load("satellite_two_arms")
    times = np.linspace(0.0, 1.0, 13)
    values = np.cumsum(np.random.default_rng(5).normal(size=13)) * 0.05
    plan: dict[str, Signal] = {system.shape_names[1]: Spline(times, values)}
    traj = pinred.simulate(system, seed=2, duration=1.0, prescribed=plan)
    assert set(times[1:]) <= set(traj.motion.knots)
    report = pinred.compare(traj)
    assert report.passed, str(report)


def test_the_start_of_planned_joints_is_the_plan() -> None:
    """What x0 says of them is not read, and the momentum is that of the plan."""
    system = pinred.load("falling_cat")
    plan: dict[str, Signal] = {"sway": swing(1)}
    traj = pinred.simulate(system, x0=[9.0, 0.2, 0.1], duration=0.2, prescribed=plan, momentum=0)
    where = system.shape_names.index("sway")
    assert traj.x[0, where] == pytest.approx(float(swing(1).value(0.0)), abs=1e-15)
    assert traj.xdot[0, where] == pytest.approx(float(swing(1).rate(0.0)), abs=1e-14)
    np.testing.assert_allclose(traj.body_momentum[0], 0.0, atol=1e-15)


@pytest.mark.skipif(not has_example_robots(), reason="needs example-robot-data")
def test_solo12_falls_with_moving_legs() -> None:
    """The centre of mass stays on the parabola whatever the legs do, and ABA agrees."""
    system = pinred.load("solo12")
    assert system.gravity[2] < -9.0
    plan: dict[str, Signal] = {name: swing(k % 3) for k, name in enumerate(system.shape_names)}
    del plan[system.shape_names[4]], plan[system.shape_names[8]]
    traj = pinred.simulate(system, seed=1, duration=0.6, prescribed=plan)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    model, data = system.model, system.model.createData()
    path = []
    for q, v in zip(traj.q, traj.v, strict=True):
        pin.centerOfMass(model, data, q, v)
        path.append(data.com[0].copy())
        if len(path) == 1:
            velocity = data.vcom[0].copy()
    t = traj.t[:, None]
    expected = path[0] + velocity * t + 0.5 * system.gravity * t**2
    np.testing.assert_allclose(path, expected, atol=1e-12)
