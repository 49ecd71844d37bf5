"""Base class and helpers of forces, which are functions or expressions of the state."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import positive
from ..common.errors import InputError
from ..common.names import brief
from ..common.parameter import Parameter, checked_number
from ..system.force_interface import Force as Force
from ..system.force_interface import Symbols as Symbols
from ..system.force_interface import Terms as Terms
from ..system.force_interface import entries as entries
from ..system.force_interface import finite as finite
from .signals import Signal

PerJoint: TypeAlias = float | Parameter | Mapping[str, float | Parameter]


class Named(Force):
    """A force with a name."""

    name: str

    @property
    def label(self) -> str:
        """Name of the force."""
        return self.name


@checks_arguments
@dataclass(frozen=True)
class Limit:
    """Bounds on torques.

    Attributes:
        most: Largest absolute torque [N·m | N]: one value for all joints, or values by joint name.
        smooth: Whether the torque saturates smoothly (tanh) instead of being clipped with a kink.
    """

    most: PerJoint
    smooth: bool = False

    def apply(
        self, s: Symbols, torque: dict[int, Any], number: Callable[[Any], Any], what: str
    ) -> dict[int, Any]:
        """Return the torques with the bounds applied.

        Args:
            s: Variables of the forces.
            torque: Torques by joint index.
            number: Function that replaces a number by a symbol.
            what: Name of the force in messages.
        Returns:
            Torques by joint index.
        """
        import casadi as ca

        bounded = dict(torque)
        for k, bound in per_joint(self.most, torque, s, f"the limit of {what}").items():
            description = f"the limit of {what} at '{s.every_name[k]}'"
            most = number(checked_number(bound, partial(positive, what=description)))
            if self.smooth:
                bounded[k] = most * ca.tanh(torque[k] / most)
            else:
                bounded[k] = ca.fmin(ca.fmax(torque[k], -most), most)
        return bounded


def of_time(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal or a number as a CasADi expression of time.

    Args:
        value: The value to convert or check.
        s: Variables of the forces.
        number: Function that replaces a number by a symbol.
        what: Name of the value in messages.
    Returns:
        The expression.
    """
    if isinstance(value, Signal):
        return value.written(s.t, s.within, number)
    return number(finite(value, what, "a Signal or a number"))


def signals_in(values: Iterable[Any]) -> list[Signal]:
    """Return the Signals that a collection of values contains."""
    return [value for value in values if isinstance(value, Signal)]


def checked(what: str, wanted: str, value: Any, *kinds: type) -> None:
    """Raise InputError if a value is neither callable nor of one of the types.

    Args:
        what: Name of the value in messages.
        wanted: Description of valid values, for the message.
        value: The value to convert or check.
        *kinds: Valid types.
    Raises:
        InputError: The value is invalid.
    """
    if not (callable(value) or isinstance(value, kinds)):
        raise InputError(f"{what} must be {wanted}, got {value!r}")


def limited(
    limit: Limit | None,
    s: Symbols,
    torque: dict[int, Any],
    number: Callable[[Any], Any],
    what: str,
) -> dict[int, Any]:
    """Apply a limit to torques, or return them unchanged if the limit is None.

    Args:
        limit: The limit, or None.
        s: Variables of the forces.
        torque: Torques by joint index.
        number: Function that replaces a number by a symbol.
        what: Name of the force in messages.
    Returns:
        Torques by joint index.
    Raises:
        InputError: The limit is not a Limit.
    """
    if limit is None:
        return torque
    if not isinstance(limit, Limit):
        raise InputError(f"limit of {what} must be a Limit, got {limit!r}")
    return limit.apply(s, torque, number, what)


def per_joint(
    values: PerJoint, joints: Iterable[int], s: Symbols, what: str
) -> dict[int, float | Parameter]:
    """Return the value for each joint, given one value for all joints or values by joint name.

    Args:
        values: One value, or values by name of a joint or of an axis of a ball.
        joints: Indices of the joints that need a value.
        s: Variables of the forces.
        what: Name of the values in messages.
    Returns:
        Values by joint index.
    Raises:
        InputError: A value is missing or not finite.
    """
    joints = list(joints)
    if not isinstance(values, Mapping):
        return dict.fromkeys(joints, finite(values, what))
    by_joint = {
        k: finite(v, f"{what} at '{name}'")
        for name, v in values.items()
        for k in s.rates(name, what)
    }
    missing = [s.every_name[k] for k in joints if k not in by_joint]
    if missing:
        raise InputError(f"{what} has no value for '{missing[0]}'")
    return {k: by_joint[k] for k in joints}


def scalar(value: Any, what: str) -> Any:
    """Return a scalar value as an SX expression.

    Args:
        value: The value to convert or check.
        what: Name of the function or value in messages.
    Returns:
        The expression.
    Raises:
        InputError: The value is neither a finite number nor a scalar SX expression.
    """
    import casadi as ca

    try:
        expression = ca.SX(value)
    except NotImplementedError:
        raise InputError(
            f"{what} must be a number or a CasADi SX expression, got {type(value).__name__}; "
            "use CasADi's functions (casadi.sin, …) on the arguments"
        ) from None
    if expression.numel() != 1:
        raise InputError(f"{what} must be one value, got shape {expression.shape}")
    if expression.is_constant() and not np.isfinite(float(expression)):
        raise InputError(f"{what} must be finite, got {float(expression)}")
    return ca.densify(expression)


Action: TypeAlias = Callable[..., Any]

_MANY = 1_000_000  # number of arguments assumed for a function with *args
_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
FORMS = "(t, x, xdot, mu), or one state s with s.t, s.x, s.xdot, s.pose, s.xi, s.mu and s.J"


def takes_state(function: Callable[..., Any], what: str) -> bool:
    """Return whether a function takes one SeenState instead of (t, x, xdot, mu).

    Args:
        function: The function.
        what: Name of the function or value in messages.
    Returns:
        True for one argument, False for four.
    Raises:
        InputError: The function accepts neither one nor four arguments, or accepts both.
    """
    least, most = _counts(function, what)
    if least > 4 or most < 1 or (least > 1 and most < 4):
        takes = f"{least}" if least == most else f"{least} to {most}"
        raise InputError(f"{what} must be a function of {FORMS}, but it takes {takes} arguments")
    if most < 4:
        return True
    if least <= 1 and most < _MANY:
        raise InputError(
            f"{what} accepts one argument and also four, because of defaults, so its form is "
            f"ambiguous: {FORMS}; write 'lambda s: f(s)', or make arguments with defaults "
            "keyword-only"
        )
    return False


def _counts(function: Callable[..., Any], what: str) -> tuple[int, int]:
    """Return the smallest and the largest number of positional arguments of a function."""
    if hasattr(function, "n_in"):  # a CasADi Function
        return function.n_in(), function.n_in()
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        raise InputError(
            f"{what}: {brief(function)} has no signature that Python can read; "
            f"write a lambda of {FORMS}"
        ) from None
    plain = [p for p in parameters if p.kind in _POSITIONAL]
    starred = any(p.kind is inspect.Parameter.VAR_POSITIONAL for p in parameters)
    needed = sum(p.default is inspect.Parameter.empty for p in plain)
    if any(
        p.kind is inspect.Parameter.KEYWORD_ONLY and p.default is inspect.Parameter.empty
        for p in parameters
    ):
        raise InputError(f"{what} has a keyword-only argument without a default")
    return needed, _MANY if starred else len(plain)


class SymbolFunction:
    """A function that is called with the whole `Symbols`, unlike user functions."""

    def __call__(self, s: Symbols) -> Any:
        """Return the expression."""
        raise NotImplementedError


def called(function: Callable[..., Any], s: Symbols, what: str) -> Any:
    """Call a function of the state with symbols, and return its result.

    Args:
        function: The function, or a Formula.
        s: Variables of the forces.
        what: Name of the function in messages.
    Returns:
        The return value of the function.
    """
    if isinstance(function, SymbolFunction):
        return function(s)
    if takes_state(function, what):
        return function(s.seen)
    return function(s.t, s.x, s.xdot, s.mu)


def acting_value(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal, a number or a function of the state as an expression.

    Args:
        value: The value to convert or check.
        s: Variables of the forces.
        number: Function that replaces a number by a symbol.
        what: Name of the value in messages.
    Returns:
        A scalar expression.
    """
    if callable(value):
        return scalar(called(value, s, what), what)
    return of_time(value, s, number, what)
