"""The two accepted argument lists of functions of the state.

A function that accepts four positional arguments is called with (t, x, xdot, mu), where mu is about
the centre of mass. A function that accepts one, and not four, is called with a SeenState. Only the
number of positional arguments decides, never their names. A function with `*args` is called with
four. A function that accepts both, because other arguments have defaults, is rejected: use a lambda
or keyword-only arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from inspect import Parameter
from typing import Any, TypeAlias

from ..common.errors import InputError
from ..common.plain_names import brief
from ..system.force_interface import Symbols
from .force import of_time, scalar

Action: TypeAlias = Callable[..., Any]

_MANY = 1_000_000  # number of arguments that *args accept
_POSITIONAL = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
FORMS = "(t, x, xdot, mu), or one state s with s.t, s.x, s.xdot, s.pose, s.xi, s.mu and s.J"


def takes_state(function: Callable[..., Any], what: str) -> bool:
    """Return whether a function takes one SeenState instead of (t, x, xdot, mu).

    Args:
        function: The function.
        what: Its name in messages.
    Returns:
        True for one argument, False for four.
    Raises:
        InputError: It accepts neither number of arguments, or both.
    """
    least, most = _counts(function, what)
    if least > 4 or most < 1 or (least > 1 and most < 4):
        takes = f"{least}" if least == most else f"{least} to {most}"
        raise InputError(f"{what} must be a function of {FORMS}, but it takes {takes} arguments")
    if most < 4:
        return True
    if least <= 1 and most < _MANY:
        raise InputError(
            f"{what} can be called with one argument and with four, as the others have defaults, "
            f"and so it is not clear which form it is: {FORMS}; write 'lambda s: f(s)', or make "
            "arguments with defaults keyword-only"
        )
    return False


def _counts(function: Callable[..., Any], what: str) -> tuple[int, int]:
    """Return the smallest and the largest number of positional arguments of a function."""
    if hasattr(function, "n_in"):  # a Function of CasADi
        return function.n_in(), function.n_in()
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        raise InputError(
            f"{what}: {brief(function)} does not say how many arguments it takes; "
            f"write a lambda of {FORMS}"
        ) from None
    plain = [p for p in parameters if p.kind in _POSITIONAL]
    starred = any(p.kind is Parameter.VAR_POSITIONAL for p in parameters)
    needed = sum(p.default is Parameter.empty for p in plain)
    if any(p.kind is Parameter.KEYWORD_ONLY and p.default is Parameter.empty for p in parameters):
        raise InputError(f"{what} has a keyword-only argument without a default")
    return needed, _MANY if starred else len(plain)


def called(function: Callable[..., Any], s: Symbols, what: str) -> Any:
    """Call a function of the state with symbols, and return its result.

    Args:
        function: The function, or a Formula.
        s: Variables of the forces.
        what: Name of the function in messages.
    Returns:
        Its result.
    """
    from .formula import Formula  # needs CasADi

    if isinstance(function, Formula):
        return function(s)
    if takes_state(function, what):
        return function(s.seen)
    return function(s.t, s.x, s.xdot, s.mu)


def acting_value(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal, a number or a function of the state as an expression.

    Args:
        value: The value.
        s: Variables of the forces.
        number: Converts a number to a symbol.
        what: Name of the value in messages.
    Returns:
        A scalar expression.
    """
    if callable(value):
        return scalar(called(value, s, what), what)
    return of_time(value, s, number, what)
