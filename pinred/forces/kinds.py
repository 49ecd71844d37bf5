"""The types of forces on joints, on balls, on the base and on links.

Each force is a set of CasADi expressions in t, x, ẋ and μ, or in the whole state. The compiled
kernel, the Pinocchio route and the full simulation that validates both use the same expressions. A
conservative force defines its potential V, and its torques are −∂V/∂x. All other forces do work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import as_floats
from ..common.errors import InputError
from ..common.names import brief, one_of
from ..common.parameter import Parameter, values_of
from ..system.force_interface import Load
from ..system.force_interface import SeenState as SeenState
from ..system.joints import attitude_of
from ..system.passive import BallSpring as BallSpring
from ..system.passive import Damper as Damper
from ..system.passive import Friction as Friction
from ..system.passive import Spring as Spring
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
    entries,
    finite,
    limited,
    scalar,
    signals_in,
)
from .signals import Attitude, Signal
from .tracking import PD as PD
from .tracking import ComputedTorque as ComputedTorque
from .tracking import attitude_errors, signals_of

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

Axes: TypeAlias = Literal["body", "world"]
AXES: tuple[Axes, ...] = ("body", "world")
_BALL_AXES = {"x": 0, "y": 1, "z": 2}
_NARROWEST = 0.003  # differences of cosines are at most 2, and exp(2/0.003) is finite


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


@checks_arguments
@dataclass(frozen=True)
class Wrench(Named):
    """A wrench [linear; angular], such as thrust, drag, or a pull at a hand.

    Without a link it acts on the base: r entries along the group's axes, at the base's origin. On a
    link it has 3 entries, a force [N], or 6, a force and a moment [N; N·m].

    Attributes:
        function: (t, x, xdot, mu) → entries, called once with symbols; or a function of one
            SeenState with the same result; or a list of entries, each a Signal, a number, or such a
            function that returns one entry.
        name: Name in messages and results.
        link: Name of a link, or None for the base.
        at: Point of the link at which the wrench acts, in the link's frame, (3,) [m].
        frame: Axes along which the entries are measured. "body": the axes of the base or link;
            "world": those of the root joint's fixed frame, which is also the frame of pose and
            spatial momentum.
    """

    function: Action | Sequence[Action | Signal | float | Parameter]
    name: str = "wrench"
    link: str | None = field(default=None, kw_only=True)
    at: Sequence[float | Parameter] | None = field(default=None, kw_only=True)
    frame: Axes = field(default="body", kw_only=True)

    def __post_init__(self) -> None:
        expected = "a function of (t, x, xdot, mu), of a state, or a list of Signals or numbers"
        checked(self.name, expected, self.function, Sequence, np.ndarray)
        if not one_of(self.frame, AXES):
            raise InputError(
                f"frame of {self.name} must be one of {', '.join(AXES)}, got {brief(self.frame)}"
            )
        if self.link is not None and not isinstance(self.link, str):
            raise InputError(f"link of {self.name} must be a name, got {brief(self.link)}")
        if self.at is None:
            return
        if self.link is None:
            raise InputError(f"{self.name}: at= is a point of a link; pass link= as well")
        point = as_floats(values_of(self.at), f"at of {self.name}")
        if point.shape != (3,) or not np.isfinite(point).all():
            raise InputError(f"at of {self.name} must be 3 finite numbers, got {brief(self.at)}")
        coordinates = self.at.tolist() if isinstance(self.at, np.ndarray) else self.at
        object.__setattr__(self, "at", tuple(coordinates))

    @property
    def signals(self) -> Iterable[Signal]:
        """Signals in the wrench."""
        return () if callable(self.function) else signals_in(self.function)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the wrench, or the load on a link.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        values = self._entries(s, number, s.mu.numel())
        if self.link is None and self.frame == "body":
            return Terms(wrench=values)
        if self.link is None:
            return Terms(loads=[Load(None, [0.0] * 3, self.frame, values)])
        point = [number(a) if isinstance(a, Parameter) else float(a) for a in self.at or (0, 0, 0)]
        padded = [*values, *[0.0] * (6 - len(values))]
        return Terms(loads=[Load(self.link, point, self.frame, padded)])

    def _entries(self, s: Symbols, number: Callable[[Any], Any], r: int) -> list[Any]:
        """Return the entries as expressions; raise InputError if their number is wrong."""
        function = self.function
        value = called(function, s, self.name) if callable(function) else function
        if self.link is None:
            values = entries(value, r, self.name)
        else:
            values = entries(value, 3 if _count(value) == 3 else 6, f"{self.name} on a link")
        if callable(function):
            return [scalar(v, f"{self.name}[{i}]") for i, v in enumerate(values)]
        return [acting_value(v, s, number, f"{self.name}[{i}]") for i, v in enumerate(values)]


@checks_arguments
@dataclass(frozen=True, eq=False)
class BallPD(Named):
    """PD control of a ball towards an attitude R_d: τ = −kp log(E) − kd (σ − Eᵀ σ_d), E = R_dᵀ R.

    The torque has a jump where the ball is half a turn away from R_d.

    Attributes:
        joint: Name of the ball joint.
        attitude: R_d as a rotation vector, (3,) [rad], or a quaternion (x, y, z, w); or an
            Attitude over time, with the angular velocity σ_d, or the three signals, numbers or
            formulas in t of its rotation vector.
        kp: Stiffness [N·m/rad].
        kd: Damping [N·m·s/rad].
        limit: Bounds on the torques by axis, such as "neck.x", or None.
        name: Name in messages and results.
    """

    joint: str
    attitude: Any
    kp: float | Parameter
    kd: float | Parameter
    limit: Limit | None = None
    name: str = "ball pd"

    def __post_init__(self) -> None:
        object.__setattr__(self, "attitude", _target(self.attitude, f"attitude of {self.name}"))
        for gain in ("kp", "kd"):
            object.__setattr__(self, gain, finite(getattr(self, gain), f"{gain} of {self.name}"))

    @property
    def signals(self) -> Iterable[Signal]:
        """Signals in the attitude."""
        return signals_of(self.attitude)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques as expressions.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        q, first = s.ball(self.joint, self.name)
        sigma = s.xdot[first : first + 3]
        errors = attitude_errors(self._motion(s, number), q, sigma)
        torque = {
            first + k: number(self.kp) * e.position + number(self.kd) * e.rate
            for k, e in enumerate(errors)
        }
        return Terms(torque=limited(self.limit, s, torque, number, self.name))

    def _motion(self, s: Symbols, number: Callable[[Any], Any]) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return R_d as a quaternion, (4,), σ_d, (3,), and its derivative, (3,)."""
        if isinstance(self.attitude, Attitude):
            return self.attitude.written(s.t, s.within, number)
        return ca.SX(ca.DM(self.attitude)), ca.SX(3, 1), ca.SX(3, 1)


@checks_arguments
@dataclass(frozen=True, eq=False)
class BallLimit(Named):
    """A smooth potential that limits the swing and the twist of a ball.

    The attitude is a twist about an axis of the child, after a swing that moves this axis.  With
    the swing angle φ in [0, π] and the twist angle ψ in (−π, π), the potential is
    k s(cos φ_max − cos φ) + k s(cos ψ_max − cos ψ), where s(y) = w log(1 + exp(y/w)) is a smooth
    max(0, y).  Beyond a limit the torque approaches k sin φ.

    Attributes:
        joint: Name of the ball joint.
        swing: Largest swing angle φ_max [rad]; None: no limit.
        twist: Largest twist angle |ψ|_max [rad]; None: no limit.
        axis: Axis of the child about which it twists: "x", "y" or "z".
        stiffness: Stiffness k [N·m].
        width: Width w of the transition, in cosines.
        name: Name in messages and results.
    """

    joint: str
    swing: float | None = None
    twist: float | None = None
    axis: str = "z"
    stiffness: float | Parameter = 100.0
    width: float = 0.05
    name: str = "ball limit"

    def __post_init__(self) -> None:
        if self.axis not in _BALL_AXES:
            raise InputError(f"axis of {self.name}: expected x, y or z, got {self.axis!r}")
        for what in ("swing", "twist"):
            angle = getattr(self, what)
            if angle is not None and not 0.0 < angle < float(ca.pi):
                raise InputError(
                    f"{what} of {self.name}: expected an angle between 0 and π, got {angle}"
                )
        if self.swing is None and self.twist is None:
            raise InputError(f"{self.name}: give swing, twist, or both")
        if not _NARROWEST <= self.width < float("inf"):
            raise InputError(
                f"width of {self.name}: expected at least {_NARROWEST}, so that exponentials do "
                f"not overflow, got {self.width}"
            )
        object.__setattr__(self, "stiffness", finite(self.stiffness, f"stiffness of {self.name}"))

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the potential as an expression.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        q, _ = s.ball(self.joint, self.name)
        component, w = q[_BALL_AXES[self.axis]], q[3]
        twist_square = component * component + w * w  # cos²(φ/2)
        potential = ca.SX(0)
        if self.swing is not None:
            potential += _softplus(ca.cos(self.swing) - (2.0 * twist_square - 1.0), self.width)
        if self.twist is not None:
            # cos ψ = (w² − a²)/(w² + a²), which is not defined at a swing of half a turn
            cosine = (w * w - component * component) / twist_square
            potential += _softplus(ca.cos(self.twist) - cosine, self.width)
        return Terms(potential=number(self.stiffness) * potential)


def _target(value: Any, what: str) -> Any:
    """Return a constant attitude as a quaternion, (4,), or an Attitude over time."""
    if isinstance(value, Attitude):
        value.refuse_jumps(what)
        return value
    entries = list(value) if isinstance(value, (list, tuple)) else []
    if len(entries) == 3 and any(isinstance(v, (Signal, Parameter, str)) for v in entries):
        return _target(Attitude(entries), what)
    return attitude_of(value, what)


def _softplus(y: ca.SX, width: float) -> ca.SX:
    """Return w log(1 + e^(y/w)), a smooth max(0, y) for differences y of two cosines."""
    smooth: ca.SX = width * ca.log(1.0 + ca.exp(y / width))
    return smooth


def _count(given: Any) -> int:
    """Return the number of entries of a value, 0 if it has none."""
    if hasattr(given, "numel"):
        return int(given.numel())
    return len(given) if hasattr(given, "__len__") else 0
