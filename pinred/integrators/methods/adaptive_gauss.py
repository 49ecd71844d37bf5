"""AdaptiveGauss as a value; gauss/adaptive.py implements it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ..gauss.tables import MOST_STAGES, lanes_of
from ..stepping.run_record import FIXED_POINT
from .method import ErrorControl

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper


@dataclass(frozen=True)
class AdaptiveGauss(ErrorControl):
    """Gauss–Legendre collocation of order 16 with step control, for tight tolerances.

    It needs smooth vector fields. Where a force has a kink or a jump, the error of a step is far
    larger than its estimate.

    State:
        y, (n,), in any order. The quaternion's four entries are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    rtol: float = 1e-12
    atol: float = 1e-14

    about: ClassVar[str] = "Gauss–Legendre collocation of order 16, for tight tolerances"
    lanes: ClassVar[int] = lanes_of(MOST_STAGES)
    stages: ClassVar[int] = MOST_STAGES
    order: ClassVar[int] = 2 * MOST_STAGES
    dense_order: ClassVar[int] = 2 * MOST_STAGES

    def stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..gauss.adaptive import adaptive_stepper

        return adaptive_stepper(MOST_STAGES)

    def registers(self, t_end: float) -> dict[str, float]:
        """Return the registers of tolerances, stages and solver, see Method.registers."""
        solved = {"stages": self.stages, "lanes": self.lanes, "solver": FIXED_POINT}
        return super().registers(t_end) | solved
