"""The recipe of docs/flow.md for derivatives at a terminal event, against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import pinred
from pinred import Parameter
from pinred.forces import PD


def test_landing_pose_derivative_agrees_with_differences_of_landings() -> None:
    """The derivative at fixed time plus the twist times the change of the landing time."""
    cat = pinred.load("falling_cat", gravity=[0, 0, -9.81])
    landing = pinred.Event("pose[2]", "landing", direction=-1, terminal=True)
    tight: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-12}

    def drop(gain: float) -> dict[str, Any]:
        forces = [PD({"bend": 0.3}, kp=Parameter("gain", gain), kd=0.2)]
        return {"seed": 1, "pose0": [0, 0, 1, 0, 0, 0, 1], "forces": forces}

    def landed(gain: float) -> pinred.Trajectory:
        return pinred.simulate(cat, **drop(gain), duration=1.0, events=[landing], **tight)

    fall = landed(2.0)
    at = pinred.flow(cat, **drop(2.0), duration=fall.t[-1], wrt=["gain"], **tight)
    slopes, xi = at.jacobian()["gain"][at.outputs["pose"]], fall.xi[-1]
    height = Rotation.from_quat(fall.pose[-1, 3:]).as_matrix()[2]
    later = -(height @ slopes[:3]) / (height @ xi[:3])
    h, group = 1e-3, cat.group
    before, after = landed(2.0 - h), landed(2.0 + h)
    expected = group.log(group.compose(group.inverse(before.pose[-1]), after.pose[-1])) / (2 * h)
    size = np.abs(expected).max()
    np.testing.assert_allclose(slopes + xi * later, expected, atol=1e-6 * size)
    assert np.abs(slopes - expected).max() > 1e-3 * size  # at fixed time it is another number
