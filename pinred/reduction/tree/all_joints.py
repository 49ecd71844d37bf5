"""Map shape coordinates to tree joints, x = G y + b, and momenta of the joints back.

The shape has m coordinates y.  The tree has M ≥ m joints x, because some joints may follow others
(see coupling.py).
"""

from __future__ import annotations

from collections.abc import Sequence

from ...system.system import System
from .scalars import Scalar, add, mul


def joint_values(system: System, x: Sequence[Scalar]) -> list[Scalar]:
    """Return the values of all M joints at shape x (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(x)
    joints = zip(coupled.of, coupled.ratio.tolist(), coupled.offset.tolist(), strict=True)
    return [add(mul(ratio, x[k]), offset) for k, ratio, offset in joints]


def joint_rates(system: System, xdot: Sequence[Scalar]) -> list[Scalar]:
    """Return the rates of all M joints at shape rate ẋ (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(xdot)
    joints = zip(coupled.of, coupled.ratio.tolist(), strict=True)
    return [mul(ratio, xdot[k]) for k, ratio in joints]


def on_shape(system: System, momenta: Sequence[Scalar]) -> list[Scalar]:
    """Map momenta or forces p of all M joints to shape momenta or forces Gᵀ p, (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(momenta)
    sums: list[Scalar] = [0.0] * system.m
    for k, ratio, value in zip(coupled.of, coupled.ratio.tolist(), momenta, strict=True):
        sums[k] = add(sums[k], mul(ratio, value))
    return sums
