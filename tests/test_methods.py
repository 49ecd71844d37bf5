"""Integrators through `simulate`: the orders that they claim, measured on robots against ABA."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import pinred
from pinred import DOP853, RKMK4
from pinred.common.arrays import Array
from pinred.integrators.methods import Method
from pinred.verification.full_state import FullMotion, FullState

# With the time over which a motion is smooth enough for its steps to be in the asymptotic range.
ROBOTS = {
    "planar_chain5": 0.5,
    "double_spherical_pendulum": 0.5,
    "coupled_spatial": 1.5,
    "falling_cat": 1.5,
}
PARTS = (0.7, 0.85, 1.0)  # of that time: an error that happens to cross zero misleads nobody


def measured(errors: list[float], steps: list[float]) -> float:
    """The order with which errors fall."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def errors_at_the_end(
    robot: str, make: Callable[[float], Method], counts: list[int]
) -> tuple[list[float], list[float]]:
    """Errors of shape and rotation with so many steps, by ABA, as a mean over a few ends."""
    system = pinred.load(robot)
    shape, rotation = np.zeros(len(counts)), np.zeros(len(counts))
    for part in PARTS:
        end = part * ROBOTS[robot]
        full = FullState(pinred.Scene(system=system, seed=3, times=[end]))
        start = pinred.Scene(system=system, seed=3, times=[end]).start
        y0 = full.state(start.pose, start.x, start.xi, start.xdot)
        truth = full.run(y0, np.array([end]), 2e-14, 1e-15)
        for k, count in enumerate(counts):
            method = make(end / count)
            traj = pinred.simulate(system, seed=3, times=[end], method=method)
            assert traj.run.method == method.name
            assert abs(traj.run.steps - count) <= 1
            found = full.distance(truth, FullMotion(x=traj.x, q=traj.q))
            shape[k] += float(found.shape[-1]) / len(PARTS)
            rotation[k] += float(found.rotation[-1]) / len(PARTS)
    return shape.tolist(), rotation.tolist()


def fixed(step: float) -> DOP853:
    """DOP853 with steps that no error makes shorter."""
    return DOP853(rtol=1e3, atol=1e3, max_step=step)


@pytest.mark.parametrize("robot", ROBOTS)
def test_order_of_rkmk4(robot: str) -> None:
    """Order 4 in shape and attitude."""
    counts = [60, 85, 120, 170, 240]
    for errors in errors_at_the_end(robot, RKMK4, counts):
        order = measured(errors, [1 / count for count in counts])
        assert order == pytest.approx(RKMK4.order, abs=0.2)


# A planar chain's eighth-order errors reach round-off before they are in the asymptotic range.
@pytest.mark.parametrize("robot", [name for name in ROBOTS if name != "planar_chain5"])
def test_order_of_dop853(robot: str) -> None:
    """Order 8 in shape and attitude together, above the plateau of round-off."""
    counts = [8, 9, 10, 11, 12, 13, 15, 18]
    errors = np.hypot(*errors_at_the_end(robot, fixed, counts)).tolist()
    kept = [(e, 1 / n) for e, n in zip(errors, counts, strict=True) if e > 3e-13]
    assert len(kept) >= 5
    order = measured([e for e, _ in kept], [h for _, h in kept])
    assert order == pytest.approx(DOP853.order, abs=0.2)


def test_a_method_has_its_own_tolerance() -> None:
    """A looser DOP853 takes fewer steps than the scene's, and is as wrong as it says."""
    system = pinred.load("falling_cat")
    loose = pinred.simulate(system, duration=2.0, method=DOP853(rtol=1e-5, atol=1e-7))
    tight = pinred.simulate(system, duration=2.0)
    assert loose.run.steps < tight.run.steps
    apart: Array = np.abs(loose.x - tight.x).max(axis=0)
    assert 1e-9 < apart.max() < 1e-3


def test_methods_that_are_none() -> None:
    """A name is no method, and SciPy has DOP853 only."""
    system = pinred.load("falling_cat")
    with pytest.raises(pinred.InputError, match=r"method must be 'auto' or DOP853\(…\) or RKMK4\("):
        pinred.simulate(system, method="RKMK4")
    with pytest.raises(pinred.InputError, match="pinocchio"):
        pinred.simulate(system, method=RKMK4(0.01), engine="pinocchio")
