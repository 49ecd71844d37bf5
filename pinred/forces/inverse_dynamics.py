"""Inverse dynamics on the reduced system, as expressions: torques for wanted accelerations."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from ..common.errors import SymmetryError
from ..reduction.potential import pivot_weight, shape_gravity
from ..reduction.tree.all_joints import joint_values
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.momenta import bracket, centre_of_mass, momenta
from ..system.system import System
from .force import Symbols


def required_torque(system: System, s: Symbols, accelerations: Mapping[int, ca.SX]) -> ca.SX:
    """Return the torques (m,) that give the joints these accelerations, with a free base.

    With p = H v, the base follows from μ̇ = ad*_ξ μ, and then τ = d/dt π − ∂T/∂x + ∂V/∂x.
    accelerations: of every joint.  Raises SymmetryError for a pivoted base that gravity turns.
    """
    if pivot_weight(system).any():
        raise SymmetryError(
            f"gravity turns the base of '{system.name}', so that its accelerations do not follow "
            "from shape and momentum alone; use PD control, or gravity=(0, 0, 0)"
        )
    r, m = system.r, system.m
    a = ca.vertcat(*(accelerations[k] for k in range(m)))
    v = ca.vertcat(s.xi, s.xdot)
    p = momenta(system, s.x, v)
    transport = ca.jtimes(p, s.x, s.xdot)  # Ḣ v
    mu, eta = p[:r], ca.SX.sym("eta", r)
    turned = ca.gradient(ca.dot(mu, bracket(system.group, s.xi, eta)), eta)  # ad*_ξ μ
    pushed = momenta(system, s.x, ca.vertcat(ca.SX(r, 1), a))
    I = ca.jacobian(mu, s.xi)
    xidot = ca.solve(I, turned - transport[:r] - pushed[:r])
    pidot = momenta(system, s.x, ca.vertcat(xidot, a))[r:] + transport[r:]
    torque = pidot - ca.gradient(0.5 * ca.dot(v, p), s.x)
    g = shape_gravity(system).direction
    if g is not None:
        com = centre_of_mass(bodies_of(system), joint_values(system, ca.vertsplit(s.x)))
        fall = sum(system.mass * float(w) * c for w, c in zip(g, com, strict=True))
        torque -= ca.gradient(ca.SX(fall), s.x)
    return torque
