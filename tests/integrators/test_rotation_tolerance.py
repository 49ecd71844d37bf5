"""The attitude follows the tolerance in steps that only the quaternion controls."""

from __future__ import annotations

import numpy as np
import pytest

import pinred
from pinred.laboratory.stress.extreme_parameters import single

RTOL, TURNED = 1e-8, 100.0


@pytest.mark.parametrize(
    ("method", "part"), [("DOP853", 1.0), ("Tsit5", 1.0), ("Radau", 0.03), ("AdaptiveGauss", 0.1)]
)
def test_rotation_error_of_sphere_follows_tolerance(method: str, part: float) -> None:
    """After 100 rad the angle's error is a fraction of rtol, larger for looser tolerances.

    Bounds: 1.5 and 3 for the explicit methods, 0.12 and 0.35 for the others.
    """
    traj = pinred.simulate(
        single([1.0, 1.0, 1.0]), xi0=[0.0, 0.0, 1.0], duration=TURNED, method=method,
        rtol=RTOL, atol=1e-20,
    )  # fmt: skip
    angle = 2.0 * np.arctan2(traj.pose[-1, 2], traj.pose[-1, 3])
    off = (angle - TURNED + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(off) < part * RTOL
