"""Motions that come back: after whole periods, known in closed form, everything is as it was."""

from __future__ import annotations

import numpy as np

from .check import Case, Cases, Check, Trial, tolerance
from .energy_drift import swings

_RTOL = 1e-12
_PER_PERIOD = 10.0  # the drift of energy may be the tolerance in each step …
_PER_SQUARE = 1.0  # … and the phase follows from it, with the square of the time


def _cases(trial: Trial) -> Cases:
    counts = trial.pick((1, 100), (1, 10, 100, 1000))
    for swing in swings():
        found = trial.simulate(
            swing.system,
            x0=swing.x0,
            xi0=swing.xi0,
            times=swing.period * np.array(counts, dtype=float),
            **tolerance(_RTOL),
        )
        rates = np.hstack([found.xdot, found.xi]) - np.append(0.0 * swing.x0, swing.xi0)
        size = max(1.0, float(np.abs(swing.xi0).max()))
        for k, count in enumerate(counts):
            missed = np.abs(np.append(found.x[k] - swing.x0, rates[k])).max() / size
            bound = _PER_PERIOD * count + _PER_SQUARE * count**2
            yield Case(f"{swing.name}, {count} periods", float(missed) / _RTOL, bound)


CHECK = Check("periods", "difference after whole periods, per tolerance", _cases)
