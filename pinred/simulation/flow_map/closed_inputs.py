"""Initial states of flows with closed loops: the nearest closed state, and its derivatives.

A shape is moved to a closed one by steps of least size, so near a closed shape its change is
P = 1 − U (J U)⁺ J, with the units U of the joints.  Rates are projected in the kinetic metric M:

    M ẋ' + Jᵀν = M ẋ,   J ẋ' = 0,   ẋ' = Π ẋ,   K = M⁻¹Jᵀ(J M⁻¹Jᵀ)⁻¹,
    δẋ' = Π (δẋ + M⁻¹(δM (ẋ − ẋ') − δJᵀν)) − K δJ ẋ'.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from ...common.arrays import Array
from ...reduction.pointwise_reduction import PointwiseReduction
from ...scene.loop_states import HeldJoints, closed_rates, closed_shape
from ...system.loops.loop_assembly import rate_units
from ...system.loops.looped_system import loop_jacobian, loop_jacobian_rate
from ...system.system import System

_OPEN = 1e-12  # relative change of rates by the projection, above which its derivative is complete


def close_inputs(system: System, x: Array, xdot: Array, values: Mapping[str, Any]) -> Array:
    """Return the closed shape and rates nearest to x (nx,) and ẋ (m,), one after the other.

    Args:
        system: The system, with loops.
        x: Shape of the inputs.
        xdot: Shape rate of the inputs.
        values: Values by name, of which x0 and xdot0 are reported if they leave loops open.
    Returns:
        (nx + m,).
    """
    held = [_held(values, name) for name in ("x0", "xdot0")]
    x = closed_shape(system, x, held[0])
    return np.concatenate([x, closed_rates(system, x, xdot, held[1])])


def _held(values: Mapping[str, Any], name: str) -> HeldJoints:
    value = values.get(name)
    names: Collection[Any] = value if isinstance(value, Mapping) else ()
    return HeldJoints(name in values, tuple(map(str, names)))


def closing_slopes(system: System, x: Array, xdot: Array, raw: Array) -> tuple[Array, Array, Array]:
    """Return the derivatives of a closed shape and of its rates.

    Args:
        system: The system, with loops.
        x: Closed shape, (nx,).
        xdot: Rates that keep loops closed, (m,).
        raw: Rates before the projection, (m,).
    Returns:
        Derivatives of x along the frame by displacements of the shape, of ẋ by displacements of the
        shape, and of ẋ by the rates before the projection, (m, m) each.
    """
    closure = system.closure
    assert closure is not None
    rows, units = closure.rows, rate_units(system, closure.length)
    J = loop_jacobian(system, x)[rows]
    P = np.eye(system.m) - units[:, None] * np.linalg.lstsq(J * units, J)[0]
    tree = system.open_tree()
    reduction = tree.workspace(PointwiseReduction, lambda: PointwiseReduction(tree))
    M = reduction.split(x).reduced_metric
    response = np.linalg.solve(M, J.T)
    K = np.linalg.solve(J @ response, response.T).T
    Pi = np.eye(system.m) - K @ J
    rates = [loop_jacobian_rate(system, x, direction)[rows] for direction in P.T]
    by_x = np.column_stack([-K @ (rate @ xdot) for rate in rates])
    change = raw - xdot
    if np.abs(change).max() > _OPEN * np.abs(raw).max():
        nu = np.linalg.solve(J @ response, J @ raw)
        dM = np.einsum("ijc,j->ic", reduction.at(x).dM, change) @ P
        loads = dM - np.column_stack([rate.T @ nu for rate in rates])
        by_x = by_x + Pi @ np.linalg.solve(M, loads)
    return P, by_x, Pi
