"""Check a trajectory with Pinocchio: drift of energy and momentum, consistency of its fields.

The measurements that controllers received are checked, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..common.arrays import Array
from ..simulation.balances import energy_balance, momentum_balance
from ..simulation.trajectory import Trajectory
from ..system.state_fields import State
from .axial_momenta import axial_momentum_drifts
from .reference_solution import FullState
from .step_defects import full_states

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
    if traj.plan.acting.momentum_changes:
        impulse = momentum_balance(traj.plan, traj.motion, states).impulse
    audit = audit_states(FullState(traj.scene), states, work, impulse)
    stopped = {bound.v for bound in traj.scene.bounds}  # impulses change these momenta
    balls = [b for b in traj.plan.acting.symmetric_balls if b.joint.v.start not in stopped]
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
    internal = kinetic - totals.com_kinetic_energy(qs, vs)
    body = totals.body_momentum(qs, vs)
    spatial = totals.momentum(qs, vs, np.zeros(3), about_pivot=True)
    fall = totals.mass * np.outer(states.t, model.gravity.linear)
    conserved = totals.momentum(qs, vs, fall, about_pivot=is_pivoted)
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
