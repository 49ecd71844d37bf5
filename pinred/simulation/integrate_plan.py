"""Integration of a plan with the flow of an engine, and the resulting trajectory."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..scene.scene import Engine, Scene
from .checkpoint import RunRecord
from .closed_loops import refuse_singular_loops
from .motion import Motion, follow
from .plan import Plan
from .reduced_flow import Integrate, ReducedFlow, Segments
from .trajectory import Cost, Trajectory

Again = Callable[[], Trajectory]


def integrate_plan(
    plan: Plan,
    flow: ReducedFlow,
    integrate: Integrate,
    engine: Engine,
    method: str,
    again: Again,
    through: Callable[[], Segments] | None = None,
    record: RunRecord | None = None,
    *,
    thinned: bool = False,
) -> Trajectory:
    """Integrate a flow over the time of its plan, and measure the run.

    Args:
        plan: The plan.
        flow: Reduced flow of the plan.
        integrate: The function that integrates the flow.
        engine: Name of the engine.
        method: Name of the method.
        again: Function that simulates the scene again; see Trajectory.
        through: Integrates the flow through all stops; see `follow`.
        record: Record of the run in a checkpoint; or None.
        thinned: Whether segments do not store their step ends.
    Returns:
        The trajectory.
    Raises:
        IntegrationError: The integration failed, or a loop is singular.
    """
    started = time.perf_counter()
    motion = follow(plan, flow, integrate, through, record, thinned=thinned)
    wall = time.perf_counter() - started
    refuse_singular_loops(plan.system, motion)
    run = Cost(engine, method, motion.steps, motion.evaluations, wall, plan.notices)
    return trajectory_of_motion(plan, motion, run, again)


def trajectory_of_motion(plan: Plan, motion: Motion, run: Cost, again: Again) -> Trajectory:
    """Return the trajectory of an integrated plan, whose scene ends where the motion ends.

    Args:
        plan: The plan.
        motion: Its motion.
        run: Cost of the integration.
        again: Function that simulates the scene again; see Trajectory.
    """
    terminal_crossing = motion.ended_by
    scene = plan.scene if terminal_crossing is None else _until(plan.scene, terminal_crossing.t)
    return Trajectory(scene, motion, run, again)


def _until(scene: Scene, end: float) -> Scene:
    """Return the scene with an earlier end, which is also a report time."""
    t = scene.report_times
    return replace(scene, duration=end, times=np.append(t[t < end], end))
