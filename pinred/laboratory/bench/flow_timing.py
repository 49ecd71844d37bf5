"""Cost of flows: overhead of a call, of gradients, and of variable inertias."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.progress import Progress, one_by_one
from ...integrators.integrate import Integration
from ...integrators.methods.method import stepper_of
from ...kernels.build import build_kernel
from ...kernels.differentiable import repeat_adjoint
from ...kernels.evaluate import repeat
from ...reduction.tree.free_bodies import STEP, Freed, pattern_of
from ...simulation.flow_map.flow import Flow, flow
from ...simulation.simulate import simulate
from ...system.catalogue import has_example_robots
from ...system.load import load
from .flow_adjoints import beside_cvodes
from .timing import alternating, repeated

BUNDLED = ("planar_chain5", "satellite_two_arms")
EXAMPLES = ("solo12", "talos")
_SPAN = 2.0  # duration of the motion [s]
_COUNT = 200  # number of evaluations in one timed call
_ROUNDS, _BURST = 300, 1e-3  # many short rounds [s], so that some are not interrupted


@checks_arguments
@dataclass(frozen=True)
class FlowTiming:
    """Cost of one robot's flow: the fastest of several alternating rounds.

    Every call of a flow uses a different initial shape.

    Attributes:
        robot: Name of the robot.
        steps: Number of steps of DOP853 at tolerance 1e-8.
        integration: Time of the integrator alone [µs].
        call: Time of a call of the flow, including access to x [µs].
        simulate: Time of simulate with the same scene [µs].
        step: Time of one step with its Jacobians [µs].
        gradient: Time of a gradient with respect to initial shape, rates and twist, including
            its forward run, relative to a forward run.
        inertias: As `gradient`, with the masses and centres of mass of all bodies as additional
            inputs.
        gauss: As `gradient`, with AdaptiveGauss at tolerance 1e-10.
        jax: Additional time of a call through JAX [µs]; NaN without JAX.
        jax_gradient: Additional time of a gradient through JAX [µs]; NaN without JAX.
        cvodes: Time of CVODES's adjoint (CasADi, same tolerance) relative to pinred's gradient.
        apart: Relative difference of the gradients of CVODES and pinred.
        adjoint: Time of an adjoint kernel evaluation, relative to a rate evaluation.
        free: Time of a rate evaluation with all inertias as inputs, relative to a kernel with
        constant inertias.
        placed: As `free`, with all placements as inputs that keep their pattern of zeros.
        generic: As `free`, with arbitrary placements as inputs.
        knots: Bytes stored per step for a gradient, if only step ends are stored.
        stages: Bytes stored per step for a gradient, if stage derivatives are stored too.
    """

    robot: str
    steps: int
    integration: float
    call: float
    simulate: float
    step: float
    gradient: float
    inertias: float
    gauss: float
    jax: float
    jax_gradient: float
    cvodes: float
    apart: float
    adjoint: float
    free: float
    placed: float
    generic: float
    knots: int
    stages: int

    @staticmethod
    def header() -> str:
        """Return the header of the table."""
        return (
            f"{'robot':<20} {'steps':>6} {'integration':>12} {'call':>7} {'simulate':>9} "
            f"{'step':>7} {'gradient':>9} {'inertias':>9} {'by Gauss':>9} {'JAX':>6} "
            f"{'its gradient':>12} {'CVODES':>7} {'apart':>8} {'adjoint':>8} {'free':>6} "
            f"{'placed':>6} {'generic':>7} {'bytes/step':>12}\n"
            f"{'':<20} {'':>6} {'[µs]':>12} {'[µs]':>7} {'[µs]':>9} {'[µs]':>7} {'[runs]':>9} "
            f"{'[runs]':>9} {'[runs]':>9} {'[+µs]':>6} {'[+µs]':>12} {'[×]':>7} {'':>8} "
            f"{'[rates]':>8} {'[×]':>6} {'[×]':>6} {'[×]':>7}"
        )

    def __str__(self) -> str:
        return (
            f"{self.robot:<20} {self.steps:>6} {self.integration:>12.1f} {self.call:>7.1f} "
            f"{self.simulate:>9.1f} {self.step:>7.1f} {self.gradient:>9.2f} "
            f"{self.inertias:>9.2f} {self.gauss:>9.2f} {self.jax:>6.1f} "
            f"{self.jax_gradient:>12.1f} {self.cvodes:>7.0f} {self.apart:>8.1e} "
            f"{self.adjoint:>8.2f} {self.free:>6.2f} "
            f"{self.placed:>6.2f} {self.generic:>7.2f} {f'{self.knots}, {self.stages}':>12}"
        )


@checks_arguments
def bench_flow(
    robots: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> list[FlowTiming]:
    """Measure the cost of each robot's flow.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each robot.
    """
    names = list(robots) or [*BUNDLED, *(EXAMPLES if has_example_robots() else ())]
    return one_by_one(names, _bench_flow, progress, "flows")


def _bench_flow(name: str) -> FlowTiming:
    system = load(name, gravity=(0.0, 0.0, 0.0))
    options: Any = {"seed": 1, "duration": _SPAN}
    motion = ["x0", "xdot0", "xi0"]
    links = [*system.model.names][1:]
    bodies = [f"{link}.{kind}" for link in links for kind in ("mass", "com")]
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
    for made in (by_motion, by_all, by_gauss):
        at = _Elsewhere(made)
        actions += [partial(_run, made, at), partial(_gradient, made, at, one)]
    at = _Elsewhere(by_motion)
    actions += [lambda: by_motion(x0=at()).x, *_of_jax(by_motion)]
    times = alternating([repeated(each) for each in actions], rounds=_ROUNDS, span=_BURST)
    integration, whole, linear, *runs = np.nanmin(times, axis=0) * 1e6
    runs, (call, *of_jax) = runs[:6], runs[6:]
    jax, jax_gradient = of_jax or (np.nan, np.nan)
    beside = beside_cvodes(by_motion, 1e-8)
    adjoint, free, placed, generic = _evaluations(by_motion)
    return FlowTiming(
        robot=name,
        steps=solution.steps,
        integration=float(integration),
        call=float(call),
        simulate=float(whole),
        step=float(linear),
        gradient=float(runs[1] / runs[0]),
        inertias=float(runs[3] / runs[2]),
        gauss=float(runs[5] / runs[4]),
        jax=float(jax - call),
        jax_gradient=float(jax_gradient - runs[1]),
        cvodes=beside.slower,
        apart=beside.error,
        adjoint=adjoint,
        free=free,
        placed=placed,
        generic=generic,
        knots=8 * (len(y) + 1),
        stages=8 * (len(y) + 1 + len(y) * stepper_of(propagator.method).stages),
    )


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
    rest = [made.own(name) for name in made.inputs if name != "x0"]
    whole = jax.jit(function)
    slope = jax.jit(jax.grad(lambda *given: function(*given).sum(), range(1 + len(rest))))
    return [
        lambda: jax.block_until_ready(whole(at(), *rest)),
        lambda: jax.block_until_ready(slope(at(), *rest)),
    ]


def _evaluations(made: Flow) -> list[float]:
    """Return times relative to the rate: the adjoint, and kernels with variable parameters."""
    kernel = made.propagator.kernel
    system = kernel.system
    every = tuple(range(system.model.njoints - 1))
    steps = [[(i, pattern_of(system, i)) for i in every[1:]], [(i, "x" * STEP) for i in every[1:]]]
    loose = [
        build_kernel(system, replace(kernel.structure, freed=freed), kernel.forces)
        for freed in (Freed(every), *(Freed(every, tuple(some)) for some in steps))
    ]
    rng = np.random.default_rng(0)
    y = 0.5 * rng.normal(size=kernel.layout.size)
    rates = [(one.rate.address, one.random_parameters(rng)) for one in (kernel, *loose)]
    adjoint, p, covector = made.propagator.field.adjoint(), rates[0][1], np.ones(len(y))
    out = np.empty(len(y) + len(p))
    times = alternating(
        [
            *(repeated(partial(repeat, address, numbers, y, _COUNT)) for address, numbers in rates),
            repeated(lambda: repeat_adjoint(adjoint, y, p, covector, out, _COUNT)),
        ],
        rounds=_ROUNDS,
        span=_BURST,
    )
    folded, *loosened, back = np.nanmin(times, axis=0).tolist()
    return [back / folded, *(one / folded for one in loosened)]
