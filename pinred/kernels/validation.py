"""Validation of kernels: before its first use, each kernel is compared with Pinocchio.

The states are random.  A compared value may be a sum of large terms that cancel, so each
comparison allows the round-off of these terms.  ReferenceState computes their magnitudes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array
from ..common.errors import InputError, KernelMismatch, ModelError
from ..forces.force_numbers import ForceInputs
from ..lie.rotations import conjugate, quaternion_product
from ..reduction.potential import translations
from ..reduction.tree.loop_constraints import GAUGE_RATE
from ..system.joints import axes_of
from ..system.loops.kinematics import loop_jacobian_rate
from ..system.system import ill_scaled
from .reference_state import (
    LoadsByPinocchio,
    ReferenceState,
    closed_solver,
    impetus_terms,
    random_state,
)

if TYPE_CHECKING:
    from ..system.system import System
    from .kernel import Kernel

_STATES = 3  # number of states at which a kernel is compared
_TRIALS = 80  # largest number of random states drawn
TOLERANCE = 1e-10  # tolerance of comparisons, relative to the largest entry
_CANCELLED = 1e-9  # largest entry, relative to its terms, of a kind whose entries all cancel
ROUND_OFF = 1e-13  # round-off of a full sweep, relative to the magnitude of the summed terms


def validate_kernel(kernel: Kernel) -> None:
    """Compare a kernel with Pinocchio at random states.

    Velocities are compared with H v = (μ, π), accelerations with
    Pinocchio's RNEA.

    Args:
        kernel: The kernel.
    Raises:
        KernelMismatch: Values differ by more than 1e-10, relative to the largest entry.
        InputError: The forces are not finite at most random states.
    """
    for at in trial_states(kernel, _STATES):
        _validate_at(kernel, at)


def trial_states(kernel: Kernel, count: int, seed: int = 0) -> Iterator[ReferenceState]:
    """Yield random states at which the forces of a kernel are finite.

    Args:
        kernel: The kernel.
        count: Number of states.
        seed: Seed of the random numbers.
    Yields:
        The states.
    Raises:
        InputError: The forces are not finite at most random states.
    """
    rng, yielded = np.random.default_rng(seed), 0
    for trial in range(_TRIALS):
        # Some forces, such as barriers, are undefined far from zero, so later states are smaller.
        at = random_state(kernel, rng, 0.9 ** max(0, trial - _STATES))
        if at is not None:
            yield at
            yielded += 1
        if yielded == count:
            return
    raise InputError(
        f"the forces or prescribed joints of '{kernel.system.name}' are not finite at "
        f"{_TRIALS - yielded} of {_TRIALS} random states; functions such as sqrt and log must "
        "be defined near the motion"
    )


def _validate_at(kernel: Kernel, at: ReferenceState) -> None:
    """Compare all values of a kernel with Pinocchio at one state."""
    outputs = kernel.evaluate_outputs(at.time, at.y, at.parameters, at.com_path)
    _validate_momentum(kernel, at, outputs)
    if kernel.layout.base_requested:
        _validate_full_state(kernel, at, outputs)
    validate_rate(kernel, at, kernel.evaluate_rate(at.y, at.parameters))


def validate_rate(kernel: Kernel, at: ReferenceState, rate: Array) -> None:
    """Compare a rate of the reduced state with Pinocchio.

    Args:
        kernel: The kernel.
        at: Reduced state, with reference values.
        rate: The rate dy/dt, (size,).
    Raises:
        KernelMismatch: Values differ.
    """
    _validate_velocity(kernel, at, rate)
    v = _velocity_of_rate(kernel, at, rate)
    _validate_inverse_dynamics(kernel, at, v)
    torque, wrench = _forces_at(kernel, at, v)
    _validate_base(kernel, at, rate, v, wrench)
    _validate_acceleration(kernel, at, rate, v, torque, wrench)


def _validate_momentum(kernel: Kernel, at: ReferenceState, outputs: Array) -> None:
    """Compare velocity, momenta, shape and centre of mass, relative to the centre of mass."""
    check, where, r = _checker(kernel), kernel.where, kernel.system.r
    prescribed, v, terms = list(at.prescribed), outputs[: kernel.system.n], at.momentum_terms
    kinds, kinds_of_x = at.is_linear, at.is_linear_x
    check("momentum of the velocity", at.H @ v, at.H @ at.v, terms, kinds=kinds)
    check("velocity", v, at.v, at.velocity_terms, kinds=kinds)
    check("centre of mass", outputs[where.com], at.com, at.reach)
    check("momentum", outputs[where.mu], at.mu, terms[:r])
    driven = list(kernel.layout.prescribed_x)
    sizes = np.abs(at.x)
    sizes[kernel.system.space.ball_x] = 1.0
    positions, momenta = outputs[where.driven_x], outputs[where.driven_pi]
    check("prescribed positions", positions, at.x[driven], sizes[driven], kinds=kinds_of_x[driven])
    check(
        "momenta of prescribed joints",
        momenta,
        at.pi[prescribed],
        terms[r:][prescribed],
        kinds=kinds[r:][prescribed],
    )
    check("shape", outputs[where.fields["x"]], at.x, sizes, kinds=kinds_of_x)


def _validate_full_state(kernel: Kernel, at: ReferenceState, outputs: Array) -> None:
    """Compare the full state: configuration, centre-of-mass path, momenta, energy."""
    system, where, check = kernel.system, kernel.where, _checker(kernel)
    model, r, k = system.sorted_model, system.r, system.group.linear
    data = system.sorted_data
    pose, q, v = (outputs[where.fields[name]] for name in ("pose", "q", "v"))
    check("configuration", q, system.sorted_q(pose, at.x), abs(q), kinds=at.is_linear_q)
    velocity = system.velocity(system.given_v(v))
    full, v = v, np.concatenate([velocity.xi, velocity.xdot])
    kinds = at.is_linear
    check("full velocity", v[k:], at.v[k:], at.velocity_terms[k:], kinds=kinds[k:])
    check("velocity of all joints", full, system.joint_rates(v), abs(full), kinds=at.is_linear_v)
    root, (c0, v0, fall) = model.jointPlacements[1], at.com_path.reshape(3, k)
    displacements = [c0, v0 * at.time, 0.5 * fall * at.time**2]
    velocities = [v0, fall * at.time]
    if at.push.size:
        displacements.append(at.push[:k])
        velocities.append(at.push[k:] / system.mass)
    com, com_velocity = np.sum(displacements, axis=0), np.sum(velocities, axis=0)
    distance = np.abs(displacements).sum() + at.reach
    speed = np.abs(velocities).sum() + at.velocity_terms[:k].sum()
    speed += at.reach * at.velocity_terms[k:r].sum() + at.momentum_terms[:k].sum() / system.mass
    pin.centerOfMass(model, data, q, full)
    axes = translations(system).T @ root.rotation.T
    check("position of the centre of mass", axes @ (data.com[0] - root.translation), com, distance)
    check("velocity of the centre of mass", axes @ data.vcom[0], com_velocity, speed)
    mu = at.H[:r] @ v
    v_terms = at.velocity_terms.copy()
    v_terms[:k] += speed
    mu_terms = np.abs(at.H[:r]) @ v_terms
    check("body momentum", outputs[where.fields["body_momentum"]], mu, mu_terms, kinds=kinds[:r])
    J = system.group.spatial_momentum(pose, mu)
    J_terms = np.abs(system.group.Ad(system.group.inverse(pose))).T @ mu_terms
    check(
        "spatial momentum", outputs[where.fields["spatial_momentum"]], J, J_terms, kinds=kinds[:r]
    )
    gravity_energy = pin.computePotentialEnergy(model, data, q)
    energy = 0.5 * v @ at.H @ v + gravity_energy
    force = system.mass * float(np.abs(system.gravity).sum())
    terms = np.abs(v) @ np.abs(at.H) @ v_terms
    terms += force * (distance + np.abs(root.translation).sum())
    if kernel.forces is not None:
        potential = kernel.forces.potential(at.x, at.force_parameters)
        energy, terms = energy + potential, terms + abs(potential)
    check("energy", outputs[-1:], np.array([energy]), terms)


def _validate_velocity(kernel: Kernel, at: ReferenceState, rate: Array) -> None:
    """Compare the rates of the joints and of the attitude."""
    layout, r, check = kernel.layout, kernel.system.r, _checker(kernel)
    active, cyclic, a = list(layout.active), list(layout.cyclic), len(layout.active)
    xdot, terms, kinds = at.v[r:], at.velocity_terms[r:], at.is_linear[r:]
    check("shape rate", rate[:a], xdot[active], terms[active], kinds=kinds[active])
    cyclic_rate = rate[2 * layout.pairs : layout.balls_at]
    check("rate of cyclic joints", cyclic_rate, xdot[cyclic], terms[cyclic], kinds=kinds[cyclic])
    check("rate of balls", _ball_rates(kernel, at, rate), xdot[layout.ball_v], terms[layout.ball_v])
    attitude, *_ = _base_rates(kernel, rate)
    jacobian = at.pose_jacobian[len(at.pose) - len(attitude) :]
    check("attitude rate", attitude, jacobian @ at.v[:r], abs(jacobian) @ at.velocity_terms[:r])


def _validate_base(
    kernel: Kernel, at: ReferenceState, rate: Array, v: Array, wrench: Array
) -> None:
    """Compare the rates of angular momentum, gravity direction and centre of mass."""
    system, counts, check = kernel.system, kernel.layout.base, _checker(kernel)
    r, k, H = system.r, system.group.linear, at.H
    omega = v[k:r]
    omega_terms = float(at.velocity_terms[k:r].sum())
    # Compute with Pinocchio the moment of all forces about the centre of mass, or the pivot.
    lever = H[:k, k:r] / system.mass  # (H_lin,ang / m)ᵀ F = c × F for F at the base's origin
    moment = wrench[k:] - lever.T @ wrench[:k]
    terms = np.abs(wrench[k:]) + np.abs(lever).T @ np.abs(wrench[:k])
    if counts.momentum and at.gravity.any():
        moment = moment + _gravity_moment(kernel, at)
        terms = terms + system.mass * at.gravity_strength * at.reach
    gyroscopic = np.cross(at.mu[k:], omega) if counts.momentum == 3 else np.zeros(counts.momentum)
    _, down, momentum, push = _base_rates(kernel, rate)
    if counts.down:
        check("rate of the direction of gravity", down, np.cross(at.down, omega), omega_terms)
    if counts.momentum:
        terms = terms + at.momentum_terms[k:r].sum() * omega_terms
        check("rate of the angular momentum", momentum, gyroscopic + moment, terms)
    if counts.push:
        R = system.group.Ad(at.pose)[:k, :k]
        expected = np.append(at.push[k:] / system.mass, R @ wrench[:k])
        terms = np.append(abs(expected[:k]), abs(R) @ abs(wrench[:k]))
        check("rate of the centre of mass", push, expected, terms, kinds=np.arange(2 * k) < k)


def _validate_acceleration(
    kernel: Kernel, at: ReferenceState, rate: Array, v: Array, torque: Array, wrench: Array
) -> None:
    """Compare accelerations computed from π̇ with accelerations computed from RNEA.

    H v̇ = ṗ − Ḣ v, with ṗ = (ad*_ξ μ + f, π̇) and Ḣ = C + Cᵀ.  A force F accelerates the frame of
    the centre of mass, so π̇ in a frame at rest has the additional term F·∂c/∂x.
    """
    system, layout, model, q, H = kernel.system, kernel.layout, at.model, at.q, at.H
    r, k, data = system.r, system.group.linear, system.sorted_data
    active, first = list(layout.active), layout.pairs
    pidot = np.zeros(system.m)
    pidot[active] = rate[first : first + len(active)]
    pidot[layout.ball_pi] = _ball_momentum_rates(kernel, at, rate)
    pidot += H[:k, r:].T @ wrench[:k] / system.mass
    # Centre the model, because the round-off of Pinocchio's Coriolis matrix grows with the
    # distance from the origin.
    centred = model.copy()
    centred.jointPlacements[1] = pin.SE3.Identity()
    full = system.joint_rates(v)
    C = system.coupled_matrix(
        pin.computeCoriolisMatrix(
            centred, data, system.sorted_q(system.group.identity(), at.x), full
        )
    )
    mudot = system.group.coadjoint(v[:r], at.mu) + wrench
    tau = np.concatenate([wrench, torque])
    if layout.base.momentum and at.gravity.any():
        mudot = mudot + _gravity_moment(kernel, at)
    prescribed = r + np.array(at.prescribed, dtype=int)
    free = at.free
    inertia = H[np.ix_(free, free)]
    coupling = H[np.ix_(free, prescribed)] @ at.accelerations
    pidot = pidot - impetus_terms(system, at.x, v[r:], at.nu)
    rates = np.concatenate([mudot, pidot]) - (C + C.T) @ v
    solve = closed_solver(system, at.x, v[r:], inertia, at.prescribed, at.accelerations)
    acceleration = solve(rates[free] - coupling)
    # Use RNEA: ABA loses digits at a light base, whose inverse inertia amplifies round-off.
    bias = system.on_shape(pin.nonLinearEffects(model, data, q, full))
    expected = solve((tau - bias)[free] - coupling)
    terms = at.force_terms + np.abs(tau) + at.gravity_terms
    terms += np.abs(H[:, free]) @ np.abs(expected)
    terms += np.abs(H[:, prescribed]) @ np.abs(at.accelerations)
    drift = np.abs(at.loop_rows[:, prescribed]) @ np.abs(at.accelerations)
    if system.closure is not None:
        turning = loop_jacobian_rate(system, at.x, v[r:])[system.closure.rows]
        drift = drift + np.abs(turning) @ np.abs(v[r:])
        terms[r:] += np.abs(at.nu) @ (np.abs(turning) + GAUGE_RATE * np.abs(at.loop_rows[:, r:]))
    terms = at.solved_terms(terms, drift)
    _checker(kernel)("acceleration", acceleration, expected, terms[free], kinds=at.is_linear[free])


def _velocity_of_rate(kernel: Kernel, at: ReferenceState, rate: Array) -> Array:
    """Return the velocity, (n,), that a rate of the reduced state contains.

    The reference for π̇ is computed at this velocity, so that round-off of the velocity does not
    count as an error of π̇.  The linear velocity is not part of the rate; it follows from the
    momentum.
    """
    layout, r, k = kernel.layout, kernel.system.r, kernel.system.group.linear
    a, v = len(layout.active), at.v.copy()
    v[r:][list(layout.active)] = rate[:a]
    v[r:][list(layout.cyclic)] = rate[2 * layout.pairs : layout.balls_at]
    v[r:][layout.ball_v] = _ball_rates(kernel, at, rate)
    if layout.base.attitude:
        attitude, *_ = _base_rates(kernel, rate)
        v[k:r] = np.linalg.lstsq(at.pose_jacobian[-len(attitude) :, k:], attitude)[0]
    v[:k] = np.linalg.solve(at.H[:k, :k], at.mu[:k] - at.H[:k, k:] @ v[k:])
    return v


def _ball_rates(kernel: Kernel, at: ReferenceState, rate: Array) -> Array:
    """Return the rates of balls along their axes, from the rates ½ q σ of their quaternions."""
    layout = kernel.layout
    if not layout.balls:
        return np.empty(0)
    first = len(layout.active) if layout.lifted_balls else layout.balls_at + len(layout.ball_pi)
    rates = rate[first : first + len(layout.ball_x)].reshape(-1, 4)
    q = at.x[layout.ball_x].reshape(-1, 4)
    return np.asarray(2.0 * quaternion_product(conjugate(q), rates)[:, :3].ravel())


def _ball_momentum_rates(kernel: Kernel, at: ReferenceState, rate: Array) -> Array:
    """Return the rates of the canonical momenta of balls along their axes, without rotors."""
    layout = kernel.layout
    if not layout.lifted_balls:
        return rate[layout.balls_at : layout.balls_at + len(layout.ball_pi)]
    first, count = len(layout.active), len(layout.ball_x)
    momenta = slice(layout.pairs + first, layout.pairs + first + count)
    q, qdot = at.x[layout.ball_x], rate[first : first + count]
    p, pdot = at.y[momenta], rate[momenta]
    q, qdot, p, pdot = (column.reshape(-1, 4) for column in (q, qdot, p, pdot))
    # π = ½ Im(q̄ ∘ p)
    products = quaternion_product(conjugate(qdot), p) + quaternion_product(conjugate(q), pdot)
    return np.asarray(0.5 * products[:, :3].ravel())


def _validate_inverse_dynamics(kernel: Kernel, at: ReferenceState, v: Array) -> None:
    """Compare torques of inverse dynamics with Pinocchio's mass matrix and RNEA.

    The base acceleration follows from its own rows of H a + bias = (0, τ), without a base wrench.
    """
    system, H, r = kernel.system, at.H, kernel.system.r
    if kernel.forces is None:
        return
    full = system.joint_rates(v)
    for acceleration, torque in kernel.forces.required(force_inputs(at, v)):
        bias = system.on_shape(pin.nonLinearEffects(at.model, system.sorted_data, at.q, full))
        base = -np.linalg.solve(H[:r, :r], H[:r, r:] @ acceleration + bias[:r])
        a = np.append(base, acceleration)
        terms = at.force_terms + at.gravity_terms + np.abs(H) @ np.abs(a)
        base_terms = np.abs(np.linalg.solve(H[:r, :r], H[:r, r:])).T @ terms[:r]
        expected = (H @ a + bias)[r:]
        terms = terms[r:] + base_terms
        _checker(kernel)("inverse dynamics", torque, expected, terms, kinds=at.is_linear[r:])


def _forces_at(kernel: Kernel, at: ReferenceState, v: Array) -> tuple[Array, Array]:
    """Return torques, (m,), and the base wrench, (r,); Pinocchio maps wrenches on links."""
    system, forces = kernel.system, kernel.forces
    if forces is None:
        return np.zeros(system.m), np.zeros(system.r)
    torque, wrench, loads = forces.acting_apart(force_inputs(at, v))
    if not forces.loads:
        return torque, wrench
    root = axes_of(system.model.joints[1])
    on_links = system.on_shape(
        LoadsByPinocchio(system, root, forces.loads).generalised(at.q, loads)
    )
    return torque + on_links[system.r :], wrench + on_links[: system.r]


def force_inputs(at: ReferenceState, v: Array) -> ForceInputs:
    """Return the arguments of a ForceModel at a state with velocity v, (r + m,)."""
    xi, xdot = v[: len(at.mu)], v[len(at.mu) :]
    return ForceInputs(at.time, at.x, xdot, xi, at.mu, at.force_parameters, at.in_space(v))


def _gravity_moment(kernel: Kernel, at: ReferenceState) -> Array:
    """Return the moment of gravity about the pivot, (r,), computed with Pinocchio."""
    gravity = pin.computeGeneralizedGravity(at.model, kernel.system.sorted_data, at.q)
    return -np.asarray(gravity[: kernel.system.r])


def _base_rates(kernel: Kernel, rate: Array) -> tuple[Array, Array, Array, Array]:
    """Split dy/dt of the base into attitude, gravity direction, momentum and push (BaseParts)."""
    first, counts = kernel.layout.base_at, kernel.layout.base
    return counts.split(rate[first : first + counts.size])


@contextmanager
def explain_ill_scaling(system: System) -> Iterator[None]:
    """Replace a KernelMismatch by a ModelError if the system is ill-scaled.

    Args:
        system: The system.
    Raises:
        ModelError: The kernel disagrees with Pinocchio, and the system is ill-scaled.
        KernelMismatch: The kernel disagrees with Pinocchio for another reason.
    """
    try:
        yield
    except KernelMismatch as error:
        if explanation := ill_scaled(system):
            raise ModelError(explanation) from error
        raise


def _checker(kernel: Kernel) -> partial[None]:
    """Return `require_agreement` with the kernel's name as its first argument."""
    return partial(require_agreement, f"the kernel of '{kernel.system.name}'")


def require_agreement(
    who: str,
    what: str,
    found: Array,
    expected: Array,
    terms: Array | float,
    tolerance: float = TOLERANCE,
    reference: str = "Pinocchio",
    kinds: NDArray[np.bool_] | None = None,
) -> None:
    """Check that two arrays agree.

    Entries may differ by `tolerance` times the largest expected entry of their kind, plus the
    round-off of the terms that sum to them.

    Args:
        who: Name of the compared code, for messages.
        what: Name of the compared quantity, for messages.
        found: Computed values.
        expected: Reference values.
        terms: Magnitude of the summed terms, which may cancel; of the shape of `expected`, or
            common to all entries.
        tolerance: Relative tolerance.
        reference: Name of the code that computed the reference values, for messages.
        kinds: For each entry, which of two units it has, for example m/s or rad/s; None if all
            entries have the same unit.
    Raises:
        KernelMismatch: The arrays differ.
    """
    if not expected.size:
        return
    error, size = np.abs(found - expected), np.abs(expected)
    largest, sums = np.full(size.shape, size.max()), np.broadcast_to(terms, size.shape)
    for kind in () if kinds is None else (kinds, ~kinds):
        top, most = size[kind].max(initial=0.0), sums[kind].max(initial=0.0)
        # Where all entries of a kind cancel, as the momenta in the frame of the centre of mass,
        # their round-off is that of the solved system.
        largest[kind] = top if top > _CANCELLED * most else most
    allowed = tolerance * largest + ROUND_OFF * np.asarray(terms)
    if not (error <= allowed).all():
        k = int(np.argmin(error <= allowed))
        raise KernelMismatch(
            f"{who} disagrees with {reference}: {what} is off by {error[k]:.3g} of "
            f"{largest[k]:.3g}\nfound    {found}\nexpected {expected}"
        )
