"""The kinds of forces, on joints, on the base and on links.

Each is written as CasADi expressions in t, x, ẋ and μ, or in the whole state, so that the same
force goes into the compiled kernel, into the Pinocchio route and into the full simulation that
judges both.  A force that has a potential gives it, and its torques −∂V/∂x follow; the others do
work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from ..common.errors import InputError
from ..common.parameter import Parameter
from ..system.force_interface import SeenState as SeenState
from ..system.passive import Damper as Damper
from ..system.passive import Friction as Friction
from ..system.passive import Spring as Spring
from .arguments import Action as Action
from .arguments import acting_value, called
from .controller import Command as Command
from .controller import Controller as Controller
from .force import Force as Force
from .force import Limit as Limit
from .force import (
    Named,
    PerJoint,
    Reference,
    Symbols,
    Terms,
    checked,
    checked_reference,
    limited,
    motions,
    per_joint,
    scalar,
    signals_in,
)
from .signals import Signal
from .wrench import Wrench as Wrench

__all__ = [
    "PD",
    "Action",
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


@dataclass(frozen=True)
class PotentialEnergy(Named):
    """A potential V(x) [J].

    function: from x, an SX of (m,) with joints by name too, to a scalar SX; called once.
    """

    function: Callable[[Any], Any]
    name: str = "potential"

    def __post_init__(self) -> None:
        checked(self.name, "a function of x", self.function)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:  # noqa: ARG002
        """Return the potential."""
        return Terms(potential=scalar(self.function(s.x), f"V(x) of {self.name}"))


@dataclass(frozen=True)
class Torque(Named):
    """Torques at the joints, τ(t, x, ẋ, μ) or τ(s) of the whole state [N·m | N].

    function: (t, x, xdot, mu) → {joint: expression} or m expressions, called once with SX
    symbols (of Symbols' meaning); or {joint: Signal, number or (t, x, xdot, mu) → expression}.
    x["hinge"] and xdot["hinge"] are entries by joint, as x[0] is.
    A function of one argument is given a SeenState instead of the four, with pose, twist and
    momenta of the base (see arguments.py): momentum stays constant all the same.
    """

    function: Action | Mapping[str, Action | Signal | float | Parameter]
    limit: Limit | None = None
    name: str = "torque"

    def __post_init__(self) -> None:
        wanted = "a function of (t, x, xdot, mu) or {joint: Signal or number}"
        checked(self.name, wanted, self.function, Mapping)

    @property
    def signals(self) -> Iterable[Signal]:
        """The functions of time in it."""
        return signals_in(self.function.values()) if isinstance(self.function, Mapping) else ()

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques."""
        if isinstance(self.function, Mapping):
            torque = {
                s.joint(name, self.name): acting_value(value, s, number, f"{self.name}['{name}']")
                for name, value in self.function.items()
            }
        else:
            found = s.column(called(self.function, s, self.name), self.name)
            torque = {k: scalar(v, f"{self.name} at '{s.every_name[k]}'") for k, v in found.items()}
        return Terms(torque=limited(self.limit, s, torque, number, self.name))


@dataclass(frozen=True)
class _Tracking(Named):
    """A controller that follows a reference: its fields, and the feedback of the error."""

    reference: Reference
    kp: PerJoint
    kd: PerJoint
    limit: Limit | None = None

    def __post_init__(self) -> None:
        checked_reference(self.reference, self.name)

    @property
    def signals(self) -> Iterable[Signal]:
        """The functions of time in it."""
        return signals_in(self.reference.values())

    def _feedback(
        self, s: Symbols, number: Callable[[Any], Any], wanted: dict[int, tuple[Any, Any, Any]]
    ) -> dict[int, Any]:
        """Return kp (x_d − x) + kd (ẋ_d − ẋ) of each joint whose motion is wanted."""
        kp = per_joint(self.kp, wanted, s, f"kp of {self.name}")
        kd = per_joint(self.kd, wanted, s, f"kd of {self.name}")
        return {
            k: number(kp[k]) * (x - s.x[k]) + number(kd[k]) * (xdot - s.xdot[k])
            for k, (x, xdot, _) in wanted.items()
        }


@dataclass(frozen=True)
class PD(_Tracking):
    """PD control: τ = kp (x_d − x) + kd (ẋ_d − ẋ) at the joints of the reference.

    reference: {joint: Signal or number}.  kp, kd: of all these joints, or by name.
    """

    name: str = "pd"

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques."""
        wanted = motions(self.reference, s, number, self.name)
        torque = self._feedback(s, number, wanted)
        return Terms(torque=limited(self.limit, s, torque, number, self.name))


@dataclass(frozen=True)
class ComputedTorque(_Tracking):
    """Torques that make every joint follow its reference exactly, whatever else acts on it.

    ẍ = ẍ_d + kd (ẋ_d − ẋ) + kp (x_d − x) by inverse dynamics on the reduced system; a wrench
    on the base is not known to it.  reference: {joint: Signal or number} of every joint that
    is not prescribed.  kp [1/s²], kd [1/s]: of all joints, or by name.
    """

    name: str = "computed torque"
    last: ClassVar[bool] = True

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques.  Raises InputError if a joint that moves has no reference."""
        wanted = motions(self.reference, s, number, self.name)
        for k in wanted:
            s.refuse_follower(k, f"{self.name} has a reference")
        missing = [k for k in range(len(s.names)) if k not in {*wanted, *s.accelerations}]
        if missing:
            raise InputError(f"{self.name} has no reference for joint '{s.names[missing[0]]}'")
        if driven := [k for k in wanted if k in s.accelerations]:
            raise InputError(
                f"{self.name} has a reference for '{s.names[driven[0]]}', which is prescribed"
            )
        accelerations = dict(s.accelerations)
        for k, feedback in self._feedback(s, number, wanted).items():
            accelerations[k] = wanted[k][2] + feedback
        every = s.required_torque(accelerations) - s.others
        torque = {k: every[k] for k in wanted}
        return Terms(torque=limited(self.limit, s, torque, number, self.name))
