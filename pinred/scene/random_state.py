"""A generic initial state from a seed: what `seed=` stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array, read_only
from ..common.memo import once
from ..system.joints import is_prismatic
from ..system.system import InitialState, System

DURATION = 2.0  # s, where neither scene nor robot says


@dataclass(frozen=True)
class _Spread:
    """The ranges that shapes are drawn from, and the scales of rates (m,) and twists (r,)."""

    low: Array
    high: Array
    rates: Array
    twists: Array


def random_state(system: System, seed: int) -> InitialState:
    """Return a generic state: moderate, within the joints' limits, with no symmetry in it."""
    spread = once(system, _Spread, lambda: _spread(system))
    rng = np.random.default_rng(seed)
    return InitialState(
        x=rng.uniform(spread.low, spread.high),
        xdot=rng.normal(size=system.m) * spread.rates,
        xi=rng.normal(size=system.r) * spread.twists,
        duration=DURATION,
    )


def _spread(system: System) -> _Spread:
    joints = [system.model.joints[i] for i in range(2, system.model.njoints)]
    reach = np.array([0.1 if is_prismatic(joint) else 0.6 for joint in joints])
    low, high = -reach, reach.copy()
    limits = system.model.lowerPositionLimit, system.model.upperPositionLimit
    for k, joint in enumerate(joints):
        least, most = (limit[joint.idx_q] for limit in limits)
        if joint.nq == 1 and least < most:
            middle = max(least, min(0.0, most))
            low[k], high[k] = max(least, middle - reach[k]), min(most, middle + reach[k])
    twists = np.where(np.arange(system.r) < system.group.linear, 0.1, 0.6)
    return _Spread(*map(read_only, (low, high, reach, twists)))
