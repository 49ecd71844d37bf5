"""The connection of a body in a perfect fluid: its momentum and the fluid's vanish together."""

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
from .viscous import moved, tensor_form


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid in a perfect fluid, by Lamb's Hydrodynamics, §114 and §373.

    semi_axes: (3,) a, b, c [m].  centre: (3,) in its link's frame [m].  axis: (3,) of a; b and c
    stand across it.  Its added masses per density are V α/(2 − α), V the volume, and on turns
    about a  (V/5) (b² − c²)² (γ − β) / (2 (b² − c²) + (b² + c²) (β − γ)), and so on in turn.
    """

    semi_axes: ArrayLike
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        axes = vector(self.semi_axes, 3, "semi_axes", ("a", "b", "c"))
        if not (axes > 0.0).all():
            raise InputError(f"semi_axes must be above zero, got {axes}")
        own = np.diag(np.concatenate(added_masses(axes)))
        object.__setattr__(self, "tensor", moved(own, self.centre, self.axis))


@dataclass(frozen=True)
class Ellipse:
    """An elliptic cylinder across the plane of a planar robot, per metre of its height.

    a, b: semi-axes along and across its link's x axis [m].  centre, axis: as of an Ellipsoid.
    convention: of the added moment of inertia per density, "textbook" π/8 (a² − b²)² (Lamb,
    §71; Kelly and Murray), or "sysplotter" (a² − b²)², as that program has it.
    Added masses are π b² along and π a² across.
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
        turn = factors[self.convention] * (a**2 - b**2) ** 2
        own = np.diag([np.pi * b**2, np.pi * a**2, 0.0, 0.0, 0.0, turn])
        object.__setattr__(self, "tensor", moved(own, self.centre, self.axis))


def added_masses(semi_axes: Array) -> tuple[Array, Array]:
    """Return the added masses and moments of an ellipsoid per density, (3,) each [m³, m⁵]."""
    from scipy.special import elliprd

    a, b, c = semi_axes
    volume = 4.0 / 3.0 * np.pi * a * b * c
    # α = abc ∫ dλ / ((a² + λ) Δ): Carlson's R_D, symmetric in the other two.
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
        apart, both, slope = squares[i] - squares[j], squares[i] + squares[j], alpha[i] - alpha[j]
        # (b² − c²)² over the rest tends to zero with b − c: then nothing is dragged along.
        if abs(apart) > 1e-12 * both:
            moment[k] = volume / 5.0 * apart**2 * -slope / (2.0 * apart + both * slope)
    return mass, moment


def fluid_form(
    system: System, density: float, bodies: Mapping[str, Ellipsoid | Ellipse | ArrayLike]
) -> ConnectionForm:
    """Return the form of the momenta of a robot and of the fluid around it, symmetric.

    density: of the fluid [kg/m³]; for an Ellipse [kg/m²] if masses are per metre of height.
    bodies: of links by name, an Ellipsoid, an Ellipse, or added inertia per density as a symmetric
    tensor (6, 6) in the link's frame.  Bodies do not see each other's flow.
    """
    system = checked_system(system, "Connection.fluid")
    rho = positive(density, "density")
    if not isinstance(bodies, Mapping) or not bodies:
        raise InputError("bodies must be {link: Ellipsoid, Ellipse or tensor (6, 6)}, at least one")
    by_link = {
        name: rho
        * (each.tensor if isinstance(each, (Ellipsoid, Ellipse)) else np.asarray(each, dtype=float))
        for name, each in bodies.items()
    }
    added = tensors_by_body(system, by_link, "bodies")
    whole = [own + more for own, more in zip(inertia_tensors(system), added, strict=True)]
    what = f"the momenta of '{system.name}' and the fluid around it"
    return tensor_form(system, whole, what, rotors=True)
