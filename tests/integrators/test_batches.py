"""Members of a batch that reuse work rows equal single runs to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.integrators.integrate import integrate
from pinred.integrators.integrate_many import integrate_many
from pinred.integrators.methods import METHODS, Gauss, Method
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of

CASES: tuple[Method, ...] = (
    *(
        kind(1e-7, 1e-9) if kind.adaptive else kind(0.02)  # type: ignore[call-arg]
        for kind in METHODS.values()
    ),
    *(Gauss(0.02, order) for order in (2, 16)),
    Gauss(0.02, 4, "Newton"),
)
TIMES = [0.0, 0.17, 0.3]
MEMBERS, BROKEN = 24, (3, 4, 12)  # with one thread three of them one after another


@pytest.mark.parametrize("method", CASES, ids=str)
@pytest.mark.parametrize(
    "robot", ["coupled_spatial", pytest.param("planar_chain5", marks=pytest.mark.by_hand)]
)
def test_reused_work_rows_do_not_affect_next_member(robot: str, method: Method) -> None:
    """Neither states nor sums nor non-finite numbers remain from the previous member."""
    system = pinred.load(robot)
    flow = CompiledFlow.of_plan(plan_of(pinred.Scene(system=system, seed=1, method=method)))
    layout, rng = flow.kernel.layout, np.random.default_rng(2)
    y0: Array = flow.y0 * (1.0 + 0.2 * rng.normal(size=(MEMBERS, len(flow.y0))))
    params = np.tile(flow.parameters, (MEMBERS, 1))
    y0[list(BROKEN)] *= 1e200  # the squares of such momenta are beyond all numbers
    kernel_arguments = (method, flow.address(method))
    more: dict[str, Any] = {"tangent": flow.tangent, "canonical": flow.kernel.canonical}
    batch = integrate_many(*kernel_arguments, params, y0, 0.3, TIMES, layout.quaternions, 1, **more)
    assert np.flatnonzero(~batch.ok).tolist() == [*BROKEN]
    for k in set(range(MEMBERS)) - set(BROKEN):
        one = integrate(*kernel_arguments, params[k], y0[k], 0.3, TIMES, layout.quaternions, **more)
        assert np.array_equal(batch.y[k], one.y)
        assert (batch.steps[k], batch.rejected[k]) == (one.steps, one.rejected)
        assert batch.evaluations[k] == one.evaluations
        assert batch.end[k] == 0.3
