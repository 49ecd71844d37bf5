"""The types of forces on joints, on the base and on links.

Each force is a set of CasADi expressions in t, x, ẋ and μ, or in the whole state. The compiled
kernel, the Pinocchio route and the full simulation that validates both use the same expressions. A
conservative force defines its potential V, and its torques are −∂V/∂x. All other forces do work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..common.argument_kinds import checks_arguments
from ..common.parameter import Parameter
from ..system.ball_forces import BallSpring as BallSpring
from ..system.force_interface import SeenState as SeenState
from ..system.passive import Damper as Damper
from ..system.passive import Friction as Friction
from ..system.passive import Spring as Spring
from .ball_control import BallLimit as BallLimit
from .ball_control import BallPD as BallPD
from .controller import Command as Command
from .controller import Controller as Controller
from .force import Action as Action
from .force import Force as Force
from .force import Limit as Limit
from .force import (
    Named,
    Symbols,
    Terms,
    acting_value,
    called,
    checked,
    limited,
    scalar,
    signals_in,
)
from .signals import Signal
from .tracking import PD as PD
from .tracking import ComputedTorque as ComputedTorque
from .wrench import Wrench as Wrench

__all__ = [
    "PD",
    "Action",
    "BallLimit",
    "BallPD",
    "BallSpring",
    "Command",
    "ComputedTorque",
    "Controller",
    "Damper",
    "Force",
    "Friction",
    "Limit",
    "PotentialEnergy",
    "SeenState",
    "Spring",
    "Torque",
    "Wrench",
]


@checks_arguments
@dataclass(frozen=True)
class PotentialEnergy(Named):
    """A potential V(x) [J].

    Attributes:
        function: x → V, called once with a CasADi column (m,) that can also be indexed by joint
            name.
        name: Name in messages and results.
    """

    function: Callable[[Any], Any]
    name: str = "potential"

    def __post_init__(self) -> None:
        checked(self.name, "a function of x", self.function)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:  # noqa: ARG002
        """Return the potential as an expression.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        return Terms(potential=scalar(self.function(s.x), f"V(x) of {self.name}"))


@checks_arguments
@dataclass(frozen=True)
class Torque(Named):
    """Torques at the joints, τ(t, x, ẋ, μ) or τ(s) of the whole state [N·m | N].

    Torques at the joints leave the momentum constant, even if they depend on the base.

    Attributes:
        function: (t, x, xdot, mu) → {joint: expression} or m expressions, called once with symbols;
            or a function of one SeenState, which also has pose, twist and momenta of the base (see
            system/force_interface.py), with the same results; or {joint: Signal, number or (t, x,
            xdot, mu) → expression}. x["hinge"] equals x[0] for the first joint "hinge".
        limit: Bounds on the torques, or None.
        name: Name in messages and results.
    """

    function: Action | Mapping[str, Action | Signal | float | Parameter]
    limit: Limit | None = None
    name: str = "torque"

    def __post_init__(self) -> None:
        expected = "a function of (t, x, xdot, mu) or {joint: Signal or number}"
        checked(self.name, expected, self.function, Mapping)

    @property
    def signals(self) -> Iterable[Signal]:
        """Signals in the torques."""
        return signals_in(self.function.values()) if isinstance(self.function, Mapping) else ()

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques as expressions.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        if isinstance(self.function, Mapping):
            torque = {
                s.joint(name, self.name): acting_value(value, s, number, f"{self.name}['{name}']")
                for name, value in self.function.items()
            }
        else:
            values = s.column(called(self.function, s, self.name), self.name)
            torque = {
                k: scalar(v, f"{self.name} at '{s.every_name[k]}'") for k, v in values.items()
            }
        return Terms(torque=limited(self.limit, s, torque, number, self.name))
