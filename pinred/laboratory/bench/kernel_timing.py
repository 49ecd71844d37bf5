"""Times of kernels and of flows.

An evaluation of a kernel is compared with `pin.aba`. A gradient of a flow is compared with a run,
and with CVODES's adjoint.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.waiting import Progress, one_by_one
from ...integrators.integrate import Integration
from ...integrators.run_derivatives import run_back
from ...kernels.build import build_kernel
from ...kernels.evaluate import repeat, repeat_adjoint
from ...kernels.kernel import Kernel, Structure
from ...kernels.reduced_graph import ReducedGraph
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
        pinred's. `adjoint` is relative to an evaluation of the rate; `cvodes` and `apart` compare
        with CVODES's adjoint (CasADi, same tolerance).
    """
    rows = one_by_one(robots_to_measure(robots), _bench_flow, progress, "flows")
    units = dict.fromkeys(("integration", "call", "simulate", "step"), "µs")
    units |= dict.fromkeys(("jvp", "gradient", "inertias", "gauss"), "runs")
    units |= dict.fromkeys(("jax", "jax_gradient"), "+µs") | {"cvodes": "×", "adjoint": "rates"}
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
    own, by_cvodes, slower = beside_cvodes(by_motion, 1e-8)
    return SimpleNamespace(
        robot=name, steps=solution.steps, integration=alone, call=call, simulate=whole, step=linear,
        jvp=jvp / runs[0], gradient=runs[1] / runs[0], inertias=runs[3] / runs[2],
        gauss=runs[5] / runs[4], jax=jax - call, jax_gradient=jax_gradient - runs[1], cvodes=slower,
        apart=float(np.abs(by_cvodes - own).max() / np.abs(own).max()), adjoint=adjoint / rate,
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


_MOST = 1_000_000  # largest number of steps of CVODES
_LONGEST = 3.0  # time limit for all runs of each of the two adjoints [s]


def beside_cvodes(
    made: Flow, tolerance: float, *, timed: bool = True
) -> tuple[Array, Array, float]:
    """Compute the gradient of a flow with the adjoints of pinred and of CVODES.

    The flow must use an explicit method over a single segment. The component along each
    quaternion's length is excluded: the flow normalises quaternions, CVODES does not.

    Args:
        made: The flow.
        tolerance: Relative tolerance of CVODES.
        timed: Whether to measure the time of both adjoints.
    Returns:
        Gradients of λ · y at the end with respect to the initial reduced state and parameters, by
        pinred and by CVODES, (n + p,) each; and the ratio of CVODES's time to pinred's, forward run
        included, of the fastest of several alternating rounds, or NaN if not timed.
    """
    propagator, kernel = made.propagator, made.propagator.kernel
    run = made.run({})
    (solution,) = run.solutions
    y0, times = solution.states[0].copy(), solution.times
    covector = np.random.default_rng(0).normal(size=len(y0))
    none = np.zeros((len(times), len(y0)))
    rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    options = {"reltol": tolerance, "abstol": 1e-2 * tolerance, "max_num_steps": _MOST}
    dae = {"x": y, "p": p, "ode": rate(y, p)}
    integrator = ca.integrator("cvodes", "cvodes", dae, 0.0, made.scene.end, options)
    adjoint = integrator.factory("adjoint", ["x0", "p", "adj:xf"], ["adj:x0", "adj:p"])
    by_cvodes = partial(adjoint, y0, solution.params, covector)

    def own() -> Any:
        (now,) = propagator.run(run.given, stages=True).solutions
        return run_back(propagator.method, propagator.field, now, times, covector, none)

    mine = own()
    gradients = [
        np.concatenate([mine.by_state, mine.by_parameters]),
        np.concatenate([np.array(part).ravel() for part in by_cvodes()]),
    ]
    first, count = kernel.layout.quaternions
    for k in range(first, first + 4 * count, 4):
        place = slice(k, k + 4)
        q = y0[place] / np.linalg.norm(y0[place])
        for gradient in gradients:
            gradient[place] -= q * (q @ gradient[place])
    slower = np.nan
    if timed:
        slow, fast = fastest([repeated(by_cvodes), repeated(own)], budget=_LONGEST)
        slower = slow / fast
    return gradients[0], gradients[1], slower
