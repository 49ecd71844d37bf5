"""Check of controller measurements, each kind of number in its unit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.forces import Command, Controller
from pinred.judge.audit import measurement_error
from pinred.judge.reference_solution import FullState

CAT = pinred.load("falling_cat")
WRONG = 1e-3


@cache
def motion(speed: float) -> tuple[pinred.Trajectory, FullState]:
    """Simulate the cat with an idle controller that is called three times."""
    idle = Controller(lambda _: np.zeros(CAT.m), 0.1)
    traj = pinred.simulate(
        CAT, x0=speed * np.array([0.5, 3.0, -2.0]), xdot0=speed * np.array([1.0, -4.0, 2.0]),
        duration=0.3, xi0=speed * np.array([0.3, 2.0, -0.5, 1.5, 0.2, 3.0]), forces=idle,
        pose0=[0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5], rtol=1e-10,
    )  # fmt: skip
    return traj, FullState(traj.scene)


def with_wrong_measurement(traj: pinred.Trajectory, name: str, of_base: bool) -> tuple[Any, ...]:
    """Return the recorded calls with one wrong number in the last one."""
    *before, last = traj.actions
    fraction: Any = last.seen.base if of_base else last.seen
    wrong = getattr(fraction, name).copy()
    wrong[-1] += WRONG
    changed = replace(fraction, **{name: wrong})
    return *before, replace(last, seen=replace(last.seen, base=changed) if of_base else changed)


KINDS = [
    ("x", False), ("xdot", False), ("xi", False), ("mu", False),
    ("pose", True), ("xi", True), ("mu", True), ("J", True),
]  # fmt: skip


@pytest.mark.parametrize("speed", [1.0, 1e-2])
@pytest.mark.parametrize(("name", "of_base"), KINDS)
def test_measurement_error_is_relative_to_unit(
    monkeypatch: pytest.MonkeyPatch, name: str, of_base: bool, speed: float
) -> None:
    """Units are radians, the largest rate, and momenta of the whole mass at that rate."""
    traj, full = motion(speed)
    kept = traj.actions
    assert len(kept) == 3
    assert measurement_error(traj, full) < 1e-12
    monkeypatch.setattr(traj.motion, "actions", with_wrong_measurement(traj, name, of_base))
    seen: list[Any] = [item.seen for item in kept]
    rates = max(float(np.abs([*item.xi[3:], *item.xdot]).max()) for item in seen)
    data, q = CAT.model.createData(), CAT.q(seen[0].base.pose, seen[0].x)
    pin.ccrba(CAT.model, data, q, np.zeros(CAT.n))
    carried = float(np.trace(data.Ig.inertia)) * rates
    least = {"x": 1.0, "pose": 1.0, "mu": carried, "J": carried}.get(name, 0.0)
    largest = max(
        float(np.abs(getattr(item.base if of_base else item, name)).max()) for item in seen
    )
    expected = WRONG / max(least, largest)
    assert measurement_error(traj, full) == pytest.approx(expected, rel=1e-6)


def test_measurement_error_without_base(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without base data the other fields are compared; without calls the error is 0."""
    traj, full = motion(1.0)
    bare = tuple(replace(item, seen=replace(item.seen, base=None)) for item in traj.actions)
    monkeypatch.setattr(traj.motion, "actions", bare)
    assert 0.0 <= measurement_error(traj, full) < 1e-12
    monkeypatch.setattr(traj.motion, "actions", ())
    assert measurement_error(traj, full) == 0.0


def test_measurement_error_without_joints() -> None:
    """Empty fields have no error."""
    push = Controller(lambda _: Command(wrench=np.array([0.1, 0.0, 0.2])), 0.1, wrench=True)
    traj = pinred.simulate(
        pinred.load("rigid_body"), duration=0.2, xi0=[0.1, 2.0, 0.3], forces=push
    )
    assert len(traj.actions) == 2
    assert measurement_error(traj, FullState(traj.scene)) < 1e-12
