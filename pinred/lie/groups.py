"""The groups by name.

A pose g is a vector of coordinates, a twist ξ = g⁻¹ġ a body velocity:

    group   pose                        twist               root joint
    R       (s,)          m             (v,)                prismatic
    SO2     (θ,)          rad           (ω,)                revolute or continuous
    SE2     (x, y, θ)     m, m, rad     (v1, v2, ω)         planar
    SO3     (qx, qy, qz, qw)            (ω1, ω2, ω3)        spherical
    SE3     (x, y, z, qx, qy, qz, qw)   (v, ω)              free flyer
    RxSE2   (z, x, y, θ)  m, m, m, rad  (v3, v1, v2, ω)     prismatic with planar across it

Twists and momenta are [linear; angular], quaternions end with the real part, both
as in Pinocchio.  Planar angles are not wrapped: a pose that has turned twice says
so, and `log` returns the principal value.  Every function takes leading axes:
poses (..., size) and twists (..., dim).

All that pinred knows of a group stands in its file: another one is a file beside these, found
by itself.  Source of the closed forms: J. Solà, J. Deray, D. Atchuthan, "A micro Lie
theory for state estimation in robotics", 2018, appendices; written here so that no formula
loses digits near the identity or near a half turn.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from ..common.errors import InputError
from .group import Group
from .line_and_circle import SO2 as SO2
from .line_and_circle import R as R
from .r_se2 import RxSE2 as RxSE2
from .se2 import SE2 as SE2
from .se3 import SE3 as SE3
from .so3 import SO3 as SO3


def _groups() -> dict[str, Group]:
    """Return the groups that the files beside this one define, by name, small ones first."""
    found: list[Group] = []
    for module in iter_modules([str(Path(__file__).parent)]):
        known = vars(import_module(f"{__package__}.{module.name}"))
        found += [each for each in known.values() if isinstance(each, Group)]
    return {group.name: group for group in sorted(found, key=lambda each: (each.dim, each.name))}


GROUPS = _groups()


def group_named(name: str) -> Group:
    """Return the group called `name`, in small or large letters.

    Raises InputError listing the valid names.
    """
    if isinstance(name, str):
        for known, group in GROUPS.items():
            if known.lower() == name.lower():
                return group
    raise InputError(f"unknown group {name!r}; the groups are {', '.join(GROUPS)}")
