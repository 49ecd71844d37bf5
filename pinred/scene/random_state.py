"""Random initial states, as the option `seed` requests them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array, read_only
from ..common.memo import once
from ..system.coordinates import InitialState
from ..system.system import System

DURATION = 2.0  # duration of a scene if neither the scene nor the robot states one [s]


@dataclass(frozen=True)
class _Spread:
    """Ranges of displacements from rest, (m,) each, and scales of rates (m,) and twists (r,)."""

    low: Array
    high: Array
    rates: Array
    twists: Array


def random_state(system: System, seed: int) -> InitialState:
    """Return a random state of moderate size, within the joint limits and without symmetry."""
    spread = once(system, _Spread, lambda: _spread(system))
    rng = np.random.default_rng(seed)
    return InitialState(
        x=system.space.integrate(system.space.neutral, rng.uniform(spread.low, spread.high)),
        xdot=rng.normal(size=system.m) * spread.rates,
        xi=rng.normal(size=system.r) * spread.twists,
        duration=DURATION,
    )


def _spread(system: System) -> _Spread:
    joints = [system.model.joints[i] for i in system.joints]
    reach = np.array([0.1 if unit == "m" else 0.6 for unit in system.units])
    low, high = -reach, reach.copy()
    limits = system.model.lowerPositionLimit, system.model.upperPositionLimit
    for k, joint in enumerate(joints):
        least, most = (limit[joint.idx_q] for limit in limits)
        if joint.nq == 1 and least < most:
            middle = max(least, min(0.0, most))
            low[k], high[k] = max(least, middle - reach[k]), min(most, middle + reach[k])
    _narrow(system, low, high)
    twists = np.where(np.arange(system.r) < system.group.linear, 0.1, 0.6)
    return _Spread(*map(read_only, (low, high, reach, twists)))


def _narrow(system: System, low: Array, high: Array) -> None:
    """Narrow shape ranges, (m,) each, in place so that mimic joints stay within their limits."""
    coupled, model = system.coupled, system.sorted_model
    if coupled is None:
        return
    for i, placed in enumerate(system.tree.joints, start=2):
        joint, j, b = model.joints[i], placed.v.start, coupled.offset[placed.x.start]
        terms = coupled.terms(j)
        if j in coupled.leads or joint.nq != 1:
            continue
        limits = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        # The other leaders of a joint that follows several stay at the middle of their ranges.
        middle = coupled.G[j] @ (low + high) / 2.0
        for k, ratio in terms:
            rest = b + middle - ratio * (low[k] + high[k]) / 2.0 if len(terms) > 1 else b
            with np.errstate(over="ignore"):  # Joints without limits have huge ones in Pinocchio.
                least, most = sorted((limit - rest) / ratio for limit in limits)
            if max(low[k], least) < min(high[k], most):
                low[k], high[k] = max(low[k], least), min(high[k], most)
