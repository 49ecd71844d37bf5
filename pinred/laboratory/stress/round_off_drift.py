"""Check that quaternions and momenta drift at most like a random walk of round-off.

The momentum is computed with Pinocchio from (q, v), and the quaternion is checked by its norm.
Without the base, DOP853 integrates the three components of μ. Their norm is a Casimir function,
a constant of motion that DOP853 conserves up to its tolerance. Gauss methods lift μ to the
quaternion.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...integrators.methods import DOP853, Method
from ...system.load import load
from ...system.system import System
from .check import EPS, Case, Cases, Check, Trial, dop853

_WALK = 10.0  # bound in units of eps times the square root of the number of steps
_RTOL = 1e-12
# Initial twist of the base, and the step [s]; joints have their default initial state.
_STARTS = {
    "rigid_body": (np.array([0.5, 0.7, 1.6]), 0.1),
    "falling_cat": (np.array([0.1, 0.0, -0.1, 0.8, 0.4, -0.3]), 0.02),
}


def _cases(trial: Trial) -> Cases:
    count = trial.pick(10_000, 1_000_000, 10_000_000)
    walk = _WALK * EPS * math.sqrt(count)
    for name, (xi0, h) in _STARTS.items():
        system, times = load(name), np.linspace(0.0, count * h, 201)
        methods: list[Method] = [_fixed_dop853(h), *(make(h) for make in trial.fixed)]
        for method in methods:
            traj = trial.simulate_many(system, xi0=xi0[None], times=times, method=method)[0]
            case = f"{name}, {method.name}, {count:.0e} steps"
            length = np.linalg.norm(traj.pose[:, -4:], axis=1)
            yield Case(f"{case}, quaternion", float(np.abs(length - 1.0).max()), 4 * EPS)
            momentum = _momenta(system, traj.q, traj.v)
            drift = np.abs(momentum - momentum[0]).max() / np.linalg.norm(momentum[0])
            yield Case(f"{case}, momentum", float(drift), walk)
    yield _casimir(trial, count)


def _fixed_dop853(h: float) -> Method:
    """Return DOP853 with a tolerance that accepts all steps, so that all have length h."""
    return DOP853(rtol=1e3, atol=1e3, max_step=h, max_steps=10**12)


def _casimir(trial: Trial, count: int) -> Case:
    """Check the drift of |μ| if DOP853 integrates a body without its attitude."""
    xi0, h = _STARTS["rigid_body"]
    end = count * h
    mu = trial.simulate_many(
        load("rigid_body"),
        xi0=xi0[None],
        times=np.linspace(0.0, end, 201),
        method=dop853(_RTOL, 1e-2 * _RTOL),
        outputs="shape",
    ).y[0]
    length = np.linalg.norm(mu, axis=1)
    change = float(np.abs(length / length[0] - 1.0).max())
    angle = end * float(np.linalg.norm(xi0))
    return Case("DOP853, Casimir |μ| without the base, per radian", change / angle, _RTOL)


def _momenta(system: System, q: Array, v: Array) -> Array:
    """Compute the angular momentum about the centre of mass with Pinocchio.

    The base is moved to the origin, because round-off grows with the distance from it.

    Returns:
        (T, 3) angular momentum [N·m·s].
    """
    model, data = system.model, system.model.createData()
    centred = q.copy()
    centred[:, : system.group.linear] = 0.0
    return np.array(
        [
            pin.computeCentroidalMomentum(model, data, *row).angular.copy()
            for row in zip(centred, v, strict=True)
        ]
    )


CHECK = Check("casimirs", "difference from the start, relative", _cases)
