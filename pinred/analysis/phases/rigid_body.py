"""The phase of a free rigid body: its rotation over one period of the body momentum.

In body axes, the angular momentum traces a closed curve on a sphere, with the period T of Jacobi's
elliptic functions. Over one period the body rotates about the fixed J by

    Δθ = 2 E T / |J| − Λ   (modulo complete rotations),

with the signed solid angle Λ that the curve encloses. Sources: R. Montgomery, "How much does the
rigid body rotate?", Am. J. Phys. 59 (1991); L. Landau, E. Lifshitz, "Mechanics", §37.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, FrozenArrays, vector
from ...common.errors import InputError
from ...lie.rotations import TAU
from ...reduction.pointwise_reduction import PointwiseReduction
from ...system.system import System, checked_system

_EDGE = 1e-12  # relative distance below which a motion counts as on the separatrix
_NODES = 4096  # number of samples of the momentum curve


@dataclass(frozen=True)
class RigidBodyPhase(FrozenArrays):
    """The motion of a free rigid body over one period of its body momentum.

    Attributes:
        period: Period T [s].
        angle: Rotation about J after one period, in [0, 2π) [rad].
        solid_angle: Signed solid angle Λ that the momentum curve encloses, below 4π [sr].
        dynamic: Dynamic phase 2 E T / |J| [rad]; angle = dynamic − solid_angle modulo 2π.
        axis: Direction of J in the initial body frame, (3,).
        energy: Rotational energy E [J].
        momentum: Magnitude |J| of the angular momentum [kg m²/s].
    """

    period: float
    angle: float
    solid_angle: float
    dynamic: float
    axis: Array
    energy: float
    momentum: float


def rigid_body_phase(system: System, omega: ArrayLike) -> RigidBodyPhase:
    """Compute the phase of a free rigid body.

    Args:
        system: System of group SO3 or SE3 without joints.
        omega: Initial angular velocity in the body frame, (3,) [rad/s].
    Returns:
        Period, rotation angle and solid angle.
    Raises:
        InputError: The system has joints or another group, omega is zero, or there is no period:
            on the separatrix of the middle axis, or for a body with equal moments.
    """
    system = checked_system(system, "rigid_body_phase")
    group = system.group
    if group.turns != 3 or group.linear not in (0, 3):
        raise InputError(f"system: expected a body of SO3 or SE3, got {group.name}")
    if system.m:
        raise InputError(f"'{system.name}' has {system.m} joints. Lock them: load(…, lock={{…}})")
    w = vector(omega, 3, "omega")
    I = PointwiseReduction(system).locked_inertia(np.zeros(0))
    inertia_about_com = I[-3:, -3:]
    if group.linear:  # about the centre of mass
        inertia_about_com = inertia_about_com - I[3:, :3] @ np.linalg.solve(I[:3, :3], I[:3, 3:])
    moments, axes = np.linalg.eigh(inertia_about_com)
    if np.linalg.det(axes) < 0.0:
        axes[:, 1] *= -1.0
    rates = axes.T @ w
    mu = moments * rates
    J, energy = float(np.linalg.norm(mu)), 0.5 * float(mu @ rates)
    if not J > 0.0:
        raise InputError("omega: expected a non-zero vector; a body at rest has no period")
    period, curve = _curve(moments, J, energy)
    solid_angle = _solid_angle(curve)
    dynamic = 2.0 * energy * period / J
    return RigidBodyPhase(
        period=period,
        angle=float((dynamic - solid_angle) % TAU),
        solid_angle=solid_angle,
        dynamic=dynamic,
        axis=np.asarray(axes @ mu / J),
        energy=energy,
        momentum=J,
    )


def _outer(moments: Array, J: float, energy: float) -> tuple[int, int, int]:
    """Return principal axes (i, j, k): the momentum circles axis k; j is the middle axis."""
    return (0, 1, 2) if 2.0 * energy * moments[1] <= J**2 else (2, 1, 0)


def _curve(moments: Array, J: float, energy: float) -> tuple[float, Array]:
    """Compute the period and the curve of μ/|J| over one period.

    The axes are (i, j, k) of `_outer`, made right-handed. The curve circles +z as time increases.

    Returns:
        The period [s], and the curve, (N, 3).
    Raises:
        InputError: The motion has no period.
    """
    from scipy.special import ellipj, ellipk

    i, j, k = _outer(moments, J, energy)
    a, b, c = moments[[i, j, k]]
    square, twice = J**2, 2.0 * energy
    denominator = (c - b) * (square - twice * a)
    rate = np.sqrt(max(denominator / (a * b * c), 0.0))
    scale = twice / b
    if not rate > _EDGE * scale**0.5:
        raise InputError(
            "there is no period: the body rotates about its middle axis, or its momentum is "
            "constant in the body (equal moments of inertia)"
        )
    modulus = max((b - a) * (twice * c - square) / denominator, 0.0)
    if not modulus < 1.0 - _EDGE:
        raise InputError("there is no period: the motion is on the separatrix of the middle axis")
    period = 4.0 * float(ellipk(modulus)) / float(rate)
    sn, cn, dn, _ = ellipj(rate * period * np.arange(_NODES) / _NODES, modulus)
    # Landau and Lifshitz (37.10): Ω₁ ∝ cn, Ω₂ ∝ sn, Ω₃ ∝ dn, in the direction of time.
    along_i = np.sqrt(max(a * (twice * c - square) / (c - a), 0.0)) * cn / J
    along_j = np.sqrt(max(b * (twice * c - square) / (c - b), 0.0)) * sn / J
    along_k = np.sqrt(max(c * (square - twice * a) / (c - a), 0.0)) * dn / J
    hand = 1.0 if (i, j, k) == (0, 1, 2) else -1.0
    return period, np.stack([along_i, hand * along_j, along_k], axis=1)


def _solid_angle(curve: Array) -> float:
    """Compute the signed solid angle of a closed curve on the sphere, counterclockwise about +z."""
    x, y, z = curve.T
    angle = np.unwrap(np.arctan2(y, x))
    windings = float(np.round((angle[-1] - angle[0]) / TAU))
    slope = _derivative(angle - windings * TAU * np.arange(len(angle)) / len(angle)) + windings
    return float(TAU * np.mean((1.0 - z) * slope))


def _derivative(values: Array) -> Array:
    """Differentiate periodic samples with respect to the phase angle in [0, 2π)."""
    modes = np.fft.rfft(values)
    modes *= 1j * np.arange(len(modes))
    modes[-1] = 0.0
    return np.asarray(np.fft.irfft(modes, len(values)))
