"""What controllers were given, against what Pinocchio sees in the motion at that time.

`compare` replays what controllers gave, so a wrong measurement would go unseen: it is judged here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..common.arrays import Array
from ..simulation.trajectory import Trajectory
from .defect import full_states
from .full_state import FullState

_MOST = 100  # calls that are judged, evenly chosen


def measurement_error(traj: Trajectory, full: FullState) -> float:
    """Return the largest difference, relative to the numbers of each kind; 0 without controllers.

    Momenta are told in parts of what the rates make of the whole mass, for they may cancel.
    """
    calls = traj.actions
    if not calls:
        return 0.0
    which = np.unique(np.linspace(0, len(calls) - 1, min(len(calls), _MOST)).astype(int))
    given = [calls[k].seen for k in which]
    times = np.array([calls[k].t for k in which])
    rows = full_states(traj, full, times)
    true = [full.sample(row) for row in rows]
    system = traj.system
    size = full.radius(full.q(rows[0]))
    rates = np.concatenate([np.append(s.xi[system.group.linear :], s.xdot) for s in true])
    carried = system.mass * size**2 * float(np.abs(rates).max(initial=0.0))
    least = {"x": 1.0, "xdot": 0.0, "xi": 0.0, "mu": carried}
    errors = [_apart(given, true, name, each) for name, each in least.items()]
    if given[0].base is not None:
        bases, seen = [s.base for s in given], [s.base for s in true]
        own = {"pose": 1.0, "xi": 0.0, "mu": carried, "J": carried}
        errors += [_apart(bases, seen, name, each) for name, each in own.items()]
    return float(np.max(errors))


def _apart(given: Sequence[object], true: Sequence[object], name: str, least: float) -> float:
    """Return the largest difference of an entry over its largest number, or over `least`."""
    a, b = (_column(each, name) for each in (given, true))
    if not b.size:
        return 0.0
    scale = max(least, float(np.abs(b).max()))
    off = float(np.abs(a - b).max())
    return off / scale if scale > 0.0 else off


def _column(each: Sequence[object], name: str) -> Array:
    return np.array([getattr(one, name) for one in each])
