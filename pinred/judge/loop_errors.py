"""Closed loops as constraints of the full state, by Pinocchio; also loops that are couplings.

The loops' equations and Jacobian come from the frames in Pinocchio's model, and all equations are
used, also redundant ones.  The reduced equations use other expressions and independent equations.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..system.loops.kinematics import LoopKinematics
from ..system.loops.loop_assembly import assemble, loop_length
from ..system.state_fields import State
from ..system.system import System

RANK = 1e-6  # singular values below this fraction of the largest belong to redundant equations


@dataclass(frozen=True)
class LoopErrors:
    """Violations of the loops along a motion.

    Attributes:
        gap: Largest |φ|, in units of the size of the loops or 1 rad; None without loops.  Files
            round numbers, so redundant equations may differ by rounding from others; the part of φ
            that no joint can change is left out.
        rate: Largest |φ̇|, without the same part, relative to its largest value if all joints moved
            at the fastest rate; None without loops.
    """

    gap: float | None = None
    rate: float | None = None


def loop_errors(system: System, states: State) -> LoopErrors:
    """Measure the violations of the loops with Pinocchio at the q and v of states."""
    loops = (*system.loops, *system.contents.coupled_loops)
    if not loops:
        return LoopErrors()
    kinematics = LoopKinematics(system.sorted_model, loops)
    unit = np.where(kinematics.is_length, loop_length(system, loops), 1.0)
    gap, rates, terms = 0.0, np.zeros(len(unit)), np.zeros(len(unit))
    for q, v in zip(system.sort_q(states.q), system.sort_v(states.v), strict=True):
        J = kinematics.jacobian(q)
        both = _reachable(J[:, system.r :], np.column_stack([kinematics.values(q), J @ v]))
        gaps, gap_rates = np.abs(both).T / unit
        gap, rates = max(gap, float(gaps.max())), np.maximum(rates, gap_rates)
        # The joints of a loop may rest exactly, so the unit is the fastest rate of any joint.
        fastest = float(np.abs(v[system.r :]).max(initial=0.0))
        terms = np.maximum(terms, np.abs(J).sum(axis=1) * fastest / unit)
    largest = float(terms.max())
    return LoopErrors(gap, float(rates.max()) / largest if largest > 0.0 else 0.0)


def _reachable(J: Array, values: Array) -> Array:
    """Return the parts of values of φ or φ̇, (c, k), that joints can change."""
    U, sizes, _ = np.linalg.svd(J, full_matrices=False)
    U = U[:, sizes > RANK * sizes[0]]
    return np.asarray(U @ (U.T @ values))


def closed(
    system: System, x: Array, xdot: Array, driven: Collection[int] = ()
) -> tuple[Array, Array]:
    """Return the nearest shape (nx,) and rates (m,) that keep all loops closed.

    Rates with the indices `driven`, and the coordinates of their joints, do not change.
    """
    assert system.closure is not None
    free = np.ones(system.m)
    free[list(driven)] = 0.0
    x, _ = assemble(system, x, system.closure.length, free)
    kinematics = LoopKinematics(system.sorted_model, system.loops)
    q = system.sorted_q(system.group.identity(), x)
    J = system.on_shape(kinematics.jacobian(q))[:, system.r :]
    return x, xdot - np.linalg.lstsq(J * free, J @ xdot, rcond=RANK)[0] * free
