"""Every kernel is judged before it runs: at random states, against Pinocchio."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..errors import KernelMismatch
from ..flow import symmetric

if TYPE_CHECKING:
    from .kernel import Kernel

_STATES = 3
_TOLERANCE = 1e-10


def judge(kernel: Kernel) -> None:
    """Compare a kernel with Pinocchio: velocities by H v = (μ, π), accelerations by ABA.

    Raises KernelMismatch with the numbers if they differ by more than 1e-10 relative.
    """
    rng = np.random.default_rng(0)
    for _ in range(_STATES):
        _judge_at(kernel, rng)


def _judge_at(kernel: Kernel, rng: np.random.Generator) -> None:
    system, layout, structure = kernel.system, kernel.layout, kernel.structure
    r, m, linear = system.r, system.m, system.group.linear
    model = system.model.copy()
    root = model.jointPlacements[1].rotation
    # What makes the whole system fall is not in the kernel.
    model.gravity.linear = root @ np.array(structure.gravity or (0.0, 0.0, 0.0))
    data = model.createData()
    pose = system.group.exp(rng.uniform(-1.0, 1.0, r))
    pose = pose if r > linear else system.group.identity()
    x = rng.uniform(-2.0, 2.0, m)
    q = system.q(pose, x)
    H = symmetric(pin.crba(model, data, q))
    com = np.array(data.Ycrb[1].lever)
    # A random velocity whose momentum is of the kind that the kernel knows.
    v = rng.normal(size=system.n)
    mu = H[:r] @ v
    if not layout.spin:
        v[:r] -= np.linalg.solve(H[:r, :r], mu)
        mu = np.zeros(r)
    elif linear:
        v[:linear] -= mu[:linear] / system.mass
        mu = H[:r] @ v
        mu[:linear] = 0.0
    pi = H[r:] @ v
    springs = list(structure.springs)
    stiffness, rest = rng.normal(size=len(springs)), rng.normal(size=len(springs))
    tau = np.zeros(system.n)
    tau[r + np.array(springs, dtype=int)] = -stiffness * (x[springs] - rest)
    attitude = pose[len(pose) - layout.attitude :]
    spin = mu[-layout.spin :] if layout.spin else np.zeros(0)
    if layout.spin == 3:
        spin = system.group.Ad(pose)[linear:, linear:] @ spin
    active, cyclic = list(layout.active), list(layout.cyclic)
    y = np.concatenate([x[active], pi[active], x[cyclic], attitude])
    parameters = np.concatenate([spin, pi[cyclic], stiffness, rest])
    # Round-off of the momenta alone moves velocities by this much.
    slack = max(_TOLERANCE, 10.0 * np.finfo(float).eps * float(np.linalg.cond(H)))
    out = kernel.evaluate_outputs(y, parameters)
    _agree(kernel, "momentum of the velocity", H @ out[: system.n], H @ v)
    _agree(kernel, "velocity", out[: system.n], v, slack)
    _agree(kernel, "centre of mass", out[system.n :], com)
    rate = kernel.evaluate_rate(y, parameters)
    k = len(active)
    _agree(kernel, "shape rate", rate[:k], v[r:][active], slack)
    _agree(kernel, "rate of cyclic joints", rate[2 * k : 2 * k + len(cyclic)], v[r:][cyclic], slack)
    turning = rate[2 * k + len(cyclic) :]
    rates = [system.group.rate(pose, e)[len(pose) - layout.attitude :] for e in np.eye(r)]
    of_twist = np.transpose(rates)  # attitude rate from ξ, (attitude, r)
    _agree(kernel, "attitude rate", turning, of_twist @ v[:r], slack)
    # π̇ is judged at the velocity of the same evaluation: round-off in that is not its error.
    # The translation, which is no part of the rate, follows from the momentum.
    v[r:][active], v[r:][cyclic] = rate[:k], rate[2 * k : 2 * k + len(cyclic)]
    v[linear:r] = np.linalg.lstsq(of_twist[:, linear:], turning)[0]
    v[:linear] = np.linalg.solve(
        H[:linear, :linear], mu[:linear] - H[:linear, linear:] @ v[linear:]
    )
    # H v̇ = ṗ − Ḣ v, with ṗ = (ad*_ξ μ, π̇) and Ḣ = C + Cᵀ.
    pidot = np.zeros(m)
    pidot[active] = rate[k : 2 * k]
    C = pin.computeCoriolisMatrix(model, data, q, v)
    momentum_rate = np.concatenate([system.group.coadjoint(v[:r], mu), pidot])
    found = np.linalg.solve(H, momentum_rate - (C + C.T) @ v)
    _agree(kernel, "acceleration", found, pin.aba(model, data, q, v, tau), slack)


def _agree(
    kernel: Kernel, what: str, found: Array, expected: Array, tolerance: float = _TOLERANCE
) -> None:
    if not expected.size:
        return
    error = float(np.abs(found - expected).max())
    scale = max(float(np.abs(expected).max()), 1e-3)
    if not error <= tolerance * scale:
        raise KernelMismatch(
            f"the kernel of '{kernel.system.name}' disagrees with Pinocchio: {what} is off by "
            f"{error:.3g} of {scale:.3g}\nfound    {found}\nexpected {expected}"
        )
