"""Formulas of the state as text: what scene files and events have in the place of functions."""

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
    """An expression in t, x, xdot, mu, pose, xi and J.  others: names beside these, {name: SX}.

    mu is that of functions of (t, x, xdot, mu), about the centre of mass; pose, xi and J are those
    of a SeenState, of the base in space.
    """

    text: str
    others: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, s: Symbols) -> ca.SX:
        """Return the expression.  Raises InputError with the place of a fault."""
        return parse(self.text, formula_names(s) | dict(self.others))


def formula_names(s: Symbols) -> dict[str, Any]:
    """Return {name: symbols} of all that formulas may use of the state."""
    seen = s.seen
    lists = {"mu": s.mu, "pose": seen.pose, "xi": seen.xi, "J": seen.J}
    return {
        "t": s.t,
        "x": {name: s.x[k] for k, name in enumerate(s.every_name)},
        "xdot": {name: s.xdot[k] for k, name in enumerate(s.every_name)},
        **{name: [ca.SX(value) for value in ca.vertsplit(v)] for name, v in lists.items()},
    }
