"""One scene with twelve coefficients, as a vector parameter and as twelve scalar parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import pinred
from pinred import Parameter
from pinred.forces import Torque

CAT = pinred.load("falling_cat")
JOINTS = CAT.shape_names
OWN = np.random.default_rng(3).normal(size=12) / 50
OTHER = np.random.default_rng(4).normal(size=12) / 50
NAMES = [f"u{k}" for k in range(12)]


def scene_of(u: Sequence[Any], **options: Any) -> pinred.Scene:
    """Return a scene whose torques are polynomials of the state with twelve coefficients."""

    def torque(_t: Any, x: Any, xdot: Any, *_: Any) -> Any:
        return {
            joint: u[k] + u[k + 1] * x[joint] + u[k + 2] * xdot[joint] - u[k + 3] * x[joint] ** 3
            for k, joint in zip((0, 4, 8), JOINTS, strict=True)
        }

    return pinred.Scene(
        system=CAT,
        forces=[Torque(torque)],
        **{"duration": 0.2, "xdot0": [0.5, -0.3, 0.2], **options},
    )


def vector_parameter() -> Any:
    """Return a vector parameter with twelve entries."""
    return Parameter("u", OWN)


def scalar_parameters() -> list[Parameter]:
    """Return twelve scalar parameters with the same values."""
    return [Parameter(name, value) for name, value in zip(NAMES, OWN.tolist(), strict=True)]


def flow_pair(**options: Any) -> tuple[Any, Any]:
    """Return the flow with one vector, and the flow with twelve scalars."""
    return (
        pinred.flow(scene_of(vector_parameter(), **options), wrt=["u", "x0"]),
        pinred.flow(scene_of(scalar_parameters(), **options), wrt=[*NAMES, "x0"]),
    )


def assert_same_bits(a: Any, b: Any) -> None:
    """Check that two arrays have the same shape and bits."""
    np.testing.assert_array_equal(np.asarray(a), np.asarray(b), strict=True)
