"""Batches of members of one problem, and pinred's methods to integrate them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

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
from ...system.state_fields import with_base
from .problems import Problem
from .solver import End

_TOLERANCES = tuple(10.0 ** (-k / 3) for k in range(18, 40))
_SPREAD = 0.05  # standard deviation of the members' rates (relative) and shapes [rad | m]


@dataclass(frozen=True)
class PreparedBatch:
    """A solver that is ready to integrate a batch.

    Attributes:
        run: Timed function: integrates all members from their initial to their final states.
        ends: Converts the result of `run` to the final states of the first members (not timed).
    """

    run: Callable[[], Any]
    ends: Callable[[Any, int], list[End]]


@dataclass(frozen=True)
class BatchSolver:
    """A solver for all members of a batch.

    Attributes:
        name: Name of the solver.
        about: Description of the timed work.
        tolerances: Tolerances from coarse to fine; step lengths relative to the duration for
            solvers with fixed steps.
        prepare: Prepares a run of some members at a tolerance.
        missing: Returns why the solver cannot run a problem; "" if it can.
        most: Largest number of members that the solver is timed with.
    """

    name: str
    about: str
    tolerances: tuple[float, ...]
    prepare: Callable[[Sequence[Problem], float], PreparedBatch]
    missing: Callable[[Problem], str] = lambda _: ""
    most: int = 10**9


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


def final_states(members: Sequence[Problem], flows: CompiledFlow, y: Any, count: int) -> list[End]:
    """Reconstruct the full final states of the first members from reduced states y (N, k)."""
    ends = []
    for k in range(count):
        reduced = flows[k].states(members[k].times, np.array(y[k])[None])
        states = with_base(reduced, members[k].name)
        ends.append(End(states.x[0], states.q[0], states.v[0], float("nan")))
    return ends


def _prepare(members: Sequence[Problem], rtol: float, *, in_lanes: bool) -> PreparedBatch:
    flows, method = compile_members(members), DOP853(rtol, 1e-2 * rtol)
    kernel, end, times = flows.kernel, members[0].start.duration, members[0].times
    y0, params, quaternions = flows.y0, flows.parameters, kernel.layout.quaternions
    run: Callable[[], Solutions]
    if in_lanes:
        lanes = lanes_of(method, kernel)
        address = wide_rate(kernel, lanes, own_parameters=True).address
        run = partial(
            integrate_in_lanes, method, address, lanes, params, y0, end, times, quaternions, 1
        )
    else:
        address = kernel.rate.address
        run = partial(integrate_many, method, address, params, y0, end, times, quaternions, 1)

    def ends(solutions: Solutions, count: int) -> list[End]:
        if not solutions.ok.all():
            raise IntegrationError(f"{method.name} did not integrate all members to their end")
        return final_states(members, flows, solutions.y[:, -1], count)

    return PreparedBatch(run, ends)


OWN = (
    BatchSolver(
        "lanes",
        "DOP853, members in SIMD lanes",
        _TOLERANCES,
        partial(_prepare, in_lanes=True),
    ),
    BatchSolver(
        "one by one",
        "DOP853, the scalar integrator, one after another",
        _TOLERANCES,
        partial(_prepare, in_lanes=False),
    ),
)
