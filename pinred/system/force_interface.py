"""The interface of forces: the symbols on which they depend, and the terms that they return.

It is part of this subpackage because a robot file can contain forces (`System.passive`).  Forces
that the user adds are in the subpackage `forces`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.errors import InputError
from ..common.names import brief, joint_index, listed, quoted
from ..common.parameter import Parameter

if TYPE_CHECKING:
    import casadi as ca


def _unknown_dynamics(_: Mapping[int, ca.SX]) -> ca.SX:
    raise InputError(
        "only a force class with last = True can request the torques of an acceleration"
    )


@checks_arguments
@dataclass(frozen=True)
class SeenState:
    """The state that is passed to a force, controller or event function of one argument.

    Forces receive CasADi symbols and controllers receive numbers.  Here μ is the body momentum
    about the origin of the base.  Functions of (t, x, xdot, mu) receive μ about the centre of
    mass, with zero linear momentum.  Twists and momenta are [linear; angular].

    Attributes:
        t: Time [s].
        x: Shape, (nx,) [rad | m | 1], by number or by label.
        xdot: Shape rate, (m,) [rad/s | m/s], by number or by joint name.
        pose: Pose of the base, (size,).
        xi: Body twist of the base, (r,).
        mu: Body momentum H_bb ξ + H_bs ẋ about the origin of the base, (r,).
        J: Spatial momentum Ad*_{g⁻¹} μ in the fixed frame of the root joint, about its origin,
            (r,).
    """

    t: Any
    x: Any
    xdot: Any
    pose: Any
    xi: Any
    mu: Any
    J: Any

    def __getattr__(self, name: str) -> NoReturn:
        """Reject an unknown name.

        Args:
            name: Name of the attribute.
        Raises:
            AttributeError: Always; the message lists the names.
        """
        names = ", ".join(field.name for field in fields(self))
        raise AttributeError(f"a state has no {name!r}; its fields are {names}")


@dataclass(frozen=True)
class Load:
    """A wrench on a link at a point of it, or on the base along fixed axes.

    Attributes:
        link: Name of a frame of the model, or None for the base.
        at: Point in the frame of the link, (3,) [m].
        frame: "body" for the axes of the link, or "world" for the fixed frame of the root joint.
        entries: Force [N] and moment [N·m], (6,); for the base, (r,).
    """

    link: str | None
    at: list[Any]
    frame: str
    entries: list[Any]


@dataclass(frozen=True)
class Symbols:
    """The variables on which forces depend.

    Only forces with `last` receive `others`, `accelerations` and `required_torque`.

    Attributes:
        names: Labels of the shape rates, (m,): joint names, "neck.x" for an axis of a ball.
        x_names: Labels of the shape coordinates, (nx,): joint names, "neck.qx" for a ball.
        t: Time [s].
        x: Shape, (nx,) [rad | m | 1], by number or by label.
        xdot: Shape rate, (m,) [rad/s | m/s], by number or by label.
        xi: Body twist of the base, relative to the motion of the centre of mass, (r,).
        mu: Body momentum about the centre of mass, (r,), with zero linear part; for SO2 and SO3
            about the axis or pivot.
        seen: State with the base in space, for functions of one argument.
        within: Time that selects the segment of a table [s].
        others: Torques of all other forces, (m,) [N·m | N].
        accelerations: Accelerations of prescribed joints, {joint index: expression}.
        required_torque: Map from the accelerations of all joints, or with closed loops of
            independent joints, to the torques, (m,), that cause these accelerations.
        loop_motion: With closed loops, map from the indices of independent joints to G, (m, k),
            with ẋ = G u̇; None without loops.
        followers: Names of follower joints, each with a description of its coupling.
    """

    names: tuple[str, ...]
    x_names: tuple[str, ...]
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
    loop_motion: Callable[[Sequence[int]], ca.SX] | None = None
    followers: Mapping[str, str] = field(default_factory=dict)

    @property
    def every_name(self) -> tuple[str, ...]:
        """Names of the shape joints, then of the follower joints."""
        return (*self.names, *self.followers)

    def joint(self, name: str, what: str) -> int:
        """Return the index of a joint.

        Follower joints come after the shape joints.  A force on a follower acts, through the
        coupling, on its independent joint.

        Args:
            name: Name of the joint.
            what: Beginning of the error message.
        Returns:
            Index of the joint in `every_name`.
        Raises:
            InputError: The name is unknown; the message lists the joints.
        """
        return joint_index(name, self.every_name, what)

    def is_ball(self, name: str) -> bool:
        """Return whether a name is that of a ball joint."""
        return f"{name}.qx" in self.x_names

    def rates(self, name: str, what: str) -> list[int]:
        """Return the indices of the rates of a joint, three for a ball.

        Args:
            name: Name of a joint, or of an axis of a ball.
            what: Beginning of the error message.
        Raises:
            InputError: The name is unknown; the message lists the joints.
        """
        if self.is_ball(name):
            first = self.names.index(f"{name}.x")
            return [first, first + 1, first + 2]
        return [self.joint(name, what)]

    def position(self, joint: int, what: str) -> Any:
        """Return the coordinate of a hinge or slide.

        Args:
            joint: Index of the joint in `every_name`.
            what: Beginning of the error message.
        Returns:
            The coordinate [rad | m].
        Raises:
            InputError: The index belongs to an axis of a ball, which has no coordinate.
        """
        name = self.every_name[joint]
        if joint >= len(self.names):
            followed: Any = self.x
            return followed[name]
        if name not in self.x_names:
            raise InputError(
                f"{what}: {name!r} is an axis of a ball joint, along which there is no coordinate; "
                "use a force on the whole ball"
            )
        return self.x[self.x_names.index(name)]

    def ball(self, name: str, what: str) -> tuple[Any, int]:
        """Return the quaternion of a ball, (4,), and the index of its first rate.

        Args:
            name: Name of the ball joint.
            what: Beginning of the error message.
        Raises:
            InputError: There is no ball joint with this name; the message lists the balls.
        """
        balls = [label.removesuffix(".qx") for label in self.x_names if label.endswith(".qx")]
        if name not in balls:
            raise InputError(
                f"{what}: no ball joint {quoted(str(name))}; the ball joints are "
                f"{listed(balls, 30) or 'none'}"
            )
        first = self.x_names.index(f"{name}.qx")
        return self.x[first : first + 4], self.names.index(f"{name}.x")

    def refuse_follower(self, joint: int, what: str) -> None:
        """Reject a follower joint, which is not a shape coordinate.

        Args:
            joint: Index of the joint in `every_name`.
            what: Beginning of the error message.
        Raises:
            InputError: The joint is a follower.
        """
        if words := self.followers.get(self.every_name[joint]):
            raise InputError(f"{what}: {words}; use the joint that it follows")

    def column(self, values: Any, what: str) -> dict[int, Any]:
        """Return values by joint index.

        Args:
            values: Mapping from joint names, or a sequence of m values.
            what: Beginning of the error message.
        Returns:
            {joint index: value}.
        """
        if isinstance(values, Mapping):
            return {self.joint(name, what): value for name, value in values.items()}
        return dict(enumerate(entries(values, len(self.names), what)))


@dataclass
class Terms:
    """The terms of a force in the equations of motion.

    Attributes:
        potential: Potential energy [J].
        torque: Joint torques [N·m | N], by index as in `Symbols.joint`.
        wrench: Wrench on the base [linear; angular], r entries.
        loads: Wrenches on links.
    """

    potential: Any = None
    torque: dict[int, Any] = field(default_factory=dict)
    wrench: list[Any] | None = None
    loads: list[Load] = field(default_factory=list)

    @property
    def expressions(self) -> list[Any]:
        """All expressions in the terms."""
        values = [self.potential, *self.torque.values(), *(self.wrench or [])]
        values += [value for load in self.loads for value in (*load.entries, *load.at)]
        return [value for value in values if value is not None]


@checks_arguments
class Force(ABC):
    """A force that acts on the system.

    Attributes:
        last: Whether the force depends on the other forces and is evaluated after them.
    """

    last: ClassVar[bool] = False

    @property
    @abstractmethod
    def label(self) -> str:
        """Name of the force in tables and messages."""

    @abstractmethod
    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the terms of the force.

        Args:
            s: Variables of the system.
            number: Function that converts a value to a CasADi symbol if it is a kernel input
                (a Parameter, or a value that may differ between scenes).
        Returns:
            Terms of the force.
        Raises:
            InputError: A joint is unknown.
        """

    @property
    def signals(self) -> Iterable[Any]:
        """The Signals (functions of time) in the force."""
        return ()


def finite(value: Any, what: str, wanted: str = "a number") -> Any:
    """Check that a value is a finite number or a Parameter.

    Args:
        value: Value to check.
        what: Name of the value in messages.
        wanted: Description of the expected value in messages.
    Returns:
        The value as a float, or the Parameter.
    Raises:
        InputError: The value is neither a finite number nor a Parameter.
    """
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
    """Convert the named fields of a force to finite floats or Parameters.  Raises InputError."""
    for name in names:
        object.__setattr__(force, name, finite(getattr(force, name), f"{name} of a {force.label}"))


def entries(values: Any, count: int, what: str) -> list[Any]:
    """Return the entries of a sequence or of a CasADi column.

    Args:
        values: Sequence, CasADi column, or a single value.
        count: Expected number of entries.
        what: Name of the values in messages.
    Returns:
        List of `count` entries.
    Raises:
        InputError: The number of entries is wrong.
    """
    import casadi as ca

    if isinstance(values, ca.SX):
        values = ca.vertsplit(ca.densify(values)) if values.shape[1] == 1 else [values]
    try:
        listing = list(values)
    except TypeError:
        listing = [values]
    if len(listing) != count:
        raise InputError(f"{what} must have {count} values, got {len(listing)}")
    return listing
