"""Scales of a robot: masses that joints move, radii of gyration, and extreme values."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array
from .joints import axes_of
from .system import System

# Masses [kg] and lengths [m] outside the range from 1/limit to limit count as extreme.
_MASS, _LENGTH = 1e12, 1e5


def ill_scaled(system: System) -> str:
    """Return a warning about extreme masses or lengths of a system, with a remedy, or ""."""
    model = system.sorted_model
    bodies = [body for body in model.inertias[1:] if body.mass > 0.0]
    steps = [float(np.linalg.norm(place.translation)) for place in model.jointPlacements[2:]]
    reaches = [float(np.hypot(np.linalg.norm(b.lever), radius_of_gyration(b))) for b in bodies]
    ranges = []
    for what, unit, most, sizes in (
        ("masses", "kg", _MASS, [body.mass for body in bodies]),
        ("lengths", "m", _LENGTH, [*reaches, *steps]),
    ):
        sizes = [size for size in sizes if size > 0.0]
        if sizes and (max(sizes) > most or min(sizes) < 1.0 / most):
            ranges.append(f"{what} from {min(sizes):.1e} to {max(sizes):.1e} {unit}")
    if not ranges:
        return ""
    return (
        f"'{system.name}' is ill-scaled: it has {' and '.join(ranges)}, so round-off hides small "
        "terms; write it in units in which masses and lengths are near 1 (gravity and forces with "
        "them)"
    )


def moved_masses(model: pin.Model, data: pin.Data, q: Array) -> tuple[NDArray[np.bool_], Array]:
    """Compute the mass that each velocity moves.

    Args:
        model: Model.
        data: Work space of the model; it is overwritten.
        q: Configuration, (nq,).
    Returns:
        Whether each velocity is a rotation, (nv,); and the mass that each velocity moves, (nv,)
        [kg].
    """
    pin.crba(model, data, q)
    angular, mass = np.ones(model.nv, dtype=bool), np.empty(model.nv)
    for i in range(1, model.njoints):
        joint = model.joints[i]
        entries = slice(joint.idx_v, joint.idx_v + joint.nv)
        angular[entries] = np.abs(axes_of(joint)[3:]).sum(axis=0) > 0.0
        mass[entries] = data.Ycrb[i].mass
    return angular, mass


def radius_of_gyration(body: pin.Inertia) -> float:
    """Compute √(tr I / m) of a body about its centre of mass [m]; 0 without mass."""
    if not body.mass > 0.0:
        return 0.0
    return float(np.sqrt(max(0.0, np.trace(body.inertia)) / body.mass))
