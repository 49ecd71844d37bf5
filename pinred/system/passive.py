"""Springs, dampers and dry friction at joints: forces that a robot's file can have of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ..common.arrays import positive
from ..common.errors import InputError
from ..common.parameter import Parameter, checked_number, value_of
from ..common.plain_names import plain
from .force import Force, Symbols, Terms, finite, settle

BASE = "springs, damping and friction of the base"  # which are left out


@dataclass(frozen=True)
class Spring(Force):
    """A spring: V = ½ k y² of y = x − rest, or of x − x_to − rest.  k: [N·m/rad | N/m].

    polynomial: coefficients k₂, k₃, … of higher powers, −τ = k y + k₂ y² + k₃ y³ + …
    """

    joint: str
    stiffness: float | Parameter
    rest: float | Parameter = 0.0
    to: str | None = None
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        settle(self, "stiffness", "rest")
        _settle_polynomial(self)

    @property
    def label(self) -> str:
        """The kind of force and the joint, or both joints."""
        return between("spring", self.joint, self.to)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the potential."""
        length = s.x[s.joint(self.joint, self.label)]
        if self.to is not None:
            if self.to == self.joint:
                raise InputError(f"{self.label}: both ends are the same joint")
            length = length - s.x[s.joint(self.to, self.label)]
        stretch = length - number(self.rest)
        potential = 0.5 * number(self.stiffness) * stretch * stretch
        power = stretch * stretch
        for k, coefficient in enumerate(self.polynomial, start=3):
            power = power * stretch
            potential += number(coefficient) / k * power
        return Terms(potential=potential)


@dataclass(frozen=True)
class Damper(Force):
    """A damper: τ = −c v of v = ẋ, or of ẋ − ẋ_to on two joints.  c: [N·m·s/rad | N·s/m].

    polynomial: coefficients c₂, c₃, … of higher powers, −τ = v (c + c₂ |v| + c₃ |v|² + …).
    """

    joint: str
    coefficient: float | Parameter
    to: str | None = None
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        settle(self, "coefficient")
        _settle_polynomial(self)

    @property
    def label(self) -> str:
        """The kind of force and the joint, or both joints."""
        return between("damper", self.joint, self.to)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques."""
        import casadi as ca

        k, c = s.joint(self.joint, self.label), number(self.coefficient)
        v, j = s.xdot[k], None
        if self.to is not None:
            j = s.joint(self.to, self.label)
            if j == k:
                raise InputError(f"{self.label}: both ends are the same joint")
            v = v - s.xdot[j]
        for power, coefficient in enumerate(self.polynomial, start=1):
            # |v| only to odd powers: what is smooth stays free of kinks.
            size = v**power if power % 2 == 0 else ca.fabs(v) * v ** (power - 1)
            c = c + number(coefficient) * size
        torque = -c * v
        return Terms(torque={k: torque} if j is None else {k: torque, j: -torque})


@dataclass(frozen=True)
class Friction(Force):
    """Dry friction at a joint, as the smooth law τ = −most · tanh(ẋ / width).

    most: of the torque [N·m | N].  width: the rate within which it turns round [rad/s | m/s];
    at twice that rate it is 96 % of the whole.  A joint at rest creeps under a load that dry
    friction would hold.  None for a friction in a file, which has none: it does not act until it
    is given one.
    """

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

    @property
    def label(self) -> str:
        """The kind of force and the joint."""
        return between("friction", self.joint, None)

    def smoothed(self, width: float) -> Friction:
        """Return the same friction with a width [rad/s | m/s].  Raises InputError."""
        return replace(self, width=width)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torque.  Raises InputError if there is no width."""
        import casadi as ca

        if self.width is None:
            raise InputError(
                f"{self.label} has no width, the rate within which it turns round; give one, as in "
                "friction.smoothed(0.01), or simulate(…, friction=0.01) for all in the file"
            )
        k = s.joint(self.joint, self.label)
        return Terms(torque={k: -number(self.most) * ca.tanh(s.xdot[k] / number(self.width))})


def between(kind: str, joint: str, to: str | None) -> str:
    """Return the name of a force at a joint, or between two."""
    ends = plain(joint) if to is None else f"{plain(joint)}–{plain(to)}"
    return f"{kind} {ends}"


def _settle_polynomial(force: Any) -> None:
    what = f"polynomial of a {force.label}"
    if isinstance(force.polynomial, str):
        raise InputError(f"{what} must be a list of numbers, got {force.polynomial!r}")
    try:
        given = tuple(force.polynomial)
    except TypeError:
        raise InputError(f"{what} must be a list of numbers, got {force.polynomial!r}") from None
    object.__setattr__(force, "polynomial", tuple(finite(value, what) for value in given))
