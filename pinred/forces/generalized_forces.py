"""Generalised forces as CasADi expressions: those of wrenches on links, and of inverse dynamics.

Wrenches on links become torques on the joints and a wrench on the base.  A force F at a point p of
a link and a moment N on it have the power F · v_p + N · ω. This power is linear in the body twist ξ
and the shape rate ẋ:

    F · v_p + N · ω = f · ξ + τ · ẋ.

The derivatives of the power are therefore the wrench f on the base and the torques τ on the joints.
Follower joints contribute through the joints they follow.

Inverse dynamics computes the torques for given accelerations, also with closed loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np

from ..common.errors import InputError
from ..common.names import listed
from ..reduction.tree.all_joints import joint_rates, joint_values, rate_map, shape_gradient
from ..reduction.tree.articulated_sweep import step_of
from ..reduction.tree.body_frames import bodies_of, moved_twist
from ..reduction.tree.loop_constraints import jacobian_function
from ..reduction.tree.momenta import bracket, centre_of_mass, momenta
from ..reduction.tree.scalars import (
    Rotation,
    Scalar,
    Turn,
    Vec,
    add,
    cross,
    dot,
    mul,
    plus,
    solve_spd,
)
from ..system.assembly import link_frame
from ..system.force_interface import Load
from ..system.loops.loop_assembly import equation_weights
from ..system.system import System
from .force import Symbols
from .force_numbers import RobotSymbols


def of_load(
    system: System, robot: RobotSymbols, s: Symbols, load: Load, what: str
) -> tuple[ca.SX, ca.SX]:
    """Express a load by torques and a wrench on the base.

    Args:
        system: The robot.
        robot: Symbols of the robot parameters.
        s: Variables of the forces.
        load: Wrench on a link, or along fixed axes.
        what: Name of the force in messages.
    Returns:
        Torques on the shape, (m,), and wrench on the base, (r,).
    """
    if load.link is None:
        column = ca.vertcat(*_base_wrench(system, s, load.entries))
        return ca.SX(system.m, 1), ca.SX(column)
    index = link_frame(system, load.link, what)
    r, m = system.r, system.m
    xi, xdot = ca.SX.sym("xi", r), ca.SX.sym("xdot", m)
    force, moment = load.entries[:3], load.entries[3:]
    if load.frame == "world":
        force, moment = (_into_root(system, s.seen.pose, velocity) for velocity in (force, moment))
    bodies = robot.bodies
    joints = joint_values(system, ca.vertsplit(s.x) if m else [])
    rates = joint_rates(system, ca.vertsplit(xdot) if m else [])
    chain, i = [], system.sorted_model.frames[index].parentJoint - 1
    while i > 0:
        chain.append(i)
        i = bodies[i].parent
    v, w = _on_axes(system, ca.vertsplit(xi))
    for i in reversed(chain):
        step = step_of(bodies[i], joints)
        v, w = moved_twist(bodies[i], *step.outward(v, w), rates)
        if load.frame == "world":
            force, moment = (_undo_turns(step.turns, vector) for vector in (force, moment))
    turn, origin = robot.place(index)
    point = plus(origin, [dot(axis, load.at) for axis in turn])
    v = plus(v, cross(w, point))
    if load.frame == "body":
        force, moment = ([dot(axis, vector) for axis in turn] for vector in (force, moment))
    power = ca.SX(add(dot(force, v), dot(moment, w)))
    torque, wrench = (ca.SX(ca.gradient(power, v)) if v.numel() else v for v in (xdot, xi))
    return torque, wrench


def _base_wrench(system: System, s: Symbols, entries: list[Scalar]) -> list[Scalar]:
    """Convert a wrench (r,) on the base from the fixed axes to the base's axes."""
    lin, ang = _on_axes(system, entries)
    rotated = [*_rotate_back(system, s.seen.pose, lin), *_rotate_back(system, s.seen.pose, ang)]
    return [rotated[axis] for axis in system.group.axes]


def _on_axes(system: System, entries: list[Scalar]) -> tuple[Vec, Vec]:
    """Return a twist or wrench of the group, (r,), as a spatial vector in the root body's frame."""
    spatial: Vec = [0.0] * 6
    for axis, entry in zip(system.group.axes, entries, strict=True):
        spatial[axis] = entry
    return spatial[:3], spatial[3:]


def _into_root(system: System, pose: ca.SX, v: Vec) -> Vec:
    """Convert a vector from the root joint's fixed frame to the root body's frame in the sweep."""
    root_axes = bodies_of(system)[0].frame.rotation.T.tolist()
    return _rotate_back(system, pose, [dot(axis, v) for axis in root_axes])


def _rotate_back(system: System, pose: ca.SX, v: Vec) -> Vec:
    """Return Rᵀ v for the attitude R of a pose; its quaternion must have length one."""
    group = system.group
    if group.turns == 0:
        return list(v)
    if group.turns == 1:
        angle = pose[group.size - 1]
        return Turn(group.axes[-1] - 3, ca.cos(angle), ca.sin(angle)).back(v)
    x, y, z, w = (pose[group.linear + k] for k in range(4))
    u = [-x, -y, -z]
    t = cross(u, v)
    second_cross = cross(u, t)
    return [add(v[i], mul(2.0, add(mul(w, t[i]), second_cross[i]))) for i in range(3)]


def _undo_turns(turns: Sequence[Turn | Rotation], v: Vec) -> Vec:
    for turn in turns:
        if not turn.is_none:
            v = turn.back(v)
    return v


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
