"""Variational, as a value: see variational/lagrange_poincare.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .method import EqualSteps

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper


@dataclass(frozen=True)
class Variational(EqualSteps):
    """A discrete Lagrange–Poincaré integrator with fixed steps, of order 2: see variational/.

    step: longest step [s]; the end time is met by making all steps equal.
    Its discrete action is stationary: the trapezoidal rule with Cayley's map on the rotations.
    The angular momentum is kept to round-off, the energy stays near its value.  For the same
    error it takes 0.7 to 1 of the time of Gauss of order 2 on a planar chain and on solo12, and
    two to three times as long on the falling cat and a satellite with arms; Gauss of order 4
    or more is better than both.  It needs an angular momentum that is constant, and steps at
    which fixed-point iteration converges.
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
