"""Check of the measurements that controllers received, against Pinocchio at the same states.

`compare` replays the recorded commands of controllers. A wrong measurement would therefore remain
unnoticed without this check.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..common.arrays import Array
from ..simulation.trajectory import Trajectory
from .audit import relative_difference
from .reference_solution import FullState
from .step_defects import full_states

_MOST_CALLS = 100  # controller calls that are checked, evenly spaced


def measurement_error(traj: Trajectory, full: FullState) -> float:
    """Return the largest relative difference of each kind of number; 0 without controllers.

    Momenta may cancel. Their unit is at least the whole mass moving at the largest rate.
    """
    calls = traj.actions
    if not calls:
        return 0.0
    indices = np.linspace(0, len(calls) - 1, min(len(calls), _MOST_CALLS)).astype(int)
    checked = [calls[k] for k in np.unique(indices)]
    measured = [call.seen for call in checked]
    y = full_states(traj, full, np.array([call.t for call in checked]))
    expected = [full.sample(state) for state in y]
    system = traj.system
    size = full.totals.radius_of_gyration(full.q(y[0]))
    rates = np.concatenate([np.append(s.xi[system.group.linear :], s.xdot) for s in expected])
    momentum = system.mass * size**2 * float(np.abs(rates).max(initial=0.0))
    units = {"x": 1.0, "xdot": 0.0, "xi": 0.0, "mu": momentum}
    errors = [_error(measured, expected, name, unit) for name, unit in units.items()]
    if measured[0].base is not None:
        bases, expected_bases = [s.base for s in measured], [s.base for s in expected]
        units = {"pose": 1.0, "xi": 0.0, "mu": momentum, "J": momentum}
        errors += [_error(bases, expected_bases, name, unit) for name, unit in units.items()]
    return float(np.max(errors))


def _error(
    measured: Sequence[object], expected: Sequence[object], name: str, least: float
) -> float:
    """Return the largest relative difference of one field; `least` is its smallest unit."""
    return relative_difference(_column(measured, name), _column(expected, name), least)


def _column(samples: Sequence[object], name: str) -> Array:
    return np.array([getattr(sample, name) for sample in samples])
