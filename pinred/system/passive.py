"""Springs, dampers and dry friction at joints: forces that a robot file can contain."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from ..common.argument_kinds import checks_arguments
from ..common.arrays import positive
from ..common.errors import InputError, ModelError
from ..common.names import plain, quoted
from ..common.parameter import Parameter, checked_number, value_of
from .force_interface import Force, Symbols, Terms, finite, settle
from .robot_file_contents import Contents, LeftOut

# Kinds of actions that pinred does not simulate (LeftOut.what).
BASE = "springs, damping and friction of the base"
MERGED = "springs, damping and friction of merged hinges"
SLIDING = "dry friction against sliding in a plane"
UNEVEN = "dry friction that is not the same in both directions"


class JointForce(Force):
    """A force at a joint, or between two joints."""

    kind: ClassVar[str]
    joint: str
    to: str | None = None

    @property
    def label(self) -> str:
        """Kind of force and its joint, or both joints."""
        ends = plain(self.joint) if self.to is None else f"{plain(self.joint)}–{plain(self.to)}"
        return f"{self.kind} {ends}"


@checks_arguments
@dataclass(frozen=True)
class Spring(JointForce):
    """A spring with potential V = ½ k y², where y = x − rest, or x − x_to − rest.

    With higher powers, the torque is τ = −(k y + k₂ y² + k₃ y³ + …).

    Attributes:
        joint: Name of the joint.
        stiffness: Stiffness k [N·m/rad | N/m].
        rest: Rest position [rad | m].
        to: Name of the joint at the other end, or None for the joint's own carrier.
        polynomial: Coefficients k₂, k₃, … of higher powers.
    """

    kind: ClassVar[str] = "spring"

    joint: str
    stiffness: float | Parameter
    rest: float | Parameter = 0.0
    to: str | None = None
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        settle(self, "stiffness", "rest")
        _settle_polynomial(self)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the potential.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the potential.
        Raises:
            InputError: The force connects a joint with itself.
        """
        k, j = _ends(self, s)
        length = s.position(k, self.label)
        if j is not None:
            length = length - s.position(j, self.label)
        stretch = length - number(self.rest)
        potential = 0.5 * number(self.stiffness) * stretch * stretch
        power = stretch * stretch
        for k, coefficient in enumerate(self.polynomial, start=3):
            power = power * stretch
            potential += number(coefficient) / k * power
        return Terms(potential=potential)


@checks_arguments
@dataclass(frozen=True)
class Damper(JointForce):
    """A damper with torque τ = −c v, where v = ẋ, or ẋ − ẋ_to between two joints.

    With higher powers, the torque is τ = −v (c + c₂ |v| + c₃ |v|² + …).

    Attributes:
        joint: Name of the joint.
        coefficient: Coefficient c [N·m·s/rad | N·s/m].
        to: Name of the joint at the other end, or None for the joint's own carrier.
        polynomial: Coefficients c₂, c₃, … of higher powers.
    """

    kind: ClassVar[str] = "damper"

    joint: str
    coefficient: float | Parameter
    to: str | None = None
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        settle(self, "coefficient")
        _settle_polynomial(self)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the torques.
        Raises:
            InputError: The force connects a joint with itself.
        """
        import casadi as ca

        k, j = _ends(self, s)
        v, c = s.xdot[k] if j is None else s.xdot[k] - s.xdot[j], number(self.coefficient)
        for power, coefficient in enumerate(self.polynomial, start=1):
            # Use |v| for odd powers only, so that laws with even powers stay smooth.
            size = v**power if power % 2 == 0 else ca.fabs(v) * v ** (power - 1)
            c = c + number(coefficient) * size
        torque = -c * v
        return Terms(torque={k: torque} if j is None else {k: torque, j: -torque})


@checks_arguments
@dataclass(frozen=True)
class Friction(JointForce):
    """Dry friction at a joint, as the smooth law τ = −most · tanh(ẋ / width).

    At a rate of twice the width, the torque is 96 % of `most`.  Under this law a loaded joint
    creeps where dry friction would hold it at rest.  Friction in a robot file has no width; it
    acts only if the scene sets a width.

    Attributes:
        joint: Name of the joint.
        most: Largest torque [N·m | N].
        width: Rate within which the torque changes its sign [rad/s | m/s], or None.
    """

    kind: ClassVar[str] = "friction"

    joint: str
    most: float | Parameter
    width: float | Parameter | None = None

    def __post_init__(self) -> None:
        settle(self, "most")
        if value_of(self.most) < 0.0:
            most = value_of(self.most)
            raise InputError(f"most of a {self.label} must not be negative, got {most:g}")
        if self.width is not None:
            width = checked_number(self.width, lambda w: positive(w, f"width of a {self.label}"))
            object.__setattr__(self, "width", width)

    def smoothed(self, width: float) -> Friction:
        """Return this friction with a width, so that it acts.

        Args:
            width: Rate within which the torque changes its sign [rad/s | m/s].
        Returns:
            Friction with the width.
        Raises:
            InputError: The width is not positive.
        """
        return replace(self, width=width)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torque.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the torque.
        Raises:
            InputError: The friction has no width.
        """
        import casadi as ca

        if self.width is None:
            raise InputError(
                f"{self.label} has no width (the rate within which it changes sign). Give one, as "
                "in friction.smoothed(0.01), or simulate(…, friction=0.01) for all friction in the "
                "file."
            )
        k = s.joint(self.joint, self.label)
        return Terms(torque={k: -number(self.most) * ca.tanh(s.xdot[k] / number(self.width))})


def _ends(force: Spring | Damper, s: Symbols) -> tuple[int, int | None]:
    """Return the indices of both joints of a force; the second index is None for one joint."""
    first = s.joint(force.joint, force.label)
    second = None if force.to is None else s.joint(force.to, force.label)
    if first == second:
        raise InputError(f"{force.label}: both ends are the same joint")
    return first, second


def _settle_polynomial(force: Any) -> None:
    """Convert the polynomial of a force to finite numbers or Parameters."""
    what = f"polynomial of a {force.label}"
    message = f"{what} must be a list of numbers, got {force.polynomial!r}"
    if isinstance(force.polynomial, str):
        raise InputError(message)
    try:
        coefficients = tuple(force.polynomial)
    except TypeError:
        raise InputError(message) from None
    object.__setattr__(force, "polynomial", tuple(finite(value, what) for value in coefficients))


def rate_labels(name: str, nv: int) -> tuple[str, ...]:
    """Return the labels of the rates of a hinge or slide (nv = 1), or of the axes of a ball."""
    return (name,) if nv == 1 else tuple(f"{name}.{axis}" for axis in "xyz")


def passive_contents(
    raw: pin.Model,
    shape: Sequence[str],
    locked: Collection[str],
    sliding: Sequence[str] = (),
    springs: Sequence[Spring] = (),
) -> Contents:
    """Return the dampers and dry friction of a model, and the actions that are not simulated.

    Args:
        raw: Model with all joints, as read from a URDF's <dynamics>.
        shape: Names of the shape joints.
        locked: Names of frozen joints.  All remaining joints belong to the base.
        sliding: Names of joints whose dry friction acts against sliding in a plane.
        springs: Springs at joints.
    Returns:
        Contents with `passive` and `left_out`.
    Raises:
        ModelError: A number is not finite.
    """
    forces: list[Force] = []
    base: list[str] = []
    uneven: list[str] = []
    for i in range(1, raw.njoints):
        name, joint = str(raw.names[i]), raw.joints[i]
        entries = slice(joint.idx_v, joint.idx_v + joint.nv)
        damping, most = raw.damping[entries], raw.upperDryFrictionLimit[entries]
        least = raw.lowerDryFrictionLimit[entries]
        numbers = np.concatenate([damping, most, least])
        joint_springs = [spring for spring in springs if spring.joint == name]
        if name in locked or not (joint_springs or numbers.any()):
            continue
        if not np.isfinite(numbers).all():
            raise ModelError(
                f"joint {quoted(name)} has damping or friction that is not a finite number"
            )
        if name not in shape:
            base.append(name)
            continue
        forces += joint_springs
        for label, d, upper, lower in zip(
            rate_labels(name, joint.nv), damping, most, least, strict=True
        ):
            if d:
                forces.append(Damper(label, float(d)))
            if upper != -lower:
                uneven.append(label)
            elif upper:
                forces.append(Friction(label, float(upper)))
    names = {BASE: base, UNEVEN: uneven, SLIDING: sliding}
    left_out = [LeftOut(kind, tuple(joints)) for kind, joints in names.items() if joints]
    return Contents(left_out=tuple(left_out), passive=tuple(forces))
