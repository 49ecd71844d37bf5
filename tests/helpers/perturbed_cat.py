"""A flow whose inputs are a shape, a torque parameter and a body mass; points to evaluate it at."""

from __future__ import annotations

from typing import Any

import numpy as np

import pinred
from pinred import Parameter
from pinred.forces import Torque
from pinred.simulation.flow_map.flow import Flow

# One input per variable parameter: initial shape [rad], torque [N m], mass of the body "back" [kg].
AT = [np.array([0.4, 0.1, -0.2]), np.array([0.5]), np.array([2.1])]
BATCH = np.random.default_rng(3).uniform(-0.5, 0.5, (5, 3))  # initial shapes [rad]


def flow_of(**options: Any) -> Flow:
    """Return the flow of a falling cat under a constant bending torque for 0.3 s."""
    torque = Parameter("kick", 0.3)
    scene_options = {
        "seed": 1, "duration": 0.3, "forces": [Torque({"bend": torque})], "method": "DOP853",
        "wrt": ["x0", "kick", "back.mass"], **options,
    }  # fmt: skip
    return pinred.flow(pinred.load("falling_cat"), **scene_options)
