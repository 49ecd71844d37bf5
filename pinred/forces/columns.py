"""Symbols for the arguments of forces; their terms as columns of torques, wrenches and loads.

The symbols are arrays with named entries: x["hinge"] is an entry, like x[0].

Shape and rate have joint names; pose, twist and momenta have the names of their components.

A Column behaves like a CasADi column, a Vector like a NumPy vector. Arrays computed from them have
no names and are indexed by number. Names are resolved while an expression is built, so they cost
nothing in the compiled kernel. A Python controller resolves them at each call.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError, PinredError
from ..common.names import component_index, joint_index, plain
from ..reduction.tree.all_joints import joint_rates, joint_values
from ..system.coupling import following
from ..system.force_interface import Force, Load, SeenState, Symbols, Terms
from ..system.system import System


class Column(ca.SX):
    """A CasADi column (n,) whose entries have names.

    Follower joints have entries, too, which are indexed by name or by numbers from n on. These
    entries are not part of the column itself.
    """

    def __init__(
        self,
        entries: ca.SX,
        names: Sequence[str] | Mapping[str, int],
        what: str,
        followers: Sequence[ca.SX] = (),
    ) -> None:
        """Store the entries and their names.

        Args:
            entries: The entries, (n,).
            names: Names of the shape joints, then of the followers; or the index of each component
                of a pose, twist or momentum by all its names.
            what: Name of the column in messages.
            followers: Entries of the follower joints.
        """
        super().__init__(entries)
        self.names, self._what, self._followers = names, what, tuple(followers)

    def __getitem__(self, key: Any) -> Any:
        """Return an entry by joint name, or any selection that CasADi supports.

        Args:
            key: Name, index or slice.
        Returns:
            The entry or entries.
        Raises:
            InputError: The name is unknown.
        """
        if isinstance(key, str):
            key = _index(key, self.names, self._what)
        if self._followers:
            n = len(self.names) - len(self._followers)
            if isinstance(key, int) and n <= key < len(self.names):
                return self._followers[key - n]
        return super().__getitem__(key)


class Vector(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """A NumPy vector (n,) whose entries have names; arrays computed from it have none."""

    _names: Sequence[str] | Mapping[str, int] | None = None
    _what = ""

    @classmethod
    def of(cls, numbers: Array, names: Sequence[str] | Mapping[str, int], what: str) -> Vector:
        """Return a copy of an array whose entries have names.

        Args:
            numbers: Values, (n,).
            names: Names of the joints; or the index of each component by all its names.
            what: Name of the vector in messages.
        Returns:
            The copy.
        """
        vector = np.array(numbers, dtype=float).view(cls)
        vars(vector).update(_names=names, _what=what)
        return vector

    def __getitem__(self, key: Any) -> Any:
        """Return an entry by joint name, or any selection that NumPy supports.

        Args:
            key: Name, index or slice.
        Returns:
            The entry or entries.
        Raises:
            InputError: The name is unknown, or this array was computed from others and has no
                names.
        """
        if isinstance(key, str):
            if self._names is None:
                raise InputError(
                    f"only the arguments x and xdot, and fields of a state, accept names such as "
                    f"'{key}'; arrays computed from them accept only indices"
                )
            key = _index(key, self._names, self._what)
        return self.view(np.ndarray)[key]

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Return results of NumPy functions as plain arrays or numbers.

        Args:
            array: Result of the NumPy function.
            context: Unused; part of NumPy's interface.
            return_scalar: Whether NumPy expects a scalar.
        Returns:
            The result as a plain array or number.
        """
        if array is self:  # as in x += 1
            return self
        return array[()] if return_scalar else np.asarray(array)


def _index(key: str, names: Sequence[str] | Mapping[str, int], what: str) -> int:
    """Return the index of an entry by its name.  Raises InputError."""
    if isinstance(names, Mapping):
        return component_index(key, names, what)
    return joint_index(key, names, what)


def symbols_of(system: System, within: ca.SX | None) -> tuple[Symbols, tuple[ca.SX, ...]]:
    """Create the CasADi variables that forces may use, including symbols of the base in space.

    The variables of the base are computed in the frame of the centre of mass where possible.
    Symbols of the base in space appear only in quantities that this frame does not determine.

    Args:
        system: The robot.
        within: Time that selects the segment of tabulated signals, None without tables.
    Returns:
        The variables, and the symbols of pose, body twist, body momentum and spatial momentum.
    """
    r, group = system.r, system.group
    t, xi, mu = ca.SX.sym("t"), ca.SX.sym("xi", r), ca.SX.sym("mu", r)
    space = system.space
    x = _column(system, "x", space.x_names, system.tree.x_names, joint_values)
    xdot = _column(system, "xdot", space.names, system.tree.names, joint_rates)
    pose, twist = ca.SX.sym("pose", group.size), ca.SX.sym("twist", r)
    momentum, J = ca.SX.sym("momentum", r), ca.SX.sym("J", r)
    k, momenta = group.linear, group.components("momentum")
    seen = SeenState(
        t=t,
        x=x,
        xdot=xdot,
        pose=Column(pose, group.components("pose"), "pose"),
        xi=Column(
            ca.vertcat(*ca.vertsplit(twist)[:k], *ca.vertsplit(xi)[k:]),
            group.components("twist"),
            "xi",
        ),
        mu=Column(momentum if k else mu, momenta, "mu"),
        J=Column(J if k or group.turns == 3 else mu, momenta, "J"),
    )
    followers = {name: following(name, system.couplings) for name in system.followers}
    symbols = Symbols(
        names=system.shape_names, x_names=system.x_names, followers=followers,
        t=t, x=x, xdot=xdot, xi=xi, mu=Column(mu, momenta, "mu"), seen=seen, within=within,
    )  # fmt: skip
    return symbols, (pose, twist, momentum, J)


def seen_of_base(system: System, everything: ca.SX, base: tuple[ca.SX, ...]) -> tuple[bool, bool]:
    """Return whether expressions depend on the attitude, and on position or velocity, of the base.

    Args:
        system: The robot.
        everything: Expressions of all forces.
        base: Symbols of the base in space, as `symbols_of` returns them.
    Returns:
        Whether they depend on the attitude, and whether they depend on position or velocity.
    """
    k, (pose, *motion) = system.group.linear, base
    coordinates = ca.vertsplit(pose)
    translation, attitude_symbols = [*coordinates[:k], *motion], coordinates[k:]
    if not k:
        translation, attitude_symbols = [], [*attitude_symbols, *motion]
    attitude_column, place_column = (
        ca.vertcat(ca.SX(0, 1), *symbols) for symbols in (attitude_symbols, translation)
    )
    return ca.depends_on(everything, attitude_column), ca.depends_on(everything, place_column)


def _column(
    system: System,
    what: str,
    names: tuple[str, ...],
    tree_names: tuple[str, ...],
    on_joints: Callable[..., list[Any]],
) -> Column:
    """Return the shape or its rate as symbols, with expressions for follower joints.

    Args:
        system: The robot.
        what: Name of the symbols.
        names: Labels of the entries.
        tree_names: Labels of the entries of all joints.
        on_joints: Function that extends entries of the shape to all joints.
    Returns:
        The symbols.
    """
    symbols = ca.SX.sym(what, len(names))
    if system.coupled is None:
        return Column(symbols, names, what)
    expressions = dict(zip(tree_names, on_joints(system, ca.vertsplit(symbols)), strict=True))
    followers = [ca.SX(expressions[name]) for name in system.followers]
    return Column(symbols, (*names, *system.followers), what, followers)


def torque_column(terms: Terms, system: System) -> ca.SX:
    """Return the torques on the shape, (m,)."""
    column = ca.SX(system.m, 1)
    for k, value in sorted(terms.torque.items()):
        for i, ratio in through(system, k):
            column[i] += ratio * value
    return column


def through(system: System, k: int) -> list[tuple[int, float]]:
    """Return the shape coordinates on which a torque at a joint acts, with factors of the torque.

    Args:
        system: The robot.
        k: Index of a shape joint, or m plus the index of a follower joint.
    Returns:
        Index of each shape coordinate, and the ratio of the joint's motion to it.
    """
    if k < system.m or system.coupled is None:
        return [(k, 1.0)]
    return system.coupled.terms(system.tree.names.index(system.followers[k - system.m]))


def wrench_column(terms: Terms, r: int) -> ca.SX:
    """Return the wrench on the base, (r,)."""
    entries: list[Any] = terms.wrench if terms.wrench is not None else [0.0] * r
    column: ca.SX = ca.vertcat(*entries)
    return column


def load_column(load: Load) -> ca.SX:
    """Return a load as a column (9,): its entries, padded with zeros to six, and its point."""
    padding = [0.0] * (6 - len(load.entries))
    column: ca.SX = ca.vertcat(*load.entries, *padding, *load.at)
    return column


_SOURCE = re.compile(r"^\S*\.[ch]pp:\d+: ")  # source location in CasADi's messages
_INSTEAD = (
    "it is called once, with CasADi symbols: write casadi.sin(t) for math.sin or np.sin, and "
    "casadi.if_else(t < 0.5, a, b) for `if`; or use a Controller, which is called with numbers"
)


def terms_of(force: Force, s: Symbols, number: Callable[[Any], Any]) -> Terms:
    """Return the terms of a force, with errors of user functions turned into InputError.

    Args:
        force: The force.
        s: Variables of the forces.
        number: Function that replaces a number by a symbol.
    Returns:
        The terms of this force.
    Raises:
        InputError: The force's function fails; the message says how to write it.
        PinredError: The force rejects its arguments.
    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", r"\s*casadi: a numpy function", FutureWarning)
            terms = force.terms(s, number)
    except PinredError as error:
        if str(error).endswith("got nan"):  # float() of a symbol is NaN, as in Python's math
            raise type(error)(f"{error}; if your function returns this value, {_INSTEAD}") from None
        raise
    except Exception as error:  # user functions may raise exceptions of any type
        description = plain(_SOURCE.sub("", str(error)).partition("Possible prototypes")[0], 160)
        if isinstance(error, FutureWarning):
            description = "a function of NumPy was called on a CasADi symbol"
        raise InputError(
            f"{force.label}: {type(error).__name__}: {description}; {_INSTEAD}"
        ) from error
    if any(_contains_nan(value) for value in terms.expressions):
        raise InputError(
            f"{force.label} is NaN at all times, because functions of Python's math return NaN for "
            f"symbols: {_INSTEAD}"
        )
    return terms


def _contains_nan(value: Any) -> bool:
    """Return whether an expression contains a constant NaN."""
    expression = ca.SX(value)
    function = ca.Function("f", ca.symvar(expression), [expression])
    return any(
        function.instruction_id(k) == ca.OP_CONST and math.isnan(function.instruction_constant(k))
        for k in range(function.n_instructions())
    )
