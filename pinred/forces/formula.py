"""Formulas of the state as text, and compiled expressions for events."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.parameter import Parameter, parameter_of, value_in
from ..reduction.tree.all_joints import height
from ..system.system import System
from .columns import seen_of_base, symbols_of, terms_of
from .force import SymbolFunction, Symbols, Terms, called, scalar
from .signals.expressions import parse
from .switch_times import SignChanges

NAMES = ("t", "x", "xdot", "mu", "pose", "xi", "J", "height")


@dataclass(frozen=True)
class Formula(SymbolFunction):
    """An expression in t, x, xdot, mu, pose, xi and J.

    mu is the momentum about the centre of mass. pose, xi and J describe the base in space, as in a
    SeenState.

    Attributes:
        text: The formula, see signals/expressions.py.
        others: Further names that the formula may use, {name: SX}.
        system: Robot of whose links the formula may use the height; None for no heights.
    """

    text: str
    others: Mapping[str, Any] = field(default_factory=dict)
    system: System | None = None

    def __call__(self, s: Symbols) -> ca.SX:
        """Return the CasADi expression of the formula in the variables of forces.

        Args:
            s: Variables of the forces.
        Returns:
            The expression.
        """
        heights = {} if self.system is None else {"height": _Heights(self.system, s)}
        return parse(self.text, formula_names(s) | dict(self.others) | heights)


def formula_names(s: Symbols) -> dict[str, Any]:
    """Return the variables of the state that formulas may use, {name: symbols}."""
    observed = s.seen
    columns = {"mu": s.mu, "pose": observed.pose, "xi": observed.xi, "J": observed.J}
    return {
        "t": s.t,
        "x": {name: s.x[k] for k, name in enumerate((*s.x_names, *s.followers))},
        "xdot": {name: s.xdot[k] for k, name in enumerate(s.every_name)},
        **{name: _Components(column) for name, column in columns.items()},
    }


class _Components(dict[str, ca.SX]):
    """The entries of a pose, twist or momentum by their first names; others are accepted, too."""

    def __init__(self, column: Any) -> None:
        self._index: Mapping[str, int] = column.names
        super().__init__(zip(column.names, map(ca.SX, ca.vertsplit(column)), strict=False))

    def __contains__(self, name: object) -> bool:
        return name in self._index

    def __missing__(self, name: str) -> ca.SX:
        entry: ca.SX = list(self.values())[self._index[name]]
        return entry


class _Heights(dict[str, ca.SX]):
    """Heights of links and frames by name, computed when a formula asks for them."""

    def __init__(self, system: System, s: Symbols) -> None:
        model = system.sorted_model
        self._system, self._seen = system, s.seen
        frames = [f for f in model.frames if f.parentJoint > 0 and f.type != pin.FrameType.JOINT]
        super().__init__((str(f.name), ca.SX(0.0)) for f in frames)

    def __getitem__(self, name: str) -> ca.SX:
        observed = self._seen
        return height(
            self._system, ca.SX(observed.pose), ca.SX(observed.x)[: self._system.nx], name
        )


class _Expression:
    """An expression wrapped as a force, so that `terms_of` reports its errors."""

    def __init__(self, system: System, expression: Callable[..., Any] | str, label: str) -> None:
        self._system, self._expression, self.label = system, expression, label

    def terms(self, s: Any, number: Any) -> Terms:  # noqa: ARG002
        function = self._expression
        if isinstance(function, str):
            function = Formula(function, system=self._system)
        return Terms(potential=scalar(called(function, s, self.label), self.label))


class Watched:
    """Compiled expressions of the state of one system, e.g. event functions.

    Attributes:
        parameters: Parameters in the expressions.
        of_time: The sign changes of each expression of time alone, {index: sign changes}.
        sees_base: Whether any expression depends on the base in space.
        sees_momentum: Whether any expression depends on ξ or μ relative to the centre of mass.
    """

    def __init__(
        self, system: System, expressions: Sequence[Callable[..., Any] | str], labels: Sequence[str]
    ) -> None:
        """Compile the expressions.

        Args:
            system: The robot.
            expressions: Functions of the state, or formulas as text.
            labels: Names of the expressions in messages.
        Raises:
            InputError: An expression is invalid.
        """
        s, base = symbols_of(system, None)
        values = []
        for expression, label in zip(expressions, labels, strict=True):
            terms = terms_of(_Expression(system, expression, label), s, float)  # type: ignore[arg-type]
            values.append(ca.SX(terms.potential))
        column = ca.vertcat(ca.SX(0, 1), *values)
        arguments = [s.t, s.x, s.xdot, s.xi, s.mu, *base]
        known_hashes = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*arguments))}
        free = [symbol for symbol in ca.symvar(column) if symbol.element_hash() not in known_hashes]
        self.parameters: list[Parameter] = []
        for symbol in free:
            parameter = parameter_of(symbol)
            if parameter is None:
                raise InputError(
                    f"an event has a symbol '{symbol}' that is not one of its arguments. "
                    "Use those or a Parameter"
                )
            self.parameters.append(parameter)
        symbols: ca.SX = ca.vertcat(ca.SX(0, 1), *free)
        self.sees_base = any(seen_of_base(system, column, base))
        self.sees_momentum = ca.depends_on(column, ca.vertcat(s.xi, s.mu))
        states = ca.vertcat(*arguments[1:])
        self.of_time = {
            k: SignChanges(value, s.t, free)
            for k, value in enumerate(values)
            if ca.depends_on(value, s.t) and not ca.depends_on(value, states)
        }
        self._function = ca.Function("watched", [*arguments, symbols], [ca.densify(column)])

    @property
    def text(self) -> str:
        """The expressions as text, equal in all processes."""
        return str(self._function.serialize())

    def numbers(self, values: Mapping[str, Any]) -> Array:
        """Return the values (p,) of the parameters in the expressions.

        Args:
            values: Values of parameters by name.
        Returns:
            The values; parameters that are not named keep their own.
        """
        return np.array([value_in(values, p) for p in self.parameters], dtype=float)

    def __call__(self, columns: Sequence[Array], values: Mapping[str, Any]) -> Array:
        """Evaluate the expressions.

        Args:
            columns: t (1, T), then x, xdot, ξ and μ relative to the centre of mass, and pose,
                twist, μ and J of the base in space, (…, T) each; zeros for arguments that no
                expression depends on.
            values: Values of parameters by name.
        Returns:
            Values of the E expressions at the T times, (E, T).
        """
        numbers = self.numbers(values)
        repeated = np.repeat(numbers[:, None], columns[0].shape[1], axis=1)
        return np.asarray(self._function(*columns, repeated))
