"""All joints of a tree from the shape, x = G y + b, in scalars of the sweep (see coupling.py)."""

from __future__ import annotations

from collections.abc import Sequence

from ...system.system import System
from .scalars import Scalar, add, mul


def joint_values(system: System, x: Sequence[Scalar]) -> list[Scalar]:
    """Return the values of all M joints at shape x (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(x)
    followed = zip(coupled.of, coupled.ratio.tolist(), coupled.offset.tolist(), strict=True)
    return [add(mul(ratio, x[k]), offset) for k, ratio, offset in followed]


def joint_rates(system: System, xdot: Sequence[Scalar]) -> list[Scalar]:
    """Return the rates of all M joints at shape rate ẋ (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(xdot)
    followed = zip(coupled.of, coupled.ratio.tolist(), strict=True)
    return [mul(ratio, xdot[k]) for k, ratio in followed]


def on_shape(system: System, momenta: Sequence[Scalar]) -> list[Scalar]:
    """Return what momenta or forces of all M joints are to the shape, Gᵀ, (m)."""
    coupled = system.coupled
    if coupled is None:
        return list(momenta)
    out: list[Scalar] = [0.0] * system.m
    for k, ratio, value in zip(coupled.of, coupled.ratio.tolist(), momenta, strict=True):
        out[k] = add(out[k], mul(ratio, value))
    return out
