"""Forces in closed loops, and shapes at which the equations of loops become dependent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize_scalar

from ..common.arrays import Array, read_only
from ..common.errors import IntegrationError
from ..common.names import listed
from ..reduction.inertia_split import symmetric
from ..system.loops.kinematics import rotation_axes
from ..system.loops.loop import Loop
from ..system.loops.loop_closure import singularity
from ..system.loops.looped_system import loop_kinematics
from ..system.state_fields import State
from ..system.system import System
from .plan import Plan
from .sample import Sample

if TYPE_CHECKING:
    from .motion import Motion

_REDUNDANT = 1e-12  # singular values below this fraction of the largest belong to redundant rows
_MOST = 400  # largest number of times at which the rank of the equations is checked
_NEAR = 0.05  # fraction of the generic singular value below which a minimum is refined
_SINGULAR = 1e-6  # fraction of the generic singular value at which equations are dependent


def loop_forces(
    plan: Plan, states: State, samples: list[tuple[Sample, Array]]
) -> Mapping[str, Array]:
    """Compute the forces in closed loops with Pinocchio.

    The multipliers λ follow from H a + bias = τ + Jᵀλ and J a + J̇ v = 0.  Redundant equations share
    a force by least squares.

    Args:
        plan: The plan of the scene.
        states: States at T times.
        samples: States that forces depend on, and parameters of the forces, at these times.
    Returns:
        {loop: wrench (T, 6)}: force [N] and moment [N·m] of frame a on frame b at its origin, in
        the axes of frame a.  A polynomial of joints has the force on its follower, (T, 1)
        [N | N·m].
    """
    system = plan.system
    count = len(states.t)
    wrenches = {
        loop.name: np.zeros((count, 6 if isinstance(loop, Loop) else 1)) for loop in system.loops
    }
    for k, sample in enumerate(samples if system.loops else ()):
        multipliers = _multipliers(plan, states, k, *sample)
        for loop, rows in zip(system.loops, loop_kinematics(system).rows, strict=True):
            own = multipliers[rows]
            wrenches[loop.name][k] = _wrench(loop.kind, own) if isinstance(loop, Loop) else own
    return {name: read_only(wrench) for name, wrench in wrenches.items()}


def _multipliers(plan: Plan, states: State, k: int, sample: Sample, numbers: Array) -> Array:
    """Return the multipliers λ of all equations, (c,), at state k."""
    system, forces = plan.system, plan.forces
    model, data, r = system.model, system.data, system.r
    q, v = system.sorted_q(states.q[k]), system.sorted_v(states.v[k])
    kinematics = loop_kinematics(system)
    J, bias = system.on_shape(kinematics.jacobian(q)), kinematics.bias(q, v)
    H = system.coupled_matrix(symmetric(pin.crba(model, data, q)))
    tau = -system.on_shape(pin.nonLinearEffects(model, data, q, v))
    if forces is not None:
        acting = forces.acting(sample.force_inputs(float(states.t[k]), numbers))
        tau[:r] += acting.wrench
        tau[r:] += acting.torque
    response = np.linalg.solve(H, np.column_stack([tau, J.T]))
    free, mobility = J @ response[:, 0], J @ response[:, 1:]
    return np.asarray(np.linalg.lstsq(mobility, -bias - free, rcond=_REDUNDANT)[0])


def _wrench(kind: str, multipliers: Array) -> Array:
    wrench = np.zeros(6)
    wrench[:3] = multipliers[:3]
    if kind == "6d":
        wrench[3:] = multipliers[3:]
    elif kind != "3d":
        for (i, axis), value in zip(rotation_axes(kind), multipliers[3:], strict=True):
            wrench[3:] += value * np.cross(np.eye(3)[axis], np.eye(3)[i])
    return wrench


def near_singular_loops(system: System, x: Array) -> str:
    """Return a clause about equations of loops that are nearly dependent at x; empty otherwise."""
    if system.closure is None or singularity(system, x) > _NEAR:
        return ""
    return f", near a shape at which the equations of the loops {_names(system)} become dependent"


def _names(system: System) -> str:
    return listed([loop.name for loop in system.loops], 6)


def refuse_singular_loops(system: System, motion: Motion) -> None:
    """Reject a motion through a shape at which the equations of the loops become dependent.

    There the motion can continue along several branches, so it is not determined.

    Args:
        system: The system.
        motion: The motion.
    Raises:
        IntegrationError: The motion passes such a shape; the message names loops, time and shape.
    """
    if system.closure is None:
        return
    knots = motion.knots
    count = min(_MOST, 4 * len(knots))
    times = np.interp(np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(knots)), knots)

    def value(t: float) -> float:
        return singularity(system, motion.states(np.array([t])).x[0])

    values = np.array([singularity(system, x) for x in motion.states(times).x])
    for k in np.flatnonzero(values < _NEAR).tolist():
        first, last = max(k - 1, 0), min(k + 1, count - 1)
        if values[k] > min(values[first], values[last]):
            continue
        span = (float(times[first]), float(times[last]))
        found = minimize_scalar(value, bounds=span, method="bounded", options={"xatol": 1e-12})
        if min(found.fun, values[k]) < _SINGULAR:
            at = motion.states(np.array([found.x])).x[0]
            raise IntegrationError(
                f"the equations of the loops {_names(system)} of '{system.name}' become dependent "
                f"at t = {found.x:g} s, x = {at}. There the motion can continue in several ways. "
                "End the motion earlier, or avoid the shape with a limit or a spring."
            )
