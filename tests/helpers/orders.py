"""Convergence orders of integrators, measured on robots against ABA."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import pinred
from pinred.integrators.methods import Method
from pinred.judge.reference_solution import FullMotion, FullState

# Robots, and the durations [s] over which their motions are in the asymptotic range of the order.
ROBOTS = {
    "planar_chain5": 0.5,
    "double_spherical_pendulum": 0.5,
    "coupled_spatial": 1.5,
    "falling_cat": 1.5,
}

# Fractions of these durations. Averaging avoids an error that crosses zero at one of them.
FRACTIONS = (0.7, 0.85, 1.0)


def fit_order(errors: list[float], steps: list[float]) -> float:
    """Return the exponent of the step size in the errors, by a fit."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def errors_at_the_end(
    robot: str, method_of: Callable[[float], Method], counts: list[int]
) -> tuple[list[float], list[float]]:
    """Return mean final errors of shape and rotation against ABA.

    Args:
        robot: Name of a robot in ROBOTS.
        method_of: Function from a step size [s] to an integrator.
        counts: Numbers of steps.
    Returns:
        Shape errors [rad | m] and rotation errors [rad], one per number of steps.
    """
    system = pinred.load(robot)
    shape, rotation = np.zeros(len(counts)), np.zeros(len(counts))
    for fraction in FRACTIONS:
        end = fraction * ROBOTS[robot]
        full = FullState(pinred.Scene(system=system, seed=3, times=[end]))
        initial = pinred.Scene(system=system, seed=3, times=[end]).start
        y0 = full.state(initial.pose, initial.x, initial.xi, initial.xdot)
        reference = full.run(y0, np.array([end]), 2e-14, 1e-15)
        for k, count in enumerate(counts):
            method = method_of(end / count)
            traj = pinred.simulate(system, seed=3, times=[end], method=method)
            assert traj.run.method == method.name
            assert abs(traj.run.steps - count) <= 1
            errors = full.distance(reference, FullMotion(x=traj.x, q=traj.q))
            shape[k] += float(errors.shape[-1]) / len(FRACTIONS)
            rotation[k] += float(errors.rotation[-1]) / len(FRACTIONS)
    return shape.tolist(), rotation.tolist()
