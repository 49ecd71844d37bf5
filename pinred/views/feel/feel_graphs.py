"""CasADi functions of the page: base twist, curvature, and placements of the joints.

Twists and momenta are those of Pinocchio's root joint in space, (6,) [linear; angular].  Shapes are
coordinates w of `Connection.in_chart`, in which a ball is a rotation vector.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
import pinocchio as pin

from ...analysis.connections.connection import Connection
from ...common.arrays import Array
from ...kernels.connection.connection_form import momentum_velocity_graph, velocity_graph
from ...reduction.tree.all_joints import joint_values
from ...reduction.tree.momenta import bracket
from ...system.joints import axes_of
from ...system.system import System


@dataclass(frozen=True, eq=False)
class FeelGraphs:
    """The functions that the page evaluates; each takes one vector.

    Attributes:
        twist: (w, ẇ, momentum) → twist −A ẇ + P_b⁻¹ μ, (6,).
        curvature: (w, u, v) → B(u, v), (r,), for constant vectors u and v, (m,).
        placements: w → position and quaternion of the joints after the root, relative to the root
            body, 7 numbers each, then the centre of mass, (3,).
    """

    twist: ca.Function
    curvature: ca.Function
    placements: ca.Function


def feel_graphs(connection: Connection, system: System) -> FeelGraphs:
    """Return the functions of a connection in the chart and its system."""
    m = connection.m
    w, u, v = (ca.SX.sym(name, m) for name in ("w", "u", "v"))
    x = w if connection.chart is None else connection.chart.shape_graph(w)
    return FeelGraphs(
        twist=_twist(connection, root_axes(system)),
        curvature=_function("curvature", [w, u, v], _curvature(connection, w, u, v)),
        placements=_function("placements", [w], _placements(system, x)),
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


def _placements(system: System, x: ca.SX) -> ca.SX:
    """Return the placements of the joints after the root, and the centre of mass."""
    model = system.model
    values = joint_values(system, ca.vertsplit(x))
    frames: list[tuple[ca.SX, ca.SX]] = [(ca.SX.zeros(3), ca.SX([0, 0, 0, 1]))] * 2
    moment = model.inertias[1].mass * ca.SX(model.inertias[1].lever)
    for i, joint in enumerate(system.tree.joints, start=2):
        p, q = frames[model.parents[i]]
        fixed = pin.SE3ToXYZQUAT(model.jointPlacements[i])
        S = axes_of(model.joints[i])
        here = [ca.SX(values[k]) for k in range(joint.x.start, joint.x.stop)]
        shift, turn = ca.SX.zeros(3), ca.SX([0, 0, 0, 1])
        if joint.kind.is_ball:
            turn = ca.vertcat(*here)
        elif joint.kind.units == ("m",):
            shift = ca.SX(S[:3, 0]) * here[0]
        else:
            turn = ca.vertcat(ca.SX(S[3:, 0]) * ca.sin(here[0] / 2), ca.cos(here[0] / 2))
        p, q = _compose((p, q), (ca.SX(fixed[:3]), ca.SX(fixed[3:])))
        p, q = _compose((p, q), (shift, turn))
        frames.append((p, q))
        body = model.inertias[i]
        moment += body.mass * (p + _rotate(q, ca.SX(body.lever)))
    mass = sum(body.mass for body in model.inertias[1:])
    entries = [entry for p, q in frames[2:] for entry in (p, q)]
    return ca.vertcat(*entries, moment / mass)


def _compose(a: tuple[ca.SX, ca.SX], b: tuple[ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the product of two placements, each a position and a quaternion."""
    (p, q), (shift, turn) = a, b
    u, s, v, t = q[:3], q[3], turn[:3], turn[3]
    product = ca.vertcat(s * v + t * u + ca.cross(u, v), s * t - ca.dot(u, v))
    return p + _rotate(q, shift), product


def _rotate(q: ca.SX, v: ca.SX) -> ca.SX:
    across = 2.0 * ca.cross(q[:3], v)
    return v + q[3] * across + ca.cross(q[:3], across)


def _function(name: str, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
    """Return a Function of all inputs in one column."""
    y = ca.SX.sym("y", sum(entry.numel() for entry in inputs))
    ends = np.cumsum([0, *(entry.numel() for entry in inputs)])
    parts = [y[int(a) : int(b)] for a, b in pairwise(ends)]
    inner = ca.Function(name, inputs, [ca.densify(output)], {"cse": True})
    return ca.Function(name, [y], [inner(*parts)], {"cse": True})
