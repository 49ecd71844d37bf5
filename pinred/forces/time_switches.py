"""Conditions on time in the expressions of forces, and expressions without jumps between them.

A switch is a comparison, abs, sign, copysign, floor, ceil, min, max, fmod or remainder whose
arguments depend only on time and on numbers. Its argument g determines when it switches: at the
zeros of g, or where g is a whole number. Between two switches, each condition has one value. It is
evaluated at a time `within` this span, so that a step that ends exactly at a switch uses the values
of its own span.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

COMPARISONS = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)
KINKS = frozenset({
    *COMPARISONS, ca.OP_FABS, ca.OP_SIGN, ca.OP_COPYSIGN, ca.OP_FMIN, ca.OP_FMAX,
    ca.OP_IF_ELSE_ZERO, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER,
})  # fmt: skip


@dataclass(frozen=True)
class Switch:
    """One condition on time.

    Attributes:
        state: Symbol of the value that the condition has between two switches.
        value: The same value as a function of `within` and the numbers.
        argument: g as a function of time, the symbols of other switches and the numbers; None if
            the condition does not depend on time within a span.
        whole: Whether it switches where g is a whole number, not where g is zero.
        level: One more than the largest level of the switches that g contains.
        written: The value as a function of time, `within` for tables, and the numbers, as the
            force states it.
    """

    state: ca.SX
    value: ca.SX
    argument: ca.SX | None
    whole: bool
    level: int
    written: ca.SX


@dataclass(frozen=True)
class Separated:
    """Expressions whose conditions on time are evaluated at `within`.

    Attributes:
        expressions: The expressions.
        switches: The switches, inner ones first.
        has_kinks: Whether a condition depends on more than time and numbers.
    """

    expressions: list[ca.SX]
    switches: list[Switch]
    has_kinks: bool


@dataclass(frozen=True)
class _Node:
    """The value of an instruction.

    Attributes:
        now: Function of time, `within` and all other symbols, with conditions at `within`.
        timed: Whether `now` depends on time.
        level: Largest level of the switches that it contains; −1 if it depends on the state.
        stated: The value as a function of time, the symbols of switches, and the numbers.
        written: The value as the force states it.
    """

    now: ca.SX
    timed: bool = False
    level: int = -1
    stated: Any = None
    written: Any = None


def separate(
    expressions: Sequence[ca.SX], t: ca.SX, within: ca.SX, numbers: Sequence[ca.SX]
) -> Separated | None:
    """Evaluate the conditions on time in expressions at `within`; None if there are none.

    Args:
        expressions: The expressions.
        t: Time.
        within: The time at which conditions are evaluated.
        numbers: Symbols of the numbers that are constant during a run.
    Returns:
        The expressions and the switches.
    """
    column = ca.vertcat(ca.SX(0, 1), *(ca.vec(ca.densify(e)) for e in expressions))
    known = [t, within, *numbers]
    hashes = {symbol.element_hash() for symbol in known}
    others = [s for s in ca.symvar(column) if s.element_hash() not in hashes]
    function = ca.Function("f", [ca.vertcat(*known, *others)], [column])
    if not _has_switches(function, len(known)):
        return None
    walk = _Walk(t, within)
    inputs = [
        *(_Node(s, timed=k == 0, level=0, stated=s, written=s) for k, s in enumerate(known)),
        *map(_Node, others),
    ]
    values = walk.run(function, inputs)
    separated, first = [], 0
    for e in expressions:
        entries = ca.vertcat(ca.SX(0, 1), *values[first : first + e.numel()])
        separated.append(ca.sparsify(ca.reshape(entries, *e.shape)))
        first += e.numel()
    return Separated(separated, walk.switches, walk.has_kinks)


def _has_switches(function: ca.Function, known: int) -> bool:
    """Return whether a condition depends on the first of `known` inputs, and on no others."""
    timed, other = 1, 2
    work = [0] * function.sz_w()
    for k in range(function.n_instructions()):
        op, into = function.instruction_id(k), function.instruction_output(k)
        if op in (ca.OP_CONST, ca.OP_OUTPUT):
            continue
        given = function.instruction_input(k)
        if op == ca.OP_INPUT:
            work[into[0]] = timed if given[1] == 0 else other * (given[1] >= known)
            continue
        if op in KINKS and any(work[i] == timed for i in given):
            decides = work[given[0]] if op == ca.OP_IF_ELSE_ZERO else max(work[i] for i in given)
            if decides == timed:
                return True
        kind = 0
        for i in given:
            kind |= work[i]
        work[into[0]] = kind
    return False


class _Walk:
    """One pass over the instructions of a function."""

    def __init__(self, t: ca.SX, within: ca.SX) -> None:
        self._t, self._within = t, within
        self.switches: list[Switch] = []
        self.has_kinks = False

    def run(self, function: ca.Function, inputs: Sequence[_Node]) -> list[ca.SX]:
        """Return the outputs of a function of one column, with conditions at `within`."""
        work: list[Any] = [None] * function.sz_w()
        outputs: list[Any] = [ca.SX(0)] * function.nnz_out()
        for k in range(function.n_instructions()):
            op, into = function.instruction_id(k), function.instruction_output(k)
            if op == ca.OP_CONST:
                constant = ca.SX(function.instruction_constant(k))
                work[into[0]] = _Node(constant, level=0, stated=constant, written=constant)
                continue
            given = function.instruction_input(k)
            if op == ca.OP_INPUT:
                work[into[0]] = inputs[given[1]]
            elif op == ca.OP_OUTPUT:
                outputs[into[1]] = work[given[0]].now
            else:
                work[into[0]] = self._node(op, [work[i] for i in given])
        return outputs

    def _node(self, op: int, given: list[_Node]) -> _Node:
        if op == ca.OP_IF_ELSE_ZERO:
            return self._selected(*given)
        if any(node.level < 0 for node in given):
            self.has_kinks |= op in KINKS
            return _Node(_applied(op, *(node.now for node in given)))
        if op in KINKS and not all(node.now.is_constant() for node in given):
            return self._switch(op, given)
        return _combined(op, given)

    def _selected(self, condition: _Node, value: _Node) -> _Node:
        """Return the value where a condition holds, else zero."""
        if condition.level < 0:
            self.has_kinks = True
        elif condition.timed:
            # A condition that is a number instead of a comparison holds where it is not zero.
            condition = self._switch(ca.OP_NE, [condition, _constant(0.0)])
        if condition.level < 0 or value.level < 0:
            return _Node(_applied(ca.OP_IF_ELSE_ZERO, condition.now, value.now))
        return _combined(ca.OP_IF_ELSE_ZERO, [condition, value])

    def _switch(self, op: int, given: list[_Node]) -> _Node:
        """Return a condition on time and numbers, and store its switches."""
        first, second = given[0], given[-1]
        if op in (ca.OP_FABS, ca.OP_SIGN):
            sign = self._add(ca.OP_SIGN, given, first)
            return sign if op == ca.OP_SIGN else _combined(ca.OP_MUL, [sign, first])
        if op in (ca.OP_FMIN, ca.OP_FMAX):
            is_less = self._add(ca.OP_LT, given, _combined(ca.OP_SUB, given))
            chosen, other = (first, second) if op == ca.OP_FMIN else (second, first)
            is_not = _combined(ca.OP_NOT, [is_less])
            parts = [
                _combined(ca.OP_IF_ELSE_ZERO, [is_less, chosen]),
                _combined(ca.OP_IF_ELSE_ZERO, [is_not, other]),
            ]
            return _combined(ca.OP_ADD, parts)
        if op in (ca.OP_FMOD, ca.OP_REMAINDER):
            quotient = _combined(ca.OP_DIV, given)
            if op == ca.OP_REMAINDER:
                quotient = _combined(ca.OP_ADD, [quotient, _constant(0.5)])
            count = self._add(ca.OP_FLOOR, [quotient], quotient, whole=True)
            if op == ca.OP_FMOD:  # rounded towards zero where the quotient is negative
                count = self._towards_zero(quotient, count)
            return _combined(ca.OP_SUB, [first, _combined(ca.OP_MUL, [second, count])])
        if op == ca.OP_COPYSIGN:
            size = self._switch(ca.OP_FABS, [first])
            sign = self._add(ca.OP_COPYSIGN, [_constant(1.0), second], second)
            return _combined(ca.OP_MUL, [size, sign])
        if op in (ca.OP_LT, ca.OP_LE):
            return self._add(op, given, _combined(ca.OP_SUB, given))
        # Equality and logical operations on numbers change their values only at isolated times.
        whole = op in (ca.OP_FLOOR, ca.OP_CEIL)
        return self._add(op, given, first if whole else None, whole=whole)

    def _towards_zero(self, quotient: _Node, count: _Node) -> _Node:
        negative = self._add(ca.OP_LT, [count, _constant(0.0)], None)
        is_whole = self._add(ca.OP_EQ, [count, quotient], None)
        fraction = _combined(ca.OP_NOT, [is_whole])
        return _combined(ca.OP_ADD, [count, _combined(ca.OP_MUL, [negative, fraction])])

    def _add(
        self, op: int, given: list[_Node], argument: _Node | None, *, whole: bool = False
    ) -> _Node:
        """Store a switch with the value op(given), and return its value."""
        symbol = ca.SX.sym("state")
        timed = any(node.timed for node in given)
        value = _applied(op, *(node.now for node in given))
        if timed:
            value = ca.substitute(value, self._t, self._within)
        g = argument.stated if timed and argument is not None else None
        written = _applied(op, *(node.written for node in given))
        level = max(node.level for node in given) + (g is not None)
        self.switches.append(Switch(symbol, value, g, whole, level, written))
        return _Node(value, level=level, stated=symbol, written=written)


def _constant(value: float) -> _Node:
    number = ca.SX(value)
    return _Node(number, level=0, stated=number, written=number)


def _combined(op: int, given: list[_Node]) -> _Node:
    """Return the result of an operation on nodes that depend on time and numbers only."""
    return _Node(
        _applied(op, *(node.now for node in given)),
        timed=any(node.timed for node in given),
        level=max(node.level for node in given),
        stated=_applied(op, *(node.stated for node in given)),
        written=_applied(op, *(node.written for node in given)),
    )


def _applied(op: int, *given: ca.SX) -> ca.SX:
    """Return the result of a CasADi operation."""
    operation = ca.SX.unary if len(given) == 1 else ca.SX.binary
    return operation(op, *given)
