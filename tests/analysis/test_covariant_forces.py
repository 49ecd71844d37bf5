"""Covariant forces of machine code against Pinocchio's inverse dynamics at zero momentum."""

from __future__ import annotations

import numpy as np
import pytest
from assertions import close
from inverse_dynamics import joint_torques
from strategies import make_case

import pinred


@pytest.mark.by_hand
@pytest.mark.parametrize("group", ["SO2", "SE2", "SO3", "SE3"])
def test_covariant_forces_are_torques_at_zero_momentum(group: str) -> None:
    """On random trees, values by RNEA and derivatives by differences of RNEA."""
    case = make_case(group, 3, 5)
    code = pinred.Connection.mechanical(case.system).code
    motion, along = case.rng.normal(size=(3, 3)), case.rng.normal(size=3)
    force, slope = code.covariant_forces(motion[:1], motion[1:2], motion[2:], along[None])
    close(force[0], joint_torques(case.system, *motion), 1e-10)
    step, expected = 1e-3, np.zeros(9)
    for k in range(9):
        for count, weight in ((1, 45.0), (2, -9.0), (3, 1.0)):
            for sign in (1.0, -1.0):
                displacement = motion.copy()
                displacement.ravel()[k] += sign * count * step
                torque = joint_torques(case.system, *displacement)
                expected[k] += sign * weight / (60.0 * step) * (along @ torque)
    close(slope[0], expected, 1e-6 * max(1.0, float(np.abs(expected).max())))
