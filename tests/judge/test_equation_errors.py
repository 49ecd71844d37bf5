"""Errors of the equations of motion, on a cart and pole in closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.judge import audit as module
from pinred.judge.audit import Accelerations, accelerations, equation_errors
from pinred.judge.reference_solution import FullState

CART, POLE, LEVER, MOMENT, G = (
    2.0,
    1.0,
    0.5,
    0.09,
    9.81,
)  # constants of robots/cartpole.urdf in SI units
TIMES = np.linspace(0.0, 0.5, 4)


@cache
def swinging(driven: bool, heavy: bool = True) -> pinred.Trajectory:
    """Simulate the cart and pole.

    driven: with a prescribed pole.  heavy: in gravity.
    """
    system = pinred.load("cartpole") if heavy else pinred.load("cartpole", gravity=np.zeros(3))
    if not driven:
        return pinred.simulate(system, x0=[0.7], xdot0=[0.5], xi0=[0.3], duration=0.5)
    plan = {system.shape_names[0]: pinred.signals.Expression("0.7 + 0.3*sin(2*t)")}
    return pinred.simulate(system, prescribed=plan, xi0=[0.3], duration=0.5)


def mass_matrix(angle: float) -> Array:
    """Compute the mass matrix of cart and pole; the pole hangs at angle 0."""
    coupled = -POLE * LEVER * np.cos(angle)
    return np.array([[CART + POLE, coupled], [coupled, MOMENT + POLE * LEVER**2]])


def closed_form(angle: float, rate: float, heavy: bool = True) -> Array:
    """Compute the accelerations of cart and pole."""
    centrifugal = POLE * LEVER * np.sin(angle) * rate**2
    weight = heavy * POLE * G * LEVER * np.sin(angle)
    return np.linalg.solve(mass_matrix(angle), [-centrifugal, -weight])


def driven_accelerations(t: float, angle: float, rate: float) -> Array:
    """Compute the accelerations with a prescribed pole."""
    turned = -4.0 * 0.3 * np.sin(2.0 * t)
    force = POLE * LEVER * (np.cos(angle) * turned - np.sin(angle) * rate**2)
    return np.array([force / (CART + POLE), turned])


def errors(
    monkeypatch: pytest.MonkeyPatch, off: Any, *, spread: Any = (0.0, 0.0), pace: float = 0.0,
    driven: bool = False, speed: Any = 1.0, heavy: bool = True,
) -> Array:  # fmt: skip
    """Compute the errors of a route with wrong accelerations.

    off: error of the accelerations.  spread, pace: see Accelerations.  speed: factor of all rates,
    at all times or at each; 0 is at rest, hanging.
    """
    traj = swinging(driven, heavy)
    states = traj(TIMES)
    speeds = np.broadcast_to(speed, TIMES.shape)[:, None]
    states = replace(states, **{k: speeds * getattr(states, k) for k in ("x", "xdot", "xi")})
    v = np.hstack([states.xi, states.xdot])
    a = [
        driven_accelerations(t, x, xdot) if driven else closed_form(x, xdot, heavy)
        for t, x, xdot in zip(TIMES, states.x[:, 0], states.xdot[:, 0], strict=True)
    ]
    paces = np.full(len(TIMES), pace)
    values = Accelerations(states, v, np.array(a) + off, np.broadcast_to(spread, v.shape), paces)
    monkeypatch.setattr(module, "accelerations", lambda *_: values)
    return equation_errors(traj, FullState(traj.scene), TIMES)


def terms(*, pace: float = 0.0, driven: bool = False, heavy: bool = True) -> tuple[Array, Array]:
    """Return the sums of magnitudes of force terms (T, 2) and the mass matrices (T, 2, 2)."""
    states, sums, inertias = swinging(driven, heavy)(TIMES), [], []
    between = 2.0 * CART * POLE / (CART + POLE) * LEVER**2
    radius = np.sqrt((0.3 + 0.19 + between) / (CART + POLE))
    weights = heavy * G * np.array([CART + POLE, POLE * LEVER])  # independent of the angle
    for t, x, xdot, xi in np.hstack([TIMES[:, None], states.x, states.xdot, states.xi]):
        H, a = (
            mass_matrix(x),
            driven_accelerations(t, x, xdot) if driven else closed_form(x, xdot, heavy),
        )
        changes = np.abs(a) + pace * np.abs([xi, xdot])
        carried = np.array([CART + POLE, POLE * radius]) * (changes[0] + radius * changes[1])
        sums.append(np.abs(H) @ changes + weights + 1e-5 * carried)
        inertias.append(H)
    return np.array(sums), np.array(inertias)


OFF = np.array([1e-3, -2e-3])


@pytest.mark.parametrize("pace", [0.0, 3.0])
def test_equation_error_is_relative_to_terms_of_forces(
    monkeypatch: pytest.MonkeyPatch, pace: float
) -> None:
    """Terms: inertial forces, changes of rates, gravity loads, 1e-5 of forces on moved bodies."""
    sums, H = terms(pace=pace)
    result = errors(monkeypatch, OFF, pace=pace)
    assert result == pytest.approx(np.abs(H @ OFF) / sums, rel=1e-8)


def test_equation_error_ignores_spread_of_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the spread of the route's accelerations is subtracted."""
    sums, H = terms()
    spread = np.array([2e-5, 1e-5])
    result = errors(monkeypatch, OFF, spread=spread)
    remaining = np.maximum(np.abs(H @ OFF) - 10.0 * np.abs(H) @ spread, 0.0)
    assert result == pytest.approx(remaining / sums, rel=1e-8)
    assert (result > 0.0).all()
    assert not errors(monkeypatch, OFF, spread=20.0 * spread).any()


def test_spread_is_largest_of_five_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """The spread of all joints includes two neighbouring times on each side."""
    sums, H = terms(driven=True)
    spread = np.zeros((len(TIMES), 2))
    spread[3] = 30.0 * np.array([2e-5, 1e-5])
    result = errors(monkeypatch, OFF, spread=spread, driven=True)
    expected = np.column_stack([np.abs(H @ OFF)[:, 0], H[:, 1, 1] * 2e-3]) / sums
    assert result[0] == pytest.approx(expected[0], rel=1e-8)
    assert not result[1:].any()


def test_equation_error_of_drive_compares_accelerations(monkeypatch: pytest.MonkeyPatch) -> None:
    """The force of a prescribed joint is free, so only its acceleration is compared."""
    sums, H = terms(driven=True)
    spread = np.array([2e-5, 1e-5])
    result = errors(monkeypatch, OFF, spread=spread, driven=True)
    assert result[:, 1] == pytest.approx(H[:, 1, 1] * (2e-3 - 1e-4) / sums[:, 1], rel=1e-8)
    remaining = np.abs(H @ OFF) - 10.0 * np.abs(H) @ spread
    assert result[:, 0] == pytest.approx(remaining[:, 0] / sums[:, 0], rel=1e-8)


def test_error_of_other_joint_does_not_appear_in_row_of_drive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rows of other joints show their errors."""
    system = pinred.load("planar_chain5")
    r, names = system.r, system.shape_names
    plan = {names[k]: pinred.signals.Expression(f"{0.2 * k} + 0.3*sin(2*t)") for k in (1, 3)}
    traj = pinred.simulate(system, prescribed=plan, xi0=[0.3, 0.1, 0.5], duration=0.5)

    def off(*of: Any) -> Accelerations:
        result = accelerations(*of)
        return replace(result, a=result.a + 1e-3 * (np.arange(r + system.m) == r - 1))

    monkeypatch.setattr(module, "accelerations", off)
    result = equation_errors(traj, FullState(traj.scene), TIMES).max(axis=0)
    assert result[[r + 1, r + 3]] == pytest.approx(0.0, abs=1e-9)
    assert (np.delete(result, [r + 1, r + 3]) > 1e-6).all()


def test_equation_error_at_rest_has_smallest_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without forces the unit is 1e-290 N."""
    off = 1e-297 * OFF
    result = errors(monkeypatch, off, speed=0.0, heavy=False)
    assert result == pytest.approx(np.abs([mass_matrix(0.0) @ off] * len(TIMES)) / 1e-290)


def test_equation_error_at_rest_is_relative_to_largest_forces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The least unit is 1e-2 of the largest forces of the row."""
    sums, H = terms(heavy=False)
    result = errors(monkeypatch, OFF, speed=[1.0, 1.0, 1.0, 0.0], heavy=False)
    assert result[:3] == pytest.approx((np.abs(H @ OFF) / sums)[:3], rel=1e-8)
    least = 1e-2 * sums[:3].max(axis=0)
    assert result[3] == pytest.approx(np.abs(mass_matrix(0.0) @ OFF) / least, rel=1e-8)


class FullStateWithRoundOff(FullState):
    """Full simulation with an artificial error of ABA in world axes at one time."""

    left = np.array([3e-6, 1e-6])

    def rate(self, t: float, y: Array, axes: pin.Convention = pin.Convention.LOCAL) -> Array:
        """Add the artificial error."""
        rate = super().rate(t, y, axes)
        if axes == pin.Convention.WORLD and t == TIMES[2]:
            rate[-2:] += self.left
        return rate


def test_equation_error_ignores_round_off_of_aba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the largest difference between two evaluations of ABA is subtracted."""
    sums, H = terms()
    errors(monkeypatch, OFF)  # replaces the route's accelerations
    traj = swinging(False)
    result = equation_errors(traj, FullStateWithRoundOff(traj.scene), TIMES)
    remaining = 10.0 * np.abs(H[2] @ FullStateWithRoundOff.left) / sums[2]
    assert result == pytest.approx(np.abs(H @ OFF) / sums - remaining, rel=1e-8)
    assert (result > 0.0).all()
    monkeypatch.setattr(FullStateWithRoundOff, "left", 1e3 * FullStateWithRoundOff.left)
    assert not equation_errors(traj, FullStateWithRoundOff(traj.scene), TIMES).any()


def test_size_is_that_of_the_initial_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other report times do not change the size that scales the steps and the units."""
    sizes: list[float] = []

    def record(traj: Any, times: Array, size: float) -> Accelerations:
        sizes.append(size)
        return accelerations(traj, times, size)

    monkeypatch.setattr(module, "accelerations", record)
    system = pinred.load("planar_chain5")
    full = None
    for second in (0.01, 0.4):
        traj = pinred.simulate(
            system,
            x0=[0.3, -0.2, 0.4, 0.1, 0.0],
            xdot0=[2.0, -1.0, 3.0, 1.0, -2.0],
            times=[0.0, second, 0.5],
        )
        full = FullState(traj.scene)
        equation_errors(traj, full, TIMES[TIMES <= 0.5])
    assert full is not None
    q = traj.system.sort_q(traj.q)
    radii = [full.totals.radius_of_gyration(q_t) for q_t in q]
    assert abs(radii[1] / radii[0] - 1.0) > 1e-3
    assert sizes == [radii[0], radii[0]]
