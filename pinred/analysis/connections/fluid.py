"""The connection of a body in a perfect fluid: the momentum of body and fluid vanishes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, positive, vector
from ...common.errors import InputError
from ...kernels.connection.form import ConnectionForm
from ...reduction.tree.link_motions import inertia_tensors
from ...system.system import System, checked_system
from .links import tensors_by_body
from .viscous import in_link_frame, tensor_form


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid in a perfect fluid, by Lamb's Hydrodynamics, §114 and §373.

    With the volume V, its added mass per density along a is V α/(2 − α), and its added moment of
    inertia about a is (V/5) (b² − c²)² (γ − β) / (2 (b² − c²) + (b² + c²) (β − γ)); the others
    follow by cyclic permutation.

    Attributes:
        semi_axes: a, b, c, (3,) [m].
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
        about_centre = np.diag(np.concatenate(added_masses(axes)))
        object.__setattr__(self, "tensor", in_link_frame(about_centre, self.centre, self.axis))


@dataclass(frozen=True)
class Ellipse:
    """An elliptic cylinder across the plane of a planar robot, per metre of its height.

    Its added masses per density are π b² along a, and π a² along b.

    Attributes:
        a: Semi-axis along `axis` [m].
        b: Semi-axis across it [m].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction of a in its link's frame, (3,).
        convention: Added moment of inertia per density: "textbook", π/8 (a² − b²)² (Lamb, §71;
            Kelly and Murray), or "sysplotter", (a² − b²)², as in that program.
        tensor: Added inertia per density, (6, 6), in its link's frame about the origin.
    """

    a: float
    b: float
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    convention: Literal["textbook", "sysplotter"] = "textbook"
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        a, b = positive(self.a, "a"), positive(self.b, "b")
        factors = {"textbook": np.pi / 8.0, "sysplotter": 1.0}
        if self.convention not in factors:
            raise InputError(f"convention must be {' or '.join(factors)}, got {self.convention!r}")
        moment = factors[self.convention] * (a**2 - b**2) ** 2
        about_centre = np.diag([np.pi * b**2, np.pi * a**2, 0.0, 0.0, 0.0, moment])
        object.__setattr__(self, "tensor", in_link_frame(about_centre, self.centre, self.axis))


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
    if not isinstance(bodies, Mapping) or not bodies:
        raise InputError("bodies must be {link: Ellipsoid, Ellipse or tensor (6, 6)}, at least one")
    by_link = {
        name: rho
        * (body.tensor if isinstance(body, (Ellipsoid, Ellipse)) else np.asarray(body, dtype=float))
        for name, body in bodies.items()
    }
    added = tensors_by_body(system, by_link, "bodies")
    tensors = [a + b for a, b in zip(inertia_tensors(system), added, strict=True)]
    what = f"the momenta of '{system.name}' and the fluid around it"
    return tensor_form(system, tensors, what, rotors=True)
