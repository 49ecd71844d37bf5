"""Drift of energy and momentum from start to end, computed by Pinocchio for every method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from .problems import Problem


@dataclass(frozen=True)
class Drift:
    """Relative changes of conserved quantities from the start to the end of a motion.

    Attributes:
        energy: Change of energy relative to the initial kinetic energy T, which excludes the
            uniform motion of the centre of mass.
        momentum: Largest change of a conserved component, relative to √(2mT); for angular
            components, to √(2mT) times the radius of gyration. Angular momentum is taken about
            the centre of mass if the group translates, else about the pivot.
    """

    energy: float
    momentum: float


def compute_drift(problem: Problem, q: Array, v: Array) -> Drift:
    """Compute the drift between the start of a problem and a final state q (nq,), v (n,)."""
    full, system, start = problem.full, problem.system, problem.start
    k = system.group.linear
    q0, v0 = problem.q0, problem.v0
    total = full.totals.kinetic_energy(q0, v0)
    internal = total - full.totals.com_kinetic_energy(q0, v0)
    scale = internal if internal > 1e-9 * total else total
    fall = system.mass * system.gravity * start.duration
    about_pivot = not system.group.turns_about_com
    before = full.totals.momentum(q0, v0, np.zeros(3), about_pivot=about_pivot)
    after = full.totals.momentum(q, v, fall, about_pivot=about_pivot)
    unit = np.full(system.r, np.sqrt(2.0 * system.mass * scale))
    unit[k:] *= full.totals.radius_of_gyration(q0)
    energy = total + full.totals.potential_energy(q0)
    gained = full.totals.kinetic_energy(q, v) + full.totals.potential_energy(q) - energy
    return Drift(
        energy=float(abs(gained) / scale if scale > 0.0 else abs(gained)),
        momentum=float(np.max(np.abs(after - before) / np.where(unit > 0.0, unit, 1.0))),
    )
