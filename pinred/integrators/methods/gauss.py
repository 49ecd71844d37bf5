"""Gauss as a value; gauss/fixed_step.py implements it."""

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

SOLVERS = {"auto": AUTO, "fixed point": FIXED_POINT, "Newton": NEWTON}


@dataclass(frozen=True)
class Gauss(EqualSteps):
    """Gauss–Legendre collocation with fixed steps: symplectic, symmetric, of even order.

    It preserves angular momenta and Casimirs to round-off, and the energy stays near its initial
    value for exponentially long times.

    State:
        y, (n,), canonical: positions, momenta, then the quaternion as Cayley–Klein lift, if any.
    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
        order: 2, 4, …, 16.
        solver: Solver of the stages, to round-off: "fixed point"; "Newton" with the exact Jacobian;
            or "auto", the fixed point while it converges well.
    """

    order: int = field(
        default=6, metadata=option("order, an even number", least=2, most=2 * MOST_STAGES)
    )
    solver: str = field(
        default="auto", metadata=option("solver of the stages", among=tuple(SOLVERS))
    )

    about: ClassVar[str] = "Gauss–Legendre collocation with fixed steps, symplectic"
    symplectic: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        orders = range(2, 2 * MOST_STAGES + 1, 2)
        is_integer = isinstance(self.order, Integral) and not isinstance(self.order, bool)
        if not is_integer or self.order not in orders:
            raise InputError(
                f"order must be one of {', '.join(map(str, orders))}, got {self.order!r}"
            )
        if self.solver not in [*SOLVERS]:
            raise InputError(f"solver must be one of {', '.join(SOLVERS)}, got {self.solver!r}")

    @property
    def name(self) -> str:
        """Gauss and the order."""
        return f"Gauss{self.order}"

    @property
    def dense_order(self) -> int:
        """Order of the dense output, that of the steps."""
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
        """Return the registers of step, stages and solver, see Method.registers."""
        solved = {
            "stages": self.stages,
            "lanes": self.lanes,
            "solver": SOLVERS[self.solver],
        }
        return super().registers(t_end) | solved
