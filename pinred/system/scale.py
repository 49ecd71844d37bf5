"""The scale of a robot: whether its units are so extreme that numbers of 64 bits lose it."""

from __future__ import annotations

import numpy as np

from .system import System

_MASS, _LENGTH = 1e12, 1e5  # kg and m; up to which, and down to one over which, scales are usual


def ill_scaled(system: System) -> str:
    """Return a sentence on extreme masses or lengths of a system, with the cure; else nothing."""
    model = system.model
    bodies = [model.inertias[i] for i in range(1, model.njoints) if model.inertias[i].mass > 0.0]
    reach = [np.linalg.norm(place.translation) for place in list(model.jointPlacements)[2:]]
    lengths = [
        float(np.sqrt(body.lever @ body.lever + np.trace(body.inertia) / body.mass))
        for body in bodies
    ]
    said = []
    for what, unit, most, sizes in (
        ("masses", "kg", _MASS, [body.mass for body in bodies]),
        ("lengths", "m", _LENGTH, [*lengths, *map(float, reach)]),
    ):
        sizes = [size for size in sizes if size > 0.0]
        if sizes and (max(sizes) > most or min(sizes) < 1.0 / most):
            said.append(f"{what} from {min(sizes):.1e} to {max(sizes):.1e} {unit}")
    if not said:
        return ""
    return (
        f"'{system.name}' is "
        f"ill-scaled: it has {' and '.join(said)}, and its numbers round off what matters; write "
        "it in units in which masses and lengths are near 1 (gravity and forces with them)"
    )
