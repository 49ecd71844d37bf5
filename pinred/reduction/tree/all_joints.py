"""Map shape coordinates to tree joints, x = G y + b, and momenta of the joints back.

The tree has more joints than the shape if some joints follow others (see coupling.py).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from ...system.system import System
from .scalars import Scalar, add, mul


def joint_values(system: System, x: Sequence[Scalar]) -> list[Scalar]:
    """Return the coordinates of all joints at shape x (nx,)."""
    coupled = system.coupled
    if coupled is None:
        return list(x)
    return [
        add(_sum(coupled.value_terms(j), x), offset)
        for j, offset in enumerate(coupled.offset.tolist())
    ]


def joint_rates(system: System, xdot: Sequence[Scalar]) -> list[Scalar]:
    """Return the rates of all joints at shape rate ẋ (m,)."""
    coupled = system.coupled
    if coupled is None:
        return list(xdot)
    return [_sum(coupled.terms(j), xdot) for j in range(len(coupled.G))]


def configuration(system: System, pose: Sequence[Scalar], x: Sequence[Scalar]) -> list[Scalar]:
    """Return Pinocchio's configuration, (nq,), at a pose and a shape x, (nx,)."""
    y, q = [*pose, *joint_values(system, x)], [0.0] * system.model.nq
    for i, at in system.plain:
        q[at] = y[i]
    for i, at in system.angles:
        q[at], q[at + 1] = ca.cos(y[i]), ca.sin(y[i])
    return q


def on_shape(system: System, momenta: Sequence[Scalar]) -> list[Scalar]:
    """Map momenta or forces p of all joints to shape momenta or forces Gᵀ p, (m,)."""
    coupled = system.coupled
    if coupled is None:
        return list(momenta)
    sums: list[Scalar] = [0.0] * system.m
    for j, value in enumerate(momenta):
        for k, ratio in coupled.terms(j):
            sums[k] = add(sums[k], mul(ratio, value))
    return sums


def shape_gradient(system: System, energy: ca.SX, x: ca.SX) -> ca.SX:
    """Return the derivatives e_αV, (m,), of an energy along the frame of the shape.

    The derivative along a ball's axes is E(q)ᵀ ∂V/∂q.  It is exact for every V, because E(q) is
    tangent to the sphere |q| = 1.

    Args:
        system: The system.
        energy: Energy V, an expression of x.
        x: Shape symbols, (nx,).
    Returns:
        The derivatives.
    """
    gradient = ca.gradient(energy, x)
    if not system.space.balls:
        return gradient
    entries: list[ca.SX] = []
    for joint in system.space.joints:
        slope = gradient[joint.x]
        entries.append(_along_axes(x[joint.x], slope) if joint.kind.is_ball else slope)
    column: ca.SX = ca.vertcat(*entries)
    return column


def rate_map(system: System, x: ca.SX) -> ca.SX:
    """Return E(x), (nx, m), which maps rates along the frame of the shape to derivatives of x."""
    space = system.space
    E = ca.SX(space.nx, space.m)
    for joint in space.joints:
        E[joint.x, joint.v] = _ball_rate_map(x[joint.x]) if joint.kind.is_ball else 1.0
    return E


def frame_jacobian(system: System, values: ca.SX, x: ca.SX) -> ca.SX:
    """Return the derivatives e_α, (k, m), of values (k,) along the frame of the shape."""
    jacobian: ca.SX = ca.jacobian(values, x)
    return jacobian @ rate_map(system, x) if system.space.balls else jacobian


def _ball_rate_map(q: ca.SX) -> ca.SX:
    """Return E, (4, 3), with q̇ = ½ q ∘ (σ, 0) = E σ."""
    matrix = ca.skew(q[:3]) + q[3] * ca.SX.eye(3)
    E: ca.SX = 0.5 * ca.vertcat(matrix, -q[:3].T)
    return E


def _along_axes(q: ca.SX, slope: ca.SX) -> ca.SX:
    """Return ½ Im(q̄ ∘ slope), (3,): the derivatives of a function of q along the child's axes."""
    u, w, v, s = q[:3], q[3], slope[:3], slope[3]
    column: ca.SX = 0.5 * (w * v - s * u - ca.cross(u, v))
    return column


def _sum(terms: list[tuple[int, float]], numbers: Sequence[Scalar]) -> Scalar:
    """Return the sum of ratios times numbers of the shape."""
    total: Scalar = 0.0
    for k, ratio in terms:
        total = add(total, mul(ratio, numbers[k]))
    return total
