"""Controllers, which are Python functions sampled with a zero-order hold; and forces of actuators.

Controls of actuators are functions of time and state, or commands of a controller.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats, positive
from ..common.errors import InputError
from ..common.names import brief
from ..common.parameter import Parameter
from ..system.force_interface import SeenState
from ..system.passive import rotation_vector
from ..system.robot_file_contents import Actuator
from .force import (
    Action,
    Limit,
    Named,
    Symbols,
    Terms,
    acting_value,
    checked,
    limited,
    signals_in,
    takes_state,
)
from .signals import Signal

Control: TypeAlias = Signal | float | Parameter | str | Action
_BASE = -1  # index of the base among the joints that actuators drive


@checks_arguments
@dataclass(frozen=True)
class Command:
    """Torques and a wrench for one period of a controller.

    A width shorter than the period models a thruster that fires during a part of each period.

    Attributes:
        torque: Torques [N·m | N], as {joint: torque} or one for each of the controller's joints;
            None for zero.
        wrench: Wrench on the base in its own axes, at its origin, [linear; angular], (r,); None for
            zero.
        width: Duration for which the command acts [s], at most to the next sample; None for the
            whole period.
    """

    torque: Mapping[str, float] | ArrayLike | None = None
    wrench: ArrayLike | None = None
    width: float | None = None


class _Stateless:
    def __repr__(self) -> str:
        return "none"


STATELESS = _Stateless()


@dataclass(frozen=True)
class Held:
    """The zero-order hold of a command.

    Attributes:
        values: Torques on the controller's joints, then the entries of the wrench.
        width: Duration for which the command acts [s], or None for the whole period.
    """

    values: Array
    width: float | None


@checks_arguments
@dataclass(frozen=True)
class Controller(Named):
    """Torques and wrenches from a Python function, sampled periodically with a zero-order hold.

    The commands are stored with the motion (Trajectory.actions). `compare` uses them instead of
    calling the function again.

    Attributes:
        function: Called with numbers, as (t, x, xdot, mu) or with one SeenState (see
            system/force_interface.py). It returns {joint: torque}, one torque per joint, or a
            Command. x["hinge"] equals x[0] for the first joint "hinge".
        period: Sampling interval [s].
        joints: Joints on which the controller acts. None stands for all joints, or for no joint if
            the controller sets a wrench.
        limit: Bounds on the torques, or None.
        name: Name in messages and results.
        wrench: Whether the controller's Commands have wrenches on the base. If so, the momentum is
            integrated.
        state0: Initial state of a controller with memory, any object that can be copied. The
            function is then update(t, state, measurement) → (action, state) with a SeenState as
            measurement. Every simulation starts with a copy of state0.
        actuators: Actuators that the function drives by controls instead of torques, as set by
            Scene.controls. `joints` then names some of them, and None stands for all; actuators
            without a control get 0.
    """

    function: Callable[..., Any]
    period: float
    joints: tuple[str, ...] | None = None
    limit: Limit | None = None
    name: str = "controller"
    wrench: bool = field(default=False, kw_only=True)
    state0: Any = field(default=STATELESS, kw_only=True)
    actuators: tuple[Actuator, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", positive(self.period, f"the period of {self.name}"))
        checked(self.name, "a function of (t, x, xdot, mu) or of a state", self.function)
        if not isinstance(self.wrench, bool):
            raise InputError(
                f"wrench of {self.name} must be True or False, got {brief(self.wrench)}; "
                "the wrench itself is part of the Command that the function returns"
            )
        if not self.keeps_state:
            takes_state(self.function, self.name)
        if self.joints is None:
            if self.wrench:
                object.__setattr__(self, "joints", ())
            return
        if isinstance(self.joints, str) or not isinstance(self.joints, Sequence):
            raise InputError(f"joints of {self.name} must be a list of names, got {self.joints!r}")
        object.__setattr__(self, "joints", tuple(self.joints))
        if len(set(self.joints)) < len(self.joints):
            raise InputError(f"joints of {self.name} must differ, got {', '.join(self.joints)}")
        if not (self.joints or self.wrench):
            raise InputError(
                f"{self.name} has no joints and no wrench, so it has no effect. "
                "Add joints or wrench=True"
            )

    @property
    def keeps_state(self) -> bool:
        """Whether the controller has a memory (see `state0`)."""
        return not isinstance(self.state0, _Stateless)

    @property
    def sees_base(self) -> bool:
        """Whether the function takes a SeenState, which contains the pose of the base."""
        return self.keeps_state or takes_state(self.function, self.name)

    def driven(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the joints on which the controller acts, or the actuators that it drives.

        Args:
            names: All shape joints.
        Returns:
            Names of the joints or actuators.
        """
        if self.joints is not None:
            return self.joints
        return tuple(a.name for a in self.actuators) if self.actuators else names

    def count(self, names: tuple[str, ...], r: int) -> int:
        """Return the number of floats in a command.

        Args:
            names: All shape joints.
            r: Dimension of the symmetry group.
        Returns:
            Number of torques and wrench entries.
        """
        return len(self.driven(names)) + (r if self.wrench else 0)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return torques and wrench as symbols; each sample of the controller sets their values.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        if self.actuators:
            by_name = {actuator.name: actuator for actuator in self.actuators}
            controls = [(by_name[name], number(0.0)) for name in self.driven(s.names)]
            return actuator_terms(controls, s)
        torque = {s.joint(name, self.name): number(0.0) for name in self.driven(s.names)}
        wrench = [number(0.0) for _ in range(s.mu.numel())] if self.wrench else None
        return Terms(torque=limited(self.limit, s, torque, number, self.name), wrench=wrench)

    def sample(self, seen: SeenState, about: Array, state: Any) -> tuple[Any, Any]:
        """Call the function at one time.

        Args:
            seen: Numeric state that the function receives.
            about: Momentum μ about the centre of mass for functions of four arguments, (r,).
            state: Memory of the controller.
        Returns:
            The function's command, and the new memory of the controller.
        Raises:
            InputError: The function of a controller with memory does not return (action, state).
        """
        if self.keeps_state:
            result = self.function(seen.t, state, seen)
            if not (isinstance(result, tuple) and len(result) == 2):
                raise InputError(
                    f"{self.name} keeps a state, so it must return (action, state), "
                    f"but returned {brief(result)} at t = {seen.t:g} s"
                )
            return result
        if self.sees_base:
            return self.function(seen), state
        return self.function(seen.t, seen.x, seen.xdot, about.copy()), state

    def held(self, given: Any, names: tuple[str, ...], r: int, t: float) -> Held:
        """Validate a command and convert it to floats.

        Args:
            given: Return value of the function.
            names: All shape joints.
            r: Dimension of the symmetry group.
            t: Time of the sample [s].
        Returns:
            The floats of the command, and the duration for which they act.
        Raises:
            InputError: The result is not a valid command.
        """
        command = given if isinstance(given, Command) else Command(torque=given)
        if command.wrench is not None and not self.wrench:
            raise InputError(
                f"{self.name} returned a wrench at t = {t:g} s. Declare it with "
                "Controller(…, wrench=True), so that the momentum is integrated."
            )
        blocks = [self._torques(command.torque, names, t)]
        if self.wrench:
            wrench = [0.0] * r if command.wrench is None else command.wrench
            blocks.append(self._checked(wrench, r, "a wrench of {} finite entries", t))
        width = command.width
        if width is not None:
            width = float(self._checked([width], 1, "one width [s]", t)[0])
            if width < 0.0:
                raise InputError(f"{self.name} returned a width of {width:g} s at t = {t:g} s")
        return Held(np.concatenate(blocks), width)

    def _torques(self, torques: Any, names: tuple[str, ...], t: float) -> Array:
        driven, what = self.driven(names), "control" if self.actuators else "torque"
        if torques is None and (self.wrench or not driven):
            return np.zeros(len(driven))
        if isinstance(torques, Mapping):
            unknown = [name for name in torques if name not in driven]
            if unknown:
                raise InputError(
                    f"{self.name} returned a {what} for '{unknown[0]}' at t = {t:g} s; "
                    f"its {'actuators' if self.actuators else 'joints'} are "
                    f"{', '.join(driven) or 'none'}"
                )
            torques = [torques.get(name, 0.0) for name in driven]
        return self._checked(torques, len(driven), f"{{}} finite {what}s ({', '.join(driven)})", t)

    def _checked(self, result: Any, count: int, expected: str, t: float) -> Array:
        values = as_floats(result, f"the values that {self.name} returned at t = {t:g} s")
        if values.shape != (count,) or not np.isfinite(values).all():
            raise InputError(
                f"{self.name} must return {expected.format(count)}, but returned {result!r} "
                f"at t = {t:g} s"
            )
        return values


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
