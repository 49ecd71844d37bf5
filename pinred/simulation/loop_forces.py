"""Forces in closed loops."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, read_only
from ..common.names import NamedResults
from ..reduction.inertia_split import symmetric
from ..system.loops.kinematics import rotation_axes
from ..system.loops.loop import Loop
from ..system.loops.looped_system import loop_kinematics
from ..system.state_fields import State
from .plan import Plan
from .sample import Sample

_REDUNDANT = 1e-12  # singular values below this fraction of the largest belong to redundant rows


def loop_forces(plan: Plan, states: State, samples: Sample, numbers: Array) -> Mapping[str, Array]:
    """Compute the forces in closed loops with Pinocchio.

    The multipliers λ follow from H a + bias = τ + Jᵀλ and J a + J̇ v = 0.  Redundant equations share
    a force by least squares.

    Args:
        plan: The plan of the scene.
        states: States at T times.
        samples: States that forces depend on at these times.
        numbers: Parameters of the forces at these times, (T, p).
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
    acting, accelerations = None, np.zeros((count, 0))
    if plan.forces is not None:
        acting = plan.forces.acting(samples.force_inputs(states.t, numbers))
        accelerations = plan.forces.prescribed(states.t, numbers).xddot
    for k in range(count if system.loops else 0):
        force = None if acting is None else np.append(acting.wrench[k], acting.torque[k])
        multipliers = _multipliers(plan, states, k, force, accelerations[k])
        for loop, rows in zip(system.loops, loop_kinematics(system).rows, strict=True):
            own = multipliers[rows]
            wrenches[loop.name][k] = _wrench(loop.kind, own) if isinstance(loop, Loop) else own
    return NamedResults("loop", {name: read_only(wrench) for name, wrench in wrenches.items()})


def _multipliers(
    plan: Plan, states: State, k: int, force: Array | None, accelerations: Array
) -> Array:
    """Return the multipliers λ of all equations, (c,), at state k.

    force: Forces on base and joints, (n,).  accelerations: Those of the prescribed joints.
    """
    system, model, data, r = (
        plan.system,
        plan.system.sorted_model,
        plan.system.sorted_data,
        plan.system.r,
    )
    q, v = system.sort_q(states.q[k]), system.sort_v(states.v[k])
    kinematics = loop_kinematics(system)
    J, bias = system.on_shape(kinematics.jacobian(q)), kinematics.bias(q, v)
    H = system.coupled_matrix(symmetric(pin.crba(model, data, q)))
    tau = -system.on_shape(pin.nonLinearEffects(model, data, q, v))
    if force is not None:
        tau += force
    moving = np.arange(len(H))
    if plan.acting.driven:  # drives apply the forces that their accelerations need
        driven = r + np.array(plan.acting.driven)
        moving = np.setdiff1d(moving, driven)
        tau, bias = tau - H[:, driven] @ accelerations, bias + J[:, driven] @ accelerations
        J = J[:, moving]
    response = np.linalg.solve(H[np.ix_(moving, moving)], np.column_stack([tau[moving], J.T]))
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
