"""Implicit methods: the dataclasses Gauss, AdaptiveGauss, Radau and Variational.

The classes select a method and hold its options. The folders gauss, radau and variational implement
the steps.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Integral
from typing import TYPE_CHECKING, ClassVar

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ..gauss.tables import MOST_STAGES, lanes_of
from ..stepping.run_state import AUTO, FIXED_POINT, NEWTON
from .method import EqualSteps, ErrorControl, option

if TYPE_CHECKING:
    from ..stepping.step_loop import Stepper

SOLVERS = {"auto": AUTO, "fixed point": FIXED_POINT, "Newton": NEWTON}


@checks_arguments
@dataclass(frozen=True)
class Gauss(EqualSteps):
    """Gauss–Legendre collocation with fixed steps: symplectic, symmetric, of even order.

    It preserves angular momenta and Casimirs to round-off, and the energy stays near its initial
    value for exponentially long times.

    State:
        y, (n,), in canonical form: positions, momenta, then the quaternion as Cayley–Klein lift, if
        any.
    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
        order: Order of the method: 2, 4, …, 16.
        solver: Solver of the stage equations, which are solved to round-off. "fixed point";
            "Newton": with the exact Jacobian; "auto": fixed-point iteration as long as it converges
            well, else Newton.
    """

    order: int = field(
        default=6, metadata=option("order, an even number", least=2, most=2 * MOST_STAGES)
    )
    solver: str = field(
        default="auto", metadata=option("solver of the stages", among=tuple(SOLVERS))
    )

    about: ClassVar[str] = "Gauss–Legendre collocation with fixed steps, symplectic"
    symplectic: ClassVar[bool] = True
    needs_smooth: ClassVar[bool] = True

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
        """Name of the method: "Gauss" and its order."""
        return f"Gauss{self.order}"

    @property
    def dense_order(self) -> int:
        """Order of the dense output, which is the order of the steps."""
        return self.order

    @property
    def stages(self) -> int:
        """Number of stages, half of the order."""
        return self.order // 2

    @property
    def lanes(self) -> int:
        """Number of states that the kernel evaluates at once."""
        return lanes_of(self.stages)

    def _stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..gauss.fixed_step import fixed_stepper

        return fixed_stepper(self.stages, needs_tangent=self.solver == "Newton")

    def _registers(self, t_end: float) -> dict[str, float]:
        """Return the registers for step length, stages and solver, see Method._registers."""
        solved = {
            "stages": self.stages,
            "lanes": self.lanes,
            "solver": SOLVERS[self.solver],
        }
        return super()._registers(t_end) | solved


@checks_arguments
@dataclass(frozen=True)
class AdaptiveGauss(ErrorControl):
    """Gauss–Legendre collocation of order 16 with step control, for tight tolerances.

    It needs smooth vector fields. Where a force has a kink or a jump, the error of a step is far
    larger than its estimate.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    rtol: float = 1e-12
    atol: float = 1e-14

    about: ClassVar[str] = "Gauss–Legendre collocation of order 16, for tight tolerances"
    needs_smooth: ClassVar[bool] = True
    lanes: ClassVar[int] = lanes_of(MOST_STAGES)
    stages: ClassVar[int] = MOST_STAGES
    order: ClassVar[int] = 2 * MOST_STAGES
    dense_order: ClassVar[int] = 2 * MOST_STAGES

    def _stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..gauss.adaptive import adaptive_stepper

        return adaptive_stepper(MOST_STAGES)

    def _registers(self, t_end: float) -> dict[str, float]:
        """Return the registers for tolerances, stages and solver, see Method._registers."""
        solved = {"stages": self.stages, "lanes": self.lanes, "solver": FIXED_POINT}
        return super()._registers(t_end) | solved


@checks_arguments
@dataclass(frozen=True)
class Radau(ErrorControl):
    """Radau IIA of order 5 with step control, in Hairer and Wanner's form: for stiff systems.

    Hard springs or strong dampers force DOP853 to tiny steps. Radau takes steps that resolve only
    the slow motion, and damps faster motions. For systems that are not stiff, it is slower than
    DOP853. Newton's method uses the exact Jacobian.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    rtol: float = 1e-8
    atol: float = 1e-10

    about: ClassVar[str] = "Radau IIA of order 5, for hard springs and dampers"
    order: ClassVar[int] = 5
    dense_order: ClassVar[int] = 5
    controlled_order: ClassVar[int] = 3

    def _stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..radau.radau_iia import STEPPER

        return STEPPER


@checks_arguments
@dataclass(frozen=True)
class Variational(EqualSteps):
    """A discrete Lagrange–Poincaré integrator of order 2 with fixed steps.

    The steps make a discrete action stationary, which is computed with the trapezoidal rule and
    Cayley's map on rotations. The angular momentum is preserved to round-off, and the energy stays
    near its initial value. Closed loops are closed at step ends to round-off, by multipliers. The
    method needs a constant angular momentum, and steps short enough for fixed-point iteration to
    converge.

    Compared with Gauss of order 2 at the same error, Variational takes 0.7 to 1 times the computing
    time on a planar chain and on solo12, and two to three times the computing time on the falling
    cat and a satellite with arms. Gauss of order 4 or higher is faster than both.

    State:
        y, (n,): m positions, m momenta, then other entries. At most one quaternion, which is the
        Cayley–Klein lift of the constant momentum, which is the first three parameters.
    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
    """

    about: ClassVar[str] = "discrete Lagrange–Poincaré equations of order 2"
    order: ClassVar[int] = 2
    dense_order: ClassVar[int] = 2
    symplectic: ClassVar[bool] = True
    steady_momentum: ClassVar[bool] = True
    one_quaternion: ClassVar[bool] = True
    multipliers: ClassVar[bool] = True

    def _stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..variational.lagrange_poincare import STEPPER

        return STEPPER
