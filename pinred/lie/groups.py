"""The symmetry groups by name, with their coordinates.

A pose g is a vector of coordinates, and a twist ξ = g⁻¹ġ is a body velocity:

    group   pose                        twist               root joint
    R       (s,)          m             (v,)                prismatic
    SO2     (θ,)          rad           (ω,)                revolute or continuous
    SE2     (x, y, θ)     m, m, rad     (v1, v2, ω)         planar
    SO3     (qx, qy, qz, qw)            (ω1, ω2, ω3)        spherical
    SE3     (x, y, z, qx, qy, qz, qw)   (v, ω)              free flyer
    RxSE2   (z, x, y, θ)  m, m, m, rad  (v3, v1, v2, ω)     prismatic with planar across it

Twists and momenta are ordered [linear; angular], and quaternions end with the real part, as in
Pinocchio.  Planar angles are not wrapped, so a pose keeps its number of full turns; `log`
returns the principal value.  All functions accept leading axes: poses (..., size) and twists
(..., dim).

Each group is defined in a module of this folder.  A `Group` instance in a new module is registered
automatically.  The closed forms follow J. Solà, J. Deray, D. Atchuthan, "A micro Lie theory for
state estimation in robotics", 2018, appendices.  They are rearranged so that no formula loses
digits near the identity or near half a turn.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from ..common.argument_kinds import checks_arguments
from ..common.errors import InputError
from .group import Group
from .planar_groups import SE2 as SE2
from .planar_groups import SO2 as SO2
from .planar_groups import R as R
from .r_se2 import RxSE2 as RxSE2
from .spatial_groups import SE3 as SE3
from .spatial_groups import SO3 as SO3


def _groups() -> dict[str, Group]:
    """Return the groups defined in this folder, by name, in order of dimension."""
    groups: list[Group] = []
    for module in iter_modules([str(Path(__file__).parent)]):
        contents = vars(import_module(f"{__package__}.{module.name}"))
        groups += [value for value in contents.values() if isinstance(value, Group)]
    return {group.name: group for group in sorted(groups, key=lambda g: (g.dim, g.name))}


GROUPS = _groups()


@checks_arguments
def group_named(name: str) -> Group:
    """Return the group with a name.

    Args:
        name: Name of the group; upper and lower case are equivalent.
    Returns:
        The group.
    Raises:
        InputError: No group has this name.  The message lists the valid names.
    """
    if isinstance(name, str):
        for group_name, group in GROUPS.items():
            if group_name.lower() == name.lower():
                return group
    raise InputError(f"unknown group {name!r}; the groups are {', '.join(GROUPS)}")
