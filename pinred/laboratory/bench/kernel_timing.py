"""Times of kernels and of flows.

An evaluation of a kernel is compared with `pin.aba`, and a gradient of a flow with a run.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.waiting import Progress, one_by_one
from ...integrators.integrate import Integration
from ...kernels.build import build_kernel
from ...kernels.evaluate import repeat, repeat_adjoint
from ...kernels.kernel import Kernel, Structure
from ...reduction.cyclic_joints import cyclic_joints
from ...reduction.pointwise_reduction import PointwiseReduction
from ...simulation.flow_map.flow import Flow, flow
from ...simulation.simulate import simulate
from ...system.load import load
from ...system.system import System
from .problems import FAMILIES, chain
from .timing import NoCache, Table, alternating, fastest, repeated, robots_to_measure, timed

_BUNDLED = ("coupled_planar", "planar_chain5", "falling_cat", "satellite_two_arms")
_EXAMPLES = ("ur5", "solo12", "talos")
_CHAIN = re.compile(f"({'|'.join(FAMILIES)})-([0-9]+)")


@checks_arguments
def bench_kernels(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the cost of each robot's kernel, with momentum and without forces.

    Args:
        robots: Names or files, and chains such as planar-20 and spatial-100; four bundled robots
            and, if installed, ur5, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot: its number of joints, the instructions of the CasADi graph, the time
        from the model to the address of machine code [s], the time of an evaluation of the kernel
        and of `pin.aba` called from Python [µs], and the ratio of these two.
    """
    names = robots_to_measure(robots, _BUNDLED, _EXAMPLES)
    rows = tuple(one_by_one(names, _bench_kernel, progress, "kernels"))
    return Table("kernels", rows, {"build": "s", "kernel": "µs", "pin_aba": "µs"})


def _bench_kernel(name: str) -> SimpleNamespace:
    system = _robot(name)

    def build() -> Kernel:
        structure = Structure(zero_momentum=False, cyclic=cyclic_joints(PointwiseReduction(system)))
        return build_kernel(system, structure, cache=NoCache())

    kernel, seconds = timed(build)
    rng = np.random.default_rng(0)
    y = rng.normal(size=kernel.layout.size)
    parameters = rng.normal(size=kernel.layout.parameters)
    model, data = system.model, system.model.createData()
    q = system.q(system.group.identity(), rng.normal(size=system.m))
    v = system.joint_rates(rng.normal(size=system.n))
    tau = np.zeros(model.nv)
    actions = [
        partial(repeat, kernel.rate.address, parameters, y),
        repeated(lambda: pin.aba(model, data, q, v, tau)),
    ]
    cost, aba = (1e6 * np.median(alternating(actions), axis=0)).tolist()
    return SimpleNamespace(
        robot=name, joints=system.m, instructions=kernel.instructions, build=seconds, kernel=cost,
        pin_aba=aba, ratio=aba / cost,
    )  # fmt: skip


def _robot(name: str) -> System:
    """Return a chain, or load a robot without gravity."""
    if match := _CHAIN.fullmatch(name):
        return chain(match[1], int(match[2]))
    return load(name, group="SE3" if name == "ur5" else None, gravity=(0.0, 0.0, 0.0))


_SPAN = 2.0  # duration of the motion [s]
_ROUNDS, _BURST = 300, 1e-3  # many short rounds [s], so that some are not interrupted


@checks_arguments
def bench_flow(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the cost of each robot's flow; docs/flow.md explains the columns.

    Every call of a flow uses a different initial shape. The fastest of several alternating rounds
    counts.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot. Times in runs include the forward run; those of JAX are in addition to
        pinred's. `adjoint` is relative to an evaluation of the rate.
    """
    rows = one_by_one(robots_to_measure(robots), _bench_flow, progress, "flows")
    units = dict.fromkeys(("integration", "call", "simulate", "step"), "µs")
    units |= dict.fromkeys(("jvp", "gradient", "inertias", "gauss"), "runs")
    units |= {"adjoint": "rates"} | dict.fromkeys(("jax", "jax_gradient"), "+µs")
    return Table("flow", tuple(rows), units)


def _bench_flow(name: str) -> SimpleNamespace:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    options: Any = {"seed": 1, "duration": _SPAN}
    motion = ["x0", "xdot0", "xi0"]
    joints = [*system.model.names][1:]
    bodies = [f"{joint}.body.{name}" for joint in joints for name in ("mass", "com")]
    by_motion = flow(system, wrt=motion, method="DOP853", rtol=1e-8, **options)
    by_all = flow(system, wrt=[*motion, *bodies], method="DOP853", rtol=1e-8, **options)
    by_gauss = flow(system, wrt=motion, method="AdaptiveGauss", rtol=1e-10, **options)
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
    actions = [
        repeated(partial(integration, p, y)),
        repeated(lambda: simulate(scene).x),
        repeated(lambda: step.linear().by_state),
        repeated(lambda: by_motion(x0=shape()).x),
        repeated(lambda: by_motion.jvp({"x0": along}, x0=shape())),
        partial(repeat, propagator.kernel.rate.address, p, y),
        partial(repeat_adjoint, field.adjoint(), y, p, covector, cotangents),
    ]
    for timed_flow in (by_motion, by_all, by_gauss):
        actions += map(repeated, _run_and_gradient(timed_flow))
    actions += map(repeated, _of_jax(by_motion))
    seconds = fastest(actions, rounds=_ROUNDS, span=_BURST)
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
