"""Stiffness of the forces of a scene: the rates at which it comes to rest, and oscillates.

Near rest, with no momentum, M ẍ = τ(x, ẋ) has the derivatives K = −∂τ/∂x and D = −∂τ/∂ẋ, and the
eigenvalues of [[0, 1], [−M⁻¹K, −M⁻¹D]] are its rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..common.errors import SingularInertiaError
from ..common.memo import once
from ..forces.acting import BaseInSpace
from ..forces.force_model import ForceModel
from ..reduction.at_a_shape import PointwiseReduction
from ..scene.scene import Scene
from ..system.system import System

_STEP = 1e-4  # rad | m, and per second: forces are rarely more curved than that


@dataclass(frozen=True)
class Rates:
    """decay: of what dies out fastest [1/s].  oscillation: of what swings fastest [rad/s]."""

    decay: float
    oscillation: float


def rates_near_rest(scene: Scene) -> Rates:
    """Return the rates of a scene's forces at shape zero, found once for the same forces.

    Zero if nothing does work, or the forces are not defined there.
    """
    forces = scene.force_model
    if forces is None or not forces.labels or len(forces.joints) == scene.system.m:
        return Rates(0.0, 0.0)
    numbers = forces.numbers_from(0.0, scene.end)
    return once(forces, (Rates, numbers.tobytes()), lambda: _rates(scene.system, forces, numbers))


def _rates(system: System, forces: ForceModel, numbers: Array) -> Rates:
    m, r = system.m, system.r
    try:
        at = PointwiseReduction(system).at(np.zeros(m))
    except SingularInertiaError:  # at shape zero, where the scene need not be
        return Rates(0.0, 0.0)

    def torque(x: Array, xdot: Array) -> Array:
        xi = -at.local_connection @ xdot  # no momentum
        base = BaseInSpace(system.group.identity(), xi, np.zeros(r), np.zeros(r))
        return forces.acting(0.0, x, xdot, xi, np.zeros(r), numbers, base).torque

    rest = np.zeros(m)
    K, D = np.empty((m, m)), np.empty((m, m))
    for k in range(m):
        e = np.zeros(m)
        e[k] = _STEP
        K[:, k] = (torque(-e, rest) - torque(e, rest)) / (2.0 * _STEP)
        D[:, k] = (torque(rest, -e) - torque(rest, e)) / (2.0 * _STEP)
    free = np.setdiff1d(np.arange(m), list(forces.joints))
    K, D, M = (matrix[np.ix_(free, free)] for matrix in (K, D, at.reduced_metric))
    with np.errstate(over="ignore", invalid="ignore"):
        slope = np.linalg.solve(M, np.hstack([-K, -D]))
    if not np.isfinite(slope).all():
        return Rates(0.0, 0.0)
    values = np.linalg.eigvals(np.vstack([np.hstack([np.zeros_like(M), np.eye(len(free))]), slope]))
    swinging = np.abs(values.imag) > np.abs(values.real)
    return Rates(
        decay=max(0.0, float(-values.real.min())),
        oscillation=float(np.abs(values.imag[swinging]).max(initial=0.0)),
    )
