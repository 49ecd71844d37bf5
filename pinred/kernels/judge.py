"""Every kernel is judged before it runs: at random states, against Pinocchio."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError, KernelMismatch
from ..reduction.inertia_split import symmetric
from ..reduction.potential import falling, translations

if TYPE_CHECKING:
    from ..forces.model import ForceModel
    from .kernel import Kernel

_STATES = 3
_TRIALS = 80
_TOLERANCE = 1e-10


def judge(kernel: Kernel) -> None:
    """Compare a kernel with Pinocchio: velocities by H v = (μ, π), accelerations by ABA.

    Raises KernelMismatch with the numbers if they differ by more than 1e-10 relative, and
    InputError if the forces are hardly ever finite.
    """
    rng, judged = np.random.default_rng(0), 0
    for trial in range(_TRIALS):
        # Where a force is not defined everywhere, as a barrier is, smaller states are tried.
        judged += _judge_at(kernel, rng, 0.9 ** max(0, trial - _STATES))
        if judged == _STATES:
            return
    raise InputError(
        f"the forces or prescribed joints of '{kernel.system.name}' are not finite at "
        f"{_TRIALS - judged} of {_TRIALS} random states; functions such as sqrt and log have to "
        "be defined around where the motion is"
    )


def _judge_at(kernel: Kernel, rng: np.random.Generator, reach: float) -> bool:
    """Judge at a random state of a size; return whether the forces are defined there."""
    system, layout, forces = kernel.system, kernel.layout, kernel.forces
    r, m, k = system.r, system.m, system.group.linear
    group, parts = system.group, layout.base
    model = system.model.copy()
    root = model.jointPlacements[1].rotation
    # What makes the whole system fall is not in the kernel.
    weight = np.array(kernel.structure.gravity or (0.0, 0.0, 0.0))
    model.gravity.linear = root @ weight
    data = model.createData()
    pose = group.exp(rng.uniform(-1.0, 1.0, r))
    pose = pose if r > k else group.identity()
    x, v = rng.uniform(-2.0, 2.0, m), rng.normal(size=system.n)
    time = float(rng.uniform(*_span(forces)))
    driven = list(layout.prescribed)
    numbers, accelerations = rng.normal(size=layout.numbers), np.zeros(len(driven))
    x, v = x * reach, v * reach
    if forces is not None:
        numbers[forces.within] = time  # far beyond its piece a table means nothing
    if forces is not None and driven:
        given = forces.prescribed(time, numbers)
        x[driven], v[[r + j for j in driven]], accelerations = given.x, given.xdot, given.xddot
        if not np.isfinite([given.x, given.xdot, given.xddot]).all():
            return False
    q = system.q(pose, x)
    H = symmetric(pin.crba(model, data, q))
    com = np.array(data.Ycrb[1].lever)
    # A random velocity whose momentum is of the kind that the kernel knows.
    mu = H[:r] @ v
    if not (parts.spin or parts.momentum):
        v[:r] -= np.linalg.solve(H[:r, :r], mu)
        mu = np.zeros(r)
    elif k:
        v[:k] -= mu[:k] / system.mass
        mu = H[:r] @ v
        mu[:k] = 0.0
    pi = H[r:] @ v
    # A base with heavy arms in a fixed direction of gravity, or with its direction alone.
    turn = group.Ad(pose)[k:, k:]
    down = turn.T @ weight / np.linalg.norm(weight) if parts.down else np.zeros(0)
    spin = turn @ mu[k:] if parts.spin else np.zeros(0)
    pushed = rng.normal(size=parts.push)
    b = np.concatenate([pose[len(pose) - parts.attitude :], down, mu[r - parts.momentum :], pushed])
    active, cyclic = list(layout.active), list(layout.cyclic)
    y = np.concatenate([x[active], pi[active], x[cyclic], b, [time] * layout.clock])
    parameters = np.concatenate([spin, pi[cyclic], numbers])
    slack = slack_of(H)
    if forces is not None:
        acting = forces.acting(time, x, v[r:], v[:r], mu, numbers)
        potential = np.array([forces.potential(x, numbers)])
        if not np.isfinite(np.concatenate([acting.torque, acting.wrench, potential])).all():
            return False
    line, where = np.append(rng.normal(size=2 * k), falling(system)), kernel.where
    out = kernel.evaluate_outputs(time, y, parameters, line)
    # Round-off is that of the terms, which cancel where the linear momentum is zero.
    _agree(kernel, "momentum of the velocity", H @ out[: system.n], H @ v, size=abs(H) @ abs(v))
    _agree(kernel, "velocity", out[: system.n], v, slack)
    _agree(kernel, "centre of mass", out[where.com], com)
    _agree(kernel, "momentum", out[where.mu], mu)
    _agree(kernel, "prescribed positions", out[where.driven_x], x[driven])
    _agree(kernel, "momenta of prescribed joints", out[where.driven_pi], pi[driven], slack)
    _agree(kernel, "shape", out[where.x], x)
    if layout.wanted:
        _judge_states(kernel, out, H, x, time, line, pushed, numbers, slack)
    rate = kernel.evaluate_rate(y, parameters)
    a = len(active)
    _agree(kernel, "shape rate", rate[:a], v[r:][active], slack)
    _agree(kernel, "rate of cyclic joints", rate[2 * a : layout.base_at], v[r:][cyclic], slack)
    found = np.split(
        rate[layout.base_at :], np.cumsum([parts.attitude, parts.down, parts.momentum, parts.push])
    )
    rates = [group.rate(pose, e)[len(pose) - parts.attitude :] for e in np.eye(r)]
    of_twist = np.transpose(rates)  # attitude rate from ξ, (attitude, r)
    _agree(kernel, "attitude rate", found[0], of_twist @ v[:r], slack)
    # π̇ is judged at the velocity of the same evaluation: round-off in that is not its error.
    # The translation, which is no part of the rate, follows from the momentum.
    v[r:][active], v[r:][cyclic] = rate[:a], rate[2 * a : layout.base_at]
    if parts.attitude:
        v[k:r] = np.linalg.lstsq(of_twist[:, k:], found[0])[0]
    v[:k] = np.linalg.solve(H[:k, :k], mu[:k] - H[:k, k:] @ v[k:])
    torque, wrench = np.zeros(m), np.zeros(r)
    if forces is not None:
        acting = forces.acting(time, x, v[r:], v[:r], mu, numbers)
        torque, wrench = acting.torque, acting.wrench
    omega = v[k:r]
    # The moment of all forces about the centre of mass, or about the pivot, by Pinocchio.
    lever = H[:k, k:r] / system.mass  # of F at the base's origin: (H_lin,ang / m)ᵀ F = c × F
    moment = wrench[k:] - lever.T @ wrench[:k]
    if parts.momentum and weight.any():
        moment = moment - pin.computeGeneralizedGravity(model, data, q)[:r]
    bent = np.cross(mu[k:], omega) if parts.momentum == 3 else np.zeros(parts.momentum)
    if parts.down:
        _agree(kernel, "rate of the direction of gravity", found[1], np.cross(down, omega), slack)
    if parts.momentum:
        _agree(kernel, "rate of the angular momentum", found[2], bent + moment, slack)
    if parts.push:
        push = np.append(pushed[k:] / system.mass, group.Ad(pose)[:k, :k] @ wrench[:k])
        _agree(kernel, "rate of the centre of mass", found[3], push, slack)
    # H v̇ = ṗ − Ḣ v, with ṗ = (ad*_ξ μ + f, π̇) and Ḣ = C + Cᵀ; the frame of the centre of
    # mass is pushed with it: π̇ in a frame at rest has F·∂c/∂x besides.
    pidot = np.zeros(m)
    pidot[active] = rate[a : 2 * a]
    pidot[active] += (H[:k, r:].T @ wrench[:k] / system.mass)[active]
    C = pin.computeCoriolisMatrix(model, data, q, v)
    turning = np.zeros(r)
    if parts.momentum and weight.any():
        turning = -pin.computeGeneralizedGravity(model, data, q)[:r]
    momentum_rate = np.concatenate([group.coadjoint(v[:r], mu) + wrench + turning, pidot])
    tau = np.concatenate([wrench, torque])
    fixed = r + np.array(driven, dtype=int)
    free = np.setdiff1d(np.arange(system.n), fixed)
    held = H[np.ix_(free, fixed)] @ accelerations
    solved = np.linalg.solve(H[np.ix_(free, free)], (momentum_rate - (C + C.T) @ v)[free] - held)
    if driven:
        bias = pin.nonLinearEffects(model, data, q, v)
        true = np.linalg.solve(H[np.ix_(free, free)], (tau - bias)[free] - held)
    else:
        true = pin.aba(model, data, q, v, tau)
    _agree(kernel, "acceleration", solved, true, slack)
    return True


def _judge_states(
    kernel: Kernel,
    out: Array,
    H: Array,
    x: Array,
    time: float,
    line: Array,
    pushed: Array,
    numbers: Array,
    slack: float,
) -> None:
    """Compare the full state with Pinocchio: place of the centre of mass, momenta, energy."""
    system, where = kernel.system, kernel.where
    model, r, k = system.model, system.r, system.group.linear
    data = model.createData()
    pose, q, v = out[where.pose], out[where.q], out[where.v]
    _agree(kernel, "configuration", q, system.q(pose, x))
    root, (c0, v0, fall) = model.jointPlacements[1], line.reshape(3, k)
    c, velocity = c0 + v0 * time + 0.5 * fall * time**2, v0 + fall * time
    if pushed.size:
        c, velocity = c + pushed[:k], velocity + pushed[k:] / system.mass
    pin.centerOfMass(model, data, q, v)
    along = translations(system).T @ root.rotation.T
    _agree(kernel, "place of the centre of mass", along @ (data.com[0] - root.translation), c)
    _agree(kernel, "its velocity", along @ data.vcom[0], velocity, slack)
    mu = H[:r] @ v
    _agree(kernel, "body momentum", out[where.body_momentum], mu, slack)
    J = system.group.spatial_momentum(pose, mu)
    _agree(kernel, "spatial momentum", out[where.spatial_momentum], J, slack)
    energy = 0.5 * v @ H @ v + pin.computePotentialEnergy(model, data, q)
    if kernel.forces is not None:
        energy += kernel.forces.potential(x, numbers)
    _agree(kernel, "energy", out[-1:], np.array([energy]), slack)


def _span(forces: ForceModel | None) -> tuple[float, float]:
    """Return a span of time on which every function of time in the forces is defined."""
    signals = () if forces is None else (*forces.signals, *forces.references)
    first = max([0.0, *(signal.span[0] for signal in signals)])
    return first, min([1.0, *(signal.span[1] for signal in signals)])


def agree(
    who: str,
    what: str,
    found: Array,
    expected: Array,
    tolerance: float = _TOLERANCE,
    size: Array | None = None,
) -> None:
    """Raise KernelMismatch, for a kernel called `who`, unless two arrays agree, relatively.

    size: of the terms that made up the expected ones, where these may cancel.
    """
    if not expected.size:
        return
    error = float(np.abs(found - expected).max())
    scale = max(float(np.abs(expected if size is None else size).max()), 1e-3)
    if not error <= tolerance * scale:
        raise KernelMismatch(
            f"{who} disagrees with Pinocchio: {what} is off by "
            f"{error:.3g} of {scale:.3g}\nfound    {found}\nexpected {expected}"
        )


def slack_of(H: Array) -> float:
    """Return how far velocities may be off: round-off of the momenta alone moves them so."""
    return max(_TOLERANCE, 10.0 * np.finfo(float).eps * float(np.linalg.cond(H)))


def _agree(
    kernel: Kernel,
    what: str,
    found: Array,
    expected: Array,
    tolerance: float = _TOLERANCE,
    size: Array | None = None,
) -> None:
    agree(f"the kernel of '{kernel.system.name}'", what, found, expected, tolerance, size)
