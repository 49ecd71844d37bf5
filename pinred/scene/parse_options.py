"""Accepted input formats of scene options, their conversion to one internal format, and checks.

Python, the command line and scene files accept the same formats (joint values: see
initial_state.py).  An integrator is an object or text.  The motion of a joint is a
Signal, a number or a formula.  Pinocchio's (q, v) may replace pose, shape and velocities.

Checks go beyond the type of a value.  They concern the keyframe, report times and lists of forces,
and the time span that signals and controllers cover.

Of the forces in a robot's file, the options select the passive ones and the actuators that act.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import build_from_text, parse_call
from ..common.arrays import Array, as_floats, entries_of, positive, read_only, vector
from ..common.errors import InputError, PinredError, ShapeError
from ..common.names import brief, listed, nearest, one_of, quoted
from ..common.parameter import Parameter, VectorParameter, refuse_entry
from ..forces.controller import Control, Controller
from ..forces.force import Force
from ..forces.signals import Attitude, Constant, Expression, Signal
from ..forces.signals.attitude_signal import parse_attitude
from ..integrators.methods import METHODS, Method
from ..system.coordinates import Configuration, Velocity
from ..system.coupling import following
from ..system.model_parameters import ModelParameters, joined, kinds_near, plain_value, requested
from ..system.passive import BallSpring, Damper, Friction, Spring
from ..system.system import System, nominal
from .initial_state import DURATION

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel

EVEN_TIMES = 201  # number of report times if a scene states none; they are evenly spaced
_COUNTS = np.arange(float(EVEN_TIMES))
# Relative difference of two times that count as equal: four units in the last place.
_SAME_TIME = 4.0 * float(np.finfo(float).eps)
MOST_CALLS = 1_000_000  # largest number of calls of a controller in a scene; each call ends a step


def check_keyframe(system: System, name: str) -> str:
    """Return the name of a keyframe; raise InputError if the robot's file does not have it."""
    if not one_of(name, system.keyframes):
        valid = listed(list(system.keyframes), 60) or "none"
        raise InputError(
            f"keyframe: '{system.name}' has no keyframe {brief(name)}; the keyframes are {valid}"
        )
    return name


def compute_report_times(times: Any, duration: float | None, system: System) -> Array:
    """Return the report times of a scene, (T,) [s].

    Args:
        times: Requested times, or None for EVEN_TIMES evenly spaced times.
        duration: Duration of the scene [s], or None.
        system: System whose own duration is used if neither times nor duration are stated.
    Returns:
        Increasing times, (T,), not before 0 [s].
    Raises:
        InputError: the times do not increase, or are outside the duration.
        ShapeError: `times` is not a vector of finite numbers.
    """
    if times is None:
        default = system.initial.duration if system.initial else DURATION
        last = default if duration is None else float(duration)
        even: Array = _COUNTS * (last / _COUNTS[-1])
        even[-1] = last
        return even
    requested = np.atleast_1d(as_floats(times, "times")).copy()
    end = np.inf if duration is None else float(duration)
    if requested.ndim != 1 or requested.size == 0 or not np.isfinite(requested).all():
        raise ShapeError("times must be a vector of finite times")
    if (np.diff(requested) <= 0.0).any() or requested[0] < 0.0 or requested[-1] > end:
        raise InputError(
            f"times must increase from 0 or later to the duration at most ({end:g} s), "
            f"got {requested[0]:g} … {requested[-1]:g}"
        )
    if duration is None:
        positive(requested[-1], "the last of times, which stands for the duration,")
    return requested


def list_forces(forces: Any) -> tuple[Any, ...]:
    """Return the option `forces` (a Force, several, or None) as a tuple; raise InputError."""
    if forces is None or isinstance(forces, Force):
        return () if forces is None else (forces,)
    entries = entries_of(forces)
    if entries is None:
        raise InputError(f"forces must be a list of objects of pinred.forces, got {brief(forces)}")
    return tuple(entries)


def check_span(model: ForceModel, end: float, *, base: bool) -> None:
    """Check that the scene's time span and outputs satisfy its forces.

    Args:
        model: Forces and prescribed joints.
        end: End of the scene [s].
        base: Whether the motion of the base is computed.
    Raises:
        InputError: a signal is not defined over the whole scene, a force observes a base that
            is not computed, or a controller would be called too often.
    """
    for signal in (*model.signals, *model.references):
        first, last = signal.span
        if not first <= 0.0 <= end <= last * (1.0 + _SAME_TIME):
            # Times that six digits do not distinguish are written in full.
            digits = 17 if f"{last:g}" == f"{end:g}" else 6
            raise InputError(
                f"{signal!r} is defined from {first:.{digits}g} to {last:.{digits}g} s, "
                f"but the scene goes from 0 to {end:.{digits}g} s"
            )
    if model.sees_base and not base:
        raise InputError(
            "a force or controller depends on the base in space, which outputs='shape' omits; "
            "use outputs='all'"
        )
    for controller, _ in model.held:
        if end / controller.period > MOST_CALLS:
            raise InputError(
                f"a period of {controller.period:g} s would call {controller.name} more than "
                f"{MOST_CALLS} times in {end:g} s"
            )


_OTHERS, _EXAMPLE = " and auto", "RKMK4(0.01)"  # for messages about methods
_UNIT = 1e-3  # tolerance for the unit norm of (cosine, sine), for values rounded to few decimals


def parse_signal(value: Any, what: str) -> Signal | Attitude:
    """Convert the motion of a prescribed joint to a Signal, or to an Attitude for a ball.

    Args:
        value: A Signal, a number, a Parameter or a formula in t; for a ball an Attitude, three of
            these as a rotation vector, or a quaternion (x, y, z, w).
        what: Name of the option in messages.
    Returns:
        The signal or attitude.
    Raises:
        InputError: The value is of another kind.
    """
    if isinstance(value, (Signal, Attitude)):
        return value
    try:
        if isinstance(value, (list, tuple, np.ndarray)) and len(value) in (3, 4):
            return parse_attitude(value)
        if isinstance(value, str):
            return Expression(value)
        if isinstance(value, Parameter):
            return Constant(value)
        if isinstance(value, Real) and not isinstance(value, bool):
            return Constant(float(value))
    except OverflowError:
        raise InputError(f"{what} exceeds the range of 64-bit floats") from None
    except PinredError as error:
        raise type(error)(f"{what}: {error}") from None
    raise InputError(
        f"{what} must be a Signal, a number or a formula in t, or for a ball joint an Attitude or "
        f"three of these, got {brief(value)}"
    )


def parse_controls(value: Any, system: System) -> dict[str, Control] | Controller:
    """Convert the controls of actuators to numbers, Signals and functions.

    Args:
        value: {actuator: number, Signal, Parameter, formula or function}, or a Controller.
        system: System with the actuators.
    Returns:
        The controls by name, or the Controller with the actuators that it drives.
    Raises:
        InputError: An actuator is unknown or left out, or a value is of another kind.
    """
    if isinstance(value, Controller):
        if value.limit is not None or value.wrench:
            raise InputError(
                f"controls: {value.name} has a limit or a wrench, which apply to torques; pass it "
                "in forces=, or state limits in the file"
            )
        _check_actuators(value.joints or ["any"] * (not system.actuators), system)
        return replace(value, actuators=system.actuators)
    if not isinstance(value, Mapping):
        raise InputError(
            f"controls must be {{actuator: number, formula, Signal or function}} or a Controller, "
            f"got {brief(value)}"
        )
    _check_actuators(value, system)
    return {name: parse_control(control, name) for name, control in value.items()}


def parse_control(value: Any, name: str) -> Control:
    """Convert the control of an actuator.

    A formula of time alone becomes a Signal, whose numbers are inputs of kernels.

    Args:
        value: Number, Signal, Parameter, formula, or function as of a Torque.
        name: Name of the actuator.
    Returns:
        The control.
    Raises:
        InputError: The value is of another kind.
    """
    if isinstance(value, str):
        from ..forces.force import Formula  # Imported here because it needs CasADi.

        try:
            return Expression(value)
        except InputError:
            return Formula(value)
    if isinstance(value, Real) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, (Signal, Parameter)):
        return value
    if callable(value):
        function: Control = value
        return function
    raise InputError(
        f"controls['{name}'] must be a number, a formula, a Signal or a function, got "
        f"{brief(value)}"
    )


def _check_actuators(names: Iterable[str], system: System) -> None:
    """Raise InputError if a name is not that of an actuator."""
    actuators = [actuator.name for actuator in system.actuators]
    for name in names:
        if name in actuators:
            continue
        left_out = [
            n
            for left_out_entry in system.left_out
            if left_out_entry.what == "actuators"
            for n in left_out_entry.names
        ]
        for entry in left_out:
            if entry.startswith(f"{name} ("):
                raise InputError(f"controls: actuator {entry} is left out and cannot be driven")
        raise InputError(
            f"controls: no actuator {quoted(str(name))}; {nearest(str(name), actuators)}"
            f"the actuators of '{system.name}' are {listed(actuators, 30) or 'none'}"
        )


def parse_configuration(q: ArrayLike, system: System) -> Configuration:
    """Split Pinocchio's configuration into pose and shape.

    Args:
        system: The system.
        q: Configuration, (nq,).
    Returns:
        Pose (size,) and shape (m,), with angles in (−π, π].
    Raises:
        ShapeError: q has the wrong length or is not finite.
        InputError: A quaternion, or a cosine and sine, do not have norm 1.
    """
    q = vector(q, system.model.nq, "q0")
    root, *joints = list(system.sorted_model.joints)[1:]
    try:
        system.group.pose(q[: root.nq])
    except PinredError as error:
        raise type(error)(f"q0: {error}") from None
    sorted_q = system.sort_q(q)
    for placed, joint in zip(system.tree.joints, joints, strict=True):
        norm = float(np.linalg.norm(sorted_q[joint.idx_q : joint.idx_q + joint.nq]))
        if joint.nq == 2 and abs(norm - 1.0) > _UNIT:
            raise InputError(
                f"q0: cosine and sine of joint '{placed.name}' must have norm 1, got {norm:g}"
            )
    split = system.configuration(q)
    x = system.space.normalized(split.x, "q0")
    if system.coupled is not None:
        _check_followers(system, sorted_q, system.sorted_q(split.pose, x), "q0")
    return Configuration(pose=system.group.normalize(split.pose), x=x)


def parse_velocity(v: ArrayLike, system: System) -> Velocity:
    """Split Pinocchio's velocity into body twist and shape rate.

    Args:
        system: The system.
        v: Velocity, (nv,).
    Returns:
        Body twist (r,) and shape rate (m,).
    Raises:
        ShapeError: v has the wrong length or is not finite.
        InputError: A follower violates its coupling.
    """
    v = vector(v, system.model.nv, "v0")
    split = system.velocity(v)
    if system.coupled is not None:
        _check_followers(system, system.sort_v(v), system.sorted_v(split.xi, split.xdot), "v0")
    return split


def _check_followers(system: System, stated: Array, coupled: Array, what: str) -> None:
    """Reject a model configuration or velocity in which a follower violates its coupling.

    Args:
        system: The system.
        stated: Configuration or velocity that the option states.
        coupled: The same array, with followers computed from their couplings.
        what: Name of the option in messages.
    Raises:
        InputError: A follower violates its coupling.
    """
    for name in system.followers:
        joint = system.sorted_model.joints[system.sorted_model.getJointId(name)]
        entries = slice(joint.idx_q, joint.idx_q + joint.nq)
        if what == "v0":
            entries = slice(joint.idx_v, joint.idx_v + 1)
        # For values above 1 the tolerance is relative, because rates have no upper limit.
        most = _UNIT * max(1.0, float(np.abs(coupled[entries]).max()))
        if np.abs(stated[entries] - coupled[entries]).max() > most:
            expected = ", ".join(f"{value:g}" for value in coupled[entries])
            words = following(name, system.couplings)
            raise InputError(
                f"{what}: {words} and must be at {expected} there, got {stated[entries]}"
            )


def parse_method(value: Any) -> Method | Literal["auto"]:
    """Convert an integrator, or text that names one.

    Args:
        value: An integrator, "auto", or text: a name with optional options in Python notation, such
            as "RKMK4(0.01)" or "DOP853(max_step=0.1)".
    Returns:
        The integrator, or "auto".
    Raises:
        InputError: The text names no integrator, or has wrong options.
    """
    if isinstance(value, str):
        return _method_of_text(value)
    if isinstance(value, Method):
        return value
    names = " or ".join(f"{name}(…)" for name in METHODS)
    raise InputError(
        f"method must be 'auto' or {names}, or one of these as text, got {brief(value)}"
    )


def _method_of_text(text: str) -> Method | Literal["auto"]:
    """Return the integrator that a text names; the text is parsed and never executed."""
    if text == "auto":  # Skip the parser in the most frequent case.
        return "auto"
    name, positional, named = parse_call(text, METHODS, "method", _OTHERS, _EXAMPLE)
    if name == "auto":
        if positional or named:
            raise InputError(f"method auto has no options, got {quoted(text)}")
        return "auto"
    method: Method = build_from_text(text, METHODS, "method", _OTHERS, _EXAMPLE)
    return method


@dataclass(frozen=True, eq=False)
class GivenParameters:
    """The option `parameters` of a scene, joined with the parameters that its system has.

    Attributes:
        values: {name: value} as stated in the option.
        requested: Names of Parameters in forces that the option lists without values.
        varied: The robot parameters in the option; None if there are none.
        numbers: {name: values} of the robot parameters, as arrays.
        system: The robot with these parameters.
    """

    values: Mapping[str, Any]
    requested: Sequence[str]
    varied: ModelParameters | None
    numbers: Mapping[str, Array]
    system: System

    def checked(self, known: Mapping[str, Parameter | VectorParameter]) -> dict[str, Any]:
        """Return all parameters as numbers and arrays.

        Args:
            known: The Parameters in forces and events, by name.
        Returns:
            {name: number or array}.
        Raises:
            InputError: a name is unknown, or belongs to both the robot and a force.
            ShapeError: a value has the wrong shape.
        """
        parameters: dict[str, Any] = {}
        for name, value in self.values.items():
            if name in self.numbers:
                if name in known:
                    raise InputError(
                        f"parameters: '{name}' is a robot parameter and also the name of a "
                        "Parameter in forces. Rename the Parameter."
                    )
                parameters[name] = plain_value(self.numbers[name])
                continue
            self._check(name, known)
            what, parameter = f"parameters['{name}']", known[name]
            if isinstance(parameter, VectorParameter):
                parameters[name] = read_only(vector(value, len(parameter), what).copy())
                continue
            number = np.ravel(as_floats(value, what))
            parameters[name] = float(vector(number, 1, what)[0])
        for name in self.requested:
            self._check(name, known)
        return parameters

    def _check(self, name: object, known: Mapping[str, Parameter | VectorParameter]) -> None:
        if name not in known:
            refuse_entry(name, known, "parameters")
            names = list(known)
            raise InputError(
                f"parameters: there is no {brief(name)}; {kinds_near(self.system, name, names)}; "
                f"the Parameters in forces and signals here are {listed(names, 60) or 'none'}"
            )


def given_parameters(system: System, parameters: Any) -> GivenParameters:
    """Join the option `parameters` of a scene with the parameters that its system has.

    A parameter of the system keeps its value unless the option has another value.

    Args:
        system: The robot.
        parameters: {name: value}, names, or "all" (see Scene).
    Returns:
        The parameters, and the robot with their values.
    Raises:
        InputError: a link or joint is unknown, a value is not physical, or two names set
            the same property.
    """
    original, present = nominal(system), system.parameters
    values, others = requested(original, parameters)
    if isinstance(parameters, Mapping):
        values = joined(present, values)
    else:  # Names without values keep the values that the system has.
        values |= present
    varied = ModelParameters(original, list(values))
    numbers = varied.checked(values)
    return GivenParameters(
        values, others, varied if varied.names else None, numbers, varied.system(numbers)
    )


def check_passive(passive: Any, friction: Any) -> tuple[bool, float | None]:
    """Validate the options `passive` and `friction` [rad/s | m/s]; raise InputError."""
    if not isinstance(passive, bool):
        raise InputError(f"passive must be True or False, got {passive!r}")
    if friction is None:
        return passive, None
    if isinstance(friction, bool):
        raise InputError(
            f"friction must be the width of the smooth law [rad/s | m/s], got {friction!r}"
        )
    return passive, positive(friction, "friction")


def acting_passive(system: System, *, passive: bool, friction: float | None) -> tuple[Force, ...]:
    """Return the forces of the robot's file that act in a scene.

    Args:
        system: System with the forces of its file.
        passive: Whether springs and dampers act.
        friction: Width of the smooth friction law [rad/s | m/s]; None for no friction.
    Returns:
        The forces, with friction in its smooth form.
    """
    acting: list[Force] = []
    for force in system.passive:
        if not isinstance(force, Friction):
            if passive:
                acting.append(force)
        elif friction is not None:
            acting.append(force.smoothed(friction))
    return tuple(acting)


def passive_left_out(
    system: System, *, passive: bool = False, friction: float | None = None, who: str = "the run"
) -> str:
    """Describe the forces of the robot's file that do not act.

    Args:
        system: System with the forces of its file.
        passive: Whether springs and dampers act.
        friction: Width of the smooth friction law [rad/s | m/s]; None for no friction.
        who: Subject of the sentence.
    Returns:
        A sentence with the options that make them act; empty if all forces act.
    """
    springs = [f for f in system.passive if not passive and not isinstance(f, Friction)]
    rubbing = [f for f in system.passive if friction is None and isinstance(f, Friction)]
    omitted = [*springs, *rubbing]
    if not omitted:
        return ""
    counts = [
        f"{count} {singular if count == 1 else plural}"
        for kind, singular, plural in (
            (Damper, "damper", "dampers"),
            ((Spring, BallSpring), "spring", "springs"),
            (Friction, "joint with dry friction", "joints with dry friction"),
        )
        if (count := sum(isinstance(force, kind) for force in omitted))
    ]
    names = counts[0] if len(counts) == 1 else f"{', '.join(counts[:-1])} and {counts[-1]}"
    pronoun = "it" if len(omitted) == 1 else "them"
    hints = []
    if springs:
        hints.append(f"passive=True uses {'springs and dampers' if rubbing else pronoun}")
    if rubbing:
        hints.append(f"friction=WIDTH uses {'the friction' if springs else pronoun}")
    return f"the file has {names}; {who} leaves {pronoun} out ({', '.join(hints)})"


def actuation(system: System, controls: Mapping[str, Control] | Controller) -> tuple[Force, ...]:
    """Return the forces of the actuators that a scene drives.

    Args:
        system: System with the actuators of its file.
        controls: Checked controls of the scene.
    """
    from ..forces.controller import Actuation

    if isinstance(controls, Controller):
        return (controls,)
    by_name = {actuator.name: actuator for actuator in system.actuators}
    driven = tuple((by_name[name], control) for name, control in controls.items())
    return (Actuation(driven),) if driven else ()


def actuators_left_out(
    system: System, controls: Mapping[str, Any] | Controller | None = None, who: str = "the run"
) -> str:
    """Describe the actuators of the robot's file that do not act.

    Args:
        system: System with the actuators of its file.
        controls: Controls of the scene; None for none.
        who: Subject of the sentence.
    Returns:
        A sentence with the option that drives them; empty if all actuators act.
    """
    names = [actuator.name for actuator in system.actuators]
    driven = controls.driven(()) if isinstance(controls, Controller) else controls or ()
    idle = [name for name in names if name not in driven]
    if not idle:
        return ""
    count, pronoun = ("1", "it") if len(idle) == 1 else (str(len(idle)), "them")
    noun = f"{'more ' if driven else ''}{'actuator' if len(idle) == 1 else 'actuators'}"
    return (
        f"the file has {count} {noun} ({listed(idle, 6)}); {who} leaves {pronoun} out "
        f"(controls={{NAME: …}} drives {pronoun})"
    )
