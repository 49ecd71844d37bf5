"""pinred's own methods: one row for each integrator of pinred.integrators.

Explicit methods are there by themselves.  A further one of another kind is one more call of
`own_method`, with what makes its value from a tolerance, or from a step for those that take
equal steps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...common.arrays import read_only
from ...integrators.methods import (
    DOP853_LEAST,
    METHODS,
    RKMK4,
    AdaptiveGauss,
    Explicit,
    Gauss,
)
from ...integrators.methods import Method as Integrator
from ...system.state_fields import State, with_base
from .problems import Problem
from .solver import ATOL, End, PreparedRun, Solver, decades, halvings

FROM_TOLERANCE = decades(2, 14)


def own_method(
    name: str,
    about: str,
    make: Callable[[float], Integrator] | None = None,
    *,
    tolerances: tuple[float, ...] = FROM_TOLERANCE,
    fixed: bool = False,
) -> Solver:
    """Return the method that simulates with an integrator of pinred, whole call.

    make: the integrator of a tolerance, or with fixed=True of a step [s]; what `simulate`
    takes by itself if None.  tolerances: as Solver has them.
    """

    def prepare(problem: Problem, tolerance: float) -> PreparedRun:
        from ...simulation.simulate import simulate

        start, times = problem.start, problem.times
        given = tolerance * start.duration if fixed else tolerance
        options: dict[str, Any] = {"rtol": tolerance, "atol": ATOL * tolerance}
        if make is not None:
            options = {"method": make(given)}

        def run() -> Any:
            traj = simulate(
                problem.system, x0=start.x, xdot0=start.xdot, xi0=start.xi, times=times, **options
            )
            return traj.states, traj.run.evaluations

        return PreparedRun(run, lambda found: _end(*found))

    return Solver(name, about, tolerances, prepare, fixed=fixed)


def _integration(problem: Problem, tolerance: float) -> PreparedRun:
    from ...simulation.compiled.compiled_flow import CompiledFlow
    from ...simulation.compiled.integrator import integrator
    from ...simulation.plan import plan_of

    scene = problem.scene(rtol=tolerance, atol=ATOL * tolerance)
    plan = plan_of(scene)
    flow = CompiledFlow.of_plan(plan)

    def end(found: Any) -> End:
        times = scene.report_times
        states = with_base(flow.states(times, found.at(times)), scene.system.name)
        return _end(states, found.evaluations)

    integrate = integrator(flow, plan, None)
    parameters = read_only(flow.parameters.copy())
    return PreparedRun(lambda: integrate(0.0, scene.end, flow.y0, parameters), end)


def _explicit(name: str, kind: type[Explicit]) -> Solver:
    return own_method(
        f"pinred-{name.lower()}",
        f"simulate() with {name}, whole call",
        lambda tol: kind(max(tol, DOP853_LEAST), ATOL * tol),
    )


def _end(states: State, evaluations: int) -> End:
    return End(states.x[0], states.q[0], states.v[0], evaluations)


OWN = (
    own_method("pinred", "simulate(), whole call from initial values"),
    Solver(
        "pinred-integration",
        "its integration alone: as heyoka is timed",
        FROM_TOLERANCE,
        _integration,
    ),
    *(_explicit(name, kind) for name, kind in METHODS.items() if issubclass(kind, Explicit)),
    own_method(
        "pinred-gauss",
        "simulate() with AdaptiveGauss, whole call",
        lambda tol: AdaptiveGauss(tol, ATOL * tol),
    ),
    own_method(
        "pinred-gauss6",
        "simulate() with Gauss of order 6, equal steps, whole call",
        lambda step: Gauss(step, 6),
        tolerances=halvings(50, 8),
        fixed=True,
    ),
    own_method(
        "pinred-rkmk4",
        "simulate() with RKMK4, equal steps, whole call",
        RKMK4,
        tolerances=halvings(50, 14),
        fixed=True,
    ),
)
