"""When two shapes are one: where the bodies are, not what the coordinates say.

Angles have periods, and universal joints reach every place twice.  What is compared is how the
masses of all bodies lie about the axis of the motion: numbers that no turn of the base changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from .problem import Problem

_SAME = 1e-5  # of the size of the robot; positions at degenerate equilibria are no better


@dataclass(frozen=True)
class Place:
    """Numbers of a shape and its axis.  odd: those that change sign when the axis is reversed."""

    even: Array
    odd: Array

    def same(self, other: Place, *, reversible: bool) -> bool:
        """Return whether two shapes are one.  reversible: or one with the opposite axis."""
        if np.abs(self.even - other.even).max(initial=0.0) > _SAME:
            return False
        apart = np.abs(self.odd - other.odd).max(initial=0.0)
        if reversible:
            apart = min(apart, float(np.abs(self.odd + other.odd).max(initial=0.0)))
        return bool(apart <= _SAME)


def place_of(problem: Problem, x: Array, n: Array) -> Place:
    """Return the place of the bodies at shape x (m,) about direction n (3,), or (0,) for none."""
    system = problem.system
    model, data = system.model, system.data
    pin.forwardKinematics(model, data, system.model_q(system.group.identity(), x))
    root, mass = data.oMi[1], system.mass
    bodies = [root.actInv(data.oMi[i]).act(model.inertias[i]) for i in range(1, model.njoints)]
    masses = np.array([body.mass for body in bodies])
    centres = np.array([body.lever for body in bodies])
    pinned = system.group.turns and not system.group.turns_about_com
    about = np.zeros(3) if pinned else masses @ centres / mass
    T = np.array([body.inertia for body in bodies])
    size = np.sqrt((np.trace(T, axis1=1, axis2=2).sum() + masses @ (centres**2).sum(axis=1)) / mass)
    size = max(float(size), 1e-300)
    a = np.sqrt(masses / mass)[:, None] * (centres - about) / size
    T = T / (mass * size**2)
    if not n.size:
        n = problem.axis
    if not system.group.turns:
        return Place(np.concatenate([a.ravel(), T.ravel()]), np.zeros(0))
    across = [np.einsum("i,kij,lj->kl", n, T, a), np.einsum("k,lki->li", n, T)]
    turned = np.cross(across[1][:, None], a[None])
    even = [
        a @ a.T,
        np.einsum("i,kij,j->k", n, T, n),
        np.einsum("kij,lji->kl", T, T),
        np.einsum("li,kij,lj->kl", a, T, a),
        across[1] @ across[1].T,
        turned @ n,
    ]
    odd = [a @ n, np.einsum("i,kli->kl", n, np.cross(a[:, None], a[None])), across[0]]
    if not n.any():  # at rest in free space
        odd = []
        even += [np.einsum("kli,mi->klm", np.cross(a[:, None], a[None]), a)]
    flat = [[np.ravel(part) for part in parts] for parts in (even, odd)]
    return Place(*(np.concatenate([*parts, np.zeros(0)]) for parts in flat))
