"""Check that periodic motions return to their initial state after each closed-form period."""

from __future__ import annotations

import numpy as np

from .check import Case, Cases, Check, Trial, tolerance
from .energy_drift import swings

_RTOL = 1e-12
_PER_PERIOD = (
    10.0  # error bound per period, in tolerances, because energy may drift by a tolerance per step
)
_PER_SQUARE = 1.0  # error bound per squared period, in tolerances: energy drift shifts the phase


def _cases(trial: Trial) -> Cases:
    counts = trial.pick((1, 100), (1, 10, 100, 1000))
    for swing in swings():
        traj = trial.simulate(
            swing.system,
            x0=swing.x0,
            xi0=swing.xi0,
            times=swing.period * np.array(counts, dtype=float),
            **tolerance(_RTOL),
        )
        rates = np.hstack([traj.xdot, traj.xi]) - np.append(0.0 * swing.x0, swing.xi0)
        size = max(1.0, float(np.abs(swing.xi0).max()))
        for k, count in enumerate(counts):
            error = np.abs(np.append(traj.x[k] - swing.x0, rates[k])).max() / size
            bound = _PER_PERIOD * count + _PER_SQUARE * count**2
            yield Case(f"{swing.name}, {count} periods", float(error) / _RTOL, bound)


CHECK = Check("periods", "difference after whole periods, per tolerance", _cases)
