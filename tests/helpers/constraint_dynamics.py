"""Pinocchio's own dynamics with loop constraints, which shares no code with pinred."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from pinred.common.arrays import Array
from pinred.system.loops.loop import Constraint, Loop


def constraint_dynamics(
    model: pin.Model, *loops: Constraint, regular: float = 1e-14
) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
    """Return Pinocchio's map from q, v, τ to acceleration and force, for kinds "3d" and "6d"."""
    data = model.createData()
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for loop in loops:
        assert isinstance(loop, Loop)
        a, b = (model.frames[model.getFrameId(name)] for name in (loop.frame_a, loop.frame_b))
        kind = pin.ContactType.CONTACT_3D if loop.kind == "3d" else pin.ContactType.CONTACT_6D
        contact = pin.RigidConstraintModel(
            kind, model, a.parentJoint, a.placement, b.parentJoint, b.placement,
            pin.ReferenceFrame.LOCAL,
        )  # fmt: skip
        models.append(contact)
        datas.append(contact.createData())
    pin.initConstraintDynamics(model, data, models, datas)
    proximal = pin.ProximalSettings(1e-14, regular, 50)

    def solve(q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        a = pin.constraintDynamics(model, data, q, v, tau, models, datas, proximal).copy()
        return a, -np.array(datas[0].contact_force.linear)  # on frame b

    return solve
