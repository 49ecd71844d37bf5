"""Integration of a plan with the engine that evaluates the equations with Pinocchio."""

from __future__ import annotations

from ...common.progress import Progress
from ..integrate_plan import Again, integrate_plan
from ..plan import Plan
from ..trajectory import Trajectory
from .pinocchio_flow import PinocchioFlow
from .scipy_integrator import integrator


def run_pinocchio(plan: Plan, progress: Progress | None, again: Again) -> Trajectory:
    """Return the trajectory of a plan, integrated with SciPy's DOP853.

    Args:
        plan: The plan.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
        again: Function that simulates the scene again; see Trajectory.
    Returns:
        The trajectory.
    Raises:
        IntegrationError: The integrator cannot continue.
    """
    flow = PinocchioFlow(plan)
    integrate = integrator(flow, plan, progress)
    return integrate_plan(plan, flow, integrate, "pinocchio", "DOP853", again)
