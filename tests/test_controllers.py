"""Controllers that are called at a rate, tables of torques, and what forces have done."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from trees import random_model

import pinred
from pinred.arrays import Array
from pinred.forces import Controller, Damper, Limit, Torque, Wrench
from pinred.signals import Expression, Hold, Linear, Spline

Act = Callable[[float, Array, Array], Array]  # from time, q and v to all n torques


def by_hand(
    system: pinred.System, pose: Array, x: Array, xi: Array, xdot: Array, stops: Array, act: Act
) -> tuple[Array, Array]:
    """Q (S, nq) and v (S, n) at stops, by ABA under SciPy, restarted at every stop.

    act: called at the beginning of every stretch for the torques of a time within it.
    """
    model = system.model
    data = model.createData()
    q, v = system.q(pose, x), system.v(xi, xdot)
    rows = [(q, v)]
    for a, b in pairwise(stops.tolist()):

        def rate(t: float, y: Array, a: float = a, b: float = b, q: Array = q) -> Array:
            # y: twist coordinates since the stretch began, and velocity.
            place = pin.integrate(model, q, y[: model.nv])
            held = act(min(max(t, a), b - 1e-12), place, y[model.nv :])
            acceleration = pin.aba(model, data, place, y[model.nv :], held)
            turn = np.linalg.inv(_dexp(model, q, y[: model.nv]))
            return np.concatenate([turn @ y[model.nv :], acceleration])

        y0 = np.concatenate([np.zeros(model.nv), v])
        found = solve_ivp(rate, (a, b), y0, "DOP853", rtol=1e-11, atol=1e-13)
        q = pin.integrate(model, q, found.y[: model.nv, -1])
        v = found.y[model.nv :, -1]
        rows.append((q, v))
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


def _dexp(model: pin.Model, q: Array, u: Array) -> Array:
    """Derivative of q ⊕ u by u, in the body's frame."""
    return np.asarray(pin.dIntegrate(model, q, u)[1])


def differ(system: pinred.System, a: Array, b: Array) -> float:
    """Largest entry of the difference of configurations."""
    pairs = zip(a, b, strict=True)
    return float(max(np.abs(pin.difference(system.model, p, q)).max() for p, q in pairs))


@pytest.mark.parametrize("group", ["SO2", "SE2", "SE3"])
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
def test_torques_are_held_between_samples(group: str, engine: Any) -> None:
    """Each sample sees the state there, and its torque is constant for one period."""
    system = pinred.load(random_model(group, 2, 8))
    seen: list[tuple[float, Array, Array]] = []

    def control(t: float, x: Array, xdot: Array, mu: Array) -> list[float]:
        seen.append((t, x, xdot))
        return [-0.5 * x[0] - 0.1 * xdot[0] + 0.05 * mu[-1], 0.3 * np.sin(5 * t)]

    period = 0.15
    stops = np.append(np.arange(7) * period, 1.0)
    scene = pinred.Scene(
        system=system, seed=4, times=stops, forces=Controller(control, period, limit=Limit(0.2))
    )
    traj = pinred.simulate(scene, engine=engine)
    assert [t for t, _, _ in seen] == pytest.approx(stops[:-1].tolist(), abs=1e-15)
    for k, (_, x, xdot) in enumerate(seen):
        np.testing.assert_allclose(x, traj.x[k], atol=1e-9)
        np.testing.assert_allclose(xdot, traj.xdot[k], atol=1e-8)
    # The torques that were held, one stretch after the other.
    torques = [
        np.clip([-0.5 * x[0] - 0.1 * v[0] + 0.05 * mu, 0.3 * np.sin(5 * t)], -0.2, 0.2)
        for (t, x, v), mu in zip(seen, _spin(traj), strict=True)
    ]

    def act(t: float, q: Array, v: Array) -> Array:  # noqa: ARG001
        return np.append(np.zeros(system.r), torques[int((t + 1e-9) / period)])

    start = scene.start
    q, v = by_hand(system, start.pose, start.x, start.xi, start.xdot, stops, act)
    assert differ(system, q, traj.q) < 1e-8
    np.testing.assert_allclose(traj.v, v, atol=1e-7)


def _spin(traj: pinred.Trajectory) -> list[float]:
    """Last entry of the momentum about the centre of mass (or the axis), at each sample."""
    system, out = traj.system, []
    red = pinred.Reduction(system)
    for k in range(len(traj) - 1):
        mu, com = traj.body_momentum[k], red.at(traj.x[k]).com
        if system.group.name == "SE2":
            out.append(float(mu[2] - (com[0] * mu[1] - com[1] * mu[0])))
        else:
            about = mu if system.group.name == "SO2" else mu[3:] - np.cross(com, mu[:3])
            out.append(float(about[-1]))
    return out


def test_a_thousand_samples_a_second() -> None:
    """A fast controller is near the continuous law that it samples."""
    system = pinred.load("satellite_two_arms")

    def law(_t: float, x: Array, xdot: Array, _mu: Array) -> Array:
        return np.asarray(-2.0 * x - 0.5 * xdot)

    calls = []

    def counted(*state: Any) -> Array:
        calls.append(state[0])
        return law(*state)

    held = pinred.simulate(system, seed=1, duration=0.5, forces=Controller(counted, 1e-3))
    assert len(calls) == 500
    smooth = pinred.simulate(
        system, seed=1, duration=0.5,
        forces=Torque(lambda _t, x, xdot, _mu: -2.0 * x - 0.5 * xdot),
    )  # fmt: skip
    assert 1e-8 < np.abs(held.x - smooth.x).max() < 1e-3


@pytest.mark.parametrize("kind", [Spline, Linear, Hold])
def test_tabulated_torques(kind: type[Spline] | type[Linear] | type[Hold]) -> None:
    """Tables of torques against ABA with the same numbers, restarted at every entry."""
    system = pinred.load(random_model("SE3", 2, 11))
    times, values = np.array([0.0, 0.3, 0.5, 0.9, 1.2]), [0.0, 0.4, -0.5, 0.3, 0.1]
    table = kind(times, values)
    scene = pinred.Scene(
        system=system, seed=2, times=times[:-1], forces=Torque({system.shape_names[0]: table})
    )
    traj = pinred.simulate(scene)
    assert set(times[1:-1]) <= set(traj.motion.knots)

    def act(t: float, q: Array, v: Array) -> Array:  # noqa: ARG001
        tau = np.zeros(system.n)
        tau[system.r] = float(table.value(t))
        return tau

    start = scene.start
    q, v = by_hand(system, start.pose, start.x, start.xi, start.xdot, times[:-1], act)
    assert differ(system, q, traj.q) < 1e-8
    np.testing.assert_allclose(traj.v, v, atol=1e-7)


@pytest.mark.parametrize("group", ["R", "SO2", "SE2", "SO3", "SE3"])
def test_work_and_impulse(group: str) -> None:
    """Work and impulse are the integrals of power and wrench along the full simulation."""
    system = pinred.load(random_model(group, 2, 6))
    r, names = system.r, system.shape_names
    wrench = [Expression(f"0.{k + 1}*cos({k + 1}*t)") for k in range(r)]
    forces = [Damper(names[0], 0.4), Torque({names[1]: 0.3}), Wrench(wrench)]
    scene = pinred.Scene(system=system, seed=3, duration=1.0, forces=forces)
    engines: tuple[Any, ...] = ("compiled", "pinocchio")
    for engine in engines:
        traj = pinred.simulate(scene, engine=engine)
        energy, momentum = traj.energy_balance, traj.momentum_balance
        scale = float(np.abs(traj.energy).max())
        np.testing.assert_allclose(energy.residual, 0.0, atol=1e-9 * max(scale, 1.0))
        np.testing.assert_allclose(momentum.residual, 0.0, atol=1e-9)
        assert energy.labels == (f"damper {names[0]}", "torque", "wrench")
        # A constant torque does the work τ Δx; a damper only takes.
        np.testing.assert_allclose(
            energy.work[:, 1], 0.3 * (traj.x[:, 1] - traj.x[0, 1]), atol=1e-9
        )
        assert (np.diff(energy.work[:, 0]) <= 1e-15).all()
        power = np.array(
            [
                [float(s.value(t)) for s in wrench] @ xi
                for t, xi in zip(traj.t, traj.xi, strict=True)
            ]
        )
        simpson = _simpson(traj.t, power)
        assert energy.work[-1, 2] == pytest.approx(simpson, abs=1e-8)


def _simpson(t: Array, f: Array) -> float:
    """Integral over an odd number of even times."""
    weights = np.ones(len(t))
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    return float(weights @ f * (t[1] - t[0]) / 3.0)


def test_no_forces_no_work() -> None:
    """Without forces there is nothing to account for, and energy is what it was."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0)
    assert traj.energy_balance.labels == ()
    assert np.abs(traj.energy_balance.residual).max() < 1e-9
    falling = pinred.simulate(pinred.load("falling_cat", gravity=(0, 0, -9.81)), duration=1.0)
    np.testing.assert_allclose(falling.momentum_balance.residual, 0.0, atol=1e-10)
    assert np.abs(falling.momentum_balance.impulse).max() > 1.0
