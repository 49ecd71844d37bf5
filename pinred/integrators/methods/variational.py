"""Variational as a value; variational/lagrange_poincare.py implements it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .method import EqualSteps

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper


@dataclass(frozen=True)
class Variational(EqualSteps):
    """A discrete Lagrange–Poincaré integrator of order 2 with fixed steps.

    Its discrete action, by the trapezoidal rule and Cayley's map on rotations, is stationary. The
    angular momentum is preserved to round-off, and the energy stays near its initial value. It
    needs a constant angular momentum, and steps short enough for fixed-point iteration to converge.

    For the same error it takes 0.7 to 1 times the time of Gauss of order 2 on a planar chain and on
    solo12, and two to three times as long on the falling cat and a satellite with arms. Gauss of
    order 4 or higher is better than both.

    State:
        y, (n,): m positions, m momenta, then other entries. The quaternion, if any, is the
        Cayley–Klein lift of the constant momentum, which is the first three parameters.
    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
    """

    about: ClassVar[str] = "discrete Lagrange–Poincaré equations of order 2"
    order: ClassVar[int] = 2
    dense_order: ClassVar[int] = 2
    symplectic: ClassVar[bool] = True
    steady_momentum: ClassVar[bool] = True

    def stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..variational.lagrange_poincare import STEPPER

        return STEPPER
