"""The methods of the accuracy benchmark: pinred's own, and those of other tools.

All explicit methods of pinred are included. To add a method, call `own_method` with a function that
creates the integrator from a tolerance, or from a step length for methods with fixed steps. Add a
method of another tool to SOLVERS.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ...common.argument_kinds import checks_arguments
from ...common.arrays import read_only
from ...common.errors import InputError
from ...integrators.methods import DOP853_LEAST, METHODS, RKMK4, AdaptiveGauss, Explicit, Gauss
from ...integrators.methods import Method as Integrator
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.compiled.integrator import integrator
from ...simulation.plan import plan_of
from ...simulation.simulate import simulate
from ...system.state_fields import with_base
from .peers.aba import ABA
from .peers.cvodes import CVODES
from .peers.drake import DRAKE
from .peers.exudyn import EXUDYN
from .peers.heyoka import HEYOKA, HEYOKA_SLOW
from .peers.mujoco import MUJOCO
from .problems import Problem
from .solver import ATOL, End, PreparedRun, Solver, decades, halvings

FROM_TOLERANCE = decades(2, 14)


@checks_arguments
def own_method(
    name: str,
    about: str,
    make: Callable[[float], Integrator] | None = None,
    *,
    tolerances: tuple[float, ...] = FROM_TOLERANCE,
    fixed: bool = False,
) -> Solver:
    """Return a benchmark method that calls `simulate` with an integrator of pinred.

    Args:
        name: Name of the method.
        about: Description of the timed work.
        make: Creates the integrator from a tolerance, or from a step [s] if `fixed`. If None,
            `simulate` chooses it.
        tolerances: Tolerances from coarse to fine, see Solver.
        fixed: Whether the integrator has fixed steps.
    Returns:
        The method.
    """

    def prepare(problem: Problem, tolerance: float) -> PreparedRun:
        start, value = problem.start, tolerance * (problem.start.duration if fixed else 1.0)
        options: dict[str, Any] = {"rtol": tolerance, "atol": ATOL * tolerance}
        if make is not None:
            options = {"method": make(value)}

        def run() -> Any:
            traj = simulate(
                problem.system, x0=start.x, xdot0=start.xdot, xi0=start.xi, times=problem.times,
                **options,
            )  # fmt: skip
            return traj.states, traj.run.evaluations

        return PreparedRun(run, lambda result: problem.end_of(*result))

    return Solver(name, about, tolerances, prepare, fixed=fixed)


def _integration(problem: Problem, tolerance: float) -> PreparedRun:
    plan = plan_of(problem.scene(rtol=tolerance, atol=ATOL * tolerance))
    flow = CompiledFlow.of_plan(plan)

    def end(solution: Any) -> End:
        states = flow.states(problem.times, solution.at(problem.times))
        return problem.end_of(with_base(states, problem.name), solution.evaluations)

    integrate = integrator(flow, plan, None)
    parameters = read_only(flow.parameters.copy())
    return PreparedRun(lambda: integrate(0.0, plan.scene.end, flow.y0, parameters), end)


def _explicit(name: str, kind: type[Explicit]) -> Solver:
    return own_method(
        f"pinred-{name.lower()}",
        f"simulate() with {name}, whole call",
        lambda tol: kind(max(tol, DOP853_LEAST), ATOL * tol),
    )


OWN = (
    own_method("pinred", "simulate(), whole call from initial values"),
    Solver(
        "pinred-integration",
        "its integration alone, as heyoka is timed",
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


SOLVERS: tuple[Solver, ...] = (*OWN, *ABA, *MUJOCO, *EXUDYN, *DRAKE, *CVODES, *HEYOKA)
# ALL_SOLVERS also includes methods whose preparation takes minutes.
ALL_SOLVERS: tuple[Solver, ...] = (*OWN, *ABA, *MUJOCO, *EXUDYN, *DRAKE, *CVODES, *HEYOKA_SLOW)


def solvers_named(
    names: Sequence[str] | None, among: Sequence[Solver] = SOLVERS
) -> tuple[Solver, ...]:
    """Return the named methods, or all if None; raise InputError for an unknown name."""
    if names is None:
        return tuple(among)
    by_name = {method.name: method for method in among}
    for name in names:
        if name not in by_name:
            raise InputError(f"no method '{name}'; the methods are {', '.join(by_name)}")
    return tuple(by_name[name] for name in dict.fromkeys(names))
