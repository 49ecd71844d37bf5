"""Evaluation counts of implicit methods, compared with counts by the kernels themselves."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from stiff_kernels import kernel_by_numba, kernels

from pinred import AdaptiveGauss, Gauss, Radau, Variational
from pinred.integrators.integrate_many import integrate_many
from pinred.integrators.methods import Method
from pinred.integrators.stepping.run_state import Canonical


@cache
def _wide(lanes: int) -> tuple[int, Any]:
    """Kernel of a soft spring of stiffness p[2] with damping p[3] and an edge at p[4].

    It counts calls of the rate in p[0] and calls of the derivative in p[1].
    """

    def rate(y: Any, p: Any, d: Any) -> None:
        p[0] += 1.0
        for j in range(lanes):
            x, v = y[j], y[lanes + j]
            d[j] = v
            d[lanes + j] = -p[2] * (x - 0.1 * x * x * x) - p[3] * v + 0.0 * np.sqrt(p[4] - x)

    def slope(y: Any, p: Any, v: Any, d: Any) -> None:
        p[1] += 1.0
        for j in range(8):
            d[j] = v[8 + j]
            d[8 + j] = -p[2] * (1.0 - 0.3 * y[0] * y[0]) * v[j] - p[3] * v[8 + j]

    return kernels(rate, slope, kernel_by_numba)


METHODS: list[Method] = [
    *(Gauss(0.05, order, way) for order in (2, 16) for way in ("auto", "fixed point", "Newton")),
    AdaptiveGauss(1e-9, 1e-11),
    Radau(1e-6, 1e-8),
    Variational(0.05),
]


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_evaluation_counts_equal_kernel_calls(method: Method) -> None:
    """Counts include all stages, derivatives, rejected steps and dense output."""
    address, tangent = _wide(method.lanes)
    stages = getattr(method, "stages", 1)
    for times in (np.zeros(0), np.linspace(0.0, 1.0, 23)):
        # Stiffness, damping, edge: one by one more than fixed points can solve, the last meets it.
        params = np.array(
            [
                [0.0, 0.0, *own]
                for own in ([1, 0, 9], [3e3, 0, 9], [1, 1e3, 9], [1e7, 0, 9], [1, 0, 1])
            ]
        )
        many = integrate_many(
            method, address, params, [[0.8, 0.9]] * 5, 1.0, times,
            threads=1, tangent=tangent, canonical=Canonical(1),
        )  # fmt: skip
        assert many.evaluations.tolist() == (stages * params[:, 0] + params[:, 1]).tolist()
        assert many.ok[0]
        assert not many.ok[-1]
        if method.adaptive:
            assert many.rejected.any()
