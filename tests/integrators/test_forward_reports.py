"""Reports inside the steps of forward sensitivities, run as Python, for a linear system."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import pinred
from pinred.common.arrays import Array
from pinred.integrators.explicit import run_sensitivities as module
from pinred.integrators.stepping import run_state
from pinred.integrators.stepping.intrinsics import SEEDS


def test_states_and_tangents_inside_steps_are_those_of_the_exponential(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Several reports in one step, at step ends, and none in a step."""
    M = np.array([[0.1, 1.0], [-2.0, -0.3]])

    def rate(_address: int, y: Array, _params: Array, out: Array) -> None:
        out[:] = M @ y

    def slopes(_address: int, _y: Array, _params: Array, v: Array, _p: Array, out: Array) -> None:
        out[:] = (M @ v.reshape(2, SEEDS)).ravel()

    for place in (module, run_state):
        for name, function in vars(place).copy().items():
            if hasattr(function, "py_func"):
                monkeypatch.setattr(place, name, function.py_func)
    monkeypatch.setattr(module, "call", rate)
    monkeypatch.setattr(module, "call_slopes", slopes)
    knots, times = np.array([0.0, 0.2, 0.35, 0.6]), np.array([0.0, 0.05, 0.13, 0.2, 0.41, 0.5, 0.6])
    start, y0 = np.random.default_rng(0).normal(size=(2, SEEDS)), np.array([0.7, -0.4])
    y, along = y0.copy(), start.reshape(1, -1).copy()
    out, out_along = np.zeros((len(times), 2)), np.zeros((len(times), 1, 2 * SEEDS))
    weights = module.weights_of(pinred.DOP853.tableau())
    forward: Any = module.forward
    forward(
        (0, (0, 0), np.zeros(0), knots, times), 0, weights,
        (y, along, np.zeros((1, 0)), out, out_along), module.workspace_of(weights, 2),
    )  # fmt: skip
    for t, state, tangent in zip(times, out, out_along, strict=True):
        np.testing.assert_allclose(state, expm(M * t) @ y0, rtol=0, atol=1e-9)
        np.testing.assert_allclose(tangent.reshape(2, -1), expm(M * t) @ start, rtol=0, atol=1e-9)
    np.testing.assert_allclose(y, expm(M * 0.6) @ y0, rtol=0, atol=1e-11)
