"""Dampers and dry friction of a pin.Model, as it has them from a URDF's <dynamics>."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..common.errors import ModelError
from ..common.plain_names import quoted
from .contents import Contents, LeftOut
from .force import Force
from .passive import BASE, Damper, Friction
from .urdf import moving_joints
from .xml_numbers import floats

UNEVEN = "dry friction that is not the same in both directions"


@dataclass
class _Found:
    forces: list[Force] = field(default_factory=list)
    base: list[str] = field(default_factory=list)
    uneven: list[str] = field(default_factory=list)


def passive_contents(raw: pin.Model, shape: Sequence[str], locked: Collection[str]) -> Contents:
    """Return the dampers and the friction of a model, and what of them is left out.

    shape: the joints of the shape.  locked: joints that are frozen; all others are the base's.
    Raises ModelError for numbers that are not finite.
    """
    found = _Found()
    for i in range(1, raw.njoints):
        name = str(raw.names[i])
        if name not in locked:
            _look_at(raw, i, name in shape, found)
    left_out = {BASE: found.base, UNEVEN: found.uneven}
    return Contents(
        left_out=tuple(LeftOut(what, tuple(names)) for what, names in left_out.items() if names),
        passive=tuple(found.forces),
    )


def _look_at(raw: pin.Model, joint: int, in_shape: bool, found: _Found) -> None:
    name, entry = str(raw.names[joint]), raw.joints[joint]
    at = slice(entry.idx_v, entry.idx_v + entry.nv)
    damping, most = raw.damping[at], raw.upperDryFrictionLimit[at]
    least = raw.lowerDryFrictionLimit[at]
    if not np.isfinite([*damping, *most, *least]).all():
        raise ModelError(
            f"joint {quoted(name)} has damping or friction that is not a finite number"
        )
    if not (damping.any() or most.any() or least.any()):
        return
    if not in_shape:
        found.base.append(name)
        return
    if damping[0]:
        found.forces.append(Damper(name, float(damping[0])))
    if most[0] == -least[0]:
        if most[0]:
            found.forces.append(Friction(name, float(most[0])))
    else:
        found.uneven.append(name)


def keep_dynamics(robot: Element, model: pin.Model) -> None:
    """Write the <dynamics> of planar and floating joints into a model: its reader drops them."""
    for joint in moving_joints(robot):
        dynamics, name = joint.find("dynamics"), joint.get("name", "?")
        if dynamics is None or joint.get("type") not in ("planar", "floating"):
            continue
        entry = model.joints[model.getJointId(name)]
        at = slice(entry.idx_v, entry.idx_v + entry.nv)
        for key, arrays in (
            ("damping", [(model.damping, 1.0)]),
            (
                "friction",
                [(model.upperDryFrictionLimit, 1.0), (model.lowerDryFrictionLimit, -1.0)],
            ),
        ):
            if key in dynamics.attrib:
                (value,) = floats(dynamics, key, f"the dynamics of joint '{name}'", 1)
                for array, sign in arrays:
                    array[at] = sign * value
