"""The discrete action of motions at equal times, from Pinocchio's mass matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

import pinred
from pinred import Gauss, Variational
from pinred.common.arrays import Array
from pinred.system.system import System

STIFFNESS, REST = 3.0, 0.2


class Action:
    """The discrete action of points (x, R) at equal times, from Pinocchio's mass matrix.

    In the frame of the centre of mass: the translation is eliminated from the mass matrix.
    """

    def __init__(self, system: System, h: float) -> None:
        """Steps of a length."""
        self._system, self._h, self._data = system, h, system.model.createData()

    def metric(self, x: Array) -> Array:
        """Mass matrix of (ω, ẋ)."""
        system, k = self._system, self._system.group.linear
        H = pin.crba(system.model, self._data, system.q(system.group.identity(), x))
        H = np.triu(H) + np.triu(H, 1).T
        return np.asarray(H[k:, k:] - H[k:, :k] @ np.linalg.solve(H[:k, :k], H[:k, k:]))

    def term(self, a: tuple[Array, Any], b: tuple[Array, Any]) -> float:
        """L_d: the harmonic mean of the metrics at both ends, with the mean velocity."""
        (x0, g0), (x1, g1), h = a, b, self._h
        if isinstance(g0, Rotation):
            turn = (g0.inv() * g1).as_quat()
            u = 2.0 * turn[:3] / turn[3]
        else:
            u = g1 - g0
        v = np.append(u, x1 - x0) / h
        both = np.linalg.inv(self.metric(x0)) + np.linalg.inv(self.metric(x1))
        potential = 0.5 * STIFFNESS * sum(float(((x - REST) ** 2).sum()) for x in (x0, x1))
        return h * float(v @ np.linalg.solve(both, v)) - 0.5 * h * potential

    def slope(self, points: list[tuple[Array, Any]], k: int, along: Array, eps: float) -> float:
        """Derivative of the action as one inner point moves along a direction."""
        x, g = points[k]

        def at(s: float) -> float:
            turn = s * along[: len(along) - len(x)]
            turned = g * Rotation.from_rotvec(turn) if isinstance(g, Rotation) else g + turn
            moved = (x + s * along[len(along) - len(x) :], turned)
            return self.term(points[k - 1], moved) + self.term(moved, points[k + 1])

        return (8.0 * (at(eps) - at(-eps)) - (at(2 * eps) - at(-2 * eps))) / (12.0 * eps)


def points_of(
    system: System, method: Variational | Gauss, count: int, **start: Any
) -> list[tuple[Array, Any]]:
    """Return shape and attitude at the step ends."""
    end = count * method.step
    traj = pinred.simulate(
        system,
        times=np.linspace(0.0, end, count + 1),
        springs=dict.fromkeys(system.shape_names, (STIFFNESS, REST)),
        method=method,
        **start,
    )
    assert traj.run.steps == count
    g = traj.pose[:, system.group.linear :]
    return [
        (x, Rotation.from_quat(q) if len(q) == 4 else q) for x, q in zip(traj.x, g, strict=True)
    ]
