"""The phase of a free rigid body: how far it has turned when its body momentum comes back.

In the body's axes the angular momentum runs round a closed curve on a sphere, in the period T of
Jacobi's elliptic functions; then the body has turned about the fixed J by

    Δθ = 2 E T / |J| − Λ   (modulo whole turns),

Λ the oriented solid angle of the curve.  Sources: R. Montgomery, "How much does the rigid body
rotate?", Am. J. Phys. 59 (1991); L. Landau, E. Lifshitz, "Mechanics", §37.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, freeze, vector
from ...common.errors import InputError
from ...lie.rotations import TAU
from ...reduction.at_a_shape import PointwiseReduction
from ...system.system import System, checked_system

_EDGE = 1e-12  # relative; how near to the separatrix, or to a sphere, is there
_NODES = 4096


@dataclass(frozen=True)
class RigidBodyPhase:
    """What one period of a free rigid body does.

    period: of the body momentum [s].  angle: by which the body has then turned about J, in
    [0, 2π) [rad].  solid_angle: oriented, of the curve of the body momentum on its sphere, less
    than a whole one [sr].  dynamic: 2 E T / |J|, so that angle = dynamic − solid_angle modulo 2π.
    axis: (3,) direction of J in the body's frame at the start.  energy: E of the rotation [J].
    momentum: |J| [kg m²/s].
    """

    period: float
    angle: float
    solid_angle: float
    dynamic: float
    axis: Array
    energy: float
    momentum: float

    def __post_init__(self) -> None:
        freeze(self)


def rigid_body_phase(system: System, omega: ArrayLike) -> RigidBodyPhase:
    """Return the phase of a system without joints, free to turn in space.

    omega: (3,) angular velocity at the start, in the body's frame [rad/s].
    Raises InputError for a system with joints or that cannot turn freely in space, for no
    rotation at all, and where there is no period: on the separatrix through the middle axis, and
    of a body that is a sphere to rotations.
    """
    system = checked_system(system, "rigid_body_phase")
    group = system.group
    if group.turns != 3 or group.linear not in (0, 3):
        raise InputError(f"rigid_body_phase takes a body of SO3 or SE3, got {group.name}")
    if system.m:
        raise InputError(f"'{system.name}' has {system.m} joints; freeze them: load(…, lock={{…}})")
    w = vector(omega, 3, "omega")
    I = PointwiseReduction(system).locked_inertia(np.zeros(0))
    turning = I[-3:, -3:]
    if group.linear:  # about the centre of mass
        turning = turning - I[3:, :3] @ np.linalg.solve(I[:3, :3], I[:3, 3:])
    moments, axes = np.linalg.eigh(turning)
    if np.linalg.det(axes) < 0.0:
        axes[:, 1] *= -1.0
    rates = axes.T @ w
    mu = moments * rates
    J, energy = float(np.linalg.norm(mu)), 0.5 * float(mu @ rates)
    if not J > 0.0:
        raise InputError("omega must not be zero: a body at rest has no period")
    period, curve = _curve(moments, J, energy)
    solid = _solid_angle(curve)
    dynamic = 2.0 * energy * period / J
    return RigidBodyPhase(
        period=period,
        angle=float((dynamic - solid) % TAU),
        solid_angle=solid,
        dynamic=dynamic,
        axis=np.asarray(axes @ mu / J),
        energy=energy,
        momentum=J,
    )


def _outer(moments: Array, J: float, energy: float) -> tuple[int, int, int]:
    """Return the axes (i, j, k): the momentum goes round k, and j is the middle one."""
    return (0, 1, 2) if 2.0 * energy * moments[1] <= J**2 else (2, 1, 0)


def _curve(moments: Array, J: float, energy: float) -> tuple[float, Array]:
    """Return the period, and the curve of μ/|J| over it, (N, 3), round +z in the sense of time.

    Its axes are (i, j, k) of `_outer`, made right-handed.
    """
    from scipy.special import ellipj, ellipk

    i, j, k = _outer(moments, J, energy)
    a, b, c = moments[[i, j, k]]
    square, twice = J**2, 2.0 * energy
    apart = (c - b) * (square - twice * a)
    rate = np.sqrt(max(apart / (a * b * c), 0.0))
    scale = twice / b
    if not rate > _EDGE * scale**0.5:
        raise InputError(
            "there is no period: the body turns about its middle axis, or is as a sphere or a "
            "symmetric top whose momentum stays where it is"
        )
    modulus = max((b - a) * (twice * c - square) / apart, 0.0)
    if not modulus < 1.0 - _EDGE:
        raise InputError("there is no period: the motion is on the separatrix of the middle axis")
    period = 4.0 * float(ellipk(modulus)) / float(rate)
    sn, cn, dn, _ = ellipj(rate * period * np.arange(_NODES) / _NODES, modulus)
    # Landau and Lifshitz (37.10): Ω₁ ∝ cn, Ω₂ ∝ sn, Ω₃ ∝ dn, which goes round as time does.
    along_i = np.sqrt(max(a * (twice * c - square) / (c - a), 0.0)) * cn / J
    along_j = np.sqrt(max(b * (twice * c - square) / (c - b), 0.0)) * sn / J
    along_k = np.sqrt(max(c * (square - twice * a) / (c - a), 0.0)) * dn / J
    hand = 1.0 if (i, j, k) == (0, 1, 2) else -1.0
    return period, np.stack([along_i, hand * along_j, along_k], axis=1)


def _solid_angle(curve: Array) -> float:
    """Return the oriented solid angle of a closed curve round +z.

    One round −z is that curve turned by half a turn about x, which changes nothing.
    """
    x, y, z = curve.T
    angle = np.unwrap(np.arctan2(y, x))
    turned = float(np.round((angle[-1] - angle[0]) / TAU))
    slope = _derivative(angle - turned * TAU * np.arange(len(angle)) / len(angle)) + turned
    return float(TAU * np.mean((1.0 - z) * slope))


def _derivative(values: Array) -> Array:
    """Return the derivative of periodic values by the angle round the period, over 1."""
    modes = np.fft.rfft(values)
    modes *= 1j * np.arange(len(modes))
    modes[-1] = 0.0
    return np.asarray(np.fft.irfft(modes, len(values)))
