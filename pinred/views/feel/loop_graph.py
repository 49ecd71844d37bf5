"""The equations of closed loops as a CasADi function of the coordinates w of the open tree.

The browser solves them for the dependent joints by Newton's method.  Equations are divided by the
size of the loops, so all are numbers of order one.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...reduction.symbolic_placements import Placement, compose, fixed_placement, inverse, rotate
from ...system.loops.joint_laws import JointLaw
from ...system.loops.kinematics import loop_ends, rotation_axes
from ...system.loops.loop import JointPolynomial, Loop
from ...system.loops.looped_system import loop_kinematics
from ...system.system import System


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
