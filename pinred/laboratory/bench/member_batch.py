"""Batches of members of one problem, and pinred's methods to integrate them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ...common.errors import IntegrationError
from ...integrators.integrate_many import Solutions, integrate_many
from ...integrators.lanes.integrate_in_lanes import integrate_in_lanes
from ...integrators.methods import DOP853
from ...kernels.derived_code import wide_rate
from ...simulation.compiled.compiled_flow import CompiledFlow, flows_of
from ...simulation.members.integrate_members import lanes_of
from ...simulation.members.member_groups import of_scenes
from ...system.coordinates import InitialState
from .problems import Problem
from .solver import End, PreparedRun, Solver

_TOLERANCES = tuple(10.0 ** (-k / 3) for k in range(18, 40))
_SPREAD = 0.05  # standard deviation of the members' rates (relative) and shapes [rad | m]


def generate_members(problem: Problem, count: int) -> list[Problem]:
    """Generate members with random initial states near the initial state of a problem."""
    rng, start, members = np.random.default_rng(0), problem.start, []
    for _ in range(count):
        factors = [1.0 + _SPREAD * rng.normal(size=len(v)) for v in (start.xdot, start.xi)]
        state = InitialState(
            x=start.x + _SPREAD * rng.normal(size=len(start.x)),
            xdot=start.xdot * factors[0],
            xi=start.xi * factors[1],
            duration=start.duration,
        )
        members.append(Problem(problem.name, problem.about, problem.system, state))
    return members


def compile_members(members: Sequence[Problem]) -> CompiledFlow:
    """Return the reduced initial states and the parameters of members with momentum."""
    (group,) = of_scenes([member.scene(method="DOP853") for member in members]).groups
    ((_, flows),) = flows_of(group.plan, group.given)
    return flows


def _prepare(members: Sequence[Problem], rtol: float, *, in_lanes: bool) -> PreparedRun:
    flows, method = compile_members(members), DOP853(rtol, 1e-2 * rtol)
    kernel, times = flows.kernel, members[0].times
    duration = members[0].start.duration
    y0, params, quaternions = flows.y0, flows.parameters, kernel.layout.quaternions
    run: Callable[[], Solutions]
    if in_lanes:
        lanes = lanes_of(method, kernel)
        address = wide_rate(kernel, lanes, own_parameters=True).address
        run = partial(
            integrate_in_lanes, method, address, lanes, params, y0, duration, times, quaternions, 1
        )
    else:
        address = kernel.rate.address
        run = partial(integrate_many, method, address, params, y0, duration, times, quaternions, 1)

    def end(solutions: Solutions, member: int) -> End:
        if not solutions.ok.all():
            raise IntegrationError(f"{method.name} did not integrate all members to their end")
        return members[member].end(solutions.y[member, -1])

    return PreparedRun(run, end)


OWN = (
    Solver(
        "lanes",
        "DOP853, members in SIMD lanes",
        _TOLERANCES,
        partial(_prepare, in_lanes=True),
    ),
    Solver(
        "one by one",
        "DOP853, the scalar integrator, one after another",
        _TOLERANCES,
        partial(_prepare, in_lanes=False),
    ),
)
