"""What controllers were given is judged, each kind of number in its own unit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.forces import Command, Controller
from pinred.judge.controller_measurements import measurement_error
from pinred.judge.reference_solution import FullState

CAT = pinred.load("falling_cat")
WRONG = 1e-3


@cache
def motion(speed: float) -> tuple[pinred.Trajectory, FullState]:
    """The cat, three times seen by a controller that does nothing."""
    idle = Controller(lambda _: np.zeros(CAT.m), 0.1)
    traj = pinred.simulate(
        CAT, x0=speed * np.array([0.5, 3.0, -2.0]), xdot0=speed * np.array([1.0, -4.0, 2.0]),
        duration=0.3, xi0=speed * np.array([0.3, 2.0, -0.5, 1.5, 0.2, 3.0]), forces=idle,
        pose0=[0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5], rtol=1e-10,
    )  # fmt: skip
    return traj, FullState(traj.scene)


def off(traj: pinred.Trajectory, name: str, of_base: bool) -> tuple[Any, ...]:
    """The calls, of which the last was told a wrong number."""
    *before, last = traj.actions
    part: Any = last.seen.base if of_base else last.seen
    wrong = getattr(part, name).copy()
    wrong[-1] += WRONG
    changed = replace(part, **{name: wrong})
    return *before, replace(last, seen=replace(last.seen, base=changed) if of_base else changed)


KINDS = [
    ("x", False), ("xdot", False), ("xi", False), ("mu", False),
    ("pose", True), ("xi", True), ("mu", True), ("J", True),
]  # fmt: skip


@pytest.mark.parametrize("speed", [1.0, 1e-2])
@pytest.mark.parametrize(("name", "of_base"), KINDS)
def test_each_number_in_its_unit(
    monkeypatch: pytest.MonkeyPatch, name: str, of_base: bool, speed: float
) -> None:
    """Radians, the largest rate, and momenta as the largest rate makes of all the mass."""
    traj, full = motion(speed)
    kept = traj.actions
    assert len(kept) == 3
    assert measurement_error(traj, full) < 1e-12
    monkeypatch.setattr(traj.motion, "actions", off(traj, name, of_base))
    seen: list[Any] = [each.seen for each in kept]
    rates = max(float(np.abs([*each.xi[3:], *each.xdot]).max()) for each in seen)
    data, q = CAT.model.createData(), CAT.q(seen[0].base.pose, seen[0].x)
    pin.ccrba(CAT.model, data, q, np.zeros(CAT.n))
    carried = float(np.trace(data.Ig.inertia)) * rates
    least = {"x": 1.0, "pose": 1.0, "mu": carried, "J": carried}.get(name, 0.0)
    largest = max(
        float(np.abs(getattr(each.base if of_base else each, name)).max()) for each in seen
    )
    expected = WRONG / max(least, largest)
    assert measurement_error(traj, full) == pytest.approx(expected, rel=1e-6)


def test_without_a_base(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it was left out, the rest is judged; without controllers there is nothing."""
    traj, full = motion(1.0)
    bare = tuple(replace(each, seen=replace(each.seen, base=None)) for each in traj.actions)
    monkeypatch.setattr(traj.motion, "actions", bare)
    assert 0.0 <= measurement_error(traj, full) < 1e-12
    monkeypatch.setattr(traj.motion, "actions", ())
    assert measurement_error(traj, full) == 0.0


def test_without_joints() -> None:
    """Of what a robot has not, nothing can be wrong."""
    push = Controller(lambda _: Command(wrench=np.array([0.1, 0.0, 0.2])), 0.1, wrench=True)
    traj = pinred.simulate(
        pinred.load("rigid_body"), duration=0.2, xi0=[0.1, 2.0, 0.3], forces=push
    )
    assert len(traj.actions) == 2
    assert measurement_error(traj, FullState(traj.scene)) < 1e-12
