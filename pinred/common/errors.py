"""Exceptions and warnings of pinred.

A message states the value, the expected value, and a way to fix the problem.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


_LONG_WORD = re.compile(r"\S{201,}")
_LONGEST = 2000  # maximum number of characters of a message


def shorten_message(text: str) -> str:
    """Omit the middle of words over 200 characters, and of a message over 2,000 characters.

    Messages contain names and values of users, which may be of any length.

    Args:
        text: The message.
    Returns:
        The shortened message.
    """
    text = _LONG_WORD.sub(lambda word: f"{word[0][:99]}…{word[0][-100:]}", text)
    if len(text) <= _LONGEST:
        return text
    half = _LONGEST // 2
    return f"{text[: half - 1]}…{text[-half:]}"


class PinredError(Exception):
    """Base of all errors raised by pinred."""

    def __init__(self, *args: object) -> None:
        """Store the message, shortened.

        Args:
            *args: The message.
        """
        super().__init__(*(shorten_message(arg) if isinstance(arg, str) else arg for arg in args))


class LoadError(PinredError):
    """A robot file does not exist or cannot be read."""


class ModelError(PinredError, ValueError):
    """A robot file was read, but pinred cannot reduce its model."""


class ChoiceError(ModelError):
    """A robot file is ambiguous; set an option of `load` to resolve the ambiguity.

    Attributes:
        option: Name of the option.
        choices: Possible values of the option, the most likely first.
    """

    def __init__(self, message: str, option: str, choices: tuple[str, ...]) -> None:
        """Store the message, the option and its possible values.

        Args:
            message: The message.
            option: Name of the option.
            choices: Possible values of the option, the most likely first.
        """
        super().__init__(message)
        self.option = option
        self.choices = choices

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.option, self.choices)


class InputError(PinredError, ValueError):
    """An argument has a value that cannot be used."""


class ShapeError(InputError):
    """An array argument has the wrong length or contains a number that is not finite."""


class SymmetryError(PinredError, ValueError):
    """A force or torque on the system is not invariant under its symmetry group."""


class SingularInertiaError(PinredError, ArithmeticError):
    """The mass matrix is not positive definite at a shape."""


class MissingPackageError(PinredError, ImportError):
    """An optional package that this function needs is not installed."""


class DeviceError(PinredError, RuntimeError):
    """No computing device can run the code, or the device reports an error."""


class RejectedValuesError(InputError):
    """Values of some members are not physical.

    Attributes:
        reasons: {member: reason}.
    """

    def __init__(self, reasons: Mapping[int, str]) -> None:
        """Store the reasons.

        Args:
            reasons: {member: reason}, at least one.
        """
        first = min(reasons)
        super().__init__(f"member {first}: {reasons[first]}")
        self.reasons = dict(reasons)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.reasons,)


class OutputError(PinredError):
    """A file could not be written; an existing file of this name is unchanged."""


class IntegrationError(PinredError, ArithmeticError):
    """An integration had to stop before its end time."""


class NoOptimum(PinredError, ArithmeticError):  # noqa: N818
    """An optimisation reached no point that satisfies all constraints."""


class UnsupportedOperationError(PinredError, NotImplementedError):
    """An operation of an expression, or a kind of joint, is not supported."""


class NotCopyable(PinredError, TypeError):  # noqa: N818
    """An object is bound to this process, so it can be neither copied nor pickled."""


class KernelMismatch(PinredError, ArithmeticError):  # noqa: N818
    """Machine code disagrees with its reference, such as Pinocchio, so pinred does not use it."""


class _Stopped(IntegrationError):  # noqa: N818
    """An integration stopped before its end time.

    Attributes:
        time: The last time that was reached [s].
        state: The state at this time, (n,).
    """

    def __init__(self, message: str, time: float, state: NDArray[np.float64]) -> None:
        super().__init__(message)
        self.time = time
        self.state = state

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.time, self.state)


class StepSizeUnderflow(_Stopped):
    """The tolerance requires steps that are too short to advance the time."""


class NoConvergence(_Stopped):
    """The equations of an implicit step could not be solved."""


class TooManySteps(_Stopped):
    """An integration has reached its maximum number of steps."""


class NonFiniteState(_Stopped):
    """A state or its rate is not finite.

    Attributes:
        entry: Index of the first entry that is not finite.
    """

    def __init__(self, message: str, time: float, state: NDArray[np.float64], entry: int) -> None:
        """Store the message, and the time, state and entry at which the integration stopped.

        Args:
            message: The message.
            time: The last time that was reached [s].
            state: The state at this time, (n,).
            entry: Index of the first entry that is not finite.
        """
        super().__init__(message, time, state)
        self.entry = entry

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.time, self.state, self.entry)


class RejectedWarning(UserWarning):
    """Some members of a batch have values that were rejected; the others were simulated."""


class LeftOutWarning(UserWarning):
    """A robot file contains an element that pinred does not simulate."""


class ModelWarning(UserWarning):
    """A robot can be simulated, but its model is doubtful or its file was not read literally."""


class AccuracyWarning(UserWarning):
    """The error of a simulation may be larger than its tolerance."""


class SceneWarning(UserWarning):
    """Joints move freely beside prescribed ones, or a motion goes beyond limits of the file."""


class LoopWarning(UserWarning):
    """An initial state leaves a closed loop open, so the nearest closed state is used."""


class CacheWarning(UserWarning):
    """The kernel cache on disk cannot be used; kernels are compiled again."""


class StoreWarning(UserWarning):
    """The store of a sweep is damaged; its damaged blocks are computed again."""
