"""CasADi Functions of the reduction, for users' own optimal-control problems."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ..reduction.tree.momenta import bracket, momenta
from ..system.system import System
from .layout import Layout, Structure
from .reduced_graph import ReducedGraph


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


def _curvature(system: System, x: ca.SX, A: ca.SX) -> ca.SX:
    r, m = system.r, system.m
    if not m:
        return ca.SX(r, 0)
    dA = [ca.jacobian(A[:, b], x) for b in range(m)]  # dA[β][:, α] = ∂_α A_β
    columns = []
    for a in range(m):
        for b in range(m):
            turned = bracket(system.group, A[:, a], A[:, b])
            columns.append(dA[b][:, a] - dA[a][:, b] - turned)
    return ca.horzcat(*columns)
