"""The interface of forces: symbols that they are functions of, and terms that they give.

It stands this low because a robot's file has forces of its own (`System.passive`), which are
values like any other.  Those that somebody adds are in the room `forces`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import numpy as np

from ..common.errors import InputError
from ..common.names import joint_index
from ..common.parameter import Parameter
from ..common.plain_names import brief

if TYPE_CHECKING:
    import casadi as ca


def _unknown_dynamics(_: Mapping[int, ca.SX]) -> ca.SX:
    raise InputError("only a force that is `last` may ask for the torques of an acceleration")


@dataclass(frozen=True)
class SeenState:
    """The state that a force, controller or event of one argument is given.

    t: time [s].  x, xdot: (m,) shape and rate, by number or by joint.  The rest has the meaning of
    State: pose (size,) of the base; xi (r,) its body twist; mu (r,) body momentum
    H_bb ξ + H_bs ẋ about the base's origin; J (r,) spatial momentum Ad*_{g⁻¹} μ in the root
    joint's fixed frame, about its origin.  Twists and momenta are [linear; angular].  Forces are
    given CasADi symbols, controllers numbers.

    It is not what functions of (t, x, xdot, mu) see: their μ is about the centre of mass, and its
    linear part zero.
    """

    t: Any
    x: Any
    xdot: Any
    pose: Any
    xi: Any
    mu: Any
    J: Any

    def __getattr__(self, name: str) -> NoReturn:
        """Refuse a name that is none of the state's.  Raises AttributeError."""
        names = ", ".join(field.name for field in fields(self))
        raise AttributeError(f"a state has {names}, no {name!r}")


@dataclass(frozen=True)
class Load:
    """A wrench on a link, at a point of it, or on the base along fixed axes.

    link: the name of a frame of the model, or None for the base.  at: (3,) the point, in the link's
    frame [m].  frame: "body", the link's axes, or "world", those of the root joint's fixed frame.
    entries: (6,) force [N] and moment [N·m]; of the base, (r,).
    """

    link: str | None
    at: list[Any]
    frame: str
    entries: list[Any]


@dataclass(frozen=True)
class Symbols:
    """The variables of which forces are functions.

    names: of the shape joints.  followers: of those that follow them, each with words on how.
    t: time [s].  x, xdot: (m,) shape and rate, by number or by
    joint.  xi, mu: (r,) body twist of the base and body momentum, both as seen from the centre
    of mass: the linear part of μ is zero, the angular one is about the centre of mass (SO2, SO3:
    about the axis or pivot).  within: a time that says which piece of a table counts.
    For forces that are `last`: others, (m,) torques of all other forces; accelerations, those
    of the prescribed joints; required_torque, from the accelerations of all joints to the (m,)
    torques that give them.  seen: the state with the base in space, for functions of one argument.
    """

    names: tuple[str, ...]
    t: ca.SX
    x: ca.SX
    xdot: ca.SX
    xi: ca.SX
    mu: ca.SX
    seen: SeenState
    within: ca.SX | None = None
    others: ca.SX | float = 0.0
    accelerations: Mapping[int, ca.SX] = field(default_factory=dict)
    required_torque: Callable[[Mapping[int, ca.SX]], ca.SX] = _unknown_dynamics
    followers: Mapping[str, str] = field(default_factory=dict)

    @property
    def every_name(self) -> tuple[str, ...]:
        """Names of the shape joints, and then of those that follow them."""
        return (*self.names, *self.followers)

    def joint(self, name: str, what: str) -> int:
        """Return the index of a joint; those that follow others come after the shape's.

        What acts on one of these acts through it on the joint that it follows.  Raises InputError
        that lists the joints.
        """
        return joint_index(name, self.every_name, what)

    def refuse_follower(self, joint: int, what: str) -> None:
        """Raise InputError, naming `what`, if a joint follows another and is no coordinate."""
        if words := self.followers.get(self.every_name[joint]):
            raise InputError(f"{what}: {words}; take the joint that it follows")

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
    potential: [J].  loads: wrenches on links.
    """

    potential: Any = None
    torque: dict[int, Any] = field(default_factory=dict)
    wrench: list[Any] | None = None
    loads: list[Load] = field(default_factory=list)

    @property
    def expressions(self) -> list[Any]:
        """All that is written in them."""
        given = [self.potential, *self.torque.values(), *(self.wrench or [])]
        given += [value for load in self.loads for value in (*load.entries, *load.at)]
        return [value for value in given if value is not None]


class Force(ABC):
    """A force: it acts on the system.  What it sees of the base in space is in Symbols.seen."""

    last: ClassVar[bool] = False  # whether it has to know what the others do

    @property
    @abstractmethod
    def label(self) -> str:
        """The force's name in tables and messages."""

    @abstractmethod
    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the action of the force.

        number: turns a value that may change from scene to scene without another kernel, or a
        Parameter, into a symbol.  Raises InputError for joints that are not there.
        """

    @property
    def signals(self) -> Iterable[Any]:
        """The functions of time in the force, as Signals."""
        return ()


def finite(value: Any, what: str, wanted: str = "a number") -> Any:
    """Return a value as a finite number, or as the Parameter it is.  Raises InputError."""
    if isinstance(value, Parameter):
        return value
    try:
        number = float(value)
    except OverflowError:
        raise InputError(f"{what} must be finite, and is larger than any float") from None
    except (TypeError, ValueError):
        raise InputError(f"{what} must be {wanted}, got {brief(value)}") from None
    if not np.isfinite(number):
        raise InputError(f"{what} must be finite, got {number}")
    return number


def settle(force: Any, *names: str) -> None:
    """Make fields of a force finite floats, or Parameters.  Raises InputError."""
    for name in names:
        object.__setattr__(force, name, finite(getattr(force, name), f"{name} of a {force.label}"))


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
