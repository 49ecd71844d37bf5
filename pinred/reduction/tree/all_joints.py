"""Map shape coordinates to tree joints, x = G y + b, and momenta of the joints back.

The shape has m coordinates y.  The tree has M ≥ m joints x, because some joints may follow others
(see coupling.py).
"""

from __future__ import annotations

from collections.abc import Sequence

from ...system.coupling import Coupled
from ...system.system import System
from .scalars import Scalar, add, mul


def joint_values(system: System, x: Sequence[Scalar]) -> list[Scalar]:
    """Return the values of all M joints at shape x (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(x)
    offsets = coupled.offset.tolist()
    return [add(_sum(coupled, j, x), offset) for j, offset in enumerate(offsets)]


def joint_rates(system: System, xdot: Sequence[Scalar]) -> list[Scalar]:
    """Return the rates of all M joints at shape rate ẋ (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(xdot)
    return [_sum(coupled, j, xdot) for j in range(len(coupled.G))]


def on_shape(system: System, momenta: Sequence[Scalar]) -> list[Scalar]:
    """Map momenta or forces p of all M joints to shape momenta or forces Gᵀ p, (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(momenta)
    sums: list[Scalar] = [0.0] * system.m
    for j, value in enumerate(momenta):
        for k, ratio in coupled.terms(j):
            sums[k] = add(sums[k], mul(ratio, value))
    return sums


def _sum(coupled: Coupled, joint: int, numbers: Sequence[Scalar]) -> Scalar:
    """Return a joint's row of G times numbers of the shape, (m)."""
    total: Scalar = 0.0
    for k, ratio in coupled.terms(joint):
        total = add(total, mul(ratio, numbers[k]))
    return total
