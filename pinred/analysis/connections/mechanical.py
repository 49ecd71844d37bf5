"""The mechanical connection: horizontal motion has no momentum."""

from __future__ import annotations

import casadi as ca

from ...common.arrays import Array
from ...kernels.connection.form import ConnectionForm, form_of
from ...reduction.at_a_shape import Reduction
from ...reduction.tree.momenta import locked, momenta
from ...system.system import System, checked_system


def mechanical_form(system: System) -> ConnectionForm:
    """Return the form of a system's momenta, H(x) (ξ, ẋ) = (μ, π), symmetric."""
    system = checked_system(system, "Connection.mechanical")

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        return momenta(system, x, v)

    def reference(x: Array) -> Array:
        return Reduction(system).mass_matrix(x)

    return form_of(
        system.group, system.shape_names, system.units, f"the momenta of '{system.name}'",
        values, reference, symmetric=True, momentum=True, locked=lambda x: locked(system, x),
    )  # fmt: skip
