"""Forces at ball joints that the user adds: PD control of the attitude, and swing–twist limits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import casadi as ca

from ..common.argument_kinds import checks_arguments
from ..common.errors import InputError
from ..common.parameter import Parameter
from ..system.force_interface import finite
from ..system.joints import attitude_of
from .force import Limit, Named, Symbols, Terms, limited
from .prescribed_joints import signals_of
from .signals import Attitude, Signal
from .tracking import attitude_errors

_AXES = {"x": 0, "y": 1, "z": 2}
_NARROWEST = 0.003  # differences of cosines are at most 2, and exp(2/0.003) is finite


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
        if self.axis not in _AXES:
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
        component, w = q[_AXES[self.axis]], q[3]
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
