"""CasADi Functions of the reduction, for users' own optimal-control problems."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ..reduction.tree.articulated_sweep import step_of
from ..reduction.tree.body_frames import Body, bodies_of
from ..reduction.tree.scalars import Scalar, Vec, cross, mul, plus, sub, times
from ..system.system import System
from .reduced_graph import AXES, Layout, ReducedGraph, Structure


@dataclass(frozen=True)
class CasadiFunctions:
    """The reduction as CasADi Functions of the shape x, (m,).

    mass_matrix: (n, n).  locked_inertia: (r, r).  local_connection: (r, m).
    reduced_metric: (m, m).  curvature: (r, m²), column α m + β is B_αβ.
    vector_field: (y, parameters) → dy/dt, the reduced equations with momentum and without
    forces; vector_field_jacobian: its exact derivative by y.  layout: where things stand in
    y and the parameters.
    """

    mass_matrix: ca.Function
    locked_inertia: ca.Function
    local_connection: ca.Function
    reduced_metric: ca.Function
    curvature: ca.Function
    vector_field: ca.Function
    vector_field_jacobian: ca.Function
    layout: Layout


def casadi_functions(system: System) -> CasadiFunctions:
    """Return the CasADi Functions of a system."""
    r, m = system.r, system.m
    x = ca.SX.sym("x", m)
    H = _mass_matrix(system, x)
    I, Hbs, Hss = H[:r, :r], H[:r, r:], H[r:, r:]
    A = ca.solve(I, Hbs) if m else ca.SX(r, 0)
    graph = ReducedGraph(system, Structure(zero_momentum=False))
    field = graph.rate()
    rate = field(graph.y, graph.parameters)

    def function(name: str, value: ca.SX) -> ca.Function:
        return ca.Function(name, [x], [value], ["x"], [name])

    return CasadiFunctions(
        mass_matrix=function("mass_matrix", H),
        locked_inertia=function("locked_inertia", I),
        local_connection=function("local_connection", A),
        reduced_metric=function("reduced_metric", Hss - Hbs.T @ A),
        curvature=function("curvature", _curvature(system, x, A)),
        vector_field=field,
        vector_field_jacobian=ca.Function(
            "vector_field_jacobian", [graph.y, graph.parameters], [ca.jacobian(rate, graph.y)]
        ),
        layout=graph.layout,
    )


def _mass_matrix(system: System, x: ca.SX) -> ca.SX:
    """Return H(x), the derivative of the momenta by the velocities."""
    v = ca.SX.sym("v", system.n)
    return ca.jacobian(momenta(system, x, v), v)


def momenta(system: System, x: ca.SX, v: ca.SX) -> ca.SX:
    """Return the momenta H(x) v, (n,), of velocities v = (ξ, ẋ), in one sweep."""
    bodies, axes = bodies_of(system), AXES[system.group.name]
    linear: Vec = [0.0, 0.0, 0.0]
    angular: Vec = [0.0, 0.0, 0.0]
    for k, (turning, axis) in enumerate(axes):
        (angular if turning else linear)[axis] = v[k]
    steps = [None, *(step_of(bodies[i], x[i - 1]) for i in range(1, len(bodies)))]
    twists = [(linear, angular)]
    for i in range(1, len(bodies)):
        step = steps[i]
        assert step is not None
        vi, wi = step.outward(*twists[bodies[i].parent])
        part = vi if bodies[i].prismatic else wi
        part[2] = part[2] + v[system.r + i - 1]
        twists.append((vi, wi))
    carried = [_momentum(body, *twist) for body, twist in zip(bodies, twists, strict=True)]
    pi: list[Scalar] = [0.0] * system.m
    for i in range(len(bodies) - 1, 0, -1):
        body, (lin, ang), step = bodies[i], carried[i], steps[i]
        assert step is not None
        pi[i - 1] = (lin if body.prismatic else ang)[2] + body.armature * v[system.r + i - 1]
        up, about = step.inward(lin, ang)
        lin0, ang0 = carried[body.parent]
        carried[body.parent] = plus(lin0, up), plus(ang0, about)
    lin, ang = carried[0]
    mu = [(ang if turning else lin)[axis] for turning, axis in axes]
    if system.group.name == "SO2":
        mu[0] = mu[0] + float(system.model.armature[0]) * v[0]
    column: ca.SX = ca.vertcat(*mu, *pi)
    return column


def _momentum(body: Body, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    lin = [sub(mul(body.mass, a), b) for a, b in zip(v, cross(body.moment, w), strict=True)]
    return lin, plus(cross(body.moment, v), times(body.inertia, w))


def _curvature(system: System, x: ca.SX, A: ca.SX) -> ca.SX:
    r, m = system.r, system.m
    if not m:
        return ca.SX(r, 0)
    dA = [ca.jacobian(A[:, b], x) for b in range(m)]  # dA[β][:, α] = ∂_α A_β
    columns = []
    for a in range(m):
        for b in range(m):
            turned = bracket(system, A[:, a], A[:, b])
            columns.append(dA[b][:, a] - dA[a][:, b] - turned)
    return ca.horzcat(*columns)


def bracket(system: System, a: ca.SX, b: ca.SX) -> ca.SX:
    """Return [a, b] in the group's algebra."""
    name = system.group.name
    if name in ("R", "SO2"):
        return ca.SX.zeros(1)
    if name == "SO3":
        return ca.cross(a, b)
    if name == "SE2":
        return ca.vertcat(b[2] * a[1] - a[2] * b[1], a[2] * b[0] - b[2] * a[0], 0)
    return ca.vertcat(ca.cross(a[3:], b[:3]) - ca.cross(b[3:], a[:3]), ca.cross(a[3:], b[3:]))
