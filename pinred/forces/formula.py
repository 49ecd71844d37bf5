"""Formulas of the state as text, used in scene files and events in place of functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from .force import Symbols
from .signals.expressions import parse

NAMES = ("t", "x", "xdot", "mu", "pose", "xi", "J")


@dataclass(frozen=True)
class Formula:
    """An expression in t, x, xdot, mu, pose, xi and J.

    mu is the momentum about the centre of mass. pose, xi and J describe the base in space, as in a
    SeenState.

    Attributes:
        text: The formula, see signals/expressions.py.
        others: Further names, {name: SX}.
    """

    text: str
    others: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, s: Symbols) -> ca.SX:
        """Return the expression for given variables.

        Args:
            s: Variables of the forces.
        Returns:
            The expression.
        """
        return parse(self.text, formula_names(s) | dict(self.others))


def formula_names(s: Symbols) -> dict[str, Any]:
    """Return the names that formulas may use of the state, {name: symbols}."""
    seen = s.seen
    lists = {"mu": s.mu, "pose": seen.pose, "xi": seen.xi, "J": seen.J}
    return {
        "t": s.t,
        "x": {name: s.x[k] for k, name in enumerate(s.every_name)},
        "xdot": {name: s.xdot[k] for k, name in enumerate(s.every_name)},
        **{name: [ca.SX(value) for value in ca.vertsplit(v)] for name, v in lists.items()},
    }
