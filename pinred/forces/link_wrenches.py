"""Wrenches on links, expressed as torques on the joints and a wrench on the base.

A force F at a point p of a link and a moment N on it have the power F · v_p + N · ω. This power is
linear in the body twist ξ and the shape rate ẋ:

    F · v_p + N · ω = f · ξ + τ · ẋ.

The derivatives of the power are therefore the wrench f on the base and the torques τ on the joints.
Follower joints contribute through the joints they follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from ..reduction.tree.all_joints import joint_rates, joint_values
from ..reduction.tree.articulated_sweep import step_of
from ..reduction.tree.body_frames import bodies_of, moved_twist
from ..reduction.tree.scalars import Rotation, Scalar, Turn, Vec, add, cross, dot, mul, plus
from ..system.assembly import link_frame
from ..system.force_interface import Load, Symbols
from ..system.system import System
from .force_numbers import RobotSymbols


@dataclass(frozen=True)
class OnCoordinates:
    """A load expressed in the coordinates: torques on the shape and a wrench on the base.

    Attributes:
        torque: Torques on the shape, (m,).
        wrench: Wrench on the base, (r,).
    """

    torque: ca.SX
    wrench: ca.SX


def of_load(
    system: System, robot: RobotSymbols, s: Symbols, load: Load, what: str
) -> OnCoordinates:
    """Express a load by torques and a wrench on the base.

    Args:
        system: The robot.
        robot: Symbols of the robot parameters.
        s: Variables of the forces.
        load: Wrench on a link, or along fixed axes.
        what: Name of the force in messages.
    Returns:
        Torques and wrench.
    """
    if load.link is None:
        column = ca.vertcat(*_base_wrench(system, s, load.entries))
        return OnCoordinates(ca.SX(system.m, 1), ca.SX(column))
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
    return OnCoordinates(torque, wrench)


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
