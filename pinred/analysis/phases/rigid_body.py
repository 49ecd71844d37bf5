"""The phase of a free rigid body: its rotation over one period of the body momentum.

In body axes, the angular momentum traces a closed curve on a sphere, with the period T of Jacobi's
elliptic functions. Over one period the body rotates about the fixed J by

    Δθ = 2 E T / |J| − Λ   (modulo complete rotations),

with the signed solid angle Λ that the curve encloses. Period and solid angle are complete elliptic
integrals. Sources: R. Montgomery, "How much does the
rigid body rotate?", Am. J. Phys. 59 (1991); L. Landau, E. Lifshitz, "Mechanics", §37.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, vector
from ...common.errors import InputError
from ...lie.rotations import TAU
from ...reduction.pointwise_reduction import PointwiseReduction
from ...system.system import System, checked_system

_ROUND_OFF = 4.0 * float(np.finfo(float).eps)  # relative error of the inertia tensor


@checks_arguments
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


@checks_arguments
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
    remedy = "Lock its joints at a closed shape (lock=)."
    system = checked_system(system, "rigid_body_phase", remedy=remedy)
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
    period, solid_angle = _period_and_solid_angle(moments, rates, J)
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


def _period_and_solid_angle(moments: Array, rates: Array, J: float) -> tuple[float, float]:
    """Compute the period [s] and the signed solid angle [sr] of the curve of μ/|J|.

    The curve circles the principal axis k.  The middle axis is j.  Differences of J² and 2E are
    sums over the components, which do not cancel near the axes.

    Args:
        moments: Principal moments of inertia, increasing, (3,) [kg m²].
        rates: Angular velocity along the principal axes, which are right-handed, (3,) [rad/s].
        J: Magnitude of the angular momentum [kg m²/s].
    Returns:
        The period, and the solid angle, positive if the curve circles +k counterclockwise.
    Raises:
        InputError: The motion has no period.
    """
    from scipy.special import ellipkm1, elliprf, elliprj

    squares = moments * rates**2
    gaps = moments - moments[1]
    above = float(squares @ gaps)  # J² − 2 E b, of the middle moment b
    if not abs(above) > _ROUND_OFF * _scale_of_errors(moments, rates):
        raise InputError(
            "there is no period: the motion is on the separatrix of the middle axis, or the "
            "momentum is constant in the body (equal moments of inertia)"
        )
    i, k = (0, 2) if above > 0.0 else (2, 0)
    a, b, c = moments[[i, 1, k]]
    near = float(squares @ (moments - a))  # J² − 2 E a, of the same sign as `above`
    denominator = (c - b) * near
    complement = min((c - a) * above / denominator, 1.0)  # 1 − m
    period = 4.0 * float(ellipkm1(complement)) * np.sqrt(a * b * c / denominator)
    # At azimuth φ from axis i to axis j, cos²θ = (n₀ + g cos²φ)/(d₀ + g cos²φ).  Carlson's
    # integrals yield the mean of cos θ (NIST Digital Library of Mathematical Functions, §19.29).
    n0, n1 = abs(above) / (b * J**2), abs(near) / (a * J**2)
    d0, d1, g = abs(c - b) / (b * c), abs(c - a) / (a * c), abs(b - a) / (a * b)
    p, q = n1 * d0, d1 * n0
    quarter = n0 * (elliprf(0.0, p, q) + g * d0 / 3.0 * elliprj(0.0, p, q, n0 * d0))
    hand = 1.0 if i == 0 else -1.0
    return float(period), hand * (TAU - 4.0 * float(quarter))


def _scale_of_errors(moments: Array, rates: Array) -> float:
    """Return the change of J² − 2 E b per relative error of the inertia tensor.

    An error of the tensor rotates the principal axes by its ratio to the gap of their moments.
    """
    size = float(np.linalg.norm(rates))
    outer = moments[[0, 2]] * np.abs(rates[[0, 2]])
    return float(moments[2] * (outer @ (np.abs(rates[[0, 2]]) + 2.0 * size)))
