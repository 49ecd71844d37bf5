"""Connections of a robot in a viscous or a perfect fluid.

In a viscous fluid, at low Reynolds number, the total drag on the robot vanishes. In a perfect
fluid, the momentum of robot and fluid vanishes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, positive, vector
from ...common.errors import InputError
from ...kernels.connection.connection_form import ConnectionForm, form_of
from ...reduction.tree.momenta import inertia_tensors, locked, momenta, tensors_of
from ...system.system import System, checked_system
from .links import summed, tensors_by_body


@checks_arguments
@dataclass(frozen=True)
class Rod:
    """A slender rod in a viscous fluid, modelled with resistive-force theory.

    Its drag is diag(c_t L, c_n L, c_n L) on translation and c_n L³/12 on rotation across its axis.
    It does not resist rotation about its axis.

    Attributes:
        length: Length L [m].
        across: Drag coefficient c_n normal to the rod, per length [N s/m²].
        along: Drag coefficient c_t along the rod, per length [N s/m²].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction of the rod in its link's frame, (3,).
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
            np.float64(positive(getattr(self, name), name))
            for name in ("length", "across", "along")
        )
        with np.errstate(all="ignore"):
            rotation = c_n * L**3 / 12.0
            about_centre = np.diag([c_t * L, c_n * L, c_n * L, 0.0, rotation, rotation])
        tensor = in_link_frame(about_centre, self.centre, self.axis, "length, across, along")
        object.__setattr__(self, "tensor", tensor)


def in_link_frame(tensor: Array, centre: ArrayLike, axis: ArrayLike, sizes: str) -> Array:
    """Transform the tensor of a body to its link's frame.

    Args:
        tensor: Tensor about the body's centre, with x along its axis, (6, 6).
        centre: Centre in the link's frame, (3,) [m].
        axis: Direction of the body's axis in the link's frame, (3,).
        sizes: Names of the arguments that determine the tensor, for messages.
    Returns:
        (6, 6), about the origin of the link's frame.
    Raises:
        InputError: The axis is zero, or the tensor is not finite.
    """
    d, c = vector(axis, 3, "axis"), vector(centre, 3, "centre")
    if not np.linalg.norm(d) > 0.0:
        raise InputError(f"axis must be a nonzero vector, got {d}")
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), d / np.linalg.norm(d))
    X = pin.SE3(turn.toRotationMatrix(), c).inverse().toActionMatrix()
    with np.errstate(all="ignore"):
        at_link = np.asarray(X.T @ tensor @ X)
    if not np.isfinite(at_link).all():
        raise InputError(
            f"{sizes}: expected values whose tensor is finite, got one with {tensor.max():g}. "
            "Use other units"
        )
    return at_link


def viscous_form(system: System, drag: Mapping[str, Rod | ArrayLike]) -> ConnectionForm:
    """Return the symmetric form Σ JᵀDJ of the drag forces; for `drag` see `Connection.viscous`."""
    system = checked_system(system, "Connection.viscous")
    tensors = _tensors(system, drag, "drag", "Rod")
    return tensor_form(system, tensors, f"drag forces on '{system.name}'", rotors=False)


def _tensors(system: System, bodies: Mapping[str, Any], what: str, kinds: str) -> list[Array]:
    """Return the tensor of each body of a robot from bodies or tensors by link."""
    if not isinstance(bodies, Mapping) or not bodies:
        raise InputError(f"{what} must be {{link: {kinds} or tensor (6, 6)}}, of at least one link")
    by_link = {
        name: np.asarray(getattr(body, "tensor", body), dtype=float)
        for name, body in bodies.items()
    }
    return tensors_by_body(system, by_link, what)


def tensor_form(system: System, tensors: list[Array], what: str, *, rotors: bool) -> ConnectionForm:
    """Return the symmetric form Σ JᵀDJ that the tensors D of all bodies define.

    Args:
        system: The system.
        tensors: Tensors (6, 6) in joint frames, root first.
        what: Short description for messages.
        rotors: Whether the tensors are inertias, so that the armature of joints is added.
    Returns:
        The form.
    """
    body_tensors = tensors_of(system, tensors)
    armature = np.diag(np.array(system.sorted_model.armature)) if rotors else 0.0

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        return momenta(system, x, v, body_tensors, rotors=rotors)

    def reference(x: Array) -> Array:
        return summed(system, tensors, x) + system.coupled_matrix(np.asarray(armature)) * rotors

    return form_of(
        system.group, system.shape_names, system.units, what, values, reference,
        symmetric=True, momentum=rotors,
        locked=lambda x: locked(system, x, body_tensors, rotors=rotors), space=system.space,
    )  # fmt: skip


@checks_arguments
@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid in a perfect fluid, with the formulas of Lamb, Hydrodynamics, §114 and §373.

    With the volume V, its added mass per density along a is V α/(2 − α), and its added moment of
    inertia about a is (V/5) (b² − c²)² (γ − β) / (2 (b² − c²) + (b² + c²) (β − γ)); the others
    follow by cyclic permutation.

    Attributes:
        semi_axes: Semi-axes a, b, c, (3,) [m].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction of a in its link's frame, (3,).
        tensor: Added inertia per density, (6, 6), in its link's frame about the origin.
    """

    semi_axes: ArrayLike
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        axes = vector(self.semi_axes, 3, "semi_axes", ("a", "b", "c"))
        if not (axes > 0.0).all():
            raise InputError(f"semi_axes must be above zero, got {axes}")
        with np.errstate(all="ignore"):
            about_centre = np.diag(np.concatenate(added_masses(axes)))
        tensor = in_link_frame(about_centre, self.centre, self.axis, "semi_axes")
        object.__setattr__(self, "tensor", tensor)


@checks_arguments
@dataclass(frozen=True)
class Ellipse:
    """An elliptic cylinder across the plane of a planar robot, per metre of its height.

    Its added masses per density are π b² along a, and π a² along b.

    Attributes:
        a: Semi-axis along `axis` [m].
        b: Semi-axis perpendicular to `axis` [m].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction of a in its link's frame, (3,).
        convention: Added moment of inertia per density: "textbook", π/8 (a² − b²)² (Lamb, §71;
            Kelly and Murray), or "sysplotter", (a² − b²)², as in the program of that name.
        tensor: Added inertia per density, (6, 6), in its link's frame about the origin.
    """

    a: float
    b: float
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    convention: Literal["textbook", "sysplotter"] = "textbook"
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        a, b = (np.float64(positive(getattr(self, name), name)) for name in "ab")
        factors = {"textbook": np.pi / 8.0, "sysplotter": 1.0}
        if self.convention not in factors:
            raise InputError(f"convention must be {' or '.join(factors)}, got {self.convention!r}")
        with np.errstate(all="ignore"):
            moment = factors[self.convention] * (a**2 - b**2) ** 2
            about_centre = np.diag([np.pi * b**2, np.pi * a**2, 0.0, 0.0, 0.0, moment])
        tensor = in_link_frame(about_centre, self.centre, self.axis, "a, b")
        object.__setattr__(self, "tensor", tensor)


def added_masses(semi_axes: Array) -> tuple[Array, Array]:
    """Return the added masses [m³] and moments [m⁵] of an ellipsoid per density, (3,) each."""
    from scipy.special import elliprd

    a, b, c = semi_axes
    volume = 4.0 / 3.0 * np.pi * a * b * c
    # α = abc ∫ dλ / ((a² + λ) Δ) is Carlson's R_D, symmetric in its first two arguments.
    squares = semi_axes**2
    alpha = np.array(
        [
            2.0 / 3.0 * a * b * c
            * elliprd(squares[(k + 1) % 3], squares[(k + 2) % 3], squares[k])
            for k in range(3)
        ]
    )  # fmt: skip
    mass = volume * alpha / (2.0 - alpha)
    moment = np.zeros(3)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        difference, total = squares[i] - squares[j], squares[i] + squares[j]
        dalpha = alpha[i] - alpha[j]
        # The moment tends to zero with b − c: a rotationally symmetric body drags no fluid along.
        if abs(difference) > 1e-12 * total:
            denominator = 2.0 * difference + total * dalpha
            moment[k] = volume / 5.0 * difference**2 * -dalpha / denominator
    return mass, moment


def fluid_form(
    system: System, density: float, bodies: Mapping[str, Ellipsoid | Ellipse | ArrayLike]
) -> ConnectionForm:
    """Return the symmetric form of the momenta of a robot and the fluid around it.

    Args:
        system: The system.
        density: Density of the fluid, see `Connection.fluid`.
        bodies: Bodies by link, see `Connection.fluid`.
    Returns:
        The form.
    Raises:
        InputError: There are no bodies.
    """
    system = checked_system(system, "Connection.fluid")
    rho = positive(density, "density")
    added = _tensors(system, bodies, "bodies", "Ellipsoid, Ellipse")
    tensors = [a + rho * b for a, b in zip(inertia_tensors(system), added, strict=True)]
    what = f"the momenta of '{system.name}' and the fluid around it"
    return tensor_form(system, tensors, what, rotors=True)
