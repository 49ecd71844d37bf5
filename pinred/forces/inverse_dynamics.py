"""Inverse dynamics as CasADi expressions: torques for given accelerations, also with loops."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np

from ..common.errors import InputError
from ..common.names import listed
from ..reduction.tree.all_joints import joint_values, rate_map, shape_gradient
from ..reduction.tree.loop_constraints import jacobian_function
from ..reduction.tree.momenta import bracket, centre_of_mass, momenta
from ..reduction.tree.scalars import dot, solve_spd
from ..system.loops.loop_assembly import equation_weights
from ..system.system import System
from .force import Symbols
from .force_numbers import RobotSymbols


def required_torque(system: System, robot: RobotSymbols, s: Symbols, accelerations: ca.SX) -> ca.SX:
    """Return the torques that produce requested joint accelerations while the base moves freely.

    The momenta are (μ, π) = H v with v = (ξ, ẋ). The base acceleration follows from μ̇ = ad*_ξ μ,
    and then τ = dπ/dt − e_α T + e_α V − π × σ, where the last term belongs to balls with the
    angular velocity σ. Gravity must have no moment on the base.

    Args:
        system: The robot.
        robot: Symbols of the robot parameters.
        s: Variables of the forces.
        accelerations: Joint accelerations, (m,) [rad/s² | m/s²].
    Returns:
        Torques, (m,) [N·m | N].
    """
    r, gravity = system.r, robot.gravity
    momenta_of = partial(momenta, system, s.x, bodies=robot.bodies)
    v = ca.vertcat(s.xi, s.xdot)
    p = momenta_of(v)
    transport = ca.jtimes(p, s.x, rate_map(system, s.x) @ s.xdot)  # Ḣ v
    mu, eta = p[:r], ca.SX.sym("eta", r)
    coadjoint = ca.gradient(ca.dot(mu, bracket(system.group, s.xi, eta)), eta)  # ad*_ξ μ
    from_accelerations = momenta_of(ca.vertcat(ca.SX(r, 1), accelerations))
    I = ca.jacobian(mu, s.xi)
    xidot = solve_spd(I, coadjoint - transport[:r] - from_accelerations[:r])
    pidot = momenta_of(ca.vertcat(xidot, accelerations))[r:] + transport[r:]
    torque = pidot - shape_gradient(system, 0.5 * ca.dot(v, p), s.x)
    for ball in system.space.balls:
        sigma, pi = s.xdot[ball.v], p[r:][ball.v]
        torque[ball.v] -= ca.cross(pi, sigma)
    if not system.group.is_pivot:  # a pivot is at the centre of mass, so gravity has no potential
        com = centre_of_mass(robot.bodies, joint_values(system, ca.vertsplit(s.x)))
        work = robot.mass * dot(gravity, com)
        torque -= shape_gradient(system, ca.SX(work), s.x)
    return torque


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
