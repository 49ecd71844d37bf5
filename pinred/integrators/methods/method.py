"""An integrator as a value: its options are its fields, its claims its attributes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import Field, dataclass, field
from math import ceil, inf
from typing import TYPE_CHECKING, Any, ClassVar

from ...common.arrays import positive
from ...common.defaults import Default
from ...common.errors import InputError

if TYPE_CHECKING:
    from ..explicit.tableau import Tableau
    from ..stepping.stepper import Stepper

DOP853_LEAST = 2.3e-14  # relative tolerance, ours and SciPy's: below it round-off decides
MOST_STEPS = 1e12  # of one length; the clock counts them


def option(about: str, **more: Any) -> dict[str, Any]:
    """Return the metadata of a field.  among: the words it may be; least, most: whole numbers."""
    return {"about": about, **more}


@dataclass(frozen=True)
class Method(ABC):
    """An integrator with its options, numbers and words.

    about: it in a few words.  adaptive: whether an estimated error decides how long steps are.
    symplectic: whether its map is, on the canonical form.
    steady_momentum: whether it needs an angular momentum that is constant in space.
    """

    about: ClassVar[str]
    adaptive: ClassVar[bool]
    symplectic: ClassVar[bool] = False
    steady_momentum: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """Name, that of its class and perhaps more."""
        return type(self).__name__

    @property
    def lanes(self) -> int:
        """Number of states that the kernel evaluates at once."""
        return 1

    @property
    @abstractmethod
    def order(self) -> int:
        """That of the states at the ends of steps."""

    @property
    @abstractmethod
    def dense_order(self) -> int:
        """That of the states between them."""

    @abstractmethod
    def stepper(self) -> Stepper:
        """Return what runs it; imports and compiles the machine code when it is first needed."""

    @abstractmethod
    def registers(self, t_end: float) -> dict[str, float]:
        """Return what it says of the registers of a run to t_end [s].  Raises InputError."""


@dataclass(frozen=True)
class ErrorControl(Method):
    """A method that keeps to a tolerance.

    rtol, atol: the estimated error of a step stays below atol + rtol |y| in the mean.
    If neither is given, a Scene gives its own; else, and outside of scenes, defaults hold.
    max_steps: of trial steps, the rejected ones included.  max_step: their longest [s].
    """

    rtol: float = field(default=Default(1e-10), metadata=option("relative tolerance of a step"))
    atol: float = field(default=Default(1e-12), metadata=option("absolute tolerance of a step"))
    max_steps: int = field(
        default=1_000_000, metadata=option("largest number of trial steps", least=1)
    )
    max_step: float = field(default=inf, metadata=option("longest step [s]"))

    adaptive: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        """Tell the defaults of a method's tolerances from tolerances that are given."""
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

    def registers(self, t_end: float) -> dict[str, float]:  # noqa: ARG002
        """Return the tolerances and limits."""
        return {
            "rtol": self.rtol,
            "atol": self.atol,
            "max_step": self.max_step,
            "max_steps": self.max_steps,
        }


@dataclass(frozen=True)
class EqualSteps(Method):
    """A method with steps of one length.

    step: longest step [s]; the end time is met by making all steps equal.
    """

    step: float = field(metadata=option("longest step [s]"))

    adaptive: ClassVar[bool] = False

    def __post_init__(self) -> None:
        positive(self.step, "step")

    def registers(self, t_end: float) -> dict[str, float]:
        """Return length and number of the steps."""
        if not t_end <= MOST_STEPS * self.step:
            raise InputError(
                f"steps of {self.step:g} s are more than {MOST_STEPS:.0e} in {t_end:g} s, which "
                "no run comes to the end of: take longer ones"
            )
        # The part of a step that round-off adds to the quotient is no step.
        total = max(1, ceil(t_end / self.step * (1.0 - 1e-12)))
        return {"h": t_end / total, "total": total, "max_steps": total}


@dataclass(frozen=True)
class Explicit(ErrorControl):
    """An explicit Runge–Kutta method with step control: its tableau is all it takes."""

    @classmethod
    @abstractmethod
    def tableau(cls) -> Tableau:
        """Return the numbers of the method, the same object at every call."""

    def stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..explicit.runge_kutta import make_stepper

        return make_stepper(type(self).__name__, self.order, self.tableau())
