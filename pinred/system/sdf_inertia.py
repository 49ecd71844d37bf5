"""Inertias of SDF links that no rigid body has, which Drake replaces by others.

Many files state such moments.  Drake then gives the link another mass and other moments.  To read
the numbers of the file, a multiple of the identity is added to the moments in the copy for Drake,
and subtracted from what Drake has read.  In all axes this multiple is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ..common.names import quoted

_MOMENTS = {
    "ixx": 1.0,
    "ixy": 0.0,
    "ixz": 0.0,
    "iyy": 1.0,
    "iyz": 0.0,
    "izz": 1.0,
}  # SDF's defaults
_ROUND_OFF = 1e-9  # relative margin of the triangle inequality


def added_moment(
    inertial: Element,
    copy: Element,
    number: Callable[[Element], float],
    fail: Callable[[Element, str], NoReturn],
) -> tuple[float, float]:
    """Add a multiple of the identity to moments that no rigid body has.

    Args:
        inertial: Element <inertial> of the file.
        copy: Copy of its link for Drake, changed in place.
        number: Function that reads the number in an element.
        fail: Function that raises an error about an element.
    Returns:
        The moment that is added to each diagonal entry, 0 for a rigid body, and the trace of the
        moments without it [kg m²].
    Raises:
        LoadError: The mass or a moment is negative, or the mass is zero with moments.
    """
    mass, owner = inertial.find("mass"), f"link {quoted(copy.get('name', ''))}"
    kg = 1.0 if mass is None else number(mass)
    stated = {key: inertial.find(f"inertia/{key}") for key in _MOMENTS}
    values = {
        key: _MOMENTS[key] if element is None else number(element)
        for key, element in stated.items()
    }
    if mass is not None and kg <= 0.0 and (kg < 0.0 or any(values.values())):
        fail(
            mass, f"{owner} has mass {kg:g} and moments of inertia; state a positive mass, or zeros"
        )
    xx, xy, xz, yy, yz, zz = values.values()
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if moments[0] + moments[1] >= (1.0 + _ROUND_OFF) * moments[2] or not moments.any():
        return 0.0, xx + yy + zz
    if moments[0] < -_ROUND_OFF * abs(moments[2]):
        shown = ", ".join(f"{moment:g}" for moment in moments)
        fail(
            inertial, f"{owner} has principal moments of inertia {shown}; all must be positive or 0"
        )
    added = 4.0 * float(np.abs(moments).max())
    element = _child(_child(copy, "inertial"), "inertia")
    for key in ("ixx", "iyy", "izz"):
        _child(element, key).text = repr(values[key] + added)
    return added, xx + yy + zz


def _child(element: Element, tag: str) -> Element:
    child = element.find(tag)
    return SubElement(element, tag) if child is None else child
