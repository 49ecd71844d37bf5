"""Inverse dynamics on the reduced system, as expressions: torques for wanted accelerations."""

from __future__ import annotations

from functools import partial

import casadi as ca

from ..reduction.tree.all_joints import joint_values
from ..reduction.tree.momenta import bracket, centre_of_mass, momenta
from ..reduction.tree.scalars import dot
from ..system.system import System
from .force import Symbols
from .robot_symbols import RobotSymbols


def required_torque(system: System, robot: RobotSymbols, s: Symbols, accelerations: ca.SX) -> ca.SX:
    """Return the torques (m,) that give the joints these accelerations, with a free base.

    With p = H v, the base follows from μ̇ = ad*_ξ μ, and then τ = d/dt π − ∂T/∂x + ∂V/∂x.
    It has to be one that gravity does not turn.  accelerations: (m,).
    """
    r, gravity = system.r, robot.gravity
    momenta_of = partial(momenta, system, s.x, bodies=robot.bodies)
    v = ca.vertcat(s.xi, s.xdot)
    p = momenta_of(v)
    transport = ca.jtimes(p, s.x, s.xdot)  # Ḣ v
    mu, eta = p[:r], ca.SX.sym("eta", r)
    turned = ca.gradient(ca.dot(mu, bracket(system.group, s.xi, eta)), eta)  # ad*_ξ μ
    pushed = momenta_of(ca.vertcat(ca.SX(r, 1), accelerations))
    I = ca.jacobian(mu, s.xi)
    xidot = ca.solve(I, turned - transport[:r] - pushed[:r])
    pidot = momenta_of(ca.vertcat(xidot, accelerations))[r:] + transport[r:]
    torque = pidot - ca.gradient(0.5 * ca.dot(v, p), s.x)
    if not system.group.is_pivot:  # that turns about its centre of mass
        com = centre_of_mass(robot.bodies, joint_values(system, ca.vertsplit(s.x)))
        fall = robot.mass * dot(gravity, com)
        torque -= ca.gradient(ca.SX(fall), s.x)
    return torque
