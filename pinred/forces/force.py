"""Forces as expressions in t, x, ẋ and μ, and the helpers to write them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from ..common.arrays import positive
from ..common.errors import InputError
from ..common.names import joint_index
from .signals import Signal

if TYPE_CHECKING:
    import casadi as ca

    from ..system.system import System

PerJoint: TypeAlias = float | Mapping[str, float]
Reference: TypeAlias = Mapping[str, Signal | float]


@dataclass(frozen=True)
class Symbols:
    """The variables of which forces are functions.

    t: time [s].  x, xdot: (m,) shape and rate, by number or by joint.  xi, mu: (r,) body twist
    of the base and body momentum, both as seen from the centre of mass: the linear part of μ is
    zero, the angular one is about the centre of mass (SO2, SO3: about the axis or pivot).
    within: a time that says which piece of a table counts.
    For forces that are `last`: others, (m,) torques of all other forces; accelerations, those
    of the prescribed joints.
    """

    system: System
    t: ca.SX
    x: ca.SX
    xdot: ca.SX
    xi: ca.SX
    mu: ca.SX
    within: ca.SX | None = None
    others: ca.SX | float = 0.0
    accelerations: Mapping[int, ca.SX] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shape joints."""
        return self.system.shape_names

    @property
    def every_name(self) -> tuple[str, ...]:
        """Names of the shape joints, and then of those that follow them."""
        return (*self.names, *self.system.followers)

    def joint(self, name: str, what: str) -> int:
        """Return the index of a joint; those that follow others come after the shape's.

        What acts on one of these acts through it on the joint that it follows.  Raises InputError
        that lists the joints.
        """
        return joint_index(name, self.every_name, what)

    def column(self, values: Any, what: str) -> dict[int, Any]:
        """Return {joint: value} of a mapping by names or of a sequence of m values."""
        if isinstance(values, Mapping):
            return {self.joint(name, what): value for name, value in values.items()}
        found = entries(values, len(self.names), what)
        return dict(enumerate(found))


@dataclass
class Terms:
    """The action of a force.

    torque: by joint, numbered as `Symbols.joint` does.  wrench: r entries on the base.
    potential: [J].
    """

    potential: Any = None
    torque: dict[int, Any] = field(default_factory=dict)
    wrench: list[Any] | None = None


class Force(ABC):
    """A force: it acts on the system, and does not depend on where its base is."""

    last: ClassVar[bool] = False  # whether it has to know what the others do

    @property
    @abstractmethod
    def label(self) -> str:
        """The force's name in tables and messages."""

    @abstractmethod
    def terms(self, s: Symbols, number: Callable[[float], Any]) -> Terms:
        """Return the action of the force.

        number: turns a value that may change from scene to scene without another kernel
        into a symbol.  Raises InputError for joints that are not there.
        """

    @property
    def signals(self) -> Iterable[Signal]:
        """The functions of time in the force."""
        return ()


class Named(Force):
    """A force with a name of its own."""

    name: str

    @property
    def label(self) -> str:
        """The name it was given."""
        return self.name


@dataclass(frozen=True)
class Limit:
    """Bounds on torques.  most: [N·m | N], of all joints or by name.  smooth: tanh, not a kink."""

    most: PerJoint
    smooth: bool = False

    def apply(self, s: Symbols, torque: dict[int, Any], what: str) -> dict[int, Any]:
        """Return the bounded torques."""
        import casadi as ca

        out = dict(torque)
        for k, bound in per_joint(self.most, torque, s, f"the limit of {what}").items():
            most = positive(bound, f"the limit of {what} at '{s.every_name[k]}'")
            if self.smooth:
                out[k] = most * ca.tanh(torque[k] / most)
            else:
                out[k] = ca.fmin(ca.fmax(torque[k], -most), most)
        return out


def motions(
    reference: Reference, s: Symbols, number: Callable[[float], Any], what: str
) -> dict[int, tuple[Any, Any, Any]]:
    """Return (x_d, ẋ_d, ẍ_d) of each joint of a reference."""
    import casadi as ca

    out = {}
    for name, value in reference.items():
        x = of_time(value, s, number, f"{what}['{name}']")
        xdot = ca.jacobian(x, s.t)
        out[s.joint(name, what)] = (x, xdot, ca.jacobian(xdot, s.t))
    return out


def of_time(value: Any, s: Symbols, number: Callable[[float], Any], what: str) -> Any:
    """Return a Signal or a number as an expression.  Raises InputError naming `what`."""
    if isinstance(value, Signal):
        return value.casadi(s.t, s.within)
    return number(finite(value, what, "a Signal or a number"))


def signals_in(values: Iterable[Any]) -> list[Signal]:
    """Return the Signals among values."""
    return [value for value in values if isinstance(value, Signal)]


def checked(what: str, wanted: str, value: Any, *kinds: type) -> None:
    """Refuse a value that is neither callable nor of one of the kinds.  Raises InputError."""
    if not (callable(value) or isinstance(value, kinds)):
        raise InputError(f"{what} must be {wanted}, got {value!r}")


def checked_reference(reference: Any, what: str) -> None:
    """Refuse what is not a mapping from joints to signals.  Raises InputError."""
    if not isinstance(reference, Mapping):
        raise InputError(f"{what} must have {{joint: Signal or number}}, got {reference!r}")


def limited(limit: Limit | None, s: Symbols, torque: dict[int, Any], what: str) -> dict[int, Any]:
    """Return torques within a limit, if there is one.  Raises InputError."""
    if limit is None:
        return torque
    if not isinstance(limit, Limit):
        raise InputError(f"limit of {what} must be a Limit, got {limit!r}")
    return limit.apply(s, torque, what)


def per_joint(values: PerJoint, joints: Iterable[int], s: Symbols, what: str) -> dict[int, float]:
    """Return the value of each joint, from one for all or one by name.  Raises InputError."""
    joints = list(joints)
    if not isinstance(values, Mapping):
        return dict.fromkeys(joints, finite(values, what))
    given = {s.joint(name, what): finite(v, f"{what} at '{name}'") for name, v in values.items()}
    missing = [s.every_name[k] for k in joints if k not in given]
    if missing:
        raise InputError(f"{what} has no value for '{missing[0]}'")
    return {k: given[k] for k in joints}


def finite(value: Any, what: str, wanted: str = "a number") -> float:
    """Return a value as a finite number.  Raises InputError naming `what`."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be {wanted}, got {value!r}") from None
    if not np.isfinite(number):
        raise InputError(f"{what} must be finite, got {number}")
    return number


def settle(force: Any, *names: str) -> None:
    """Make fields of a force finite floats.  Raises InputError."""
    for name in names:
        object.__setattr__(force, name, finite(getattr(force, name), f"{name} of a {force.label}"))


def between(kind: str, joint: str, to: str | None) -> str:
    """Return the name of a force at a joint, or between two."""
    return f"{kind} {joint}" if to is None else f"{kind} {joint}–{to}"


def entries(values: Any, count: int, what: str) -> list[Any]:
    """Return the entries of a column or sequence of `count`.  Raises InputError."""
    import casadi as ca

    if isinstance(values, ca.SX):
        values = ca.vertsplit(ca.densify(values)) if values.shape[1] == 1 else [values]
    try:
        found = list(values)
    except TypeError:
        found = [values]
    if len(found) != count:
        raise InputError(f"{what} must give {count} values, gave {len(found)}")
    return found


def scalar(value: Any, what: str) -> Any:
    """Return one value as an expression.  Raises InputError naming `what`."""
    import casadi as ca

    try:
        out = ca.SX(value)
    except NotImplementedError:
        raise InputError(
            f"{what} must be a number or a CasADi SX expression, got {type(value).__name__}; "
            "use CasADi's functions (casadi.sin, …) on the symbols that are given"
        ) from None
    if out.numel() != 1:
        raise InputError(f"{what} must be one value, got shape {out.shape}")
    if out.is_constant() and not np.isfinite(float(out)):
        raise InputError(f"{what} must be finite, got {float(out)}")
    return ca.densify(out)
