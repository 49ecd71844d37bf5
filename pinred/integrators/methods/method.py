"""The integrators: dataclasses that select a method and hold its options, and their base classes.

Dataclass fields are options, class attributes are properties. The folders explicit and implicit
implement the steps; coefficients are in explicit/runge_kutta.py and explicit/munthe_kaas.py.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import Field, dataclass, field
from math import ceil, inf
from numbers import Integral
from typing import TYPE_CHECKING, Any, ClassVar

from ...common.argument_kinds import Default, checks_arguments
from ...common.arrays import positive
from ...common.errors import InputError
from ..stepping.run_state import AUTO, FIXED_POINT, MOST_STAGES, NEWTON, lanes_of

if TYPE_CHECKING:
    from ..explicit.runge_kutta import Tableau
    from ..stepping.step_loop import Stepper

RTOL = Default(1e-10)  # relative tolerance
ATOL = Default(1e-12)  # absolute tolerance, in the units of each entry of the state


# Smallest useful relative tolerance, limited by round-off; SciPy has the same limit.
DOP853_LEAST = 2.3e-14
MOST_STEPS = 1e12  # largest number of equal steps


def option(about: str, **more: Any) -> dict[str, Any]:
    """Return the metadata of a dataclass field that is an option.

    Args:
        about: Description.
        **more: `among`: allowed words; `least`, `most`: limits of an integer.
    Returns:
        The metadata.
    """
    return {"about": about, **more}


@checks_arguments
@dataclass(frozen=True)
class Method(ABC):
    """Base class of integrators; an instance holds the options of a method.

    Attributes:
        about: Short description.
        adaptive: Whether an error estimate controls the step lengths.
        symplectic: Whether the map of a step is symplectic for systems in canonical form.
        steady_momentum: Whether the method requires an angular momentum that is constant in space.
        needs_smooth: Whether kinks of the vector field cause errors that no estimate shows.
        one_quaternion: Whether the state must not contain more than one quaternion.
        multipliers: Whether multipliers close loops at step ends; the rates are then those of the
            open tree.
    """

    about: ClassVar[str]
    adaptive: ClassVar[bool]
    symplectic: ClassVar[bool] = False
    steady_momentum: ClassVar[bool] = False
    needs_smooth: ClassVar[bool] = False
    one_quaternion: ClassVar[bool] = False
    multipliers: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """Name of the method: the name of its class, possibly with options."""
        return type(self).__name__

    @property
    def lanes(self) -> int:
        """Number of states that the kernel evaluates at once."""
        return 1

    @property
    @abstractmethod
    def order(self) -> int:
        """Order of the states at step ends."""

    @property
    @abstractmethod
    def dense_order(self) -> int:
        """Order of the dense output."""

    @abstractmethod
    def _stepper(self) -> Stepper:
        """Return the compiled stepper; the first call imports and compiles it."""

    @abstractmethod
    def _registers(self, t_end: float) -> dict[str, float]:
        """Return the registers of a run (see Run) that depend on the options.

        Args:
            t_end: End time [s].
        Returns:
            Register values, by register name.
        Raises:
            InputError: The options do not fit the end time.
        """


def stepper_of(method: Method) -> Stepper:
    """Return the compiled stepper of a method; the first call imports and compiles it."""
    return method._stepper()  # noqa: SLF001 - private, because users do not call it


def registers_of(method: Method, t_end: float) -> dict[str, float]:
    """Return the registers of a run (see Run) that depend on the options of a method.

    Args:
        method: The method.
        t_end: End time [s].
    Returns:
        Register values, by register name.
    Raises:
        InputError: The options do not fit the end time.
    """
    return method._registers(t_end)  # noqa: SLF001 - private, because users do not call it


@checks_arguments
@dataclass(frozen=True)
class ErrorControl(Method):
    """A method that controls the error of its steps.

    If neither tolerance is set, a Scene uses its own defaults. Functions outside of scenes use the
    defaults of the class.

    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step. The root mean square of the estimated errors, each
            divided by atol + rtol |y|, stays below 1.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    rtol: float = field(default=RTOL, metadata=option("relative tolerance of a step"))
    atol: float = field(default=ATOL, metadata=option("absolute tolerance of a step"))
    max_steps: int = field(
        default=1_000_000, metadata=option("largest number of trial steps", least=1)
    )
    max_step: float = field(default=inf, metadata=option("longest step [s]"))

    adaptive: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        """Mark the default tolerances of a subclass, to distinguish them from users' values."""
        super().__init_subclass__()
        for name in ("rtol", "atol"):
            value = vars(cls).get(name)
            if isinstance(value, Field):
                value.default = Default(value.default)  # type: ignore[arg-type]
            elif value is not None:
                setattr(cls, name, Default(value))

    def __post_init__(self) -> None:
        positive(self.rtol, "rtol")
        positive(self.atol, "atol")
        if self.max_step != inf:
            positive(self.max_step, "max_step")
        if isinstance(self.max_steps, bool) or not isinstance(self.max_steps, int):
            raise InputError(f"max_steps must be a whole number, got {self.max_steps!r}")
        if self.max_steps < 1:
            raise InputError(f"max_steps must be at least 1, got {self.max_steps}")

    @property
    def controlled_order(self) -> int:
        """Order of the solution whose error is estimated; lower than `order` for some methods."""
        return self.order

    def _registers(self, t_end: float) -> dict[str, float]:  # noqa: ARG002
        """Return the registers for tolerances and limits, see Method._registers."""
        return {
            "rtol": self.rtol,
            "atol": self.atol,
            "max_step": self.max_step,
            "max_steps": self.max_steps,
        }


@checks_arguments
@dataclass(frozen=True)
class EqualSteps(Method):
    """A method with steps of equal length.

    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
    """

    step: float = field(metadata=option("longest step [s]"))

    adaptive: ClassVar[bool] = False

    def __post_init__(self) -> None:
        positive(self.step, "step")

    def _registers(self, t_end: float) -> dict[str, float]:
        """Return the registers for length and number of the steps, see Method._registers.

        Args:
            t_end: End time [s].
        Returns:
            Register values, by register name.
        Raises:
            InputError: There would be more than MOST_STEPS steps.
        """
        if not t_end <= MOST_STEPS * self.step:
            raise InputError(
                f"step: expected at most {MOST_STEPS:.0e} steps in {t_end:g} s, got steps of "
                f"{self.step:g} s. Choose a longer step."
            )
        # The quotient is reduced slightly, so that its round-off does not add a step.
        total = max(1, ceil(t_end / self.step * (1.0 - 1e-12)))
        return {"h": t_end / total, "total": total, "max_steps": total}


@checks_arguments
@dataclass(frozen=True)
class Explicit(ErrorControl):
    """An explicit Runge–Kutta method with step control, defined by its tableau.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
    """

    @classmethod
    @abstractmethod
    def tableau(cls) -> Tableau:
        """Return the coefficients of the method, the same object at every call."""

    def _stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..explicit.runge_kutta import make_stepper

        return make_stepper(type(self).__name__, self.order, self.tableau())


@checks_arguments
@dataclass(frozen=True)
class DOP853(Explicit):
    """Dormand and Prince's Runge–Kutta method of order 8(5,3), in Hairer's form.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step. The root mean square of the estimated errors, each
            divided by atol + rtol |y|, stays below 1.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    about: ClassVar[str] = "Dormand and Prince's method of order 8"
    order: ClassVar[int] = 8
    dense_order: ClassVar[int] = 7

    @classmethod
    def tableau(cls) -> Tableau:
        """Return the coefficients of Hairer's code."""
        from ..explicit.runge_kutta import dop853_tableau

        return dop853_tableau()


@checks_arguments
@dataclass(frozen=True)
class Tsit5(Explicit):
    """Tsitouras's Runge–Kutta method of order 5(4).

    Its dense output costs no evaluations. The method is rarely faster than DOP853, and only at
    errors of about 1e-4.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    rtol: float = 1e-6
    atol: float = 1e-8

    about: ClassVar[str] = "Tsitouras's method of order 5"
    order: ClassVar[int] = 5
    dense_order: ClassVar[int] = 4

    @classmethod
    def tableau(cls) -> Tableau:
        """Return the coefficients of Tsitouras's paper."""
        from ..explicit.runge_kutta import tsit5_tableau

        return tsit5_tableau()


@checks_arguments
@dataclass(frozen=True)
class RKMK4(EqualSteps):
    """Munthe-Kaas's form of the classical method RK4, with fixed steps that stay on the Lie group.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
    """

    about: ClassVar[str] = "Munthe-Kaas's form of RK4, with fixed steps"
    order: ClassVar[int] = 4
    dense_order: ClassVar[int] = 3

    def _stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..explicit.munthe_kaas import STEPPER

        return STEPPER


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
        from ..implicit.gauss_fixed_step import fixed_stepper

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
        from ..implicit.gauss_adaptive import adaptive_stepper

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
        from ..implicit.radau_iia import STEPPER

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
        from ..implicit.lagrange_poincare import STEPPER

        return STEPPER
