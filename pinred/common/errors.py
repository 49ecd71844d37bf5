"""Every error that pinred raises on purpose, in one tree.

A message says what was given, what was expected, and what to do about it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class PinredError(Exception):
    """Base of all errors raised by pinred."""


class LoadError(PinredError):
    """A robot could not be found or read."""


class ModelError(PinredError, ValueError):
    """A robot was read, but its model is outside what pinred can reduce."""


class ChoiceError(ModelError):
    """A robot's file leaves open what an option of load decides.

    option: its name.  choices: values that it may have, the most likely first.
    """

    def __init__(self, message: str, option: str, choices: tuple[str, ...]) -> None:
        """Take the message, the option and its values."""
        super().__init__(message)
        self.option = option
        self.choices = choices

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.option, self.choices)


class InputError(PinredError, ValueError):
    """An argument has a value that cannot be used."""


class ShapeError(InputError):
    """An array argument has the wrong length or holds a number that is not finite."""


class SymmetryError(PinredError, ValueError):
    """Something acts on the system that its symmetry group does not leave unchanged."""


class SingularInertiaError(PinredError, ArithmeticError):
    """The mass matrix is not positive definite at a shape."""


class MissingPackageError(PinredError, ImportError):
    """A package that only some parts of pinred need is not installed."""


class OutputError(PinredError):
    """A file could not be written; an older file of that name is unchanged."""


class IntegrationError(PinredError, ArithmeticError):
    """An integration had to stop before its end time."""


class NoOptimum(PinredError, ArithmeticError):  # noqa: N818
    """An optimisation found nothing that satisfies what was asked for."""


class UnsupportedOperationError(PinredError, NotImplementedError):
    """An expression contains an operation that cannot be compiled."""


class NotCopyable(PinredError, TypeError):  # noqa: N818
    """Something lives in this process alone, and can be neither copied nor pickled."""


class KernelMismatch(PinredError, ArithmeticError):  # noqa: N818
    """A compiled kernel disagrees with Pinocchio and must not run."""


class _Stopped(IntegrationError):  # noqa: N818
    """An integrator stopped.  time: the last time it reached [s].  state: (n,) there."""

    def __init__(self, message: str, time: float, state: NDArray[np.float64]) -> None:
        super().__init__(message)
        self.time = time
        self.state = state

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.time, self.state)


class StepSizeUnderflow(_Stopped):
    """The tolerance asks for steps that are too short to advance the time."""


class NoConvergence(_Stopped):
    """The equations of an implicit step were not solved."""


class TooManySteps(_Stopped):
    """An integrator has used up the steps it was allowed."""


class NonFiniteState(_Stopped):
    """A state or its rate is not finite.  entry: index of the first such number."""

    def __init__(self, message: str, time: float, state: NDArray[np.float64], entry: int) -> None:
        """Take the message, and where the integrator stopped and why."""
        super().__init__(message, time, state)
        self.entry = entry

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.time, self.state, self.entry)


class LeftOutWarning(UserWarning):
    """Something acts in a robot's file that is not simulated; the motion is without it."""


class ModelWarning(UserWarning):
    """A robot can be simulated, but its model has what no real one has, or singular shapes."""


class CacheWarning(UserWarning):
    """Something is wrong with the kernels on disk; they are rebuilt."""
