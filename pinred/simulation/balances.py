"""Balances of energy and momentum, computed from a motion when they are requested.

Energy changes by the work of forces without a potential and of the drives of prescribed joints.
Momentum changes by the impulse of wrenches and of gravity.  Powers and wrenches are integrated over
each step with 8 Gauss points; steps that these do not resolve are halved.  The steps of a motion
follow its integrated variables, so a joint may oscillate within one step if it is prescribed.

The torques τ of prescribed joints follow by inverse dynamics.  With the mass matrix H, the bias b
of Pinocchio's RNEA and the other forces F,

    H a + b = F + τ

is solved first for the accelerations a of the base and of the free joints, because a of the
prescribed joints and τ of the others are known.  It then determines τ of the prescribed joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.polynomial import legendre

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays, read_only
from ..reduction.pointwise_reduction import com_derivative, symmetric
from ..reduction.potential import shape_gravity
from ..scene.stop import Bound
from ..system.joints import axes_of
from ..system.loops.kinematics import loop_jacobian, loop_jacobian_rate
from ..system.state_fields import State, with_base
from ..system.system import System
from .motion import Motion
from .plan import Plan
from .reduced_flow import Sample, map_samples

_POINTS = 8  # Number of Gauss points in each step.
_ROUND_OFF = 16.0 * float(np.finfo(float).eps)  # of all components, relative to the largest one
_RESOLVED = 1e-9  # highest Legendre terms of resolved steps, relative to the largest integrand
_HALVINGS = 8  # largest number of times that a step is halved
_ENTRIES = 2**18  # Number of entries of mass matrices that are in memory at once.
_STOPS = "joint stops"  # Label for the energy that impacts at joint stops remove.
_DRIVES = "prescribed joints"  # Label for the work done by the drives of prescribed joints.


@checks_arguments
@dataclass(frozen=True)
class EnergyBalance(FrozenArrays):
    """The balance of energy and work; arrays are read-only.

    Attributes:
        t: Report times, (T,) [s].
        energy: Kinetic and potential energy, (T,) [J].
        labels: Names of the K forces that do work.
        work: Work of each force since the start of the motion, (T, K) [J].
    """

    t: Array
    energy: Array
    labels: tuple[str, ...]
    work: Array

    @property
    def residual(self) -> Array:
        """E(t) − E(0) − work, (T,) [J]; zero except for integration errors."""
        return np.asarray(self.energy - self.energy[0] - self.work.sum(axis=1) + self.work[0].sum())

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        entries = [
            ("energy at the start", float(self.energy[0])),
            *((f"work of {k}", float(w)) for k, w in zip(self.labels, self.work[-1], strict=True)),
            ("energy at the end", float(self.energy[-1])),
            ("largest residual", float(np.abs(self.residual).max())),
        ]
        return card("Energy", f"balance to {self.t[-1]:g} s", table("", ["", "J"], entries))


@checks_arguments
@dataclass(frozen=True)
class MomentumBalance(FrozenArrays):
    """The balance of momentum and impulse in the root joint's fixed frame, about its origin.

    Attributes:
        t: Report times, (T,) [s].
        momentum: Spatial momentum J, (T, r) [N·s | N·m·s].
        impulse: Impulse of wrenches and gravity since the start, (T, r) [N·s | N·m·s].
    """

    t: Array
    momentum: Array
    impulse: Array

    @property
    def residual(self) -> Array:
        """J(t) − J(0) − impulse, (T, r) [N·s | N·m·s]; zero except for integration errors."""
        return np.asarray(self.momentum - self.momentum[0] - self.impulse + self.impulse[0])

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        J, worst = self.momentum, np.abs(self.residual).max(axis=0)
        columns = np.column_stack([J[0], self.impulse[-1], J[-1], worst])
        components = [[str(k), *numbers.tolist()] for k, numbers in enumerate(columns)]
        head = ["component", "start", "impulse", "end", "largest residual"]
        return card("Spatial momentum", f"balance to {self.t[-1]:g} s", table("", head, components))


def energy_balance(plan: Plan, motion: Motion, states: State) -> EnergyBalance:
    """Compute the energy balance of a motion.

    Args:
        plan: The plan of the scene.
        motion: The motion, which includes the base.
        states: States of the motion at the report times.
    Returns:
        The balance at the times of the states.
    """
    forces, impacts = plan.forces, motion.impacts
    if impacts is not None:
        stopped = -_sum_before(impacts.t, impacts.energy_lost, states.t)[:, None]
    else:
        stopped = np.zeros((len(states.t), 0))
    of_stops = (_STOPS,) * stopped.shape[1]
    if forces is None or not (forces.labels or forces.joints):
        return EnergyBalance(states.t, states.energy, of_stops, stopped)
    labels = (*forces.labels, *([_DRIVES] if forces.joints else []))

    def compute_powers(t: Array) -> Array:
        full = with_base(motion.states(t), plan.system.name)
        samples, numbers = motion.samples(t)
        powers = forces.powers(samples.force_inputs(t, numbers), full.xi)
        if not forces.joints:
            return powers
        drive = torques_of_motion(plan, motion, t)[0]
        power = np.sum(drive * full.xdot[:, list(forces.joints)], axis=1)
        return np.column_stack([powers, power])

    work = _integral(motion, states.t, compute_powers)
    if forces.joints:
        work[:, -1] += _sum_before(*motion.work_of_drives, states.t)
    work = np.hstack([work, stopped])
    return EnergyBalance(states.t, states.energy, (*labels, *of_stops), work)


def _sum_before(times: Array, energies: Array, t: Array) -> Array:
    """Return the sum of the energies (I,) of impacts at `times` (I,) before each time t, (T,).

    A report time at an impact has the state before it; that at the start, the one after it.
    """
    sums = np.append(0.0, np.cumsum(energies * (times > 0.0)))
    return np.asarray(sums[np.searchsorted(times, t, side="left")])


def momentum_balance(plan: Plan, motion: Motion, states: State) -> MomentumBalance:
    """Compute the momentum balance of a motion.

    Args:
        plan: The plan of the scene.
        motion: The motion, which includes the base.
        states: States of the motion at the report times.
    Returns:
        The balance at the times of the states.
    """
    system, forces = plan.system, plan.forces
    axes, weight = axes_of(system.model.joints[1]), system.mass * system.gravity
    # Moments are about the root joint, not the world's origin, so that a robot that is balanced
    # about this joint has no round-off from a large lever arm.
    model, data = system.model.copy(), system.data
    rotation = model.jointPlacements[1].rotation.copy()
    model.jointPlacements[1].translation = np.zeros(3)

    def compute_wrenches(t: Array) -> Array:
        full = with_base(motion.states(t), system.name)
        wrenches = np.empty((len(t), system.r))
        for k, q in enumerate(full.q):
            moment = np.cross(pin.centerOfMass(model, data, q), weight)
            wrenches[k] = axes.T @ (np.array([weight, moment]) @ rotation).ravel()
        if forces is not None and plan.wrench:
            samples, numbers = motion.samples(t)
            body = forces.acting(samples.force_inputs(t, numbers)).wrench
            wrenches += system.group.spatial_momentum(full.pose, body)
        return wrenches

    impulse = np.zeros((len(states.t), system.r))
    if plan.wrench or weight.any():
        impulse = _integral(motion, states.t, compute_wrenches)
    return MomentumBalance(states.t, states.spatial_momentum, impulse)


def _integral(motion: Motion, t: Array, integrand: Callable[[Array], Array]) -> Array:
    """Return the integrals from 0 to times t (T,) of an integrand (T,) → (T, K).

    In each step the Legendre series through the Gauss points is integrated.
    """
    ends = motion.knots[: np.searchsorted(motion.knots, t[-1]) + 1]
    if len(ends) < 2:
        ends = motion.knots[:2]
    points, weights = legendre.leggauss(_POINTS)
    degree = np.arange(_POINTS)
    basis = legendre.legvander(points, _POINTS - 1) * weights[:, None] * (degree + 0.5)
    for halvings_left in reversed(range(_HALVINGS + 1)):
        half = 0.5 * np.diff(ends)
        middle = ends[:-1] + half
        nodes = middle[:, None] + half[:, None] * points
        values = integrand(nodes.ravel()).reshape(*nodes.shape, -1)
        terms = np.einsum("spk,pn->snk", values, basis)
        largest = np.abs(values).max(axis=(0, 1), initial=0.0)
        allowed = _RESOLVED * largest + _ROUND_OFF * largest.max(initial=0.0)
        coarse = (np.abs(terms[:, -2:]) > allowed).any(axis=(1, 2))
        if not (halvings_left and coarse.any()):
            break
        ends = np.sort(np.concatenate([ends, middle[coarse]]))
    series = terms * half[:, None, None]
    at_ends = np.concatenate([np.zeros_like(series[:1, 0]), np.cumsum(2.0 * series[:, 0], axis=0)])
    step = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(half) - 1)
    P = legendre.legvander((t - middle[step]) / half[step], _POINTS)
    # ∫ P_n from −1 is (P_{n+1} − P_{n−1})/(2n + 1), with P_{−1} = −1.
    previous = np.concatenate([-np.ones((len(t), 1)), P[:, : _POINTS - 1]], axis=1)
    integrals = (P[:, 1:] - previous) / (2 * degree + 1)
    return np.asarray(at_ends[step] + np.einsum("tn,tnk->tk", integrals, series[step]))


def joint_torques(plan: Plan, motion: Motion, t: Array) -> Array:
    """Compute the torques on the joints: of forces, of prescribed motions, and of stops at rest.

    Args:
        plan: The plan of the scene.
        motion: The motion.
        t: Times, (T,) [s].
    Returns:
        (T, m) [N·m | N].
    """
    driving, of_stops = torques_of_motion(plan, motion, t)
    torques = np.array(of_stops)
    if plan.forces is not None:
        samples, numbers = motion.samples(t)
        acting = np.array(plan.forces.acting(samples.force_inputs(t, numbers)).torque)
        acting[:, list(plan.driven)] += driving
        torques = acting + of_stops if of_stops.any() else acting
    return read_only(torques)


def torques_of_motion(plan: Plan, motion: Motion, t: Array) -> tuple[Array, Array]:
    """Compute the torques of prescribed joints, and the reactions of stops at which joints rest.

    Args:
        plan: The plan of the scene.
        motion: The motion.
        t: Times, (T,) [s].
    Returns:
        (T, k) in the order of the prescribed joints, and (T, m), zero for moving joints [N·m | N].
    """
    samples, numbers = motion.samples(t)
    driven = len(plan.driven)
    driving, reactions = np.zeros((len(t), driven)), np.zeros((len(t), plan.system.m))
    for stops, indices in motion.resting(t):
        chosen = map_samples(lambda field, indices=indices: field[0][indices], [samples])
        torques = driving_torques(plan, t[indices], chosen, numbers[indices], stops)
        driving[indices] = torques[:, :driven]
        for k, bound in enumerate(stops):
            normals = np.array([bound.normal(x, plan.system.m) for x in chosen.x])
            reactions[indices] += torques[:, driven + k, None] * normals
    return read_only(driving), read_only(reactions)


def driving_torques(
    plan: Plan, t: Array, samples: Sample, numbers: Array, rest: Sequence[Bound] = ()
) -> Array:
    """Compute the torques of the prescribed joints, and the reactions of stops.

    Args:
        plan: The plan of the scene.
        t: Times, (T,) [s].
        samples: States that forces depend on at these times.
        numbers: Parameters of the forces at these times, (T, p).
        rest: Stops at which joints rest.
    Returns:
        (T, k) [N·m | N]: torques in the order of the prescribed joints; then the reactions of the
        stops, away from them.
    """
    count = len(plan.driven) + len(rest)
    if not count:
        return read_only(np.zeros((len(t), 0)))
    torques = np.empty((len(t), count))
    count = max(1, _ENTRIES // plan.system.n**2)
    for first in range(0, len(t), count):
        chunk_at = slice(first, first + count)
        chunk = map_samples(lambda field, chunk_at=chunk_at: field[0][chunk_at], [samples])
        torques[chunk_at] = _driving_torques(plan, t[chunk_at], chunk, numbers[chunk_at], rest)
    return read_only(torques)


def _driving_torques(
    plan: Plan, t: Array, samples: Sample, numbers: Array, rest: Sequence[Bound]
) -> Array:
    """Return `driving_torques` at times whose mass matrices fit into memory."""
    system, r, forces = plan.system, plan.system.r, plan.forces
    on_surface = [bound.surface is not None for bound in rest]
    locked = [bound for bound, is_on in zip(rest, on_surface, strict=True) if not is_on]
    driven = r + np.array([*plan.driven, *(bound.v for bound in locked)], dtype=np.intp)
    free = np.setdiff1d(np.arange(system.n), driven)
    H, force = _inertial_terms(system, samples)
    a, loads = np.zeros_like(force), np.zeros_like(force)
    if forces is not None:
        acting = forces.acting(samples.force_inputs(t, numbers))
        force = np.concatenate([acting.wrench, acting.torque], axis=1) + force
        a[:, driven[: len(forces.joints)]] = forces.prescribed(t, numbers).xddot
    free_force = force[:, free] - np.einsum("tij,tj->ti", H[:, free[:, None], driven], a[:, driven])
    surfaces = [bound for bound, is_on in zip(rest, on_surface, strict=True) if is_on]
    reactions = np.empty((len(t), len(surfaces)))
    if system.closure is not None or surfaces:
        for k, load in enumerate(loads):
            J, bias = _constraints(system, samples.x[k], samples.xdot[k], surfaces)
            bias = bias + J[:, driven] @ a[k, driven]
            right = np.column_stack([free_force[k], J[:, free].T])
            solved = np.linalg.solve(H[k][np.ix_(free, free)], right)
            mobility = J[:, free] @ solved[:, 1:]
            multipliers = np.linalg.solve(mobility, -bias - J[:, free] @ solved[:, 0])
            load[:] = multipliers @ J
            reactions[k] = multipliers[len(J) - len(surfaces) :]
    right = (free_force + loads[:, free])[..., None]
    a[:, free] = np.linalg.solve(H[:, free[:, None], free], right)[..., 0]
    needed = np.einsum("tij,tj->ti", H[:, driven], a)
    torques = np.asarray(needed - force[:, driven] - loads[:, driven])
    if not rest:
        return torques
    count = len(plan.driven)
    of_stops = np.empty((len(t), len(rest)))
    of_stops[:, np.logical_not(on_surface)] = torques[:, count:] * [bound.sign for bound in locked]
    of_stops[:, on_surface] = reactions
    return np.hstack([torques[:, :count], of_stops])


def _inertial_terms(system: System, samples: Sample) -> tuple[Array, Array]:
    """Return mass matrices, (T, n, n), and the sums of gravity and −b, (T, n)."""
    gravity, data, r = shape_gravity(system), system.sorted_data, system.r
    weightless = system.workspace("model without gravity", lambda: _weightless(system.sorted_model))
    q = system.sorted_q(system.group.identity(), samples.x)
    v = system.sorted_v(samples.xi, samples.xdot)
    upper, bias = np.empty((*v.shape, v.shape[1])), np.empty_like(v)
    for k, (q_k, v_k) in enumerate(zip(q, v, strict=True)):
        upper[k] = pin.crba(system.sorted_model, data, q_k)
        bias[k] = pin.nonLinearEffects(weightless, data, q_k, v_k)
    terms = -system.on_shape(bias)
    for k, x in enumerate(samples.x):
        if not gravity.is_zero:
            terms[k, r:] -= gravity.gradient(x)
        if samples.weight[k].any():
            pin.crba(system.sorted_model, data, q[k])
            terms[k, r:] += samples.weight[k] @ com_derivative(system, x)
            terms[k, :r] += np.cross(data.Ycrb[1].lever, samples.weight[k])
    return system.coupled_matrix(symmetric(upper)), terms


def _constraints(
    system: System, x: Array, xdot: Array, surfaces: Sequence[Bound]
) -> tuple[Array, Array]:
    """Return the rows J (c, n) of loops and of stops that lock no joint, and J̇ v, (c,).

    Base and free joints obey H a = F + Jᵀλ and J a + J̇ v = 0.
    """
    gradients, rates = [np.zeros((0, system.m))], [np.zeros((0, system.m))]
    if system.closure is not None:
        gradients.append(loop_jacobian(system, x)[system.closure.rows])
        rates.append(loop_jacobian_rate(system, x, xdot)[system.closure.rows])
    for bound in surfaces:
        gradients.append(bound.normal(x, system.m)[None])
        rates.append(bound.normal_rate(x, xdot)[None])
    on_shape = np.vstack(gradients)
    J = np.hstack([np.zeros((len(on_shape), system.r)), on_shape])
    return J, np.vstack(rates) @ xdot


def _weightless(model: pin.Model) -> pin.Model:
    """Return a copy of a model without gravity."""
    weightless = model.copy()
    weightless.gravity.setZero()
    return weightless
