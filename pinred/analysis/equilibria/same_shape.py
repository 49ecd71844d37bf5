"""Identify shapes by the positions of the bodies instead of the joint coordinates.

Angles are periodic, and universal joints reach every orientation twice. Two shapes are compared by
invariants of the mass distribution about the axis of the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from .equilibrium_problem import Problem

_SAME = 1e-5  # largest difference of equal invariants, relative to the robot's size


@dataclass(frozen=True)
class Place:
    """Invariants of the mass distribution at a shape about the axis of the motion.

    Attributes:
        even: Invariants that do not change when the axis is reversed.
        odd: Invariants that change sign when the axis is reversed.
    """

    even: Array
    odd: Array

    def same(self, other: Place, *, reversible: bool) -> bool:
        """Return whether two shapes are the same.

        Args:
            other: Invariants of the other shape.
            reversible: Whether the opposite axis counts as the same motion.
        Returns:
            True if all invariants agree.
        """
        if np.abs(self.even - other.even).max(initial=0.0) > _SAME:
            return False
        difference = np.abs(self.odd - other.odd).max(initial=0.0)
        if reversible:
            difference = min(difference, float(np.abs(self.odd + other.odd).max(initial=0.0)))
        return bool(difference <= _SAME)


def place_of(problem: Problem, x: Array, n: Array) -> Place:
    """Compute the invariants of a shape.

    Args:
        problem: The problem.
        x: Shape, (m,).
        n: Direction in the body, (3,), or (0,) for none.
    Returns:
        The invariants.
    """
    system = problem.system
    model, data = system.model, system.data
    pin.forwardKinematics(model, data, system.model_q(system.group.identity(), x))
    root, mass = data.oMi[1], system.mass
    bodies = [root.actInv(data.oMi[i]).act(model.inertias[i]) for i in range(1, model.njoints)]
    masses = np.array([body.mass for body in bodies])
    centres = np.array([body.lever for body in bodies])
    pinned = system.group.turns and not system.group.turns_about_com
    origin = np.zeros(3) if pinned else masses @ centres / mass
    T = np.array([body.inertia for body in bodies])
    size = np.sqrt((np.trace(T, axis1=1, axis2=2).sum() + masses @ (centres**2).sum(axis=1)) / mass)
    size = max(float(size), 1e-300)
    a = np.sqrt(masses / mass)[:, None] * (centres - origin) / size
    T = T / (mass * size**2)
    if not n.size:
        n = problem.axis
    if not system.group.turns:
        return Place(np.concatenate([a.ravel(), T.ravel()]), np.zeros(0))
    coupling = [np.einsum("i,kij,lj->kl", n, T, a), np.einsum("k,lki->li", n, T)]
    crossed = np.cross(coupling[1][:, None], a[None])
    even = [
        a @ a.T,
        np.einsum("i,kij,j->k", n, T, n),
        np.einsum("kij,lji->kl", T, T),
        np.einsum("li,kij,lj->kl", a, T, a),
        coupling[1] @ coupling[1].T,
        crossed @ n,
    ]
    odd = [a @ n, np.einsum("i,kli->kl", n, np.cross(a[:, None], a[None])), coupling[0]]
    if not n.any():  # a free body at rest has no axis
        odd = []
        even += [np.einsum("kli,mi->klm", np.cross(a[:, None], a[None]), a)]
    flat = [[np.ravel(invariant) for invariant in invariants] for invariants in (even, odd)]
    return Place(*(np.concatenate([*invariants, np.zeros(0)]) for invariants in flat))
