"""Tangent directions of a periodic motion with joint stops, through its impacts.

The kernels leave out the positions of cyclic joints, and their momenta are constant. A stop breaks
this symmetry of its joint, and an impact changes the momentum. So both are added to the leaf.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed
from ...simulation.compiled.compiled_flow import has_no_momentum
from ...simulation.flow_map.flow_through_stops import StoppedPropagator
from ...simulation.flow_map.inputs import Inputs
from ...simulation.plan import plan_of
from ...simulation.run_with_stops import StoppedMotion
from ...simulation.trajectory import Trajectory
from .linearised_flow import LinearisedFlow, without_base
from .reduced_state import leaf_of

_TOLERANCE = 1e-11  # Largest rtol and atol of the motion whose derivatives are computed.


def tangents_through_stops(
    traj: Trajectory, period: float
) -> tuple[LinearisedFlow, LinearisedFlow]:
    """Return a motion and its tangent directions at the start and at the end of a period.

    Constant momenta of cyclic joints with stops follow the reduced state in `y` and in `Y`.

    Args:
        traj: A motion with stops.
        period: Period [s].
    Returns:
        The start and the end.
    Raises:
        InputError: A joint is at its stop at the start or at the end, or the motion has no
            derivative.
    """
    scene = without_base(traj.scene)
    rtol, atol = min(scene.rtol, _TOLERANCE), min(scene.atol, _TOLERANCE)
    scene = replace(scene, duration=period, times=np.array([period]), rtol=rtol, atol=atol)
    plan = plan_of(replace(scene, stops=None))
    propagator = StoppedPropagator(scene, ("x0", "xdot0"), zero_momentum=has_no_momentum(plan))
    run = propagator.run(Inputs(scene, propagator.kernel, plan.gravity, ()).own)
    last = propagator.parts_of(run)[-1]
    motion = run.trajectory.motion
    assert isinstance(motion, StoppedMotion)
    if resting := motion.phases[-1].mode.rest:
        names = [bound.joint for bound in resting]
        raise InputError(
            f"period: {listed(names, 8)} of '{scene.system.name}' rests at its stop after "
            f"{period:g} s. Simulate from a state in which no joint is at its stop"
        )
    flow, layout = run.flow, propagator.kernel.layout
    leaf = leaf_of(flow.kernel, flow.y0, flow.sample(0.0, flow.y0).x)
    joints, n, d = {bound.v for bound in scene.bounds}, len(flow.y0), leaf.basis.shape[1]
    stopped = np.array([k for k, v in enumerate(layout.cyclic) if v in joints], dtype=np.intp)
    added = np.concatenate([2 * layout.pairs + stopped, n + np.arange(len(stopped))])
    momenta = layout.base.spin + stopped
    Y = np.zeros((n + len(stopped), d + len(added)))
    Y[leaf.indices, :d] = np.linalg.qr(leaf.embed(np.eye(d)))[0]
    Y[added, d + np.arange(len(added))] = 1.0
    head = np.zeros((layout.gravity_at, Y.shape[1]))
    head[momenta] = Y[n:]
    count = layout.parameters - layout.gravity_at + len(run.stops)
    heads = head, np.zeros((count, Y.shape[1]))
    path = np.zeros((len(flow.path), Y.shape[1]))
    y_end, head_end, _ = propagator.tangents(run, (), Y[:n], *heads, path)
    leaf = replace(leaf, indices=np.concatenate([leaf.indices, added]))

    def at(y: Array, parameters: Array, tangents: Array) -> LinearisedFlow:
        rows = np.zeros_like(tangents)
        rows[leaf.indices] = tangents[leaf.indices]
        return LinearisedFlow(flow, leaf, np.append(y, parameters[momenta]), rows, np.inf)

    end = np.vstack([y_end, head_end[momenta]])
    return at(flow.y0, flow.parameters, Y), at(last.solution.states[-1], last.solution.params, end)
