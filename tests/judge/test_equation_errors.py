"""What an error of accelerations counts for: a cart and pole in closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.judge import equation_errors as module
from pinred.judge.equation_errors import equation_errors
from pinred.judge.reference_solution import FullState
from pinred.simulation.accelerations import Accelerations, accelerations

CART, POLE, LEVER, MOMENT, G = 2.0, 1.0, 0.5, 0.09, 9.81  # of robots/cartpole.urdf, SI
TIMES = np.linspace(0.0, 0.5, 4)


@cache
def swinging(driven: bool, heavy: bool = True) -> pinred.Trajectory:
    """The cart and pole.  driven: with the pole on a plan.  heavy: in gravity."""
    system = pinred.load("cartpole") if heavy else pinred.load("cartpole", gravity=np.zeros(3))
    if not driven:
        return pinred.simulate(system, x0=[0.7], xdot0=[0.5], xi0=[0.3], duration=0.5)
    plan = {system.shape_names[0]: pinred.signals.Expression("0.7 + 0.3*sin(2*t)")}
    return pinred.simulate(system, prescribed=plan, xi0=[0.3], duration=0.5)


def mass_matrix(angle: float) -> Array:
    """Of cart and pole, of which the pole hangs at angle 0."""
    coupled = -POLE * LEVER * np.cos(angle)
    return np.array([[CART + POLE, coupled], [coupled, MOMENT + POLE * LEVER**2]])


def closed_form(angle: float, rate: float, heavy: bool = True) -> Array:
    """Accelerations of cart and pole."""
    centrifugal = POLE * LEVER * np.sin(angle) * rate**2
    weight = heavy * POLE * G * LEVER * np.sin(angle)
    return np.linalg.solve(mass_matrix(angle), [-centrifugal, -weight])


def pulled(t: float, angle: float, rate: float) -> Array:
    """The same where the pole follows its plan."""
    turned = -4.0 * 0.3 * np.sin(2.0 * t)
    moved = POLE * LEVER * (np.cos(angle) * turned - np.sin(angle) * rate**2)
    return np.array([moved / (CART + POLE), turned])


def errors(
    monkeypatch: pytest.MonkeyPatch, off: Any, *, spread: Any = (0.0, 0.0), pace: float = 0.0,
    driven: bool = False, speed: Any = 1.0, heavy: bool = True,
) -> Array:  # fmt: skip
    """The errors of a route whose accelerations are off by that.

    spread, pace: of its accelerations.  speed: of all, or at each time; 0 at rest, hanging.
    """
    traj = swinging(driven, heavy)
    states = traj(TIMES)
    speeds = np.broadcast_to(speed, TIMES.shape)[:, None]
    states = replace(states, **{k: speeds * getattr(states, k) for k in ("x", "xdot", "xi")})
    v = np.hstack([states.xi, states.xdot])
    a = [
        pulled(t, x, xdot) if driven else closed_form(x, xdot, heavy)
        for t, x, xdot in zip(TIMES, states.x[:, 0], states.xdot[:, 0], strict=True)
    ]
    paces = np.full(len(TIMES), pace)
    given = Accelerations(states, v, np.array(a) + off, np.broadcast_to(spread, v.shape), paces)
    monkeypatch.setattr(module, "accelerations", lambda *_: given)
    return equation_errors(traj, FullState(traj.scene), TIMES)


def terms(*, pace: float = 0.0, driven: bool = False, heavy: bool = True) -> tuple[Array, Array]:
    """What the forces are sums of (T, 2), and the mass matrices (T, 2, 2)."""
    states, sums, inertias = swinging(driven, heavy)(TIMES), [], []
    between = 2.0 * CART * POLE / (CART + POLE) * LEVER**2
    radius = np.sqrt((0.3 + 0.19 + between) / (CART + POLE))
    weights = heavy * G * np.array([CART + POLE, POLE * LEVER])  # however the pole hangs
    for t, x, xdot, xi in np.hstack([TIMES[:, None], states.x, states.xdot, states.xi]):
        H, a = mass_matrix(x), pulled(t, x, xdot) if driven else closed_form(x, xdot, heavy)
        changes = np.abs(a) + pace * np.abs([xi, xdot])
        carried = np.array([CART + POLE, POLE * radius]) * (changes[0] + radius * changes[1])
        sums.append(np.abs(H) @ changes + weights + 1e-5 * carried)
        inertias.append(H)
    return np.array(sums), np.array(inertias)


OFF = np.array([1e-3, -2e-3])


@pytest.mark.parametrize("pace", [0.0, 3.0])
def test_forces_in_parts_of_what_they_are_sums_of(
    monkeypatch: pytest.MonkeyPatch, pace: float
) -> None:
    """Of inertia, of rates that change so fast, of weights, and 1e-5 of what the bodies carry."""
    sums, H = terms(pace=pace)
    found = errors(monkeypatch, OFF, pace=pace)
    assert found == pytest.approx(np.abs(H @ OFF) / sums, rel=1e-8)


def test_what_two_derivatives_leave_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the spread of the route's accelerations."""
    sums, H = terms()
    spread = np.array([2e-5, 1e-5])
    found = errors(monkeypatch, OFF, spread=spread)
    left = np.maximum(np.abs(H @ OFF) - 10.0 * np.abs(H) @ spread, 0.0)
    assert found == pytest.approx(left / sums, rel=1e-8)
    assert (found > 0.0).all()
    assert not errors(monkeypatch, OFF, spread=20.0 * spread).any()


def test_derivatives_that_agree_by_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Round-off of a drive is that of two times on either side, and of no further ones."""
    sums, H = terms(driven=True)
    spread = np.zeros((len(TIMES), 2))
    spread[3] = 30.0 * np.array([2e-5, 1e-5])
    found = errors(monkeypatch, OFF, spread=spread, driven=True)
    whole = np.column_stack([np.abs(H @ OFF)[:, 0], H[:, 1, 1] * 2e-3]) / sums
    assert found[0] == pytest.approx(whole[0], rel=1e-8)
    assert found[:3, 0] == pytest.approx(whole[:3, 0], rel=1e-8)
    assert not found[1:, 1].any()


def test_a_drive_follows_its_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a prescribed joint its acceleration is what counts, whatever force that takes."""
    sums, H = terms(driven=True)
    spread = np.array([2e-5, 1e-5])
    found = errors(monkeypatch, OFF, spread=spread, driven=True)
    assert found[:, 1] == pytest.approx(H[:, 1, 1] * (2e-3 - 1e-4) / sums[:, 1], rel=1e-8)
    left = np.abs(H @ OFF) - 10.0 * np.abs(H) @ spread
    assert found[:, 0] == pytest.approx(left[:, 0] / sums[:, 0], rel=1e-8)


def test_each_drive_has_a_row_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """It gives whatever force an error elsewhere takes; the rows of all others show that."""
    system = pinred.load("planar_chain5")
    r, names = system.r, system.shape_names
    plan = {names[k]: pinred.signals.Expression(f"{0.2 * k} + 0.3*sin(2*t)") for k in (1, 3)}
    traj = pinred.simulate(system, prescribed=plan, xi0=[0.3, 0.1, 0.5], duration=0.5)

    def off(*of: Any) -> Accelerations:
        found = accelerations(*of)
        return replace(found, a=found.a + 1e-3 * (np.arange(r + system.m) == r - 1))

    monkeypatch.setattr(module, "accelerations", off)
    found = equation_errors(traj, FullState(traj.scene), TIMES).max(axis=0)
    assert found[[r + 1, r + 3]] == pytest.approx(0.0, abs=1e-9)
    assert (np.delete(found, [r + 1, r + 3]) > 1e-6).all()


def test_forces_that_are_hardly_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """At rest they count in steps of 1e-290 N."""
    off = 1e-297 * OFF
    found = errors(monkeypatch, off, speed=0.0, heavy=False)
    assert found == pytest.approx(np.abs([mass_matrix(0.0) @ off] * len(TIMES)) / 1e-290)


def test_at_rest_a_hundredth_of_the_greatest_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing is left of a row's forces, they are judged as parts of that, and no less."""
    sums, H = terms(heavy=False)
    found = errors(monkeypatch, OFF, speed=[1.0, 1.0, 1.0, 0.0], heavy=False)
    assert found[:3] == pytest.approx((np.abs(H @ OFF) / sums)[:3], rel=1e-8)
    least = 1e-2 * sums[:3].max(axis=0)
    assert found[3] == pytest.approx(np.abs(mass_matrix(0.0) @ OFF) / least, rel=1e-8)


class Rounded(FullState):
    """One whose ABA has round-off in the world's axes, at one time alone."""

    left = np.array([3e-6, 1e-6])

    def rate(self, t: float, y: Array, axes: pin.Convention = pin.Convention.LOCAL) -> Array:
        """Off by that."""
        out = super().rate(t, y, axes)
        if axes == pin.Convention.WORLD and t == TIMES[2]:
            out[-2:] += self.left
        return out


def test_round_off_of_aba_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times what two ways through it are apart, at the time when that is most."""
    sums, H = terms()
    errors(monkeypatch, OFF)  # the route is off by that from here on
    traj = swinging(False)
    found = equation_errors(traj, Rounded(traj.scene), TIMES)
    left = 10.0 * np.abs(H[2] @ Rounded.left) / sums[2]
    assert found == pytest.approx(np.abs(H @ OFF) / sums - left, rel=1e-8)
    assert (found > 0.0).all()
    monkeypatch.setattr(Rounded, "left", 1e3 * Rounded.left)
    assert not equation_errors(traj, Rounded(traj.scene), TIMES).any()
