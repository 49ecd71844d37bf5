"""Numbers of forces at one state: what they see of the base in space, and what acts."""

from __future__ import annotations

from dataclasses import dataclass

from ..common.arrays import Array, freeze


@dataclass(frozen=True)
class BaseInSpace:
    """The base as seen from the root joint's fixed frame: see SeenState.

    pose: (size,).  xi, mu, J: (r,) body twist, body momentum, spatial momentum.
    """

    pose: Array
    xi: Array
    mu: Array
    J: Array


@dataclass(frozen=True)
class Acting:
    """All that acts at one state.  torque: (m,) on the joints, −∂V/∂x included.  wrench: (r,)."""

    torque: Array
    wrench: Array


@dataclass(frozen=True)
class Prescribed:
    """Positions, rates and accelerations of the prescribed joints, (k,) each."""

    x: Array
    xdot: Array
    xddot: Array

    def __post_init__(self) -> None:
        freeze(self)
