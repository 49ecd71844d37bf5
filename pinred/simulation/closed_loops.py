"""Closed loops along a motion: shapes at which it can branch, and the forces in the loops."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, read_only
from ..common.errors import IntegrationError
from ..common.names import NamedResults, listed
from ..reduction.pointwise_reduction import symmetric
from ..reduction.tree.loop_constraints import jacobian_function
from ..system.loops.kinematics import loop_kinematics, rotation_axes
from ..system.loops.loop import Loop
from ..system.loops.loop_assembly import rate_units, singularity
from ..system.state_fields import State
from ..system.system import System
from .plan import Plan
from .reduced_flow import Sample

if TYPE_CHECKING:
    from .motion import Motion


_MOST = 400  # largest number of times at which the rank of the equations is checked
_NEAR = 0.05  # fraction of the generic singular value below which a minimum is refined
_SINGULAR = 1e-6  # fraction of the generic singular value at which equations are dependent
# Number of times of a closer look, and least cosine between neighbours at which rows are followed.
_CLOSER, _RESOLVED = 17, 0.8
_COSINE = 0.3  # least cosine between the row spaces of J at neighbouring times


class SingularLoopsError(IntegrationError):
    """The equations of the loops become dependent along a motion.

    Attributes:
        time: Time at which they do [s].
    """

    def __init__(self, message: str, time: float) -> None:
        """Store the message and the time."""
        super().__init__(message)
        self.time = time

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.time)


def may_pass_singular_shape(system: System, x: Array) -> bool:
    """Return whether a motion through given shapes may pass a singular shape of the loops.

    The least singular value of the scaled Jacobian J is small near such a shape, and behind it the
    rows of J span the same space with the opposite orientation.

    Args:
        system: The system, with or without loops.
        x: Shapes of the motion in order, (T, nx) [rad | m].
    Returns:
        True if J is nearly singular at a shape, or turns too far between two shapes.
    """
    if system.closure is None or not len(x):
        return False
    J = _scaled_jacobians(system, x)
    if not np.linalg.svd(J, compute_uv=False)[:, -1].min() > _NEAR * system.closure.least:
        return True
    cosines, orientation = _turns(J)
    return bool((cosines < _COSINE).any() or (orientation < 0.0).any())


def _scaled_jacobians(system: System, x: Array) -> Array:
    """Return the Jacobians without units, (T, k, m), at shapes (T, nx)."""
    closure = system.closure
    assert closure is not None
    blocks = jacobian_function(system).map(len(x))(x.T).full()
    J = blocks.reshape(closure.rank, len(x), system.m).transpose(1, 0, 2)
    is_length = loop_kinematics(system).is_length[closure.rows]
    J = J * np.where(is_length, 1.0 / closure.length, 1.0)[:, None]
    return np.asarray(J * rate_units(system, closure.length))


def _turns(J: Array) -> tuple[Array, Array]:
    """Return how the row spaces of successive Jacobians (T, k, m) turn.

    Returns:
        Cosines of the largest angles between them, (T − 1,), and numbers that are negative where
        the orientation of the rows changes, (T − 1,).
    """
    Q, R = np.linalg.qr(J.transpose(0, 2, 1))
    Q[:, :, 0] *= np.sign(np.linalg.det(R))[:, None]
    change = Q[:-1].transpose(0, 2, 1) @ Q[1:]
    return np.linalg.svd(change, compute_uv=False)[:, -1], np.linalg.det(change)


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
    if system.closure is not None:
        refuse_singular_shapes(system, motion.knots, lambda t: motion.states(t).x)


def refuse_singular_shapes(
    system: System, knots: Array, shapes_at: Callable[[Array], Array]
) -> None:
    """Reject a motion through a singular shape, given its shapes; see `refuse_singular_loops`.

    Args:
        system: The system, with loops.
        knots: Times of all step ends, (K,) [s].
        shapes_at: Function that returns the shapes (T, nx) at times (T,).
    Raises:
        SingularLoopsError: The motion passes such a shape.
    """
    count = min(_MOST, 4 * len(knots))
    times = np.interp(np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(knots)), knots)

    def value(t: float) -> float:
        return singularity(system, shapes_at(np.array([t]))[0])

    shapes = shapes_at(times)
    values = np.array([singularity(system, x) for x in shapes])
    passed = np.zeros(count, dtype=bool)
    for k in np.flatnonzero(_turns(_scaled_jacobians(system, shapes))[1] < 0.0).tolist():
        # Rows that turn far between two times also change their orientation, so look closer.
        between = shapes_at(np.linspace(times[k], times[k + 1], _CLOSER))
        cosines, orientation = _turns(_scaled_jacobians(system, between))
        passed[k] = cosines.min() > _RESOLVED and np.prod(orientation) < 0.0
    for k in np.flatnonzero((values < _NEAR) | passed).tolist():
        first, last = max(k - 1, 0), min(k + 1, count - 1)
        if values[k] > min(values[first], values[last]) and not passed[k]:
            continue
        span = (float(times[first]), float(times[last]))
        from scipy.optimize import minimize_scalar

        minimum = minimize_scalar(value, bounds=span, method="bounded", options={"xatol": 1e-12})
        if passed[k] or min(minimum.fun, values[k]) < _SINGULAR:
            at = shapes_at(np.array([minimum.x]))[0]
            raise SingularLoopsError(
                f"the equations of the loops {_names(system)} of '{system.name}' become dependent "
                f"at t = {minimum.x:g} s, x = {at}. There the motion can continue in several ways. "
                "End the motion earlier, or avoid the shape with a limit or a spring.",
                float(minimum.x),
            )


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
        for loop, equations in zip(system.loops, loop_kinematics(system).rows, strict=True):
            lam = multipliers[equations]
            wrenches[loop.name][k] = _wrench(loop.kind, lam) if isinstance(loop, Loop) else lam
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
    if plan.driven:  # drives apply the forces that their accelerations need
        driven = r + np.array(plan.driven)
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
