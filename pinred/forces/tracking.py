"""Controllers that make joints follow reference motions: PD control and computed torque.

A hinge or slide follows a signal.  A ball follows an Attitude R_d(t), with the error E = R_dᵀ R.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeAlias

import casadi as ca
import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..common.errors import InputError
from ..common.parameter import Parameter
from ..system.ball_forces import rotation_vector
from .force import Limit, Named, PerJoint, Symbols, Terms, limited, of_time, per_joint
from .prescribed_joints import differentiated, require_attitude, signals_of
from .signals import Attitude, Signal
from .signals.attitude_signal import parse_attitude

Goal: TypeAlias = Signal | Attitude | float | Parameter | Sequence[Any] | Array
Reference: TypeAlias = Mapping[str, Goal]


@dataclass(frozen=True)
class TrackingError:
    """The deviation of a joint from its reference along one rate, as expressions.

    Attributes:
        position: x_d − x; along an axis of a ball −log E.
        rate: ẋ_d − ẋ; along an axis of a ball Eᵀσ_d − σ.
        acceleration: The acceleration that keeps `rate` constant, ẍ_d; along an axis of a ball
            Eᵀσ̇_d − σ × Eᵀσ_d.
    """

    position: Any
    rate: Any
    acceleration: Any


def tracking_errors(
    reference: Reference, s: Symbols, number: Callable[[Any], Any], what: str
) -> dict[int, TrackingError]:
    """Return the deviations of joints from a reference.

    Args:
        reference: Signal or number by joint, Attitude by ball.
        s: Variables of the forces.
        number: Function that replaces a number by a symbol.
        what: Name of the force in messages.
    Returns:
        Errors by index of the rate, three for a ball.
    Raises:
        InputError: A joint is unknown, or its reference is for another kind of joint.
    """
    errors: dict[int, TrackingError] = {}
    for name, value in reference.items():
        if isinstance(value, Attitude):
            q, first = s.ball(name, what)
            sigma = s.xdot[first : first + 3]
            target = value.written(s.t, s.within, number)
            errors |= {first + k: e for k, e in enumerate(attitude_errors(target, q, sigma))}
            continue
        if s.is_ball(name):
            require_attitude(value, f"{what}['{name}']")
        k = s.joint(name, what)
        goal = of_time(value, s, number, f"{what}['{name}']")
        x, xdot, acceleration = differentiated([goal], s.t)
        errors[k] = TrackingError(x - s.position(k, what), xdot - s.xdot[k], acceleration)
    return errors


def attitude_errors(
    target: tuple[ca.SX, ca.SX, ca.SX], q: ca.SX, sigma: ca.SX
) -> list[TrackingError]:
    """Return the deviations of a ball from an attitude over time, along the axes of the child.

    Args:
        target: Quaternion R_d, (4,), angular velocity σ_d, (3,), and σ̇_d, (3,).
        q: Quaternion of the ball, (4,).
        sigma: Angular velocity of the ball, (3,).
    """
    attitude, sigma_d, sigmadot_d = target
    u, w, v, real = attitude[:3], attitude[3], q[:3], q[3]
    vector, scalar = w * v - real * u - ca.cross(u, v), w * real + ca.dot(u, v)  # E = R_dᵀ R
    position = -rotation_vector(vector, scalar)
    follow = _turned_back(vector, scalar, sigma_d)
    acceleration = _turned_back(vector, scalar, sigmadot_d) - ca.cross(sigma, follow)
    return [TrackingError(position[k], follow[k] - sigma[k], acceleration[k]) for k in range(3)]


def _turned_back(vector: ca.SX, scalar: ca.SX, sigma: ca.SX) -> ca.SX:
    """Return Eᵀ σ, (3,), for the rotation E of a unit quaternion."""
    cross = ca.cross(vector, sigma)
    back: ca.SX = sigma - 2.0 * scalar * cross + 2.0 * ca.cross(vector, cross)
    return back


@checks_arguments
@dataclass(frozen=True)
class _Tracking(Named):
    """Base class of forces that track a reference with feedback of the error."""

    reference: Reference
    kp: PerJoint
    kd: PerJoint
    limit: Limit | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.reference, Mapping):
            raise InputError(
                f"{self.name} must have {{joint: Signal or number}}, got {self.reference!r}"
            )
        plans = {
            name: _plan(value, f"{self.name}['{name}']") for name, value in self.reference.items()
        }
        object.__setattr__(self, "reference", plans)

    @property
    def signals(self) -> Iterable[Signal]:
        """Signals in the reference."""
        return [signal for plan in self.reference.values() for signal in signals_of(plan)]

    def _feedback(
        self, s: Symbols, number: Callable[[Any], Any], errors: Mapping[int, TrackingError]
    ) -> dict[int, Any]:
        """Return kp (x_d − x) + kd (ẋ_d − ẋ) for each rate of the reference."""
        kp = per_joint(self.kp, errors, s, f"kp of {self.name}")
        kd = per_joint(self.kd, errors, s, f"kd of {self.name}")
        return {k: number(kp[k]) * e.position + number(kd[k]) * e.rate for k, e in errors.items()}


@checks_arguments
@dataclass(frozen=True)
class PD(_Tracking):
    """PD control: τ = kp (x_d − x) + kd (ẋ_d − ẋ) at the joints of the reference.

    At a ball with the reference R_d, τ = −kp log E + kd (Eᵀσ_d − σ) with E = R_dᵀ R.

    Attributes:
        reference: Signal or number by joint [rad | m]; for a ball an Attitude, or three signals,
            numbers or formulas in t of its rotation vector.
        kp: Stiffness [N·m/rad | N/m]: one value for all joints of the reference, or values by name.
        kd: Damping [N·m·s/rad | N·s/m]: one value for all joints of the reference, or values by
            name.
        limit: Bounds on the torques, or None.
        name: Name in messages and results.
    """

    name: str = "pd"

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques as expressions.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        errors = tracking_errors(self.reference, s, number, self.name)
        torque = self._feedback(s, number, errors)
        return Terms(torque=limited(self.limit, s, torque, number, self.name))


@checks_arguments
@dataclass(frozen=True)
class ComputedTorque(_Tracking):
    """Torques computed with inverse dynamics that make every joint follow its reference.

    ẍ = ẍ_d + kd (ẋ_d − ẋ) + kp (x_d − x) on the reduced system, with all other torques compensated.
    At a ball, the error E = R_dᵀ R obeys ė = −kd e − kp log E, where e = σ − Eᵀσ_d is its rate.
    Wrenches on the base are not compensated.  With closed loops, independent joints have references
    and torques, and the other joints follow.

    Attributes:
        reference: Signal or number by joint [rad | m], for every joint that is not prescribed, or
            with closed loops for as many as determine the others; for
            a ball an Attitude, or three signals, numbers or formulas in t of its rotation vector.
        kp: Stiffness [1/s²]: one value for all joints, or values by name.
        kd: Damping [1/s]: one value for all joints, or values by name.
        limit: Bounds on the torques, or None.
        name: Name in messages and results.
        last: Whether the force is evaluated after all others, whose sum it needs.
    """

    name: str = "computed torque"
    last: ClassVar[bool] = True

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques as expressions.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        Raises:
            InputError: The reference lacks a moving joint or contains a prescribed one.
        """
        errors = tracking_errors(self.reference, s, number, self.name)
        for k in errors:
            s.refuse_follower(k, f"{self.name} has a reference")
        missing = [k for k in range(len(s.names)) if k not in {*errors, *s.accelerations}]
        if missing and s.loop_motion is None:
            raise InputError(f"{self.name} has no reference for joint '{s.names[missing[0]]}'")
        if driven := [k for k in errors if k in s.accelerations]:
            raise InputError(
                f"{self.name} has a reference for '{s.names[driven[0]]}', which is prescribed"
            )
        accelerations = dict(s.accelerations)
        for k, feedback in self._feedback(s, number, errors).items():
            accelerations[k] = errors[k].acceleration + feedback
        torques = s.required_torque(accelerations) - s.others
        torque = {k: torques[k] for k in errors}
        if s.loop_motion is not None:  # the drives of these joints also move the others
            joints = sorted(accelerations)
            on_joints = s.loop_motion(joints).T @ torques
            torque = {k: on_joints[joints.index(k)] for k in errors}
        return Terms(torque=limited(self.limit, s, torque, number, self.name))


@dataclass(frozen=True)
class ComputedTorqueAtRest(ComputedTorque):
    """The same torques while some joints rest at their stops, against which they press.

    Attributes:
        resting: Indices of the rates of these joints.
    """

    resting: frozenset[int] = frozenset()

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques, as if the joints at rest could follow their references.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        moving = {k: a for k, a in s.accelerations.items() if k not in self.resting}
        return super().terms(replace(s, accelerations=moving), number)


def _plan(value: Any, what: str) -> Any:
    """Return the reference of a joint, with three signals or a quaternion as an Attitude."""
    plan = parse_attitude(value) if isinstance(value, (list, tuple, np.ndarray)) else value
    if isinstance(plan, Attitude):
        plan.refuse_jumps(what)
    return plan
