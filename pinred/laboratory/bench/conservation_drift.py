"""Drift of energy and momentum: by Pinocchio, for every method alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from .problems import Problem


@dataclass(frozen=True)
class Drift:
    """Change from start to end, relative.

    energy: over the kinetic energy T at the start, less that of a centre of mass that goes
    on as it is.  momentum: the largest of the conserved components, over √(2mT), for angular
    ones times the radius of gyration.  Angular momentum is that about the centre of mass
    where the group translates, about the pivot elsewhere.
    """

    energy: float
    momentum: float


def compute_drift(problem: Problem, q: Array, v: Array) -> Drift:
    """Return the drift of a problem that has come to q (nq,) and v (n,)."""
    full, system, start = problem.full, problem.system, problem.start
    k = system.group.linear
    q0, v0 = problem.q0, problem.v0
    total = full.totals.kinetic_energy(q0, v0)
    internal = total - full.totals.com_kinetic_energy(q0, v0)
    scale = internal if internal > 1e-9 * total else total
    fall = system.mass * system.gravity * start.duration
    before = full.totals.momentum(q0, v0, np.zeros(3), about_pivot=not system.group.turns_about_com)
    after = full.totals.momentum(q, v, fall, about_pivot=not system.group.turns_about_com)
    unit = np.full(system.r, np.sqrt(2.0 * system.mass * scale))
    unit[k:] *= full.totals.radius_of_gyration(q0)
    energy = total + full.totals.potential_energy(q0)
    gained = full.totals.kinetic_energy(q, v) + full.totals.potential_energy(q) - energy
    return Drift(
        energy=abs(gained) / scale if scale > 0.0 else abs(gained),
        momentum=float(np.max(np.abs(after - before) / np.where(unit > 0.0, unit, 1.0))),
    )
