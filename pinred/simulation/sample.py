"""The state that forces depend on, in the frame of the centre of mass."""

from __future__ import annotations

from dataclasses import dataclass

from ..common.arrays import Array
from ..forces.force_values import BaseInSpace, ForceInputs


@dataclass(frozen=True)
class Sample:
    """The state at one time that forces depend on, in the frame of the centre of mass.

    Attributes:
        x: Shape, (m,) [rad | m].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist relative to the centre of mass, (r,) [m/s | rad/s].
        mu: Body momentum about the centre of mass, (r,) [N·s | N·m·s]; its linear part is zero.
        weight: Gravity force m g in the body frame if it rotates a pivoted base, else zero, (3,)
            [N].
        base: State of the base in the fixed frame, None if the scene leaves it out.
    """

    x: Array
    xdot: Array
    xi: Array
    mu: Array
    weight: Array
    base: BaseInSpace | None = None

    def force_inputs(self, t: float, numbers: Array) -> ForceInputs:
        """Return the arguments of a ForceModel at time t [s] with force parameters (p,)."""
        return ForceInputs(float(t), self.x, self.xdot, self.xi, self.mu, numbers, self.base)
