"""Why a motion cannot go on: the mass matrix is singular where it has come to."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..common.plain_names import quoted
from ..system.system import System
from .inertia_split import mass_matrix, usual_inertias, usual_mass_matrices

_LOST = 1e-6  # of the usual; the square of the distance from a singular shape
_LEADING = 0.1  # of the motion's largest part: the first joint that has as much has lost its mass


def lost_inertia(system: System, x: Array) -> str:
    """Return words, to be added to a message, on who moves hardly any mass at shape x (m,).

    Empty if the least inertia there, each coordinate scaled by its usual inertia, is not far
    below what it is at random shapes.
    """
    if not np.isfinite(x).all():
        return ""
    size, others = np.sqrt(usual_inertias(system)), usual_mass_matrices(system)
    if not (size > 0.0).all():
        return ""
    scale = np.outer(size, size)
    usual = float(np.median([np.linalg.eigvalsh(H / scale)[0] for H in others]))
    values, directions = np.linalg.eigh(mass_matrix(system, x) / scale)
    if not values[0] < _LOST * usual:
        return ""
    part = np.abs(directions[:, 0])
    i = int(np.argmax(part > _LEADING * part.max()))
    root = i < system.r
    who = (
        f"the root joint {quoted(system.root_name)}"
        if root
        else f"joint {quoted(system.shape_names[i - system.r])}"
    )
    return f"; the mass matrix is singular there or nearby, where {who} moves no mass"
