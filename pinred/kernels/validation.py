"""The judge of kernels: each is compared with Pinocchio at random states before it runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError, KernelMismatch, ModelError
from ..reduction.potential import translations
from ..system.joints import axes_of
from ..system.scale import ill_scaled
from .loads_by_pinocchio import LoadsByPinocchio
from .reference_state import ReferenceState, random_state

if TYPE_CHECKING:
    from ..system.system import System
    from .kernel import Kernel

_STATES = 3
_TRIALS = 80
_TOLERANCE = 1e-10
ROUND_OFF = 1e-13  # of the terms, through all of a sweep


def validate_kernel(kernel: Kernel) -> None:
    """Compare a kernel with Pinocchio: velocities by H v = (μ, π), accelerations by RNEA.

    Raises KernelMismatch with the numbers if they differ by more than 1e-10 relative, and
    InputError if the forces are hardly ever finite.
    """
    rng, judged = np.random.default_rng(0), 0
    for trial in range(_TRIALS):
        # Where a force is not defined everywhere, as a barrier is, smaller states are tried.
        at = random_state(kernel, rng, 0.9 ** max(0, trial - _STATES))
        if at is not None:
            _judge_at(kernel, at)
            judged += 1
        if judged == _STATES:
            return
    raise InputError(
        f"the forces or prescribed joints of '{kernel.system.name}' are not finite at "
        f"{_TRIALS - judged} of {_TRIALS} random states; functions such as sqrt and log have to "
        "be defined around where the motion is"
    )


def _judge_at(kernel: Kernel, at: ReferenceState) -> None:
    """Judge all values of a kernel at a state."""
    out = kernel.evaluate_outputs(at.time, at.y, at.parameters, at.line)
    rate = kernel.evaluate_rate(at.y, at.parameters)
    _judge_momentum(kernel, at, out)
    if kernel.layout.wanted:
        _judge_full_state(kernel, at, out)
    _judge_velocity(kernel, at, rate)
    v = _velocity_in(kernel, at, rate)
    _judge_inverse_dynamics(kernel, at, v)
    torque, wrench = _acting(kernel, at, v)
    _judge_base(kernel, at, rate, v, wrench)
    _judge_acceleration(kernel, at, rate, v, torque, wrench)


def _judge_momentum(kernel: Kernel, at: ReferenceState, out: Array) -> None:
    """Compare velocity, momenta, shape and centre of mass, as seen from the centre of mass."""
    check, where, r = _checker(kernel), kernel.where, kernel.system.r
    driven, v, terms = list(at.driven), out[: kernel.system.n], at.momentum_terms
    check("momentum of the velocity", at.H @ v, at.H @ at.v, terms)
    check("velocity", v, at.v, at.velocity_terms)
    check("centre of mass", out[where.com], at.com, at.reach)
    check("momentum", out[where.mu], at.mu, terms[:r])
    check("prescribed positions", out[where.driven_x], at.x[driven], abs(at.x[driven]))
    momenta = terms[r:][driven]
    check("momenta of prescribed joints", out[where.driven_pi], at.pi[driven], momenta)
    check("shape", out[where.fields["x"]], at.x, abs(at.x))


def _judge_full_state(kernel: Kernel, at: ReferenceState, out: Array) -> None:
    """Compare the full state: configuration, path of the centre of mass, momenta, energy."""
    system, where, check = kernel.system, kernel.where, _checker(kernel)
    model, r, k = system.model, system.r, system.group.linear
    data = system.data
    pose, q, v = out[where.fields["pose"]], out[where.fields["q"]], out[where.fields["v"]]
    check("configuration", q, system.model_q(pose, at.x), abs(q))
    found = system.velocity(system.given_v(v))
    full, v = v, np.concatenate([found.xi, found.xdot])
    check("full velocity", v[k:], at.v[k:], at.velocity_terms[k:])
    check("velocity of all joints", full, system.joint_rates(v), abs(full))
    root, (c0, v0, fall) = model.jointPlacements[1], at.line.reshape(3, k)
    parts = [c0, v0 * at.time, 0.5 * fall * at.time**2]
    speeds = [v0, fall * at.time]
    if at.pushed.size:
        parts, speeds = [*parts, at.pushed[:k]], [*speeds, at.pushed[k:] / system.mass]
    c, velocity = np.sum(parts, axis=0), np.sum(speeds, axis=0)
    far = np.abs(parts).sum() + at.reach
    fast = np.abs(speeds).sum() + at.velocity_terms[:k].sum()
    fast += at.reach * at.velocity_terms[k:r].sum() + at.momentum_terms[:k].sum() / system.mass
    pin.centerOfMass(model, data, q, full)
    along = translations(system).T @ root.rotation.T
    check("place of the centre of mass", along @ (data.com[0] - root.translation), c, far)
    check("its velocity", along @ data.vcom[0], velocity, fast)
    mu = at.H[:r] @ v
    whole = at.velocity_terms.copy()
    whole[:k] += fast
    body = np.abs(at.H[:r]) @ whole
    check("body momentum", out[where.fields["body_momentum"]], mu, body)
    J = system.group.spatial_momentum(pose, mu)
    carried = np.abs(system.group.Ad(system.group.inverse(pose))).T @ body
    check("spatial momentum", out[where.fields["spatial_momentum"]], J, carried)
    height = pin.computePotentialEnergy(model, data, q)
    energy = 0.5 * v @ at.H @ v + height
    weight = system.mass * float(np.abs(system.gravity).sum())
    terms = np.abs(v) @ np.abs(at.H) @ whole + weight * (far + np.abs(root.translation).sum())
    if kernel.forces is not None:
        potential = kernel.forces.potential(at.x, at.numbers)
        energy, terms = energy + potential, terms + abs(potential)
    check("energy", out[-1:], np.array([energy]), terms)


def _judge_velocity(kernel: Kernel, at: ReferenceState, rate: Array) -> None:
    """Compare the rates of the joints and of the attitude."""
    layout, r, check = kernel.layout, kernel.system.r, _checker(kernel)
    active, cyclic, a = list(layout.active), list(layout.cyclic), len(layout.active)
    xdot, terms = at.v[r:], at.velocity_terms[r:]
    check("shape rate", rate[:a], xdot[active], terms[active])
    turned = rate[2 * a : layout.base_at]
    check("rate of cyclic joints", turned, xdot[cyclic], terms[cyclic])
    attitude, *_ = _base_rates(kernel, rate)
    of_twist = _attitude_of_twist(kernel, at)
    turning = abs(of_twist) @ at.velocity_terms[:r]
    check("attitude rate", attitude, of_twist @ at.v[:r], turning)


def _judge_base(kernel: Kernel, at: ReferenceState, rate: Array, v: Array, wrench: Array) -> None:
    """Compare the rates of angular momentum, of gravity's direction and of the centre of mass."""
    system, parts, check = kernel.system, kernel.layout.base, _checker(kernel)
    r, k, H = system.r, system.group.linear, at.H
    omega = v[k:r]
    fast = float(at.velocity_terms[k:r].sum())
    # The moment of all forces about the centre of mass, or about the pivot, by Pinocchio.
    lever = H[:k, k:r] / system.mass  # of F at the base's origin: (H_lin,ang / m)ᵀ F = c × F
    moment = wrench[k:] - lever.T @ wrench[:k]
    terms = np.abs(wrench[k:]) + np.abs(lever).T @ np.abs(wrench[:k])
    if parts.momentum and at.gravity.any():
        moment = moment + _moment_of_gravity(kernel, at)
        terms = terms + system.mass * at.weight * at.reach
    bent = np.cross(at.mu[k:], omega) if parts.momentum == 3 else np.zeros(parts.momentum)
    _, down, momentum, push = _base_rates(kernel, rate)
    if parts.down:
        check("rate of the direction of gravity", down, np.cross(at.down, omega), fast)
    if parts.momentum:
        terms = terms + at.momentum_terms[k:r].sum() * fast
        check("rate of the angular momentum", momentum, bent + moment, terms)
    if parts.push:
        turn = system.group.Ad(at.pose)[:k, :k]
        true = np.append(at.pushed[k:] / system.mass, turn @ wrench[:k])
        terms = np.append(abs(true[:k]), abs(turn) @ abs(wrench[:k]))
        check("rate of the centre of mass", push, true, terms)


def _judge_acceleration(
    kernel: Kernel, at: ReferenceState, rate: Array, v: Array, torque: Array, wrench: Array
) -> None:
    """Compare the accelerations that follow from π̇ with those that follow from RNEA's forces.

    H v̇ = ṗ − Ḣ v, with ṗ = (ad*_ξ μ + f, π̇) and Ḣ = C + Cᵀ; the frame of the centre of mass
    is pushed with it: π̇ in a frame at rest has F·∂c/∂x besides.
    """
    system, layout, model, q, H = kernel.system, kernel.layout, at.model, at.q, at.H
    r, k, data = system.r, system.group.linear, system.data
    active, a = list(layout.active), len(layout.active)
    pidot = np.zeros(system.m)
    pidot[active] = rate[a : 2 * a]
    pidot += H[:k, r:].T @ wrench[:k] / system.mass
    # Far from the world's origin Pinocchio's Coriolis matrix has round-off of the distance.
    near = model.copy()
    near.jointPlacements[1] = pin.SE3.Identity()
    full = system.joint_rates(v)
    C = system.coupled_matrix(
        pin.computeCoriolisMatrix(near, data, system.model_q(system.group.identity(), at.x), full)
    )
    mudot = system.group.coadjoint(v[:r], at.mu) + wrench
    tau = np.concatenate([wrench, torque])
    if layout.base.momentum and at.gravity.any():
        mudot = mudot + _moment_of_gravity(kernel, at)
    fixed = r + np.array(at.driven, dtype=int)
    free = at.free
    inertia, held = H[np.ix_(free, free)], H[np.ix_(free, fixed)] @ at.accelerations
    left = np.concatenate([mudot, pidot]) - (C + C.T) @ v
    found = np.linalg.solve(inertia, left[free] - held)
    # Not by ABA: where a base is light its inverse inertia rounds off what is far larger.
    bias = system.on_shape(pin.nonLinearEffects(model, data, q, full))
    true = np.linalg.solve(inertia, (tau - bias)[free] - held)
    terms = at.force_terms + np.abs(tau) + at.weight_terms
    terms += np.abs(H[:, free]) @ np.abs(true) + np.abs(H[:, fixed]) @ np.abs(at.accelerations)
    _checker(kernel)("acceleration", found, true, at.solved_terms(terms)[free])


def _velocity_in(kernel: Kernel, at: ReferenceState, rate: Array) -> Array:
    """Return the velocity (n,) that a rate has.

    π̇ is judged at the velocity of the same evaluation: round-off in that is not its error.
    The translation, which is no part of the rate, follows from the momentum.
    """
    layout, r, k = kernel.layout, kernel.system.r, kernel.system.group.linear
    a, v = len(layout.active), at.v.copy()
    v[r:][list(layout.active)] = rate[:a]
    v[r:][list(layout.cyclic)] = rate[2 * a : layout.base_at]
    if layout.base.attitude:
        attitude, *_ = _base_rates(kernel, rate)
        v[k:r] = np.linalg.lstsq(_attitude_of_twist(kernel, at)[:, k:], attitude)[0]
    v[:k] = np.linalg.solve(at.H[:k, :k], at.mu[:k] - at.H[:k, k:] @ v[k:])
    return v


def _judge_inverse_dynamics(kernel: Kernel, at: ReferenceState, v: Array) -> None:
    """Compare torques of inverse dynamics with those of Pinocchio's mass matrix and RNEA.

    The base goes as its own rows of H a + bias = (0, τ) have it, with nothing acting on it.
    """
    system, H, r = kernel.system, at.H, kernel.system.r
    if kernel.forces is None:
        return
    full = system.joint_rates(v)
    for wanted, torque in kernel.forces.required(*_seen(at, v)):
        bias = system.on_shape(pin.nonLinearEffects(at.model, system.data, at.q, full))
        base = -np.linalg.solve(H[:r, :r], H[:r, r:] @ wanted + bias[:r])
        a = np.append(base, wanted)
        terms = at.force_terms + at.weight_terms + np.abs(H) @ np.abs(a)
        carried = np.abs(np.linalg.solve(H[:r, :r], H[:r, r:])).T @ terms[:r]
        true = (H @ a + bias)[r:]
        _checker(kernel)("inverse dynamics", torque, true, terms[r:] + carried)


def _acting(kernel: Kernel, at: ReferenceState, v: Array) -> tuple[Array, Array]:
    """Return torques (m,) and the wrench on the base (r,); those on links by Pinocchio."""
    system, forces = kernel.system, kernel.forces
    if forces is None:
        return np.zeros(system.m), np.zeros(system.r)
    acting, loads = forces.acting_apart(*_seen(at, v))
    if not forces.loads:
        return acting.torque, acting.wrench
    root = axes_of(system.model.joints[1])
    on_all = LoadsByPinocchio(system, root, forces.loads).generalised(at.q, loads)
    on_links = system.on_shape(on_all)
    return acting.torque + on_links[system.r :], acting.wrench + on_links[: system.r]


def _seen(at: ReferenceState, v: Array) -> tuple[Any, ...]:
    """Return what forces see of a state, in the order in which a ForceModel takes it."""
    xi, xdot = v[: len(at.mu)], v[len(at.mu) :]
    return at.time, at.x, xdot, xi, at.mu, at.numbers, at.in_space(v)


def _moment_of_gravity(kernel: Kernel, at: ReferenceState) -> Array:
    """Return the moment of the weight about the pivot, (r,), by Pinocchio."""
    weight = pin.computeGeneralizedGravity(at.model, kernel.system.data, at.q)
    return -np.asarray(weight[: kernel.system.r])


def _attitude_of_twist(kernel: Kernel, at: ReferenceState) -> Array:
    """Return the map from body twists to rates of the attitude, (attitude, r)."""
    group, first = kernel.system.group, len(at.pose) - kernel.layout.base.attitude
    return np.transpose([group.rate(at.pose, twist)[first:] for twist in np.eye(group.dim)])


def _base_rates(kernel: Kernel, rate: Array) -> tuple[Array, Array, Array, Array]:
    """Return the rates of attitude, down, momentum and push (see BaseParts)."""
    first, parts = kernel.layout.base_at, kernel.layout.base
    return parts.split(rate[first : first + parts.size])


@contextmanager
def explain_ill_scaling(system: System) -> Iterator[None]:
    """Raise ModelError in the place of a KernelMismatch, if the system is ill-scaled."""
    try:
        yield
    except KernelMismatch as error:
        if words := ill_scaled(system):
            raise ModelError(words) from error
        raise


def _checker(kernel: Kernel) -> partial[None]:
    """Return `require_agreement` for a kernel."""
    return partial(require_agreement, f"the kernel of '{kernel.system.name}'")


def require_agreement(
    who: str,
    what: str,
    found: Array,
    expected: Array,
    terms: Array | float,
    tolerance: float = _TOLERANCE,
) -> None:
    """Raise KernelMismatch, for a kernel called `who`, unless two arrays agree.

    They may differ by `tolerance` times the largest number that is expected, and by the round-off
    of what each is a sum of.  terms: magnitude of that, which may cancel.
    """
    if not expected.size:
        return
    error = np.abs(found - expected)
    allowed = tolerance * float(np.abs(expected).max()) + ROUND_OFF * np.asarray(terms)
    if not (error <= allowed).all():
        k = int(np.argmin(error <= allowed))
        raise KernelMismatch(
            f"{who} disagrees with Pinocchio: {what} is off by {error[k]:.3g} of "
            f"{np.abs(expected).max():.3g}\nfound    {found}\nexpected {expected}"
        )
