"""The viscous connection: at low Reynolds number, the total drag on the robot vanishes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...common.arrays import Array, positive, vector
from ...common.errors import InputError
from ...kernels.connection.form import ConnectionForm, form_of
from ...reduction.tree.link_motions import tensors_of
from ...reduction.tree.momenta import locked, momenta
from ...system.system import System, checked_system
from .links import summed, tensors_by_body


@dataclass(frozen=True)
class Rod:
    """A slender rod in a viscous fluid, by resistive-force theory.

    Its drag is diag(c_t L, c_n L, c_n L) on translation and c_n L³/12 on rotation across its axis.
    It does not resist rotation about its axis.

    Attributes:
        length: Length L [m].
        across: Drag coefficient c_n per length [N s/m²].
        along: Drag coefficient c_t per length [N s/m²].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction in its link's frame, (3,).
        tensor: Drag tensor, (6, 6), in its link's frame about the origin.
    """

    length: float
    across: float
    along: float
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        L, c_n, c_t = (
            positive(getattr(self, name), name) for name in ("length", "across", "along")
        )
        rotation = c_n * L**3 / 12.0
        about_centre = np.diag([c_t * L, c_n * L, c_n * L, 0.0, rotation, rotation])
        object.__setattr__(self, "tensor", in_link_frame(about_centre, self.centre, self.axis))


def in_link_frame(tensor: Array, centre: ArrayLike, axis: ArrayLike) -> Array:
    """Transform the tensor of a body to its link's frame.

    Args:
        tensor: Tensor about the body's centre, with x along its axis, (6, 6).
        centre: Centre in the link's frame, (3,) [m].
        axis: Direction of the body's axis in the link's frame, (3,).
    Returns:
        (6, 6), about the origin of the link's frame.
    Raises:
        InputError: The axis is zero.
    """
    d, c = vector(axis, 3, "axis"), vector(centre, 3, "centre")
    if not np.linalg.norm(d) > 0.0:
        raise InputError(f"axis must have a direction, got {d}")
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), d / np.linalg.norm(d))
    X = pin.SE3(turn.toRotationMatrix(), c).inverse().toActionMatrix()
    return np.asarray(X.T @ tensor @ X)


def viscous_form(system: System, drag: Mapping[str, Rod | ArrayLike]) -> ConnectionForm:
    """Return the symmetric form of drag forces, Σ JᵀDJ; drag: see `Connection.viscous`."""
    system = checked_system(system, "Connection.viscous")
    if not isinstance(drag, Mapping) or not drag:
        raise InputError("drag must be {link: Rod or tensor (6, 6)}, of at least one link")
    by_link = {
        name: body.tensor if isinstance(body, Rod) else np.asarray(body, dtype=float)
        for name, body in drag.items()
    }
    return tensor_form(
        system, tensors_by_body(system, by_link, "drag"), f"drag forces on '{system.name}'",
        rotors=False,
    )  # fmt: skip


def tensor_form(system: System, tensors: list[Array], what: str, *, rotors: bool) -> ConnectionForm:
    """Return the symmetric form of tensors of all bodies.

    Args:
        system: The system.
        tensors: Tensors (6, 6) in joint frames, root first.
        what: Short description for messages.
        rotors: Whether the tensors are inertias, so that the armature of joints is added.
    Returns:
        The form.
    """
    body_tensors = tensors_of(system, tensors)
    armature = np.diag(np.array(system.model.armature)) if rotors else 0.0

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        return momenta(system, x, v, body_tensors, rotors=rotors)

    def reference(x: Array) -> Array:
        return summed(system, tensors, x) + system.coupled_matrix(np.asarray(armature)) * rotors

    return form_of(
        system.group, system.shape_names, system.units, what, values, reference,
        symmetric=True, momentum=rotors,
        locked=lambda x: locked(system, x, body_tensors, rotors=rotors),
    )  # fmt: skip
