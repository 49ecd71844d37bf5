"""Forces of the actuators in a robot file, driven by controls."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.errors import InputError
from ..common.parameter import Parameter
from ..system.ball_forces import rotation_vector
from ..system.robot_file_contents import Actuator
from .force import Action, Named, Symbols, Terms, acting_value, signals_in
from .signals import Signal

Control: TypeAlias = Signal | float | Parameter | str | Action
_BASE = -1  # index of the base among the joints that actuators drive


@checks_arguments
@dataclass(frozen=True)
class Actuation(Named):
    """The forces of actuators whose controls are functions of time and state.

    Attributes:
        controls: Actuators with their controls: numbers, Signals, or functions as of a Torque.
        name: Name in messages and results.
    """

    controls: tuple[tuple[Actuator, Any], ...]
    name: str = "actuators"

    @property
    def signals(self) -> Iterable[Signal]:
        """Signals in the controls."""
        return signals_in(control for _, control in self.controls)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return torques at the joints, and the wrench on the base, as expressions.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        Raises:
            InputError: A control is invalid.
        """
        driven = []
        for actuator, control in self.controls:
            what = f"controls['{actuator.name}']"
            value, limits = control, actuator.control_limits
            if isinstance(control, float) and limits is not None:
                value = float(np.clip(control, *limits))  # so that the force has no kink
            try:
                driven.append((actuator, acting_value(value, s, number, what)))
            except InputError as error:
                text = str(error)
                raise InputError(text if text.startswith(what) else f"{what}: {text}") from None
        return actuator_terms(driven, s)


def actuator_terms(controls: Iterable[tuple[Actuator, Any]], s: Symbols) -> Terms:
    """Return the terms of actuators, given their controls before the limits.

    Args:
        controls: Actuators, each with an expression of its control.
        s: Variables of the forces.
    Returns:
        The torques, and the wrench if an actuator moves the base.
    """
    import casadi as ca

    torques: dict[int, Any] = {}
    limits = {}
    for actuator, value in controls:
        joints, gear, length, rate = _transmission(actuator, s)
        control = value if isinstance(value, float) else _clamped(value, actuator.control_limits)
        gain, bias = (
            sum(c * v for c, v in zip(law, (1.0, length, rate), strict=True) if c)
            for law in (actuator.gain, actuator.bias)
        )
        force = _clamped(ca.SX(gain * control + bias), actuator.force_limits)
        for joint, factor in zip(joints, gear, strict=True):
            torques[joint] = torques.get(joint, 0.0) + factor * force
            limits[joint] = actuator.torque_limits
    torques = {joint: _clamped(torque, limits[joint]) for joint, torque in torques.items()}
    on_base = torques.pop(_BASE, None)
    return Terms(torque=torques, wrench=None if on_base is None else [on_base])


def _transmission(actuator: Actuator, s: Symbols) -> tuple[list[int], list[Any], Any, Any]:
    """Return indices of joint rates, the gear of each, and length and rate of an actuator."""
    import casadi as ca

    what = f"actuator '{actuator.name}'"
    gear: list[Any] = list(actuator.gear)
    if actuator.on_base:
        return [_BASE], gear, gear[0] * s.seen.pose[0], gear[0] * s.seen.xi[0]
    if not s.is_ball(actuator.joint):
        joint = s.joint(actuator.joint, what)
        return [joint], gear, gear[0] * s.position(joint, what), gear[0] * s.xdot[joint]
    q, first = s.ball(actuator.joint, what)
    length = ca.dot(ca.DM(gear), rotation_vector(q[:3], q[3]))
    if actuator.in_parent:
        u, axes = q[:3], ca.DM(gear)
        cross = ca.cross(u, axes)
        gear = ca.vertsplit(axes - 2.0 * (q[3] * cross - ca.cross(u, cross)))
    joints = [first, first + 1, first + 2]
    return joints, gear, length, sum(g * s.xdot[k] for g, k in zip(gear, joints, strict=True))


def _clamped(value: Any, limits: tuple[float, float] | None) -> Any:
    """Return an expression within limits."""
    import casadi as ca

    return value if limits is None else ca.fmin(ca.fmax(value, limits[0]), limits[1])
