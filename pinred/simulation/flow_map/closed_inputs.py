"""Initial states of flows with closed loops: the nearest closed state, and its derivatives.

A shape is moved to a closed one by steps of least size, so near a closed shape its change is
P = 1 − U (J U)⁺ J, with the units U of the joints.  Rates are projected in the kinetic metric M:

    M ẋ' + Jᵀν = M ẋ,   J ẋ' = 0,   ẋ' = Π ẋ,   K = M⁻¹Jᵀ(J M⁻¹Jᵀ)⁻¹,
    δẋ' = Π (δẋ + M⁻¹(δM (ẋ − ẋ') − δJᵀν)) − K δJ ẋ'.

Prescribed joints have their planned values and do not move: the pseudo-inverse, M⁻¹ and K then
belong to the other joints, while J contains all columns.  If they determine the other joints, P is
exact at any distance.  Else its relative error is about the distance to the closed shape, as that
of x0 is.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed
from ...reduction.pointwise_reduction import PointwiseReduction
from ...scene.initial_state import HeldJoints, closed_rates, closed_shape
from ...system.loops.loop_assembly import loop_rates, rate_units
from ...system.loops.looped_system import loop_jacobian, loop_jacobian_rate
from ...system.system import System

_MOVED = 1e-9  # largest change of a shape whose projection has the derivative P [rad | m]
_RANK = 1e-9  # singular values below it count as zero [m | 1]
_OPEN = 1e-12  # relative change of rates by the projection, above which its derivative is complete


def close_inputs(
    system: System, x: Array, xdot: Array, values: Mapping[str, Any], driven: Sequence[int] = ()
) -> Array:
    """Return the closed shape and rates nearest to x (nx,) and ẋ (m,), one after the other.

    Args:
        system: The system, with loops.
        x: Shape of the inputs.
        xdot: Shape rate of the inputs.
        values: Values by name, of which x0 and xdot0 are reported if they leave loops open.
        driven: Indices of the rates of prescribed joints, which have their planned values.
    Returns:
        (nx + m,).
    Raises:
        InputError: The loops do not close, or planned positions leave the other joints undetermined
            and `values` has no x0.
    """
    held = [_held(values, name) for name in ("x0", "xdot0")]
    start, x = x, closed_shape(system, x, held[0], driven=driven, nearby=True)
    moved = float(np.abs(system.space.difference(start, x)).max())
    if "x0" not in values and moved > _MOVED and not _determined(system, x, driven):
        names = listed([system.space.names[k] for k in driven], 6)
        raise InputError(
            f"prescribed: the Parameters move {names} at time 0 away from the scene's shape, and "
            f"do not determine the other joints of the loops of '{system.name}'. Also give x0, a "
            "shape that closes the loops at these positions."
        )
    return np.concatenate([x, closed_rates(system, x, xdot, held[1], driven=driven)])


def _determined(system: System, x: Array, driven: Sequence[int]) -> bool:
    """Return whether prescribed joints determine all other joints of the loops near x (nx,)."""
    moving = sorted(loop_rates(system) - {*driven})
    J = loop_jacobian(system, x)[:, moving]
    return int(np.linalg.matrix_rank(J, tol=_RANK)) == len(moving)


def _held(values: Mapping[str, Any], name: str) -> HeldJoints:
    value = values.get(name)
    names: Collection[Any] = value if isinstance(value, Mapping) else ()
    return HeldJoints(name in values, tuple(map(str, names)))


def closing_slopes(
    system: System, x: Array, xdot: Array, raw: Array, driven: Sequence[int] = ()
) -> tuple[Array, Array, Array]:
    """Return the derivatives of a closed shape and of its rates.

    Args:
        system: The system, with loops.
        x: Closed shape, (nx,).
        xdot: Rates that keep loops closed, (m,).
        raw: Rates before the projection, (m,).
        driven: Indices of the rates of prescribed joints, which have their planned values.
    Returns:
        Derivatives of x along the frame by displacements of the shape, of ẋ by displacements of the
        shape, and of ẋ by the rates before the projection, (m, m) each. Displacements and rates of
        prescribed joints are those of their plans.
    """
    closure = system.closure
    assert closure is not None
    rows, units = closure.rows, rate_units(system, closure.length)
    free = np.setdiff1d(np.arange(system.m), driven)
    J = loop_jacobian(system, x)[rows]
    P = np.eye(system.m)
    P[free] -= units[free, None] * np.linalg.lstsq((J * units)[:, free], J)[0]
    tree = system.open_tree()
    reduction = tree.workspace(PointwiseReduction, lambda: PointwiseReduction(tree))
    M = reduction.split(x).reduced_metric[np.ix_(free, free)]
    response = np.linalg.solve(M, J[:, free].T)
    mobility, K = J[:, free] @ response, np.zeros(J.T.shape)
    K[free] = np.linalg.solve(mobility, response.T).T
    Pi = np.eye(system.m) - K @ J
    rates = [loop_jacobian_rate(system, x, direction)[rows] for direction in P.T]
    by_x = np.column_stack([-K @ (rate @ xdot) for rate in rates])
    change = raw - xdot
    if np.abs(change).max() > _OPEN * np.abs(raw).max():
        nu = np.linalg.solve(mobility, J @ raw)
        dM = np.einsum("ijc,j->ic", reduction.at(x).dM, change) @ P
        loads = dM - np.column_stack([rate.T @ nu for rate in rates])
        by_x = by_x + Pi[:, free] @ np.linalg.solve(M, loads[free])
    return P, by_x, Pi
