"""Initial angles that are suspicious: too large to be accurate, or perhaps meant in degrees."""

from __future__ import annotations

import math

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.plain_names import quoted
from ..system.joints import joint_units
from ..system.system import System

_RESOLUTION = 1e-6  # largest spacing of floats at an accepted angle [rad]
_TURN = 2.0 * math.pi  # rad


def refuse_vague(x: Array, system: System) -> None:
    """Reject angles of a shape (m,) at which adjacent floats differ by more than 1e-6 rad.

    Raises InputError.
    """
    for name, angle in _angles(x, system):
        if np.spacing(abs(angle)) > _RESOLUTION:
            raise InputError(
                f"x0: the angle of joint {quoted(name)}, {angle:g} rad, is known to "
                f"{np.spacing(abs(angle)):.1g} rad only, so its sine means nothing; give it "
                "within a turn"
            )


def large_angles(x: Array, system: System) -> str:
    """Return a sentence on angles of a shape (m,) above one turn; empty if there are none."""
    large = [(name, angle) for name, angle in _angles(x, system) if abs(angle) > _TURN]
    if not large:
        return ""
    name, angle = max(large, key=lambda named: abs(named[1]))
    others = f" (and {len(large) - 1} more)" if len(large) > 1 else ""
    return (
        f"joint {quoted(name)} begins at {angle:g} rad, {abs(angle) / _TURN:.3g} turns{others}; "
        f"in degrees that would be {math.radians(angle):.4g} rad"
    )


def _angles(x: Array, system: System) -> list[tuple[str, float]]:
    """Return names and angles of the revolute joints of a shape (m,)."""
    names = system.shape_names
    units = dict(zip(list(system.model.names)[2:], joint_units(system.model), strict=True))
    return [(n, float(v)) for n, v in zip(names, x, strict=True) if units[n] == "rad"]
