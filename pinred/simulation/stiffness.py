"""Stiffness of the forces of a scene: rates of decay and oscillation near rest.

At zero momentum the linearisation of M ẍ = τ(x, ẋ) has K = −∂τ/∂x and D = −∂τ/∂ẋ.  The rates are
the eigenvalues of [[0, 1], [−M⁻¹K, −M⁻¹D]].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..common.errors import SingularInertiaError
from ..common.memo import once
from ..forces.acting import BaseInSpace, ForceInputs
from ..forces.force_model import ForceModel
from ..reduction.at_a_shape import PointwiseReduction
from ..scene.scene import Scene
from ..system.system import System

_STEP = 1e-4  # Step of the differences of forces [rad | m, and per second].


@dataclass(frozen=True)
class Rates:
    """The fastest rates of a linear system.

    Attributes:
        decay: Rate of the fastest decay [1/s].
        oscillation: Angular frequency of the fastest oscillation [rad/s].
    """

    decay: float
    oscillation: float


def rates_near_rest(scene: Scene) -> Rates:
    """Return the rates of a scene's forces at shape zero, cached for equal forces.

    They are zero if no force does work, or the forces are not defined at shape zero.
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
    except SingularInertiaError:  # The scene need not contain shape zero.
        return Rates(0.0, 0.0)

    def torque(x: Array, xdot: Array) -> Array:
        xi = -at.local_connection @ xdot  # The body twist at zero momentum.
        base = BaseInSpace(system.group.identity(), xi, np.zeros(r), np.zeros(r))
        return forces.acting(ForceInputs(0.0, x, xdot, xi, np.zeros(r), numbers, base)).torque

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
        accelerations = np.linalg.solve(M, np.hstack([-K, -D]))
    if not np.isfinite(accelerations).all():
        return Rates(0.0, 0.0)
    rates = np.hstack([np.zeros_like(M), np.eye(len(free))])
    values = np.linalg.eigvals(np.vstack([rates, accelerations]))
    swinging = np.abs(values.imag) > np.abs(values.real)
    return Rates(
        decay=max(0.0, float(-values.real.min())),
        oscillation=float(np.abs(values.imag[swinging]).max(initial=0.0)),
    )
