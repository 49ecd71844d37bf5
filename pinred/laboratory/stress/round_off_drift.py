"""Quaternions and momenta over up to ten million steps: drift no faster than round-off's walk.

The momentum is judged as Pinocchio makes it of (q, v), and the quaternion by its length.
Without the base, DOP853 integrates three numbers μ, whose length is a Casimir that it does not
keep, but to its tolerance; Gauss's methods lift them to the quaternion.
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

_WALK = 10.0  # of eps times the root of the number of steps
_RTOL = 1e-12
# Twist of the base, and a step; the joints of the cat start as it comes.
_STARTS = {
    "rigid_body": (np.array([0.5, 0.7, 1.6]), 0.1),
    "falling_cat": (np.array([0.1, 0.0, -0.1, 0.8, 0.4, -0.3]), 0.02),
}


def _cases(trial: Trial) -> Cases:
    count = trial.pick(10_000, 1_000_000, 10_000_000)
    walk = _WALK * EPS * math.sqrt(count)
    for name, (xi0, h) in _STARTS.items():
        system, times = load(name), np.linspace(0.0, count * h, 201)
        methods: list[Method] = [_steady(h), *(make(h) for make in trial.fixed)]
        for method in methods:
            found = trial.simulate_many(system, xi0=xi0[None], times=times, method=method)[0]
            who = f"{name}, {method.name}, {count:.0e} steps"
            length = np.linalg.norm(found.pose[:, -4:], axis=1)
            yield Case(f"{who}, quaternion", float(np.abs(length - 1.0).max()), 4 * EPS)
            momentum = _momenta(system, found.q, found.v)
            drift = np.abs(momentum - momentum[0]).max() / np.linalg.norm(momentum[0])
            yield Case(f"{who}, momentum", float(drift), walk)
    yield _casimir(trial, count)


def _steady(h: float) -> Method:
    """Return DOP853 with a tolerance that no step misses: its steps are as long as they may be."""
    return DOP853(rtol=1e3, atol=1e3, max_step=h, max_steps=10**12)


def _casimir(trial: Trial, count: int) -> Case:
    """|μ| of a body without its attitude, by DOP853 at its tolerance."""
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
    turned = end * float(np.linalg.norm(xi0))
    return Case("DOP853, Casimir |μ| without the base, per radian", change / turned, _RTOL)


def _momenta(system: System, q: Array, v: Array) -> Array:
    """Return the angular momentum about the centre of mass, (T, 3), by Pinocchio.

    The base is put at the origin: far away, its distance would be all that round-off shows.
    """
    model, data = system.model, system.model.createData()
    here = q.copy()
    here[:, : system.group.linear] = 0.0
    return np.array(
        [
            pin.computeCentroidalMomentum(model, data, *row).angular.copy()
            for row in zip(here, v, strict=True)
        ]
    )


CHECK = Check("casimirs", "difference from the start, relative", _cases)
