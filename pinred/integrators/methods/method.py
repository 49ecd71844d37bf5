"""Base classes of integrators: dataclass fields are options, class attributes are properties."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import Field, dataclass, field
from math import ceil, inf
from typing import TYPE_CHECKING, Any, ClassVar

from ...common.argument_kinds import Default, checks_arguments
from ...common.arrays import positive
from ...common.errors import InputError

if TYPE_CHECKING:
    from ..explicit.tableau import Tableau
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
