"""The viscous connection: at low Reynolds number, drag forces on the whole body vanish."""

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

    length: L [m].  across, along: drag coefficients c_n and c_t per length [N s/m²].  centre:
    (3,) of the rod in its link's frame [m].  axis: (3,) along it, x if not given.  Its drag is
    diag(c_t L, c_n L, c_n L) on translation, and c_n L³/12 on turns across it; it resists no turn
    about its own axis.
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
        own = np.diag([c_t * L, c_n * L, c_n * L, 0.0, c_n * L**3 / 12.0, c_n * L**3 / 12.0])
        object.__setattr__(self, "tensor", moved(own, self.centre, self.axis))


def moved(own: Array, centre: ArrayLike, axis: ArrayLike) -> Array:
    """Return a tensor (6, 6) of a body about its centre with the given x axis, in its link's frame.

    Raises InputError for an axis without direction.
    """
    d, c = vector(axis, 3, "axis"), vector(centre, 3, "centre")
    if not np.linalg.norm(d) > 0.0:
        raise InputError(f"axis must have a direction, got {d}")
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), d / np.linalg.norm(d))
    X = pin.SE3(turn.toRotationMatrix(), c).inverse().toActionMatrix()
    return np.asarray(X.T @ own @ X)


def viscous_form(system: System, drag: Mapping[str, Rod | ArrayLike]) -> ConnectionForm:
    """Return the form of drag forces, Σ JᵀDJ, symmetric.

    drag: of links by name, a Rod, or a symmetric tensor (6, 6) from twists to what resists them
    [N s/m, N s, N m s], in the link's frame about its origin.
    """
    system = checked_system(system, "Connection.viscous")
    if not isinstance(drag, Mapping) or not drag:
        raise InputError("drag must be {link: Rod or tensor (6, 6)}, of at least one link")
    by_link = {
        name: each.tensor if isinstance(each, Rod) else np.asarray(each, dtype=float)
        for name, each in drag.items()
    }
    return tensor_form(
        system, tensors_by_body(system, by_link, "drag"), f"drag forces on '{system.name}'",
        rotors=False,
    )  # fmt: skip


def tensor_form(system: System, tensors: list[Array], what: str, *, rotors: bool) -> ConnectionForm:
    """Return the symmetric form of tensors (6, 6) of all bodies, in joint frames, root first.

    rotors: whether they are inertias, beside which joints have their armature.
    """
    own = tensors_of(system, tensors)
    armature = np.diag(np.array(system.model.armature)) if rotors else 0.0

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        return momenta(system, x, v, own, rotors=rotors)

    def reference(x: Array) -> Array:
        return summed(system, tensors, x) + system.coupled_matrix(np.asarray(armature)) * rotors

    return form_of(
        system.group, system.shape_names, system.units, what, values, reference,
        symmetric=True, momentum=rotors, locked=lambda x: locked(system, x, own, rotors=rotors),
    )  # fmt: skip
