"""Checks of a trajectory's states: drifts of energy and momentum, its fields, its accelerations.

The measurements that controllers received are checked, too.

Errors of the equations of motion compare an engine's accelerations with ABA at equal states. Both
sides are evaluated at the states of the trajectory. The result depends neither on chaos nor on the
tolerance.

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
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError
from ..reduction.cyclic_joints import SymmetricBall
from ..simulation.balances import energy_balance, momentum_balance
from ..simulation.trajectory import Trajectory
from ..system.state_fields import State
from ..system.system import System, moved_masses
from .full_system import gravity_load_sizes, mass_matrix
from .reference_solution import SPREAD_MARGIN, FullState
from .step_defects import full_states


def axial_momentum_drifts(
    system: System, balls: Sequence[SymmetricBall], states: State
) -> list[Array]:
    """Compute the changes of π · n of symmetric balls, of all of π for spherical rotors.

    The unit is the momentum of the body at the largest angular velocity of base and joints.

    Args:
        system: The system.
        balls: Balls whose momentum about an axis of symmetry of their body is constant.
        states: States at T times.
    Returns:
        Relative changes since the first time, (T,) each.
    """
    if not balls:
        return []
    model, data, k = system.sorted_model, system.sorted_data, system.group.linear
    is_angular = np.array([unit == "rad" for unit in system.units])
    rates = np.hstack([states.xi[:, k:], states.xdot[:, is_angular]])
    fastest = float(np.abs(rates).max(initial=0.0)) or 1.0
    momenta: list[list[Array]] = [[] for _ in balls]
    for q, v in zip(system.sort_q(states.q), system.sort_v(states.v), strict=True):
        pin.forwardKinematics(model, data, q, v)
        for ball, rows in zip(balls, momenta, strict=True):
            i = system.sorted_joints[ball.joint.v.start]
            at = slice(model.idx_vs[i], model.idx_vs[i] + 3)
            axial = (model.inertias[i] * data.v[i]).angular + model.armature[at] * v[at]
            rows.append(axial if ball.axis is None else np.atleast_1d(ball.axis @ axial))
    drifts: list[Array] = []
    for ball, rows in zip(balls, momenta, strict=True):
        i = system.sorted_joints[ball.joint.v.start]
        moment = float(np.trace(model.inertias[i].inertia)) + model.armature[model.idx_vs[i]]
        drifts += list((np.array(rows) - rows[0]).T / (moment * fastest))
    return drifts


_ENERGY_ROUND_OFF = 1e-14  # round-off of the energy relative to its kinetic and potential parts
_HEIGHT_ROUND_OFF = (
    5e-14  # round-off of the energy relative to the potential energy of a distant base
)
_SLOPE_STEP = (
    1e-6  # step of the difference quotients of the potential, in error units of the joints
)
_LEAST = 1e-290  # smallest energy unit [J], near the smallest floating-point numbers

_MOST_CALLS = 100  # largest number of controller calls that are checked, evenly spaced


@dataclass(frozen=True)
class Audit:
    """Drifts and inconsistencies of the states of a trajectory, all relative.

    Attributes:
        energies: Change of energy less work, (T,). The unit is the largest kinetic energy about
            the centre of mass. It is at least the work of a rotation by 1 rad, or of a translation
            by the robot's size, against gravity and springs.
        momenta: Change of each conserved momentum component, (T, r + k). The unit is √(2mT),
            times the radius of gyration for angular ones. About a pivot it is at least the momentum
            that gravity transfers over a swing of 1 rad.  The last k are constant momenta of
            symmetric bodies on balls (see `axial_momentum_drifts`).
        fields: Largest difference of pose, twist, momenta and energy from Pinocchio's at q and v.
    """

    energies: Array
    momenta: Array
    fields: float

    @property
    def energy(self) -> float:
        """Largest change of energy."""
        return float(np.abs(self.energies).max())

    @property
    def momentum(self) -> float:
        """Largest change of momentum."""
        return float(np.abs(self.momenta).max())


def audit_trajectory(traj: Trajectory, states: State) -> Audit:
    """Audit states of a trajectory; subtract work and impulse of its forces."""
    work = energy_balance(traj.plan, traj.motion, states).work.sum(axis=1)
    impulse = None
    if traj.plan.momentum_changes:
        impulse = momentum_balance(traj.plan, traj.motion, states).impulse
    audit = audit_states(FullState(traj.scene), states, work, impulse)
    stopped = {bound.v for bound in traj.scene.bounds}  # impulses change these momenta
    balls = [b for b in traj.plan.symmetric_balls if b.joint.v.start not in stopped]
    drifts = axial_momentum_drifts(traj.system, balls, states)
    return replace(audit, momenta=np.column_stack([audit.momenta, *drifts]))


def audit_with_reference(full: FullState, states: State, reference: Array) -> Audit:
    """Audit states with the work and the impulse that a reference solution receives.

    In stiff scenes, powers amplify errors of dense output between step ends.

    Args:
        full: Full simulation of the scene.
        states: States at T times.
        reference: Full states of the reference solution at these times, (T, n).
    Returns:
        Drifts and inconsistencies. Drifts are the differences from the energies and momenta of the
        reference solution.
    """
    q, (x, v), totals = full.q(reference), full.shapes_and_velocities(reference), full.totals
    energies = totals.kinetic_energy(q, v) + totals.potential_energy(q) + full.force_potential(x)
    return audit_states(
        full, states, energies, totals.momentum(q, v, np.zeros(3), about_pivot=True)
    )


def audit_states(full: FullState, states: State, work: Array, impulse: Array | None) -> Audit:
    """Audit states with energies, momenta and kinematics computed by Pinocchio.

    Args:
        full: Full simulation of the scene.
        states: States at T times.
        work: Work done by forces since the start, (T,) [J].
        impulse: Impulse received since the start in the root's fixed frame, (T, r); None if
            momentum is conserved.
    Returns:
        Drifts and inconsistencies.
    """
    totals, system, linear = full.totals, full.system, full.root.linear
    model, is_pivoted = system.sorted_model, full.root.is_pivoted
    qs, vs = system.sort_q(states.q), system.sort_v(states.v)
    joints, radius = full.couplings.values(states.x), totals.radius_of_gyration(qs[0])
    kinetic = totals.kinetic_energy(qs, vs)
    heights = totals.potential_energy(qs) + full.force_potential(states.x)
    centroidal = totals.centroidal(qs, vs)
    internal = kinetic - totals.com_kinetic_energy(centroidal)
    body = totals.body_momentum(qs, vs)
    momentum = partial(totals.momentum, qs, vs, centroidal=centroidal)
    spatial = momentum(np.zeros(3), about_pivot=True)
    fall = totals.mass * np.outer(states.t, model.gravity.linear)
    conserved = momentum(fall, about_pivot=is_pivoted)
    potential_unit = _potential_unit(full, qs, states.x, full.joint_error_units(joints, radius))
    # A falling rigid body has no internal motion, so its total energy is the unit.
    fastest = float(kinetic.max())
    most = float(internal.max()) if internal.max() > 1e-9 * fastest else fastest
    scale = np.full(system.r, np.sqrt(2.0 * totals.mass * most))
    scale[linear:] *= radius
    if is_pivoted:
        load = totals.pivot_load_sizes(qs).max(axis=0)
        swing = np.minimum(load * np.ptp(states.t), radius * np.sqrt(totals.mass * load))
        scale[linear:] = np.maximum(scale[linear:], swing)
    energies = kinetic + heights
    gained = energies - energies[0] - (work - work[0])
    # During a fast fall, round-off of the total energy exceeds the energy of a slow rotation.
    round_off = _ENERGY_ROUND_OFF * (2.0 * fastest + float(np.abs(energies).max()))
    round_off += _HEIGHT_ROUND_OFF * float(np.abs(heights).max())
    gained[np.abs(gained) <= round_off] = 0.0
    if impulse is not None:
        conserved = spatial - impulse
        scale = np.maximum(scale, np.abs(spatial).max())
    scale[scale == 0.0] = 1.0
    rates = full.couplings.rates(states.xdot)
    momentum_unit = float(scale.max())
    reconstructed_q = full.q(np.hstack([states.pose, joints]))
    mismatches = [
        relative_difference(reconstructed_q, qs, 1.0),
        relative_difference(np.hstack([states.xi, rates]), vs, 0.0),
        relative_difference(states.body_momentum, body, momentum_unit),
        relative_difference(states.spatial_momentum, spatial, momentum_unit),
        relative_difference(states.energy, energies, max(most, _LEAST)),
    ]
    # Wrenches do work on the whole system, so their work counts as well.
    done = 0.0 if impulse is None else float(np.abs(work - work[0]).max())
    unit = max(most, done, potential_unit)
    return Audit(
        energies=gained / unit if unit > _LEAST else gained,
        momenta=(conserved - conserved[0]) / scale,
        fields=float(np.max(mismatches)),
    )


def _potential_unit(full: FullState, q: Array, x: Array, units: Array) -> float:
    """Return the work [J] of moving all joints by their units and the pivot by 1 rad.

    The work is estimated from the first derivatives of the potential energy. The result is the
    largest at states with configurations q, (T, nq), and shapes x, (T, nx).
    """
    r, shape_units = full.system.r, full.couplings.shape_rate(units)
    move = full.system.space.integrate
    slopes = full.totals.gravity_slopes(q)
    work = slopes[:, r:] @ units + slopes[:, full.root.linear : r].sum(axis=1)
    if full.has_force_potential:
        for step in _SLOPE_STEP * np.diag(shape_units):
            difference = full.force_potential(move(x, step)) - full.force_potential(move(x, -step))
            work += np.abs(difference) / (2.0 * _SLOPE_STEP)
    return float(work.max())


def relative_difference(a: Array, b: Array, least: float) -> float:
    """Return max |a − b| / max(max |b|, least); NaN if an entry is NaN."""
    if not b.size:
        return 0.0
    difference, scale = float(np.abs(a - b).max()), max(least, float(np.abs(b).max()))
    return difference / scale if scale > 0.0 else difference


def measurement_error(traj: Trajectory, full: FullState) -> float:
    """Return the largest relative error of the controllers' measurements; 0 without controllers.

    Contributions to a momentum may cancel, so the unit of momenta is at least that of the whole
    mass moving at the largest rate.
    """
    calls = traj.actions
    if not calls:
        return 0.0
    indices = np.linspace(0, len(calls) - 1, min(len(calls), _MOST_CALLS)).astype(int)
    checked = [calls[k] for k in np.unique(indices)]
    measured = [call.seen for call in checked]
    y = full_states(traj, full, np.array([call.t for call in checked]))
    expected = [full.sample(state) for state in y]
    system = traj.system
    size = full.totals.radius_of_gyration(full.q(y[0]))
    rates = np.concatenate([np.append(s.xi[system.group.linear :], s.xdot) for s in expected])
    momentum = system.mass * size**2 * float(np.abs(rates).max(initial=0.0))
    units = {"x": 1.0, "xdot": 0.0, "xi": 0.0, "mu": momentum}
    errors = [_error(measured, expected, name, unit) for name, unit in units.items()]
    if measured[0].base is not None:
        bases, expected_bases = [s.base for s in measured], [s.base for s in expected]
        units = {"pose": 1.0, "xi": 0.0, "mu": momentum, "J": momentum}
        errors += [_error(bases, expected_bases, name, unit) for name, unit in units.items()]
    return float(np.max(errors))


def _error(
    measured: Sequence[object], expected: Sequence[object], name: str, least: float
) -> float:
    """Return the largest relative difference of one field; `least` is its smallest unit."""
    return relative_difference(_column(measured, name), _column(expected, name), least)


def _column(samples: Sequence[object], name: str) -> Array:
    return np.array([getattr(sample, name) for sample in samples])


WORLD, BODIES = pin.Convention.WORLD, pin.Convention.LOCAL  # axes for the evaluation of ABA
_CANCELLED = 1e-5  # fraction of the inertial forces on moved bodies in the unit of force errors
_AT_REST = 1e-2  # smallest unit of force errors, relative to the largest forces during the motion
_WINDOW = 5  # number of neighbouring times over which round-off of the differences is measured
_LEAST_UNIT = 1e-290  # smallest unit of force errors; floating-point numbers below it lose digits

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
    driven = [r + k for k in traj.plan.driven]
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
    least = np.maximum(_AT_REST * units.max(axis=0, initial=0.0), _LEAST_UNIT)
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
    loads = system.sizes_on_shape(gravity_load_sizes(model, data, q))
    return system.coupled_matrix(mass_matrix(model, data, q)), loads


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
    carried_masses = system.sizes_on_shape(mass * np.where(angular, size, 1.0))
    return np.outer(fastest, carried_masses)


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
    units[system.r :][list(traj.plan.cyclic)] = 0.0
    pace = np.abs(v) @ units
    h = np.divide(_STEP, pace, out=np.ones(len(t)), where=pace > 0.0)
    if traj.plan.driven:
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
