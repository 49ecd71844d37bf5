"""Balances of energy and momentum against quadratures and closed forms."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from forced_trees import tree
from scipy.integrate import cumulative_simpson

import pinred
from pinred.common.arrays import Array
from pinred.forces import Controller, Damper, Spring, Torque, Wrench
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Fourier, Hold
from pinred.simulation import balances
from pinred.simulation.balances import EnergyBalance, MomentumBalance, _integral

G = np.array([0.5, 0.0, -3.0])  # of tree("SE3", …)


@pytest.mark.parametrize("engine", ENGINES)
def test_impulse_of_gravity_agrees_with_free_fall(engine: Engine) -> None:
    """It is m g t, and ∫ c × m g dt about the origin, with c on its parabola."""
    system = tree("SE3", 2, 4)
    traj = pinred.simulate(system, seed=1, duration=1.5, engine=engine)
    model, data, t = system.model, system.model.createData(), traj.t[:, None]
    pin.centerOfMass(model, data, traj.q[0], traj.v[0])
    place = model.jointPlacements[1]
    c0, v0 = data.com[0] - place.translation, data.vcom[0]
    weight = system.mass * G
    about = np.cross(c0 * t + 0.5 * v0 * t**2, weight)  # g × g is zero
    expected = np.hstack([weight * t @ place.rotation, about @ place.rotation])
    balance = traj.momentum_balance
    np.testing.assert_allclose(balance.impulse, expected, atol=1e-9)
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-9)
    np.testing.assert_array_equal(balance.momentum, traj.spatial_momentum)
    assert traj.energy_balance.labels == ()
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_work_of_each_force_agrees_with_simpson(engine: Engine) -> None:
    """The work of each label is ∫ τ·ẋ dt or ∫ f·ξ dt, by Simpson's rule on the trajectory."""
    system = tree("SE3", 3, 6)
    a, b, c = system.shape_names
    push = np.array([0.4, 0.0, -0.3, 0.1, 0.2, 0.0])
    forces = [
        Spring(a, 2.0),
        Damper(a, 0.3),
        Torque({b: Hold([0.0, 0.5], [0.4, -0.2])}, name="table"),
        Controller(lambda t, *_: [0.1 if t < 0.6 else -0.3], 0.25, (b,), name="robot"),
        Wrench(push.tolist(), name="jet"),
    ]
    plan = {c: Fourier(0.0, [], [0.4], 1.0)}
    traj = pinred.simulate(
        system, seed=2, duration=1.0, forces=forces, prescribed=plan, engine=engine,
        times=np.linspace(0.0, 1.0, 201),
    )  # fmt: skip
    balance, t = traj.energy_balance, traj.t
    assert balance.labels == (f"damper {a}", "table", "robot", "jet", "prescribed joints")
    x, at = traj.x[:, 1], {s: float(traj(s).x[1]) for s in (0.5, 0.75)}
    table = np.where(t < 0.5, 0.4 * (x - x[0]), 0.4 * (at[0.5] - x[0]) - 0.2 * (x - at[0.5]))
    robot = np.where(t < 0.75, 0.1 * (x - x[0]), 0.1 * (at[0.75] - x[0]) - 0.3 * (x - at[0.75]))
    for k, work in ((1, table), (2, robot)):
        np.testing.assert_allclose(balance.work[:, k], work, atol=1e-8)
    # Other forces by Simpson's rule, until the first jump.
    powers = {
        0: -0.3 * traj.xdot[:, 0] ** 2,
        3: traj.xi @ push,
        4: traj.driving_torques[:, 0] * traj.xdot[:, 2],
    }
    for k, power in powers.items():
        work = cumulative_simpson(power, x=t, initial=0.0)
        np.testing.assert_allclose(balance.work[:98:2, k], work[:98:2], atol=1e-8)
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-8)
    # The energy is Pinocchio's plus that of the spring.
    bare = system.model.copy()
    armature, bare.armature = np.array(bare.armature), np.zeros(bare.nv)
    data = bare.createData()
    energy = [
        pin.computeKineticEnergy(bare, data, q, v)
        + 0.5 * armature @ v**2
        + pin.computePotentialEnergy(bare, data, q)
        for q, v in zip(traj.q[::20], traj.v[::20], strict=True)
    ]
    expected = np.array(energy) + traj.x[::20, 0] ** 2
    np.testing.assert_allclose(balance.energy[::20], expected, atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_impulse_of_wrench_agrees_with_simpson(engine: Engine) -> None:
    """On a tumbling body it is ∫ R F dt and ∫ (p × R F + R N) dt."""
    system = pinred.load("rigid_body", group="SE3", gravity=(0.0, 0.0, 0.0))
    push = np.array([0.4, -0.1, -0.3, 0.1, 0.2, 0.3])
    traj = pinred.simulate(
        system, xi0=[0.1, 0.2, 0.3, 0.5, 0.7, 1.6], forces=[Wrench(push.tolist())],
        times=np.linspace(0.0, 1.0, 201), engine=engine,
    )  # fmt: skip
    R = np.array([pin.Quaternion(g[3:]).matrix() for g in traj.pose])
    F, N = R @ push[:3], R @ push[3:]
    wrench = np.hstack([F, np.cross(traj.pose[:, :3], F) + N])
    expected = cumulative_simpson(wrench, x=traj.t, axis=0, initial=0.0)[::2]
    np.testing.assert_allclose(traj.momentum_balance.impulse[::2], expected, atol=1e-8)
    np.testing.assert_allclose(traj.momentum_balance.residual, 0.0, atol=1e-8)


def test_balance_starts_with_the_motion() -> None:
    """Work counts from the start of the motion, not from the first report."""
    system = pinred.load("elroys_beanie")
    damper = [Damper("beanie", 0.5)]
    full = pinred.simulate(system, duration=2.0, forces=damper, times=[0.0, 1.0, 2.0])
    late = pinred.simulate(system, duration=2.0, forces=damper, times=[1.0, 2.0])
    np.testing.assert_allclose(late.energy_balance.work, full.energy_balance.work[1:], rtol=1e-9)
    np.testing.assert_allclose(late.energy_balance.residual, 0.0, atol=1e-9)


def test_residuals_are_unexplained_changes() -> None:
    """The residual is the change of energy or momentum minus work or impulse."""
    t = np.array([0.0, 1.0])
    work = np.array([[0.5, 0.25], [1.5, 3.25]])
    energy = EnergyBalance(t, np.array([2.0, 6.5]), ("a", "b"), work)
    assert energy.residual.tolist() == [0.0, 0.5]
    momentum, impulse = np.array([[1.0, 2.0], [4.0, 8.0]]), np.array([[0.5, 0.0], [2.5, 5.0]])
    momenta = MomentumBalance(t, momentum, impulse)
    assert momenta.residual.tolist() == [[0.0, 0.0], [1.0, 1.0]]
    for values in (energy.work, energy.energy, momenta.momentum, momenta.impulse):
        assert not values.flags.writeable


@pytest.mark.parametrize("last", [0.0, 0.2, 0.3, 1.7, 2.5])
def test_integral_of_piecewise_polynomials_is_exact(last: float) -> None:
    """Polynomials that jump at step ends are integrated exactly, and only as far as needed."""
    step_ends, evaluated = np.array([0.0, 0.3, 1.0, 2.5]), []
    rng = np.random.default_rng(0)
    segments = [[np.polynomial.Polynomial(rng.normal(size=8)) for _ in range(2)] for _ in range(3)]

    class Steps:
        """A motion of three steps."""

    def integrand(t: Array) -> Array:
        evaluated.append(t)
        step = np.searchsorted(step_ends, t) - 1
        return np.array([[p(s) for p in segments[k]] for s, k in zip(t, step, strict=True)])

    motion: Any = Steps()
    motion.knots = step_ends
    times = np.array([s for s in (0.0, 0.1, 0.3, 0.7, 1.0, 1.7, 2.5) if s <= last])
    times = np.unique(np.append(times, last))
    integrals = _integral(motion, times, integrand)
    for time, integral in zip(times, integrals, strict=True):
        expected = np.zeros(2)
        for k, (first, end) in enumerate(pairwise(step_ends)):
            until = min(max(time, first), end)
            expected += [p.integ()(until) - p.integ()(first) for p in segments[k]]
        assert integral == pytest.approx(expected, rel=1e-12, abs=1e-12)
    needed = step_ends[max(1, int(np.searchsorted(step_ends, last)))]
    assert np.concatenate(evaluated).max() < needed


def test_balance_is_right_where_no_step_is_ever_resolved(monkeypatch: pytest.MonkeyPatch) -> None:
    """The series of the last halving belong to its steps."""
    monkeypatch.setattr(balances, "_RESOLVED", 0.0)
    traj = pinred.simulate(
        pinred.load("falling_cat"), seed=1, duration=0.5, prescribed={"bend": "0.3*sin(3*t)"}
    )
    balance = traj.energy_balance
    assert np.abs(balance.residual).max() < 1e-10 * np.abs(balance.energy).max()


def test_components_of_round_off_are_not_resolved_and_small_ones_are() -> None:
    """A moment that is round-off of a force has no smooth series, so halving steps is in vain."""
    rng, counts = np.random.default_rng(0), []
    motion: Any = SimpleNamespace(knots=np.array([0.0, 1.0]))
    for small in (
        lambda t: rng.uniform(-2e-15, 2e-15, len(t)),
        lambda t: 2e-14 * np.sin(40.0 * t),
    ):
        calls: list[int] = []

        def integrand(t: Array, small: Any = small, calls: list[int] = calls) -> Array:
            calls.append(len(t))
            return np.column_stack([np.ones(len(t)), small(t)])

        found = _integral(motion, np.array([0.0, 1.0]), integrand)
        np.testing.assert_allclose(found[:, 0], [0.0, 1.0], rtol=1e-14)
        counts.append(len(calls))
    assert counts[0] == 1
    assert counts[1] > 1
    assert found[1, 1] == pytest.approx(2e-14 * (1.0 - np.cos(40.0)) / 40.0, abs=1e-17)
