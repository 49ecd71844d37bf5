"""Forces from user functions, with errors in CasADi or Python explained in terms of forces."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca

from ..common.errors import InputError, PinredError
from ..common.plain_names import plain
from ..system.force_interface import Force, Symbols, Terms

_SOURCE = re.compile(r"^\S*\.[ch]pp:\d+: ")  # source location in CasADi's messages
_INSTEAD = (
    "it is called once, with CasADi symbols: write casadi.sin(t) for math.sin or np.sin, and "
    "casadi.if_else(t < 0.5, a, b) for `if`; or use a Controller, which is called with numbers"
)


def terms_of(force: Force, s: Symbols, number: Callable[[Any], Any]) -> Terms:
    """Return the terms of a force.

    Args:
        force: The force.
        s: Variables of the forces.
        number: Converts a number to a symbol.
    Returns:
        The terms.
    Raises:
        InputError: The force's function fails; the message says what to write instead.
    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", r"\s*casadi: a numpy function", FutureWarning)
            terms = force.terms(s, number)
    except PinredError as error:
        if str(error).endswith("got nan"):  # float() of a symbol is NaN, as in Python's math
            raise type(error)(f"{error}; if a function of yours returns it, {_INSTEAD}") from None
        raise
    except Exception as error:  # user functions may raise any type
        description = plain(_SOURCE.sub("", str(error)).partition("Possible prototypes")[0], 160)
        if isinstance(error, FutureWarning):
            description = "a function of NumPy was called on a CasADi symbol"
        raise InputError(
            f"{force.label}: {type(error).__name__}: {description}; {_INSTEAD}"
        ) from error
    if any(_contains_nan(value) for value in terms.expressions):
        raise InputError(
            f"{force.label} is not a number at any time, as what Python's math makes of "
            f"symbols is: {_INSTEAD}"
        )
    return terms


def _contains_nan(value: Any) -> bool:
    """Return whether an expression contains a constant NaN."""
    expression = ca.SX(value)
    function = ca.Function("f", ca.symvar(expression), [expression])
    return any(
        function.instruction_id(k) == ca.OP_CONST and math.isnan(function.instruction_constant(k))
        for k in range(function.n_instructions())
    )
