"""CasADi functions of the page: base twist, curvature, placements, closed loops.

Twists and momenta are those of Pinocchio's root joint in space, (6,) [linear; angular].  Shapes are
coordinates w of `Connection.in_chart`, in which a ball is a rotation vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
import pinocchio as pin

from ...analysis.connections.connection import Connection
from ...common.arrays import Array
from ...kernels.connection.connection_form import momentum_velocity_graph, velocity_graph
from ...reduction.symbolic_placements import (
    Placement,
    all_joint_values,
    compose,
    fixed_placement,
    inverse,
    joint_frames,
    rotate,
)
from ...reduction.tree.momenta import bracket
from ...system.joints import axes_of
from ...system.loops.kinematics import JointLaw, loop_ends, rotation_axes
from ...system.loops.loop import JointPolynomial, Loop
from ...system.loops.looped_system import loop_kinematics
from ...system.system import System


@dataclass(frozen=True, eq=False)
class FeelGraphs:
    """The functions that the page evaluates; each takes one vector.

    Attributes:
        twist: (w, ẇ, momentum) → twist −A ẇ + P_b⁻¹ μ, (6,).
        curvature: (w, u, v) → B(u, v), (r,), for constant vectors u and v, (m,).
        placements: w → position and quaternion of the joints after the root, relative to the root
            body, 7 numbers each, then the centre of mass, (3,).
        loops: w → equations of the closed loops and their Jacobian (see `loop_graph`); empty
            without loops.
    """

    twist: ca.Function
    curvature: ca.Function
    placements: ca.Function
    loops: ca.Function


def feel_graphs(connection: Connection, system: System) -> FeelGraphs:
    """Return the functions of a robot.

    Args:
        connection: Connection of the open tree, in the chart.
        system: The system, perhaps with closed loops.
    Returns:
        The functions.
    """
    m = connection.m
    w, u, v = (ca.SX.sym(name, m) for name in ("w", "u", "v"))
    x = w if connection.chart is None else connection.chart.shape_graph(w)
    values = all_joint_values(system, x)
    frames = joint_frames(system, values)
    closing = loop_graph(system, w, values, frames) if system.loops else ca.SX.zeros(0, 1)
    return FeelGraphs(
        twist=_twist(connection, root_axes(system)),
        curvature=_function("curvature", [w, u, v], _curvature(connection, w, u, v)),
        placements=_function("placements", [w], _placements(system, frames)),
        loops=_function("loops", [w], closing),
    )


def root_axes(system: System) -> Array:
    """Return the twists of the root joint in its body's frame, (6, r)."""
    return axes_of(system.model.joints[1])


def _twist(connection: Connection, S: Array) -> ca.Function:
    m, r = connection.m, connection.r
    w, wdot, momentum = ca.SX.sym("w", m), ca.SX.sym("wdot", m), ca.SX.sym("momentum", 6)
    mu = ca.DM(S.T) @ momentum if connection.form.momentum else ca.SX.zeros(r, 1)
    graph = momentum_velocity_graph(connection.form)
    xi = graph(ca.vertcat(w, wdot, mu), ca.SX.sym("none"))
    return _function("twist", [w, wdot, momentum], ca.DM(S) @ xi)


def _horizontal(connection: Connection, w: ca.SX, wdot: ca.SX) -> ca.SX:
    values = velocity_graph(connection.form)(ca.vertcat(w, wdot), ca.SX.sym("none"))
    return values[: connection.r]


def _curvature(connection: Connection, w: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
    """Return ∂_u(A v) − ∂_v(A u) − [A u, A v], (r,)."""
    Au, Av = -_horizontal(connection, w, u), -_horizontal(connection, w, v)
    exterior = ca.jtimes(Av, w, u) - ca.jtimes(Au, w, v)
    return exterior - bracket(connection.group, Au, Av)


def _placements(system: System, frames: list[Placement]) -> ca.SX:
    """Return the placements of the joints after the root, and the centre of mass."""
    bodies = list(zip(system.sorted_model.inertias, frames, strict=True))[1:]
    moment = sum(
        (body.mass * (p + rotate(q, ca.SX(body.lever))) for body, (p, q) in bodies), ca.SX.zeros(3)
    )
    entries = [entry for placement in frames[2:] for entry in placement]
    return ca.vertcat(*entries, moment / sum(body.mass for body, _ in bodies))


def _function(name: str, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
    """Return a Function of all inputs in one column."""
    y = ca.SX.sym("y", sum(entry.numel() for entry in inputs))
    ends = np.cumsum([0, *(entry.numel() for entry in inputs)])
    parts = [y[int(a) : int(b)] for a, b in pairwise(ends)]
    inner = ca.Function(name, inputs, [ca.densify(output)], {"cse": True})
    return ca.Function(name, [y], [inner(*parts)], {"cse": True})


def loop_graph(
    system: System, w: ca.SX, values: Sequence[ca.SX], frames: Sequence[Placement]
) -> ca.SX:
    """Return the independent equations φ and their Jacobian ∂φ/∂w, column by column, (k + k m,).

    Args:
        system: The system, with loops.
        w: Coordinates of the open tree, (m,).
        values: Coordinates of all joints of the tree, as functions of w.
        frames: Placements of the joints relative to the root body, by Pinocchio's index.
    Returns:
        The expressions.
    """
    closure = system.closure
    assert closure is not None
    rows = [row for loop in system.loops for row in _equations(system, loop, values, frames)]
    lengths = loop_kinematics(system).is_length
    scaled = [row / closure.length if lengths[k] else row for k, row in enumerate(rows)]
    phi = ca.vertcat(*(scaled[k] for k in closure.rows.tolist()))
    return ca.vertcat(phi, ca.vec(ca.densify(ca.jacobian(phi, w))))


def _equations(
    system: System,
    loop: Loop | JointPolynomial,
    values: Sequence[ca.SX],
    frames: Sequence[Placement],
) -> list[ca.SX]:
    """Return the equations of one loop, in the order of LoopKinematics."""
    if isinstance(loop, JointPolynomial):
        follower, leader = (
            values[system.tree.joints[i - 2].x.start]
            for i in JointLaw(system.sorted_model, loop).joints
        )
        by = leader - loop.leader_zero
        law = sum(c * by**k for k, c in enumerate(loop.coefficients))
        return [follower - loop.follower_zero - law]
    a, b = (
        compose(frames[end.joint], fixed_placement(pin.SE3(end.placement)))
        for end in loop_ends(system.sorted_model, loop)
    )
    p, q = compose(inverse(a), b)
    position = [p[0], p[1], p[2]]
    if loop.kind == "3d":
        return position
    columns: list[Array] = [np.eye(3)[k] for k in range(3)]
    R = ca.horzcat(*(rotate(q, ca.SX(column)) for column in columns))
    if loop.kind == "6d":
        turn = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
        return [*position, *(0.5 * entry for entry in turn)]
    return [*position, *(R[i, k] for i, k in rotation_axes(loop.kind))]
