"""Errors of the equations of motion: an engine's accelerations against ABA at equal states.

Both sides are evaluated at the states of the trajectory. The result depends neither on chaos nor on
the tolerance.

The error of row i is the force H Δa of the acceleration difference. Its unit is the sum of the
magnitudes of the terms in that row's equation. So errors of a light joint are relative to its own
forces, and an ill-conditioned H does not amplify errors. For a body that is small about its joint,
terms of mass · acceleration · robot size cancel, so a small fraction of these terms is added to the
unit.

Round-off is measured and subtracted. For the engine it is the difference between two finite
differences of its velocity. For ABA it is the difference of ABA in the world's axes from
ABA in body axes, which is large where the mass matrix is almost singular.

Accelerations of the trajectory follow from the equations of the engine that computed it. At time t
the engine computes the rate of the reduced state, ẏ = f(t, y), and the velocity v(t, y). The
acceleration v̇ is the derivative of v along (1, ẏ), computed with central differences of order 8.
The acceleration therefore follows from the equations alone, independent of the integrator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError
from ..reduction.inertia_split import symmetric
from ..simulation.trajectory import Trajectory
from ..system.state_fields import State
from ..system.system import System, moved_masses
from .reference_solution import SPREAD_MARGIN, FullState
from .system_totals import gravity_load_sizes

WORLD, BODIES = pin.Convention.WORLD, pin.Convention.LOCAL  # axes for the evaluation of ABA
_CANCELLED = 1e-5  # fraction of the inertial forces on moved bodies in the unit of force errors
_AT_REST = 1e-2  # smallest unit of force errors, relative to the largest forces during the motion
_WINDOW = 5  # number of neighbouring times over which round-off of the differences is measured
_LEAST = 1e-290  # smallest unit of force errors; floating-point numbers below it lose digits

# Weights of v(t + k h) − v(t − k h), k = 1, …, 4, in the central difference times h.
_WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
# Step h: motion of the fastest joint or of the base within h [rad, or fraction of robot size].
_STEP = 0.005
_SHORTER = 0.7  # Factor of h in the second estimate, which shows the round-off.
# Largest h in integrator steps if prescribed joints depend on time.
_FRACTION_OF_STEP = 1 / 64


def equation_errors(traj: Trajectory, full: FullState, times: Array) -> Array:
    """Compute the relative errors of the equations of motion.

    Args:
        traj: The trajectory.
        full: Full simulation of the system whose equations the trajectory should satisfy.
        times: Times, (T,) [s].
    Returns:
        (T, n) relative errors of base and shape rows.
    """
    q0 = traj.system.sort_q(traj.q[0])
    size = full.totals.radius_of_gyration(q0)
    route, parameters = accelerations(traj, times, size), traj.motion.numbers(times)
    states, r = route.states, full.system.r
    driven = [r + k for k in traj.plan.acting.driven]
    # Two differences may agree by chance at one time, but not at five in sequence.
    half = _WINDOW // 2
    padded = np.pad(route.spread, ((half, half), (0, 0)), mode="edge")
    spread = np.lib.stride_tricks.sliding_window_view(padded, _WINDOW, axis=0).max(axis=-1)
    y = full.state(states.pose, states.x, states.xi, states.xdot)
    a, other = (_accelerations(full, times, y, parameters, axes) for axes in (BODIES, WORLD))
    H, loads = _mass_matrices_and_loads(full.system, full.q(y))
    changes = np.abs(a) + route.pace[:, None] * np.abs(route.v)
    units = _products(np.abs(H), changes) + loads
    units += _CANCELLED * _inertial_forces(full.system, q0, changes, size)
    # Differences below the spread of the engine's own derivatives cannot be resolved.
    errors = np.abs(_products(H, route.a - a)) - SPREAD_MARGIN * _products(np.abs(H), spread)
    # A drive applies whatever force its plan needs, so only its acceleration is compared.
    diagonals = np.diagonal(H, axis1=1, axis2=2)
    errors[:, driven] = (diagonals * (np.abs(route.a - a) - SPREAD_MARGIN * spread))[:, driven]
    aba_spread = np.abs(_products(H, a - other))
    # At rest, the forces are only round-off, so the unit of force errors has a lower limit.
    least = np.maximum(_AT_REST * units.max(axis=0, initial=0.0), _LEAST)
    units = np.maximum(units, least)
    # Two evaluations of ABA may agree by chance at one time, so the largest spread is subtracted.
    round_off = SPREAD_MARGIN * (aba_spread / units).max(axis=0, initial=0.0)
    return np.asarray(np.maximum(errors / units - round_off, 0.0))


def _products(matrices: Array, vectors: Array) -> Array:
    """Return the products of matrices (T, n, n) and vectors (T, n)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _accelerations(
    full: FullState, t: Array, y: Array, parameters: Sequence[Array], axes: pin.Convention
) -> Array:
    """Return ABA's accelerations (T, n) of base and shape, evaluated in the given axes."""
    r, nv = full.system.r, full.system.model.nv
    a = full.rates(t, y, parameters, axes)[:, y.shape[1] - nv :]
    return np.hstack([a[:, :r], full.couplings.shape_rate(a[:, r:])])


def _mass_matrices_and_loads(system: System, q: Array) -> tuple[Array, Array]:
    """Return Pinocchio's mass matrices (T, n, n) and magnitudes of gravity loads (T, n)."""
    model, data = system.sorted_model, system.sorted_data
    upper = np.array([pin.crba(model, data, q_k) for q_k in q])
    loads = system.sizes_on_shape(gravity_load_sizes(model, data, q))
    return system.coupled_matrix(symmetric(upper)), loads


def _inertial_forces(system: System, q0: Array, changes: Array, size: float) -> Array:
    """Return the largest possible inertial forces on the bodies that each joint moves, (T, n).

    The masses that joints move do not depend on the configuration.

    Args:
        system: The system.
        q0: A configuration, (nq,).
        changes: Accelerations, (T, n).
        size: Size of the robot [m], used as lever arm of moments.
    Returns:
        The forces.
    """
    angular, mass = moved_masses(system.sorted_model, system.sorted_data, q0)
    rotates = (
        angular
        if system.coupled is None
        else np.append(angular[: system.r], angular[system.r :][system.coupled.leads])
    )
    fastest = size * changes[:, rotates].sum(axis=1) + changes[:, ~rotates].sum(axis=1)
    moved = system.sizes_on_shape(mass * np.where(angular, size, 1.0))
    return np.outer(fastest, moved)


@dataclass(frozen=True)
class Accelerations:
    """States and accelerations at some times.

    Attributes:
        states: States at the times (T,).
        v: Body twist and shape rate, (T, n).
        a: Time derivatives of v, (T, n).
        spread: Difference between the accelerations for two lengths h, (T, n); it measures the
            round-off of v.
        pace: Rate at which shape and attitude change, with slides in units of the robot's size,
            (T,) [1/s].  It is larger if prescribed joints need shorter differences.  The round-off
            of a is that of v times this rate.
    """

    states: State
    v: Array
    a: Array
    spread: Array
    pace: Array


def accelerations(traj: Trajectory, t: Array, size: float) -> Accelerations:
    """Compute states and accelerations of a trajectory.

    Args:
        traj: The trajectory.
        t: Times, (T,) [s].
        size: Length of the robot [m].
    Returns:
        States and accelerations at the times.
    Raises:
        InputError: The scene leaves out the base.
    """
    motion, system = traj.motion, traj.system
    states = motion.states(t)
    if not isinstance(states, State):
        raise InputError("accelerations need the base, which outputs='shape' leaves out")
    v = np.hstack([states.xi, states.xdot])
    # v is linear in the momenta, so only the motion of shape and attitude limits h.  Cyclic joints
    # are excluded, because nothing depends on their angles.
    units = np.ones(system.n)
    units[: system.group.linear] = 0.0
    units[system.r :][[unit == "m" for unit in system.units]] = 1.0 / size
    units[system.r :][list(traj.plan.acting.cyclic)] = 0.0
    pace = np.abs(v) @ units
    h = np.divide(_STEP, pace, out=np.ones(len(t)), where=pace > 0.0)
    if traj.plan.acting.driven:
        step_ends = motion.knots
        last = np.clip(np.searchsorted(step_ends, t), 1, len(step_ends) - 1)
        h = np.minimum(h, _FRACTION_OF_STEP * (step_ends[last] - step_ends[last - 1]))
        # A prescribed joint that reverses is slow, but its acceleration is large.
        h = np.minimum(h, _STEP / max(_prescribed_pace(traj, t), 1e-300))
        pace = np.maximum(pace, _STEP / h)
    changes = motion.changes(t)

    multiples = np.arange(1, len(_WEIGHTS) + 1)[:, None]

    def differentiate(h: Array) -> Array:
        after, before = (motion.beside(t, changes, sign * multiples * h) for sign in (1.0, -1.0))
        return np.asarray(np.einsum("k,ktn->tn", _WEIGHTS, after - before) / h[:, None])

    a = differentiate(h)
    return Accelerations(states, v, a, np.abs(a - differentiate(_SHORTER * h)), pace)


def _prescribed_pace(traj: Trajectory, t: Array) -> float:
    """Return the largest ratio of |ẍ| to |ẋ| of the prescribed joints at times t [1/s]."""
    forces, numbers = traj.plan.forces, traj.motion.numbers(t)
    assert forces is not None
    plans = forces.prescribed(t, np.array(numbers))
    speeds, accelerations = (np.abs(rates).max(axis=0) for rates in (plans.xdot, plans.xddot))
    return float(np.divide(accelerations, speeds, out=0.0 * speeds, where=speeds > 0.0).max())
