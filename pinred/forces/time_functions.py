"""The functions of time in the expressions of forces, evaluated with NumPy at many times.

A function of time is a part of an expression that depends on time and on numbers, but not on the
state. In `6 exp(−(t − 1)²) x`, it is the factor of x. Expressions such as `sin(400 t − x)`, which
depend on both together, count with a fixed state. The terms of a sum are functions of their own,
because a large slow term would hide a short pulse.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import product
from math import prod
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from .vector_program import VectorProgram

_CONSTANT, _TIMED, _STATE = range(3)
_MOST_TERMS = 64  # largest number of functions for which sums are split into terms


class TimeFunctions:
    """The functions of time in one force model that are not linear in time.

    Attributes:
        count: Number of functions; those with an operation that NumPy lacks are left out.
        firsts: Index of the first term of each sum, (S,).
    """

    def __init__(
        self, functions: Sequence[tuple[ca.Function, int]], size: int, held: Collection[int]
    ) -> None:
        """Collect the functions of time.

        Args:
            functions: CasADi functions with time as first input, each with the index of the input
                that has the numbers of the forces.
            size: Number of numbers p.
            held: Indices of the numbers that change during a run.
        """
        t, p = ca.SX.sym("t"), ca.SX.sym("p", size)
        values_by_index: dict[int, _Value] = {}
        for function, numbers in functions:
            _collect(function, numbers, t, p, held, values_by_index)
        values = [v for v in values_by_index.values() if _is_bent(v.expression, t)]
        values = [v for v in values if _is_known([t, p], v.expression)]
        groups = [_terms(value, t) for value in values]
        if sum(map(len, groups)) > _MOST_TERMS:
            groups = [[value.expression] for value in values]
        timed = [term for group in groups for term in group]
        self.count = len(timed)
        self.firsts = np.cumsum([0, *map(len, groups[:-1])], dtype=np.int64)[: len(groups)]
        self.used = [k for k, used in enumerate(_depends(timed, p)) if used]
        self._program = VectorProgram([t, *(p[k] for k in self.used)], timed)

    def __call__(self, times: Array, numbers: Array, within: slice, spans: Array) -> Array:
        """Return the values of all functions.

        Args:
            times: Times, (…) [s].
            numbers: Numbers of the forces, (p,), or (p, …) with axes that broadcast to the times.
            within: Slice of the numbers that change from span to span.
            spans: Values of these numbers at each time, (w, …), likewise.
        Returns:
            The values, (count, …).
        """
        first, last = within.start, within.stop
        inputs: list[Any] = [
            spans[k - first] if first <= k < last else numbers[k] for k in self.used
        ]
        values = np.empty((self.count, *times.shape))
        for row, value in zip(values, self._program(times, *inputs), strict=True):
            row[:] = value
        return values

    def widths(
        self, starts: Array, ends: Array, numbers: Array, within: slice, spans: Array
    ) -> Array:
        """Return widths of intervals that contain all values over intervals of time, (count, P).

        Args:
            starts: Starts of the intervals of time, (P,) [s].
            ends: Their ends, (P,) [s].
            numbers: Numbers of the forces, (p,), or (p, P) in each interval.
            within: Slice of the numbers that change from span to span.
            spans: Values of these numbers in each interval of time, (w, P).
        """
        first, last = within.start, within.stop
        inputs: list[Any] = [
            spans[k - first] if first <= k < last else numbers[k] for k in self.used
        ]
        bounds = self._program.bounds([(starts, ends), *((value, value) for value in inputs)])
        widths = np.empty((self.count, len(starts)))
        for row, (low, high) in zip(widths, bounds, strict=True):
            row[:] = np.subtract(high, low)
        return np.where(np.isnan(widths), np.inf, widths)


def _depends(expressions: Sequence[ca.SX], p: ca.SX) -> Sequence[bool]:
    """Return whether any of the expressions depends on each symbol of p."""
    column = ca.vertcat(ca.SX(0, 1), *expressions)
    return list(ca.which_depends(column, p)) if p.numel() and column.numel() else []


def _is_bent(expression: ca.SX, t: ca.SX) -> bool:
    """Return whether an expression depends on time, but not linearly."""
    return bool(ca.depends_on(ca.jacobian(expression, t), t))


def _terms(value: _Value, t: ca.SX) -> list[ca.SX]:
    """Return the terms of a sum; those that are linear in time are added up."""
    bent, straight = [], ca.SX(0)
    for term in value.terms or (value.expression,):
        if _is_bent(term, t):
            bent.append(term)
        else:
            straight += term
    return bent if straight.is_zero() else [*bent, straight]


def _is_known(inputs: Sequence[ca.SX], expression: ca.SX) -> bool:
    """Return whether NumPy has all operations of an expression."""
    try:
        VectorProgram(inputs, [expression])
    except InputError:
        return False
    return True


class _Value(NamedTuple):
    """A value in a CasADi function.

    Attributes:
        kind: Whether it is constant, depends on time, or depends on the state.
        expression: The expression of time and numbers, with a fixed state.
        timed: Whether it depends on time.
        bent: Whether it depends on time and state together in another way than through sums, and
            products of functions of time with functions of the state.
        terms: Its terms, if it is a sum.
    """

    kind: int
    expression: ca.SX
    timed: bool = False
    bent: bool = False
    terms: tuple[ca.SX, ...] = ()


_SUMS = (ca.OP_ASSIGN, ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE)


def _collect(
    function: ca.Function,
    numbers: int,
    t: ca.SX,
    p: ca.SX,
    held: Collection[int],
    found: dict[int, _Value],
) -> None:
    """Add the functions of time in a CasADi function to {hash: value}; see TimeFunctions."""
    work: list[Any] = [None] * function.sz_w()

    def use(value: _Value) -> None:
        if value.kind == _TIMED or value.bent:
            found.setdefault(value.expression.element_hash(), value)

    for k in range(function.n_instructions()):
        op, into = function.instruction_id(k), function.instruction_output(k)
        if op == ca.OP_CONST:
            work[into[0]] = _Value(_CONSTANT, ca.SX(function.instruction_constant(k)))
            continue
        operands: Any = function.instruction_input(k)
        if op == ca.OP_INPUT:
            work[into[0]] = _input(operands, numbers, t, p, held)
        elif op == ca.OP_OUTPUT:
            use(work[operands[0]])
        else:
            values = [work[i] for i in operands]
            value = _apply(op, values)
            if value.kind == _STATE:
                for operand in values:
                    if operand.kind == _TIMED:
                        use(operand)
            work[into[0]] = value


def _apply(op: int, values: Sequence[_Value]) -> _Value:
    """Return the value of an operation."""
    operation: Any = ca.SX.unary if len(values) == 1 else ca.SX.binary
    kind = max(value.kind for value in values)
    timed = [value.timed for value in values]
    is_sum = op in _SUMS or (op == ca.OP_MUL and sum(timed) < 2)
    is_sum = is_sum or (op == ca.OP_DIV and not timed[1])
    bent = any(value.bent for value in values) or not is_sum
    expression = operation(op, *(value.expression for value in values))
    terms: tuple[ca.SX, ...] = ()
    if kind == _TIMED and op in (*_SUMS, ca.OP_MUL, ca.OP_DIV):
        term_lists = [value.terms or (value.expression,) for value in values]
        if op in (ca.OP_ADD, ca.OP_SUB):
            if sum(map(len, term_lists)) <= _MOST_TERMS:
                terms = (*term_lists[0], *(operation(op, 0.0, e) for e in term_lists[1]))
        elif op == ca.OP_DIV:
            terms = tuple(operation(op, e, values[1].expression) for e in term_lists[0])
        elif prod(map(len, term_lists)) <= _MOST_TERMS:
            terms = tuple(operation(op, *factors) for factors in product(*term_lists))
    return _Value(kind, expression, any(timed), kind == _STATE and any(timed) and bent, terms)


def _input(given: Sequence[int], numbers: int, t: ca.SX, p: ca.SX, held: Collection[int]) -> _Value:
    """Return the value of entry given[1] of input given[0]."""
    if given[0] == 0:
        return _Value(_TIMED, t, timed=True)
    if given[0] == numbers and given[1] not in held:
        return _Value(_CONSTANT, p[given[1]])
    # Any state shows how fast the expression changes with time; numbers of one size are typical.
    return _Value(_STATE, ca.SX(0.2 + 0.7 * ((0.618 * (given[1] + 1)) % 1.0)))
