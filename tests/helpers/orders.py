"""Orders of integrators, measured on robots against ABA."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import pinred
from pinred.integrators.methods import Method
from pinred.judge.distances import FullMotion
from pinred.judge.reference_solution import FullState

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
