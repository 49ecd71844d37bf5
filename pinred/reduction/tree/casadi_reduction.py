"""CasADi expressions of the mass matrix, split along the symmetry."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ...system.system import System
from .all_joints import frame_jacobian
from .momenta import bracket, momenta
from .scalars import solve_spd


@dataclass(frozen=True)
class CasadiReduction:
    """CasADi expressions of the terms of the reduction.

    They hold where the quaternions of balls have length one.

    Attributes:
        x: Shape symbols, (nx, 1).
        H: Mass matrix, (n, n).
        I: Locked inertia, (r, r).
        A: Local connection, (r, m).
        M: Reduced metric, (m, m).
        B: Curvature, (r, m²); column α m + β is B_αβ.
    """

    x: ca.SX
    H: ca.SX
    I: ca.SX
    A: ca.SX
    M: ca.SX
    B: ca.SX


def casadi_reduction(system: System, x: ca.SX | None = None) -> CasadiReduction:
    """Return the expressions of a system at shape symbols x (nx, 1); None: new symbols."""
    r = system.r
    x, v = ca.SX.sym("x", system.nx) if x is None else x, ca.SX.sym("v", system.n)
    H = ca.jacobian(momenta(system, x, v), v)
    I, Hbs, Hss = H[:r, :r], H[:r, r:], H[r:, r:]
    A = solve_spd(I, Hbs)
    return CasadiReduction(x, H, I, A, Hss - Hbs.T @ A, _curvature(system, x, A))


def _curvature(system: System, x: ca.SX, A: ca.SX) -> ca.SX:
    """Return the curvature; see reduction/pointwise_reduction.py."""
    r, m = system.r, system.m
    if not m:
        return ca.SX(r, 0)
    dA = [frame_jacobian(system, A[:, b], x) for b in range(m)]  # dA[β][:, α] = ∂_α A_β
    columns = [
        dA[b][:, a] - dA[a][:, b] - bracket(system.group, A[:, a], A[:, b])
        for a in range(m)
        for b in range(m)
    ]
    B: ca.SX = ca.horzcat(*columns)
    if not system.space.balls:
        return B
    # Column α m + β of c is c^γ_αβ, γ first.
    return B - A @ ca.SX(ca.DM(system.space.structure.reshape(m, m * m)))
