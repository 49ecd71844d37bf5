"""Gauss, as a value: see gauss/fixed_step.py."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Integral
from typing import TYPE_CHECKING, ClassVar

from ...common.errors import InputError
from ..gauss.tables import MOST_STAGES, lanes_of
from ..stepping.run_record import AUTO, FIXED_POINT, NEWTON
from .method import EqualSteps, option

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper

STAGES_FOUND_BY = {"auto": AUTO, "fixed point": FIXED_POINT, "Newton": NEWTON}


@dataclass(frozen=True)
class Gauss(EqualSteps):
    """Gauss–Legendre collocation with fixed steps: symplectic, symmetric, of even order.

    step: longest step [s]; the end time is met by making all steps equal.  order: 2, 4, …, 16.
    Angular momenta and Casimirs are kept to round-off, the energy stays near its value for
    exponentially long times.  solver: how the stages are found, to round-off: "fixed point",
    "Newton" with the exact Jacobian, or "auto", the first as long as it converges well.
    """

    order: int = field(
        default=6, metadata=option("order, an even number", least=2, most=2 * MOST_STAGES)
    )
    solver: str = field(
        default="auto", metadata=option("how stages are found", among=tuple(STAGES_FOUND_BY))
    )

    about: ClassVar[str] = "Gauss–Legendre collocation with fixed steps, symplectic"
    symplectic: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        orders = range(2, 2 * MOST_STAGES + 1, 2)
        whole = isinstance(self.order, Integral) and not isinstance(self.order, bool)
        if not whole or self.order not in orders:
            raise InputError(
                f"order must be one of {', '.join(map(str, orders))}, got {self.order!r}"
            )
        if self.solver not in [*STAGES_FOUND_BY]:
            raise InputError(
                f"solver must be one of {', '.join(STAGES_FOUND_BY)}, got {self.solver!r}"
            )

    @property
    def name(self) -> str:
        """Gauss and the order."""
        return f"Gauss{self.order}"

    @property
    def dense_order(self) -> int:
        """That of the steps: a state between them comes from a shorter one."""
        return self.order

    @property
    def stages(self) -> int:
        """Half of the order."""
        return self.order // 2

    @property
    def lanes(self) -> int:
        """Number of states that the kernel evaluates at once."""
        return lanes_of(self.stages)

    def stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..gauss.fixed_step import fixed_stepper

        return fixed_stepper(self.stages, needs_tangent=self.solver == "Newton")

    def registers(self, t_end: float) -> dict[str, float]:
        """Return length and number of the steps, and how the stages are evaluated and found."""
        solved = {
            "stages": self.stages,
            "lanes": self.lanes,
            "solver": STAGES_FOUND_BY[self.solver],
        }
        return super().registers(t_end) | solved
