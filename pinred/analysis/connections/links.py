"""Look up the links of a robot by name; compute their Jacobians with Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed, nearest, quoted
from ...system.system import System

_ROUND_OFF = 1e-14  # largest asymmetry of a symmetric tensor, relative to its largest entry


@dataclass(frozen=True)
class Link:
    """A link, or any other frame of the model.

    Attributes:
        joint: Index in the model of the joint that moves the link; 1 is the root joint.
        placement: Placement in the frame of that joint.
    """

    joint: int
    placement: pin.SE3


def link_named(system: System, name: str, what: str) -> Link:
    """Return a moving link by name.

    Args:
        system: The system.
        name: Name of the link, or of another frame.
        what: Name of the argument, for error messages.
    Returns:
        The link.
    Raises:
        InputError: No moving link has this name; the message lists the moving links.
    """
    model = system.sorted_model
    moving = {
        frame.name: frame
        for frame in model.frames
        if frame.parentJoint >= 1 and frame.type == pin.FrameType.BODY
    }
    frame = moving.get(name)
    # Pinocchio raises exceptions for names that are not UTF-8, so the names are compared here.
    candidate = next((entry for entry in model.frames if entry.name == name), None)
    if frame is None and candidate is not None and candidate.parentJoint >= 1:
        frame = candidate
    if frame is None:
        names = list(moving)
        raise InputError(
            f"{what}: no moving link {quoted(str(name))}; {nearest(str(name), names)}"
            f"the links are {listed(names)}"
        )
    return Link(frame.parentJoint, pin.SE3(frame.placement))


def tensors_by_body(system: System, by_link: Mapping[str, Array], what: str) -> list[Array]:
    """Sum the tensors of links for each body.

    Args:
        system: The system.
        by_link: Symmetric tensors (6, 6), each in its link's frame.
        what: Name of the argument, for error messages.
    Returns:
        Tensors (6, 6) of all bodies in their joint frames, root first.
    Raises:
        InputError: A link is unknown, or a tensor is not symmetric.
    """
    tensors = [np.zeros((6, 6)) for _ in range(1, system.model.njoints)]
    for name, tensor in by_link.items():
        link = link_named(system, name, what)
        D = np.asarray(tensor, dtype=float)
        if not _is_symmetric(D):
            raise InputError(f"{what}: the tensor of {quoted(name)} must be symmetric, (6, 6)")
        X = link.placement.inverse().toActionMatrix()
        tensors[link.joint - 1] += X.T @ D @ X
    return tensors


def _is_symmetric(D: Array) -> bool:
    """Return whether D is a finite symmetric matrix (6, 6), up to round-off of a rotation."""
    if D.shape != (6, 6) or not np.isfinite(D).all():
        return False
    return bool(np.allclose(D, D.T, atol=_ROUND_OFF * float(np.abs(D).max())))


def summed(system: System, tensors: Sequence[Array], x: Array) -> Array:
    """Compute Σ JᵀDJ over all bodies with the Jacobians J of Pinocchio.

    Args:
        system: The system.
        tensors: Tensors D (6, 6) of all bodies in their joint frames, root first.
        x: Shape, (m,).
    Returns:
        Sum of the tensors on velocities (ξ, ẋ), (n, n).
    """
    model, data = system.sorted_model, system.sorted_data
    pin.computeJointJacobians(model, data, system.sorted_q(system.group.identity(), x))
    total = np.zeros((model.nv, model.nv))
    for i, D in enumerate(tensors):
        J = pin.getJointJacobian(model, data, i + 1, pin.LOCAL)
        total += J.T @ D @ J
    return system.coupled_matrix(total)


def link_jacobian(system: System, link: Link, x: Array) -> Array:
    """Compute the Jacobian of a link's twist in its frame, (6, n), at shape x (m,)."""
    model, data = system.sorted_model, system.sorted_data
    pin.computeJointJacobians(model, data, system.sorted_q(system.group.identity(), x))
    J = pin.getJointJacobian(model, data, link.joint, pin.LOCAL)
    in_frame = link.placement.inverse().toActionMatrix() @ J
    return np.asarray(system.on_shape(in_frame))
