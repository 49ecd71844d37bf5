"""Measure the cost of flows: `python tests/helpers/flow_cost.py [ROBOT …]`; see docs/flow.md.

Every call of a flow uses a different initial shape. The fastest of several alternating rounds
counts. Times in runs include the forward run; those of JAX are in addition to pinred's. `adjoint`
is relative to an evaluation of the rate.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

import pinred
from pinred.common.arrays import Array
from pinred.common.waiting import one_by_one
from pinred.integrators.integrate import Integration
from pinred.kernels.kernel import repeat, repeat_adjoint
from pinred.laboratory.bench.timing import Action, Table, alternating, repeated, robots_to_measure
from pinred.simulation.flow_map.flow import Flow

_BUNDLED, _EXAMPLES = ("planar_chain5", "satellite_two_arms"), ("solo12", "talos")
_SPAN = 2.0  # duration of the motion [s]
_ROUNDS, _BURST = 300, 1e-3  # many short rounds [s], so that some are not interrupted


def measure_flows(robots: Sequence[str] = ()) -> Table:
    """Return a row of costs for each robot.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
    Returns:
        The table.
    """
    names = robots_to_measure(robots, _BUNDLED, _EXAMPLES)
    rows = one_by_one(names, _measure_flow, True, "flows")
    units = dict.fromkeys(("integration", "call", "simulate", "step"), "µs")
    units |= dict.fromkeys(("jvp", "gradient", "inertias", "gauss"), "runs")
    units |= {"adjoint": "rates"} | dict.fromkeys(("jax", "jax_gradient"), "+µs")
    return Table("flow", tuple(rows), units)


def _measure_flow(name: str) -> SimpleNamespace:
    system = pinred.load(name, gravity=(0.0, 0.0, 0.0))
    options: Any = {"seed": 1, "duration": _SPAN}
    motion = ["x0", "xdot0", "xi0"]
    joints = [*system.model.names][1:]
    bodies = [f"{joint}.body.{name}" for joint in joints for name in ("mass", "com")]
    by_motion = pinred.flow(system, wrt=motion, method="DOP853", rtol=1e-8, **options)
    by_all = pinred.flow(system, wrt=[*motion, *bodies], method="DOP853", rtol=1e-8, **options)
    by_gauss = pinred.flow(system, wrt=motion, method="AdaptiveGauss", rtol=1e-10, **options)
    scene, propagator = by_motion.scene, by_motion.propagator
    field = propagator.field
    (solution,) = by_motion.run({}).solutions
    y, p, times = solution.states[0].copy(), solution.params, solution.times
    integration = Integration(
        propagator.method, field.address, len(y), _SPAN, times, field.quaternions
    )
    step = by_motion.step(solution.knots[1])
    shape = _DistinctShapes(by_motion)
    along, covector, cotangents = np.ones(system.m), np.ones(len(y)), np.empty(len(y) + len(p))
    actions: list[Action] = [
        repeated(partial(integration, p, y)),
        repeated(lambda: pinred.simulate(scene).x),
        repeated(lambda: step.linear().by_state),
        repeated(lambda: by_motion(x0=shape()).x),
        repeated(lambda: by_motion.jvp({"x0": along}, x0=shape())),
        partial(repeat, propagator.kernel.rate.address, p, y),
        partial(repeat_adjoint, field.adjoint(), y, p, covector, cotangents),
    ]
    for timed_flow in (by_motion, by_all, by_gauss):
        actions += map(repeated, _run_and_gradient(timed_flow))
    actions += map(repeated, _of_jax(by_motion))
    seconds = np.nanmin(alternating(actions, rounds=_ROUNDS, span=_BURST), axis=0)
    alone, whole, linear, call, jvp, rate, adjoint, *runs = (1e6 * lapse for lapse in seconds)
    jax, jax_gradient = runs[6:] or (np.nan, np.nan)
    return SimpleNamespace(
        robot=name, steps=solution.steps, integration=alone, call=call, simulate=whole, step=linear,
        jvp=jvp / runs[0], gradient=runs[1] / runs[0], inertias=runs[3] / runs[2],
        gauss=runs[5] / runs[4], adjoint=adjoint / rate, jax=jax - call,
        jax_gradient=jax_gradient - runs[1],
    )  # fmt: skip


class _DistinctShapes:
    """Source of distinct initial shapes."""

    def __init__(self, made: Flow) -> None:
        self._own, self._calls = made.own("x0"), 0

    def __call__(self) -> Array:
        self._calls += 1
        return self._own + 1e-9 * self._calls


def _run_and_gradient(made: Flow) -> list[Callable[[], object]]:
    """Return functions that run a flow, and that compute the gradient of all its outputs."""
    shape = _DistinctShapes(made)
    one = np.ones(sum(place.stop - place.start for place in made.outputs.values()))
    return [lambda: made.run({"x0": shape()}), lambda: made.vjp(one, x0=shape())]


def _of_jax(made: Flow) -> list[Callable[[], object]]:
    """Return functions that call the flow and its gradient through JAX; none without JAX."""
    try:
        import jax
    except ImportError:
        return []
    function, shape = made.jax(), _DistinctShapes(made)
    inputs = [made.own(name) for name in made.inputs if name != "x0"]
    compiled_flow = jax.jit(function)
    slope = jax.jit(jax.grad(lambda *given: function(*given).sum(), range(1 + len(inputs))))
    return [
        lambda: jax.block_until_ready(compiled_flow(shape(), *inputs)),
        lambda: jax.block_until_ready(slope(shape(), *inputs)),
    ]


if __name__ == "__main__":
    print(measure_flows(sys.argv[1:]))
