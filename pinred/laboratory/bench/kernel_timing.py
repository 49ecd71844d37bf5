"""Times of kernels and flows, and of their derivatives.

An evaluation of a kernel is compared with `pin.aba`, measured with forces, and for long chains. The
cost of a flow is relative to a run, that of a kernel's derivative to an evaluation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError
from ...common.waiting import Progress, one_by_one, quiet, shown
from ...forces import SeenState, Torque, Wrench
from ...forces.force_model import ForceModel
from ...integrators.integrate import Integration
from ...integrators.methods.method import stepper_of
from ...integrators.run_derivatives import run_back
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.intrinsics import SEEDS, call, call_slopes
from ...integrators.stepping.linear_systems import jacobian
from ...kernels.build import build_kernel, jacobian_code, tangent_of
from ...kernels.flow_functions import rate_of
from ...kernels.kernel import Kernel, Structure, repeat, repeat_adjoint
from ...kernels.reduced_graph import ReducedGraph
from ...reduction.cyclic_joints import cyclic_joints
from ...reduction.pointwise_reduction import PointwiseReduction
from ...reduction.tree.free_bodies import STEP, Freed, pattern_of
from ...simulation.flow_map.flow import Flow, flow
from ...simulation.simulate import simulate
from ...system.load import load
from ...system.system import System
from .problems import FAMILIES, chain
from .timing import (
    ROUNDS,
    NoCache,
    Table,
    alternating,
    evaluations,
    fastest,
    repeated,
    robots_to_measure,
    timed,
)

_BUNDLED = ("coupled_planar", "planar_chain5", "falling_cat", "satellite_two_arms")
_EXAMPLES = ("ur5", "solo12", "talos")


@checks_arguments
def bench_kernels(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the cost of each robot's kernel, with momentum and without forces.

    Args:
        robots: Names or files; four bundled robots and, if installed, ur5, solo12 and talos by
            default.
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
    system = load(name, group="SE3" if name == "ur5" else None, gravity=(0.0, 0.0, 0.0))
    kernel, build = _build(system)
    rng = np.random.default_rng(0)
    model, data = system.model, system.model.createData()
    q = system.q(system.group.identity(), rng.normal(size=system.m))
    v = system.joint_rates(rng.normal(size=system.n))
    tau = np.zeros(model.nv)
    actions = [evaluations(kernel), repeated(lambda: pin.aba(model, data, q, v, tau))]
    cost, aba = (1e6 * np.median(alternating(actions), axis=0)).tolist()
    return SimpleNamespace(
        robot=name, joints=system.m, instructions=kernel.instructions, build=build, kernel=cost,
        pin_aba=aba, ratio=aba / cost,
    )  # fmt: skip


def _build(system: System) -> tuple[Kernel, float]:
    """Build the kernel with momentum and without forces; return it and the time [s]."""

    def build() -> Kernel:
        structure = Structure(zero_momentum=False, cyclic=cyclic_joints(PointwiseReduction(system)))
        return build_kernel(system, structure, cache=NoCache())

    return timed(build)


_MANY, _SHORT = 400, 5e-4  # many short rounds [s], so that some are not interrupted


@checks_arguments
def bench_forces(robots: Sequence[str] = (), *, progress: Progress | bool | None = None) -> Table:
    """Measure the cost of forces that depend on the base, for each robot.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot: the time of an evaluation without forces [µs]; the ratios to it with
        torques that depend on attitude and angular velocity, with a constant wrench, and with a
        wrench that depends on pose and twist; the numbers of integrated states of the four kernels.
    """
    rows = one_by_one(robots_to_measure(robots), _bench_forces, progress, "forces")
    return Table("forces", tuple(rows), {"free": "µs"})


def _bench_forces(name: str) -> SimpleNamespace:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    kernels = [_kernel(system, force) for force in (None, *_forces(system))]
    # A few percent can only be measured in rounds that the operating system does not interrupt.
    free, *forced = fastest([evaluations(k) for k in kernels], rounds=_MANY, span=_SHORT)
    torque, wrench, full = (seconds / free for seconds in forced)
    return SimpleNamespace(
        robot=name, free=1e6 * free, torque=torque, wrench=wrench, full=full,
        integrated=", ".join(str(kernel.layout.size) for kernel in kernels),
    )  # fmt: skip


def _kernel(system: System, force: Any) -> Kernel:
    # A kernel skips cyclic joints without forces. For comparison, all kernels integrate all joints.
    forces = None if force is None else ForceModel(system, [force], {})
    return build_kernel(system, Structure(zero_momentum=False), forces)


def _forces(system: System) -> list[Torque | Wrench]:
    group, r, k = system.group, system.r, system.group.linear

    def rotation_of(s: SeenState) -> tuple[list[ca.SX], list[ca.SX]]:
        attitude = ca.vertsplit(s.pose)[k:][: r - k]
        return attitude, ca.vertsplit(s.xi)[k:]

    def torque(s: SeenState) -> dict[str, ca.SX]:
        attitude, omega = rotation_of(s)
        torques = [-2.0 * a - 0.3 * w for a, w in zip(attitude, omega, strict=True)]
        return {name: torques[j % len(torques)] for j, name in enumerate(system.shape_names)}

    def wrench(s: SeenState) -> ca.SX:
        attitude, omega = rotation_of(s)
        position, velocity = ca.vertsplit(s.pose)[:k], ca.vertsplit(s.xi)[:k]
        pairs = zip([*position, *attitude], [*velocity, *omega], strict=True)
        components: ca.SX = ca.vertcat(*(-0.5 * a - 0.3 * b for a, b in pairs))
        return components

    constant: Callable[..., list[float]] = lambda *_: [0.1] * group.dim  # noqa: E731
    return [Torque(torque), Wrench(constant), Wrench(wrench)]


JOINTS = (5, 10, 20, 50, 100)
LONG = 20  # smallest number of joints that is included in the fit of the exponent


@checks_arguments
def bench_scaling(
    joints: Sequence[int] = JOINTS,
    *,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> list[Table]:
    """Measure the costs of planar and spatial chains.

    Args:
        joints: Increasing numbers of joints.
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A table for each family, with a row for each chain: its number of joints, the instructions
        of the CasADi graph, the time from System to machine code [s], and the time of an evaluation
        with momentum and without forces, in total [µs] and for each joint [ns].
    Raises:
        InputError: `joints` is empty or not increasing.
    """
    if not joints or (np.diff(joints) <= 0).any():
        raise InputError(f"joints must be increasing numbers, got {tuple(joints)}")
    with shown(progress, "scaling") as bar:
        cases = [(family, n) for family in FAMILIES for n in joints]
        kernels, builds = zip(*(_build(chain(*case)) for case in cases), strict=True)
        actions = [evaluations(kernel) for kernel in kernels]
        times = alternating(actions, rounds=rounds, progress=bar or quiet)
    medians = np.median(times, axis=0)
    rows = [
        SimpleNamespace(
            joints=n, instructions=kernel.instructions, build=build,
            kernel=1e6 * seconds, per_joint=1e9 * seconds / n,
        )
        for (_, n), kernel, build, seconds in zip(cases, kernels, builds, medians, strict=True)
    ]  # fmt: skip
    count = len(joints)
    return [scaling_table(name, rows[k * count :][:count]) for k, name in enumerate(FAMILIES)]


def scaling_table(family: str, rows: Sequence[SimpleNamespace]) -> Table:
    """Return the table of one family of chains, with the exponents of the number of joints."""
    long = [row for row in rows if row.joints >= LONG]
    notes: tuple[str, ...] = ()
    if len(long) > 1:
        x = np.log([row.joints for row in long])
        costs = [(row.kernel, row.instructions) for row in long]
        time_slope, instruction_slope = np.polyfit(x, np.log(costs), 1)[0]
        notes = (
            f"from {LONG} joints on, time grows with their number to the power {time_slope:.2f}, "
            f"instructions {instruction_slope:.2f}",
        )
    units = {"build": "s", "kernel": "µs", "per_joint": "ns"}
    return Table("scaling", tuple(rows), units, f"{family} chain", notes, {"family": family})


_SPAN = 2.0  # duration of the motion [s]
_COUNT = 200  # number of evaluations in one timed call
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
        pinred's. `adjoint`, `free`, `placed` and `generic` are relative to an evaluation of the
        rate; `cvodes` and `apart` compare with CVODES's adjoint (CasADi, same tolerance).
    """
    rows = one_by_one(robots_to_measure(robots), _bench_flow, progress, "flows")
    units = dict.fromkeys(("integration", "call", "simulate", "step"), "µs")
    units |= dict.fromkeys(("gradient", "inertias", "gauss"), "runs")
    units |= dict.fromkeys(("jax", "jax_gradient"), "+µs") | {"cvodes": "×", "adjoint": "rates"}
    units |= dict.fromkeys(("free", "placed", "generic"), "×") | {"stored": "bytes/step"}
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
    (solution,) = by_motion.run({}).solutions
    y, times = solution.states[0].copy(), solution.times
    integration = Integration(
        propagator.method,
        propagator.field.address,
        len(y),
        _SPAN,
        times,
        propagator.field.quaternions,
    )
    step = by_motion.step(solution.knots[1])
    one = np.ones(sum(place.stop - place.start for place in by_motion.outputs.values()))
    actions: list[Callable[[], object]] = [
        partial(integration, solution.params, y),
        lambda: simulate(scene).x,
        lambda: step.linear().by_state,
    ]
    for timed_flow in (by_motion, by_all, by_gauss):
        at = _Elsewhere(timed_flow)
        actions += [partial(_run, timed_flow, at), partial(_gradient, timed_flow, at, one)]
    at = _Elsewhere(by_motion)
    actions += [lambda: by_motion(x0=at()).x, *_of_jax(by_motion)]
    seconds = fastest([repeated(action) for action in actions], rounds=_ROUNDS, span=_BURST)
    alone, whole, linear, *runs = (1e6 * lapse for lapse in seconds)
    call, *of_jax = runs[6:]
    jax, jax_gradient = of_jax or (np.nan, np.nan)
    beside = beside_cvodes(by_motion, 1e-8)
    adjoint, free, placed, generic = _evaluations(by_motion)
    y_size, stages = len(y), stepper_of(propagator.method).stages
    return SimpleNamespace(
        robot=name, steps=solution.steps, integration=alone, call=call, simulate=whole, step=linear,
        gradient=runs[1] / runs[0], inertias=runs[3] / runs[2], gauss=runs[5] / runs[4],
        jax=jax - call, jax_gradient=jax_gradient - runs[1], cvodes=beside.slower,
        apart=beside.error, adjoint=adjoint, free=free, placed=placed, generic=generic,
        stored=f"{8 * (y_size + 1)}, {8 * (y_size + 1 + y_size * stages)}",
    )  # fmt: skip


class _Elsewhere:
    """Source of distinct initial shapes."""

    def __init__(self, made: Flow) -> None:
        self._own, self._calls = made.own("x0"), 0

    def __call__(self) -> Array:
        self._calls += 1
        return self._own + 1e-9 * self._calls


def _run(made: Flow, at: _Elsewhere) -> object:
    return made.run({"x0": at()})


def _gradient(made: Flow, at: _Elsewhere, covector: Array) -> object:
    return made.vjp(covector, x0=at())


def _of_jax(made: Flow) -> list[Callable[[], object]]:
    """Return functions that call the flow and its gradient through JAX; none without JAX."""
    try:
        import jax
    except ImportError:
        return []
    function, at = made.jax(), _Elsewhere(made)
    inputs = [made.own(name) for name in made.inputs if name != "x0"]
    compiled_flow = jax.jit(function)
    slope = jax.jit(jax.grad(lambda *given: function(*given).sum(), range(1 + len(inputs))))
    return [
        lambda: jax.block_until_ready(compiled_flow(at(), *inputs)),
        lambda: jax.block_until_ready(slope(at(), *inputs)),
    ]


def _evaluations(made: Flow) -> list[float]:
    """Return times relative to the rate: the adjoint, and kernels with variable parameters."""
    kernel = made.propagator.kernel
    system = kernel.system
    bodies = tuple(range(system.model.njoints - 1))
    steps = [
        [(i, pattern_of(system, i)) for i in bodies[1:]],
        [(i, "x" * STEP) for i in bodies[1:]],
    ]
    loose = [
        build_kernel(system, replace(kernel.structure, freed=variable), kernel.forces)
        for variable in (Freed(bodies), *(Freed(bodies, tuple(pattern)) for pattern in steps))
    ]
    rng = np.random.default_rng(0)
    y = 0.5 * rng.normal(size=kernel.layout.size)
    rates = [(one.rate.address, one.random_parameters(rng)) for one in (kernel, *loose)]
    adjoint, p, covector = made.propagator.field.adjoint(), rates[0][1], np.ones(len(y))
    cotangents = np.empty(len(y) + len(p))
    folded, *loosened, back = fastest(
        [
            *(repeated(partial(repeat, address, numbers, y, _COUNT)) for address, numbers in rates),
            repeated(lambda: repeat_adjoint(adjoint, y, p, covector, cotangents, _COUNT)),
        ],
        rounds=_ROUNDS,
        span=_BURST,
    )
    return [back / folded, *(one / folded for one in loosened)]


_MOST = 1_000_000  # largest number of steps of CVODES
_LONGEST = 3.0  # time limit for all runs of each of the two adjoints [s]


@dataclass(frozen=True)
class Adjoints:
    """Gradients of λ · y at the end with respect to the initial reduced state and parameters.

    Attributes:
        cvodes: Gradient computed by CVODES, (n + p,).
        own: Gradient computed by pinred, (n + p,).
        slower: Ratio of CVODES's time to pinred's, forward run included; the fastest of several
            alternating rounds. NaN if not timed.
    """

    cvodes: Array
    own: Array
    slower: float

    @property
    def error(self) -> float:
        """Largest difference relative to the largest entry of the gradient."""
        return float(np.abs(self.cvodes - self.own).max() / np.abs(self.own).max())


def beside_cvodes(made: Flow, tolerance: float, *, timed: bool = True) -> Adjoints:
    """Compute the gradient of a flow with the adjoints of pinred and of CVODES.

    The flow must use an explicit method over a single segment. The component along each
    quaternion's length is excluded: the flow normalises quaternions, CVODES does not.

    Args:
        made: The flow.
        tolerance: Relative tolerance of CVODES.
        timed: Whether to measure the time of both adjoints.
    Returns:
        Both gradients and the time ratio.
    """
    propagator, kernel = made.propagator, made.propagator.kernel
    run = made.run({})
    (solution,) = run.solutions
    y0, parameters, times = solution.states[0].copy(), solution.params, solution.times
    covector = np.random.default_rng(0).normal(size=len(y0))
    none = np.zeros((len(times), len(y0)))
    first, count = kernel.layout.quaternions
    adjoint = _cvodes(made, tolerance)
    by_cvodes = partial(adjoint, y0, parameters, covector)

    def own() -> Any:
        (now,) = propagator.run(run.given, stages=True).solutions
        return run_back(propagator.method, propagator.field, now, times, covector, none)

    theirs = [np.array(each).ravel() for each in by_cvodes()]
    mine = own()
    for k in range(first, first + 4 * count, 4):
        place = slice(k, k + 4)
        q = y0[place] / np.linalg.norm(y0[place])
        for slopes in (theirs[0], mine.by_state):
            slopes[place] -= q * (q @ slopes[place])
    slower = float("nan")
    if timed:
        slow, fast = fastest([repeated(by_cvodes), repeated(own)], budget=_LONGEST)
        slower = slow / fast
    own_slopes = np.concatenate([mine.by_state, mine.by_parameters])
    return Adjoints(np.concatenate(theirs), own_slopes, slower)


def _cvodes(made: Flow, tolerance: float) -> Any:
    """Return the function (y₀, parameters, λ) → gradient, computed by CasADi's CVODES."""
    kernel = made.propagator.kernel
    rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    options = {"reltol": tolerance, "abstol": 1e-2 * tolerance, "max_num_steps": _MOST}
    dae = {"x": y, "p": p, "ode": rate(y, p)}
    integrator = ca.integrator("cvodes", "cvodes", dae, 0.0, made.scene.end, options)
    return integrator.factory("adjoint", ["x0", "p", "adj:xf"], ["adj:x0", "adj:p"])


_DERIVATIVE_ROUNDS = 100


@checks_arguments
def bench_derivatives(
    robots: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> Table:
    """Measure the cost of each robot's derivatives; docs/flow.md explains the columns.

    Args:
        robots: Names or files of robots whose joints are hinges and slides; two bundled robots and,
            if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        A row for each robot, with ratios of the fastest of several alternating rounds: a flow's
        derivative along one direction and gradient in runs, which they include; derivatives of
        kernels in evaluations of the rate; Pinocchio's computeABADerivatives in its aba.
    """
    rows = one_by_one(robots_to_measure(robots), _bench_derivatives, progress, "derivatives")
    units = dict.fromkeys(("jvp", "vjp"), "runs") | {"pinocchio": "aba"}
    units |= dict.fromkeys(("direction", "eight", "adjoint", "jacobian", "columns"), "rates")
    return Table("derivatives", tuple(rows), units)


def _bench_derivatives(name: str) -> SimpleNamespace:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    options: Any = {"seed": 1, "duration": _SPAN, "method": "DOP853", "rtol": 1e-8}
    made = flow(system, wrt=["x0", "xdot0", "xi0"], **options)
    at, direction_of_x0 = _Elsewhere(made), {"x0": np.ones(system.m)}
    covector = np.ones(sum(place.stop - place.start for place in made.outputs.values()))
    flows = [
        repeated(partial(_run, made, at)),
        repeated(lambda: made.jvp(direction_of_x0, x0=at())),
        repeated(partial(_gradient, made, at, covector)),
    ]
    often: Any = {"rounds": _DERIVATIVE_ROUNDS, "span": _BURST}
    run, jvp, vjp = fastest(flows, **often)
    rate, *kernels = fastest(kernel_repetitions(made), **often)
    model, data = system.model, system.model.createData()
    q, v, tau = pin.neutral(model), np.ones(model.nv), np.zeros(model.nv)
    functions = (pin.aba, pin.computeABADerivatives)
    by_pinocchio = [repeated(partial(f, model, data, q, v, tau)) for f in functions]
    aba, derivatives = fastest(by_pinocchio, **often)
    direction, eight, adjoint, recursion, columns = (kernel / rate for kernel in kernels)
    return SimpleNamespace(
        robot=name, joints=system.m, jvp=jvp / run, vjp=vjp / run, direction=direction,
        eight=eight, adjoint=adjoint, jacobian=recursion, columns=columns,
        pinocchio=derivatives / aba,
    )  # fmt: skip


def kernel_repetitions(made: Flow) -> list[Any]:
    """Return repetitions of the rate, then of its derivatives in the order of DerivativeTiming."""
    kernel = made.propagator.kernel
    function = rate_of(kernel)
    (solution,) = made.run({}).solutions
    y, p = solution.states[0].copy(), solution.params
    n = len(y)
    dy, dp, tangents = np.ones(n), np.ones(len(p)), np.empty(2 * n)
    wide = np.ones(n * SEEDS), np.ones(len(p) * SEEDS), np.empty(n * SEEDS)
    covector, back = np.ones(n), np.empty(n + len(p))
    matrix, columns = np.empty(n * n), np.empty((n, n + SEEDS))
    seeds, slopes = np.zeros((2, n * SEEDS))
    tangent = tangent_of(kernel).address
    return [
        partial(repeat, kernel.rate.address, p, y),
        partial(_repeat_tangent, function.pair.address, y, p, dy, dp, tangents),
        partial(_repeat_tangent, function.tangent.address, y, p, *wide),
        partial(repeat_adjoint, function.adjoint.address, y, p, covector, back),
        partial(_repeat_jacobian, jacobian_code(kernel).address, y, p, matrix),
        partial(_repeat_columns, tangent, y, p, seeds, slopes, columns),
    ]


@compiled
def _repeat_tangent(
    address: int, y: Array, p: Array, dy: Array, dp: Array, out: Array, count: int
) -> None:
    for _ in range(count):
        call_slopes(address, y, p, dy, dp, out)


@compiled
def _repeat_jacobian(address: int, y: Array, p: Array, out: Array, count: int) -> None:
    for _ in range(count):
        call(address, y, p, out)


@compiled
def _repeat_columns(
    address: int, y: Array, p: Array, seeds: Array, slopes: Array, matrix: Array, count: int
) -> None:
    for _ in range(count):
        jacobian(address, y, p, seeds, slopes, matrix, 0, len(y))
