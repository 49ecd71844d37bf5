"""Integration of a plan with the compiled engine."""

from __future__ import annotations

from ...common.progress import Progress
from ...integrators.methods import EqualSteps
from ..checkpoint import Checkpoint
from ..integrate_plan import Again, integrate_plan
from ..plan import Plan
from ..trajectory import Trajectory
from .compiled_flow import CompiledFlow
from .integrator import integrator
from .long_segments import long_integrator
from .thinned_segments import thinned
from .through_stops import through_stops


def run_compiled(
    plan: Plan, progress: Progress | None, again: Again, checkpoint: Checkpoint | None = None
) -> Trajectory:
    """Return the trajectory of a plan, integrated with machine code.

    Args:
        plan: The plan.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
        again: Function that simulates the scene again; see Trajectory.
        checkpoint: Checkpoint that the run continues and updates; or None.
    Returns:
        The trajectory.
    Raises:
        IntegrationError: The integrator cannot continue.
    """
    flow = CompiledFlow.of_plan(plan)
    record = None if checkpoint is None else checkpoint.run(flow, plan)
    method, through, long = plan.method, None, None
    if isinstance(method, EqualSteps):
        through = thinned(flow, plan, method, progress, record)
    if through is None and plan.passes_stops and record is None:
        through = through_stops(flow, plan, progress)
    integrate = integrator(flow, plan, progress)
    if isinstance(method, EqualSteps) and through is None:
        long = long_integrator(flow, plan, method, integrate, progress)
    integrate = long or integrate
    trajectory = integrate_plan(
        plan, flow, integrate, "compiled", method.name, again, through, record,
        thinned=long is not None,
    )  # fmt: skip
    if checkpoint is not None and record is not None:
        checkpoint.close(record, flow, plan, cut=trajectory.ended_by is not None)
    return trajectory
