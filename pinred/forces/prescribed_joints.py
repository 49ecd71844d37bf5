"""Joints with prescribed motions: their rates, and their motions as expressions of time.

A hinge or slide follows a Signal, and a ball follows an Attitude.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import casadi as ca

from ..common.errors import InputError
from ..common.names import joint_index
from ..system.force_interface import Symbols
from ..system.system import System
from .signals import Attitude, Signal

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
