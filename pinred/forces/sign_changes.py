"""All times at which a function of time changes its sign, or an error if some might be missing."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from ..common.arrays import Array
from .span_numbers import Tables
from .switch_times import SwitchTimes, time_within
from .time_switches import separate


class SignChanges:
    """The sign changes of an expression that depends on time and numbers only."""

    def __init__(self, expression: ca.SX, t: ca.SX, numbers: Sequence[ca.SX]) -> None:
        """Prepare the search.

        Args:
            expression: The expression, a scalar.
            t: Time.
            numbers: Symbols of the numbers, (p,).
        Raises:
            InputError: The expression contains an operation that has no bounds.
        """
        within = ca.SX.sym("within")
        separated = separate([ca.sign(expression)], t, within, numbers)
        switches = [] if separated is None else separated.switches
        self._switches = SwitchTimes(switches, t, within, numbers, Tables())
        self._value = ca.Function("g", [t, ca.vertcat(ca.SX(0, 1), *numbers)], [expression])

    def spans(self, end: float, numbers: Array) -> tuple[Array, Array]:
        """Return the times at which the sign may change, and values between them.

        Args:
            end: End time [s].
            numbers: Numbers, (p,).
        Returns:
            Starts of spans of constant sign, (S,) [s], and a value of the expression in each, (S,).
        Raises:
            InputError: There are too many times, or a sign cannot be decided.
        """
        starts = np.append(0.0, self._switches.breaks(end, numbers))
        within = time_within(starts, np.append(starts[1:], end))
        repeated = np.repeat(numbers[:, None], len(within), axis=1)
        return starts, np.asarray(self._value(within[None], repeated)).ravel()
