"""Links of a robot by name, and what Pinocchio says of their motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import nearest
from ...common.plain_names import listed, quoted
from ...system.system import System


@dataclass(frozen=True)
class Link:
    """A link, or any other frame of the model.

    joint: index in the model of the joint that moves it, 1 the root's.  placement: in the frame
    of that joint.
    """

    joint: int
    placement: pin.SE3


def link_named(system: System, name: str, what: str) -> Link:
    """Return a link by name.  Raises InputError naming `what` and listing the links."""
    model = system.model
    moving = {
        frame.name: frame
        for frame in model.frames
        if frame.parentJoint >= 1 and frame.type == pin.FrameType.BODY
    }
    frame = moving.get(name)
    if frame is None and isinstance(name, str) and model.existFrame(name):
        found = model.frames[model.getFrameId(name)]
        frame = found if found.parentJoint >= 1 else None
    if frame is None:
        known = list(moving)
        raise InputError(
            f"{what}: no link {quoted(str(name))} that moves; {nearest(str(name), known)}"
            f"the links are {listed(known)}"
        )
    return Link(frame.parentJoint, pin.SE3(frame.placement))


def tensors_by_body(system: System, by_link: Mapping[str, Array], what: str) -> list[Array]:
    """Return what links have, (6, 6) each in its own frame, summed by bodies in joint frames.

    Raises InputError for a link that there is not, or a tensor that is not symmetric.
    """
    out = [np.zeros((6, 6)) for _ in range(1, system.model.njoints)]
    for name, tensor in by_link.items():
        link = link_named(system, name, what)
        D = np.asarray(tensor, dtype=float)
        if D.shape != (6, 6) or not np.isfinite(D).all() or not np.allclose(D, D.T, atol=0.0):
            raise InputError(f"{what}: the tensor of {quoted(name)} must be symmetric, (6, 6)")
        X = link.placement.inverse().toActionMatrix()
        out[link.joint - 1] += X.T @ D @ X
    return out


def summed(system: System, tensors: Sequence[Array], x: Array) -> Array:
    """Return Σ JᵀDJ, (n, n), of tensors of all bodies, by Pinocchio's Jacobians."""
    model, data = system.model, system.data
    pin.computeJointJacobians(model, data, system.model_q(system.group.identity(), x))
    out = np.zeros((model.nv, model.nv))
    for i, D in enumerate(tensors):
        J = pin.getJointJacobian(model, data, i + 1, pin.LOCAL)
        out += J.T @ D @ J
    return system.coupled_matrix(out)


def link_jacobian(system: System, link: Link, x: Array) -> Array:
    """Return the Jacobian (6, n) of a link's twist in its own frame, by Pinocchio."""
    model, data = system.model, system.data
    pin.computeJointJacobians(model, data, system.model_q(system.group.identity(), x))
    J = pin.getJointJacobian(model, data, link.joint, pin.LOCAL)
    own = link.placement.inverse().toActionMatrix() @ J
    return np.asarray(system.on_shape(own))
