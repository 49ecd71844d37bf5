"""Joints that follow motions: prescribed ones, and those that PD control or computed torque drives.

A hinge or slide follows a Signal.  A ball follows an Attitude R_d(t), with the error E = R_dᵀ R.
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
from ..common.names import joint_index
from ..common.parameter import Parameter
from ..system.passive import rotation_vector
from ..system.system import System
from .force import Limit, Named, PerJoint, Symbols, Terms, limited, of_time, per_joint
from .signals import Attitude, Signal
from .signals.attitude_signal import parse_attitude

Plan: TypeAlias = Signal | Attitude
Motion: TypeAlias = tuple[ca.SX, ca.SX, ca.SX]


def signals_of(plan: Any) -> tuple[Signal, ...]:
    """Return the scalar signals in a prescribed motion or in the reference of a controller."""
    if isinstance(plan, Attitude):
        return tuple(plan.vector)
    return (plan,) if isinstance(plan, Signal) else ()


def prescribed_rates(system: System, prescribed: Mapping[str, Plan]) -> tuple[int, ...]:
    """Validate prescribed joints and their motions.

    Args:
        system: The robot.
        prescribed: Motions of joints by name.
    Returns:
        Indices of the rates of the prescribed joints, three for a ball.
    Raises:
        InputError: A joint does not exist or is a follower, or its motion has another format, a
            kink or a jump.
    """
    for name in prescribed:
        system.refuse_follower(name, "prescribed")
    rates: list[int] = []
    for name, plan in prescribed.items():
        rates += rates_of_joint(system, name, plan, "prescribed")
    for name, plan in prescribed.items():
        what = f"prescribed['{name}']"
        for signal in signals_of(plan):
            if signal.smoothness < 1:
                raise InputError(
                    f"{what} must have a continuous rate, but {signal!r} has a kink or a jump; "
                    "use a Spline"
                )
        if isinstance(plan, Attitude):
            plan.refuse_jumps(what)
    return tuple(rates)


def rates_of_joint(system: System, name: str, plan: Any, what: str) -> list[int]:
    """Return the indices of the rates of a joint that follows a plan.

    Args:
        system: The robot.
        name: Name of the joint.
        plan: Attitude for a ball; any other value for a hinge or slide.
        what: Beginning of the error message.
    Raises:
        InputError: There is no such joint, or the plan is for another kind of joint.
    """
    space = system.space
    balls = {joint.name: joint for joint in space.balls}
    if name in balls:
        require_attitude(plan, f"{what}['{name}']")
        return list(range(balls[name].v.start, balls[name].v.stop))
    if balls and name in space.names and name not in space.x_names:
        ball, _, _ = name.rpartition(".")
        raise InputError(
            f"{what}: {name!r} is an axis of a ball joint, along which there is no coordinate; "
            f"use the whole ball '{ball}' with an Attitude"
        )
    if name not in space.names:
        joint_index(name, [joint.name for joint in space.joints], what)
    if isinstance(plan, Attitude):
        raise InputError(
            f"{what}['{name}'] is no ball joint: expected a Signal, a number or a formula in t, "
            "got an Attitude"
        )
    return [space.names.index(name)]


def require_attitude(plan: Any, what: str) -> None:
    """Raise InputError if the plan of a ball joint is no Attitude."""
    if not isinstance(plan, Attitude):
        raise InputError(
            f"{what} is a ball joint: expected an Attitude, or three signals, numbers or formulas "
            f"of a rotation vector, got {plan!r}"
        )


def prescribed_motion(
    prescribed: Mapping[str, Plan], s: Symbols, number: Callable[[Any], Any]
) -> Motion:
    """Return coordinates, rates and accelerations of the prescribed joints as expressions.

    Args:
        prescribed: Motions of joints by name.
        s: Variables of the forces.
        number: Function that replaces a number by a symbol.
    Returns:
        Columns of coordinates, four for a ball, and of rates and accelerations, three for a ball.
    """
    signals = [plan for plan in prescribed.values() if isinstance(plan, Signal)]
    if len(signals) == len(prescribed):
        return differentiated([plan.written(s.t, s.within, number) for plan in signals], s.t)
    motions = [motion_of(plan, s, number) for plan in prescribed.values()]
    x, xdot, xddot = (ca.vertcat(*columns) for columns in zip(*motions, strict=True))
    return x, xdot, xddot


def motion_of(plan: Plan, s: Symbols, number: Callable[[Any], Any]) -> Motion:
    """Return coordinates, rates and accelerations of one joint that follows a plan."""
    if isinstance(plan, Attitude):
        return plan.written(s.t, s.within, number)
    return differentiated([plan.written(s.t, s.within, number)], s.t)


def differentiated(values: Sequence[ca.SX], t: ca.SX) -> Motion:
    """Return expressions of time as a column, and its first two derivatives."""
    x = ca.vertcat(*values)
    xdot = ca.jacobian(x, t)
    return x, xdot, ca.jacobian(xdot, t)


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
