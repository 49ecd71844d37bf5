"""Motions of robots with closed loops in independent joints, as CasADi expressions of forces."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from ..common.errors import InputError
from ..common.names import listed
from ..reduction.tree.all_joints import rate_map
from ..reduction.tree.loop_constraints import jacobian_function
from ..system.loops.loop_assembly import equation_weights
from ..system.system import System
from .force import Symbols


def loop_motion(system: System, s: Symbols, independent: Sequence[int]) -> tuple[ca.SX, ca.SX]:
    """Return G and d with ẋ = G u̇ and ẍ = G ü + d for the rates u̇ of independent joints.

    J ẋ = 0 determines the rates of the dependent joints D, −J_D⁻¹ J_I u̇.  J ẍ + J̇ ẋ = 0
    determines their drift, d_D = −J_D⁻¹ J̇ ẋ.

    Args:
        system: The robot, with loops.
        s: Variables of the forces.
        independent: Indices of the independent rates, as many as `shape_dim`.
    Returns:
        G, (m, k), and d, (m,).
    Raises:
        InputError: The number of independent joints is wrong.
    """
    assert system.closure is not None
    if len(independent) != system.shape_dim:
        names = listed([loop.name for loop in system.loops], 6)
        raise InputError(
            f"computed torque: expected references and plans for {system.shape_dim} joints, which "
            f"determine the others by the loops {names}, got {len(independent)}"
        )
    dependent = np.setdiff1d(np.arange(system.m), independent).tolist()
    rate = ca.SX.sym("rate", system.m)
    J = jacobian_function(system)(s.x)
    turning = ca.jtimes(J @ rate, s.x, rate_map(system, s.x) @ s.xdot)
    turning = ca.substitute(turning, rate, s.xdot)
    G, drift = ca.SX(system.m, len(independent)), ca.SX(system.m, 1)
    G[list(independent), :] = ca.SX.eye(len(independent))
    # The QR factorisation of ca.solve loses digits where equations have different units.
    units = equation_weights(system, system.closure.length)[system.closure.rows]
    scaled = ca.diag(ca.DM(units)) @ ca.horzcat(J, turning)
    solved = ca.solve(scaled[:, dependent], scaled[:, [*independent, system.m]])
    G[dependent, :], drift[dependent] = -solved[:, :-1], -solved[:, -1]
    return G, drift
