"""A flow with a shape, a parameter of a torque and one of a body as inputs, and where it is."""

from __future__ import annotations

from typing import Any

import numpy as np

import pinred
from pinred import Parameter
from pinred.forces import Torque
from pinred.simulation.flow_map.flow import Flow

AT = [np.array([0.4, 0.1, -0.2]), np.array([0.5]), np.array([2.1])]
BATCH = np.random.default_rng(3).uniform(-0.5, 0.5, (5, 3))


def flow_of(**options: Any) -> Flow:
    """Return the flow of a falling cat that is kicked for 0.3 s."""
    kick = Parameter("kick", 0.3)
    given = {
        "seed": 1, "duration": 0.3, "forces": [Torque({"bend": kick})], "method": "DOP853",
        "wrt": ["x0", "kick", "back.mass"], **options,
    }  # fmt: skip
    return pinred.flow(pinred.load("falling_cat"), **given)
