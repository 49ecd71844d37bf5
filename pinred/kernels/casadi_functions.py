"""CasADi Functions of the reduced quantities, for use in optimal-control problems."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from ..common.argument_kinds import checks_arguments
from ..reduction.tree.momenta import casadi_reduction
from ..system.system import System
from .reduced_graph import ReducedGraph
from .state_layout import Layout, Structure


@dataclass(frozen=True)
class CasadiFunctions:
    """Reduced quantities as CasADi Functions of the shape x, (nx,).

    The quaternion (x, y, z, w) of a ball takes four entries of x and must have length one.
    Velocities and momenta have three entries for each ball, along the axes of its child.  In the
    reduced state y, balls follow hinges and slides: first the momenta of all balls, three for each,
    then their quaternions, four for each (`layout.balls_at` is the index of the first).

    Attributes:
        mass_matrix: Mass matrix H(x), (n, n).
        locked_inertia: Locked inertia I(x), (r, r).
        local_connection: Local connection A(x), (r, m).
        reduced_metric: Reduced metric M(x), (m, m).
        curvature: Curvature B of the connection, (r, m²); column α m + β is B_αβ.
        vector_field: Reduced equations (y, parameters) → dy/dt, with nonzero momentum and
            without forces.
        vector_field_jacobian: Jacobian of the vector field with respect to y.
        layout: Layout of y and of the parameters.
    """

    mass_matrix: ca.Function
    locked_inertia: ca.Function
    local_connection: ca.Function
    reduced_metric: ca.Function
    curvature: ca.Function
    vector_field: ca.Function
    vector_field_jacobian: ca.Function
    layout: Layout


@checks_arguments
def casadi_functions(system: System) -> CasadiFunctions:
    """Build the CasADi Functions of a system.

    Args:
        system: The system.
    Returns:
        The Functions.
    Raises:
        UnsupportedOperationError: The system has closed loops.
    """
    system.refuse_loops(
        "casadi_functions",
        "Use flow, or the functions of system.open_tree() with the Jacobian of the loops.",
    )
    terms = casadi_reduction(system)
    graph = ReducedGraph(system, Structure(zero_momentum=False))
    field = graph.rate()
    rate = field(graph.y, graph.parameters)

    def function(name: str, value: ca.SX) -> ca.Function:
        return ca.Function(name, [terms.x], [value], ["x"], [name])

    return CasadiFunctions(
        mass_matrix=function("mass_matrix", terms.H),
        locked_inertia=function("locked_inertia", terms.I),
        local_connection=function("local_connection", terms.A),
        reduced_metric=function("reduced_metric", terms.M),
        curvature=function("curvature", terms.B),
        vector_field=field,
        vector_field_jacobian=ca.Function(
            "vector_field_jacobian", [graph.y, graph.parameters], [ca.jacobian(rate, graph.y)]
        ),
        layout=graph.layout,
    )
