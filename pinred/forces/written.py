"""Forces as users write them in Python: what goes wrong in them, told in words of forces."""

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

_SOURCE = re.compile(r"^\S*\.[ch]pp:\d+: ")  # where in CasADi
_INSTEAD = (
    "it is called once, with CasADi symbols: write casadi.sin(t) for math.sin or np.sin, and "
    "casadi.if_else(t < 0.5, a, b) for `if`; or use a Controller, which is given numbers"
)


def terms_of(force: Force, s: Symbols, number: Callable[[Any], Any]) -> Terms:
    """Return the action of a force.  Raises InputError, with what to write instead."""
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", r"\s*casadi: a numpy function", FutureWarning)
            terms = force.terms(s, number)
    except PinredError as error:
        if str(error).endswith("got nan"):  # as float() makes of a symbol, and so Python's math
            raise type(error)(f"{error}; if a function of yours gives it, {_INSTEAD}") from None
        raise
    except Exception as error:  # of any type, as somebody else's function raised it
        said = plain(_SOURCE.sub("", str(error)).partition("Possible prototypes")[0], 160)
        if isinstance(error, FutureWarning):
            said = "a function of NumPy was called on a CasADi symbol"
        raise InputError(f"{force.label}: {type(error).__name__}: {said}; {_INSTEAD}") from error
    if any(_lost(value) for value in terms.expressions):
        raise InputError(
            f"{force.label} is not a number at any time, as what Python's math makes of "
            f"symbols is: {_INSTEAD}"
        )
    return terms


def _lost(value: Any) -> bool:
    """Return whether an expression has a NaN in it that is a constant."""
    expression = ca.SX(value)
    function = ca.Function("f", ca.symvar(expression), [expression])
    return any(
        function.instruction_id(k) == ca.OP_CONST and math.isnan(function.instruction_constant(k))
        for k in range(function.n_instructions())
    )
