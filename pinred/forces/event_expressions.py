"""Expressions of the state that somebody watches: of events, as numbers at many times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.parameter import Parameter, parameter_of
from ..system.system import System
from .arguments import called
from .columns import seen_of_base, symbols_of
from .force import Terms, scalar
from .formula import Formula
from .written import terms_of


class _Expression:
    """An expression, as far as `terms_of` takes it for a force, to tell what is wrong in it."""

    def __init__(self, expression: Callable[..., Any] | str, label: str) -> None:
        self._expression, self.label = expression, label

    def terms(self, s: Any, number: Any) -> Terms:  # noqa: ARG002
        given = Formula(self._expression) if isinstance(self._expression, str) else self._expression
        return Terms(potential=scalar(called(given, s, self.label), self.label))


class Watched:
    """Expressions of one system's state.

    parameters: the Parameters in them.  sees_base: whether any sees the base in space.
    sees_momentum: whether any sees μ about the centre of mass.
    """

    def __init__(
        self, system: System, expressions: Sequence[Callable[..., Any] | str], labels: Sequence[str]
    ) -> None:
        """Write them down.  Raises InputError, naming the one that is at fault."""
        s, base = symbols_of(system, None)
        given = []
        for expression, label in zip(expressions, labels, strict=True):
            terms = terms_of(_Expression(expression, label), s, float)  # type: ignore[arg-type]
            given.append(ca.SX(terms.potential))
        whole = ca.vertcat(ca.SX(0, 1), *given)
        arguments = [s.t, s.x, s.xdot, s.xi, s.mu, *base]
        own = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*arguments))}
        free = [symbol for symbol in ca.symvar(whole) if symbol.element_hash() not in own]
        self.parameters: list[Parameter] = []
        for symbol in free:
            parameter = parameter_of(symbol)
            if parameter is None:
                raise InputError(f"an event has a symbol '{symbol}' that it was not given")
            self.parameters.append(parameter)
        symbols: ca.SX = ca.vertcat(ca.SX(0, 1), *free)
        self.sees_base = any(seen_of_base(system, whole, base))
        self.sees_momentum = ca.depends_on(whole, ca.vertcat(s.xi, s.mu))
        self._function = ca.Function("watched", [*arguments, symbols], [ca.densify(whole)])

    def __call__(self, columns: Sequence[Array], values: Mapping[str, Any]) -> Array:
        """Return the values (E, T) at T times.

        columns: t (1, T), x, xdot, ξ and μ relative to the centre of mass, pose, twist, μ and J
        of the base in space, (…, T) each; zeros where nobody looks.  values: of parameters.
        """
        numbers = np.array([values.get(p.name, p.value) for p in self.parameters])
        repeated = np.repeat(numbers[:, None], columns[0].shape[1], axis=1)
        return np.asarray(self._function(*columns, repeated))
