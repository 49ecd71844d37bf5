"""Angles of an initial shape that are none: known to no digit, or perhaps meant in degrees."""

from __future__ import annotations

import math

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.plain_names import quoted
from ..system.joints import joint_units
from ..system.system import System

_KNOWN = 1e-6  # rad; to what an angle must be known
_TURN = 2.0 * math.pi


def refuse_vague(x: Array, system: System) -> None:
    """Refuse angles (m,) so large that the next number is another angle.  Raises InputError."""
    for name, angle in _angles(x, system):
        if np.spacing(abs(angle)) > _KNOWN:
            raise InputError(
                f"x0: the angle of joint {quoted(name)}, {angle:g} rad, is known to "
                f"{np.spacing(abs(angle)):.1g} rad only, so its sine means nothing; give it "
                "within a turn"
            )


def large_angles(x: Array, system: System) -> str:
    """Return a sentence on angles (m,) above a whole turn; nothing if there are none."""
    found = [(name, angle) for name, angle in _angles(x, system) if abs(angle) > _TURN]
    if not found:
        return ""
    name, angle = max(found, key=lambda each: abs(each[1]))
    others = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return (
        f"joint {quoted(name)} begins at {angle:g} rad, {abs(angle) / _TURN:.3g} turns{others}; "
        f"in degrees that would be {math.radians(angle):.4g} rad"
    )


def _angles(x: Array, system: System) -> list[tuple[str, float]]:
    """Return names and angles of the joints that turn."""
    names = system.shape_names
    every = dict(zip(list(system.model.names)[2:], joint_units(system.model), strict=True))
    return [(n, float(v)) for n, v in zip(names, x, strict=True) if every[n] == "rad"]
