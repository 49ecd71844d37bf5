"""The two forms of functions of the state, and how they are told apart.

A function that can take four arguments is given (t, x, xdot, mu), as seen from the centre of
mass; one that can take one, and not four, is given a SeenState.  What decides is the number of
positional arguments, never their names.  A function that takes `*args` takes four.  One that
could take either, because its other arguments have defaults, is refused: say which is meant,
with a lambda or with keyword-only arguments.
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

_MANY = 1_000_000  # what *args take
_POSITIONAL = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
FORMS = "(t, x, xdot, mu), or one state s with s.t, s.x, s.xdot, s.pose, s.xi, s.mu and s.J"


def takes_state(function: Callable[..., Any], what: str) -> bool:
    """Return whether a function is of one argument, a SeenState, and not of (t, x, xdot, mu).

    Raises InputError, naming `what`, where it is neither, or could be both.
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
    """Return how many positional arguments a function takes, at least and at most."""
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
    """Return what a function of the state gives, in the form that it has, with symbols."""
    from .formula import Formula  # needs CasADi

    if isinstance(function, Formula):
        return function(s)
    if takes_state(function, what):
        return function(s.seen)
    return function(s.t, s.x, s.xdot, s.mu)


def acting_value(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal, a number or a function of the state as an expression."""
    if callable(value):
        return scalar(called(value, s, what), what)
    return of_time(value, s, number, what)
