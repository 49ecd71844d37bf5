"""Expressions and functions of time, evaluated with NumPy at many times or over many intervals.

A VectorProgram bounds an expression over intervals: an interval contains all values that the
expression takes while each input varies within its own interval. Every operation widens its result
by its round-off.

A function of time is a part of an expression that depends on time and on numbers, but not on the
state. In `6 exp(−(t − 1)²) x`, it is the factor of x. Expressions such as `sin(400 t − x)`, which
depend on both together, count with a fixed state. The terms of a sum are functions of their own,
because a large slow term would hide a short pulse.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import reduce
from itertools import product
from math import prod
from typing import Any, NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError

Interval: TypeAlias = "tuple[Any, Any]"
_Operations: TypeAlias = "Mapping[int, Callable[..., Any]]"

_WIDER = 8.0 * float(np.finfo(float).eps)  # relative round-off of one operation of NumPy


class VectorProgram:
    """The instructions of an expression without state-dependent conditions."""

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> None:
        """Read the instructions.

        Args:
            inputs: Scalar symbols.
            outputs: Scalar expressions.
        Raises:
            InputError: The expression contains an operation that has no bounds.
        """
        function = ca.Function("f", [ca.vertcat(*inputs)], [ca.densify(ca.vertcat(*outputs))])
        self._size, self._outputs = function.sz_w(), len(outputs)
        self._steps: list[tuple[int, Any, Any]] = []
        for k in range(function.n_instructions()):
            op, into = function.instruction_id(k), function.instruction_output(k)
            operands: Any = function.instruction_input(k)
            if op == ca.OP_CONST:
                operands = function.instruction_constant(k)
            elif op not in _POINTS and op not in (ca.OP_INPUT, ca.OP_OUTPUT):
                name = next(name for name, code in vars(ca).items() if code is op or code == op)
                raise InputError(f"a condition on time contains {name}, which has no bounds")
            self._steps.append((op, into, operands))

    def __call__(self, *values: Any) -> list[Any]:
        """Return the outputs, (P,) or scalars, at points: one array (P,) or number per input."""
        with np.errstate(all="ignore"):
            return self._run(_POINTS, values, lambda number: number)

    def bounds(self, intervals: Sequence[Interval]) -> list[Interval]:
        """Return intervals (lower, upper) of the outputs over an interval of each input."""
        with np.errstate(all="ignore"):
            return self._run(_INTERVALS, intervals, lambda number: (number, number))

    def _run(self, operations: _Operations, values: Sequence[Any], number: Any) -> list[Any]:
        work: list[Any] = [None] * self._size
        outputs: list[Any] = [number(0.0)] * self._outputs
        for op, into, operands in self._steps:
            if op == ca.OP_OUTPUT:
                outputs[into[1]] = work[operands[0]]
            elif op == ca.OP_INPUT:
                work[into[0]] = values[operands[1]]
            elif op == ca.OP_CONST:
                work[into[0]] = number(operands)
            else:
                work[into[0]] = operations[op](*(work[k] for k in operands))
        return outputs


def _compare(ufunc: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda a, b: np.asarray(ufunc(a, b), float)


def _erf(x: Any) -> Any:
    from scipy.special import erf

    return erf(x)


_INCREASING: dict[int, Callable[[Any], Any]] = {
    ca.OP_EXP: np.exp, ca.OP_EXPM1: np.expm1, ca.OP_ASIN: np.arcsin, ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh, ca.OP_TANH: np.tanh, ca.OP_ASINH: np.arcsinh, ca.OP_ERF: _erf,
}  # fmt: skip
# Increasing functions, with the least argument at which they are defined.
_INCREASING_FROM: dict[int, tuple[Callable[[Any], Any], float]] = {
    ca.OP_SQRT: (np.sqrt, 0.0), ca.OP_LOG: (np.log, 0.0), ca.OP_LOG1P: (np.log1p, -1.0),
    ca.OP_ACOSH: (np.arccosh, 1.0),
}  # fmt: skip

_POINTS: dict[int, Callable[..., Any]] = {
    **_INCREASING,
    **{op: function for op, (function, _) in _INCREASING_FROM.items()},
    ca.OP_ASSIGN: lambda a: a, ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide, ca.OP_NEG: np.negative, ca.OP_INV: lambda a: 1.0 / np.asarray(a),
    ca.OP_SQ: np.square, ca.OP_TWICE: lambda a: 2.0 * a, ca.OP_POW: np.float_power,
    ca.OP_CONSTPOW: np.float_power, ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_TAN: np.tan,
    ca.OP_ACOS: np.arccos, ca.OP_ATANH: np.arctanh, ca.OP_COSH: np.cosh, ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot, ca.OP_FABS: np.abs, ca.OP_SIGN: np.sign, ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil, ca.OP_FMIN: np.fmin, ca.OP_FMAX: np.fmax, ca.OP_FMOD: np.fmod,
    ca.OP_COPYSIGN: np.copysign, ca.OP_LT: _compare(np.less), ca.OP_LE: _compare(np.less_equal),
    ca.OP_EQ: _compare(np.equal), ca.OP_NE: _compare(np.not_equal),
    ca.OP_AND: _compare(np.logical_and), ca.OP_OR: _compare(np.logical_or),
    ca.OP_NOT: lambda a: np.asarray(np.equal(a, 0.0), float),
    ca.OP_IF_ELSE_ZERO: lambda c, a: np.where(np.not_equal(c, 0.0), a, 0.0),
    ca.OP_REMAINDER: lambda a, b: a - b * np.rint(np.divide(a, b)),
}  # fmt: skip


# --- intervals ----------------------------------------------------------------------------------


def _wider(low: Any, high: Any) -> Interval:
    """Return an interval widened by round-off; a NaN bound becomes infinite."""
    low, high = low - _WIDER * np.abs(low), high + _WIDER * np.abs(high)
    return np.fmax(low, -np.inf), np.fmin(high, np.inf)


def _hull(*values: Any) -> Interval:
    """Return the interval that the values span."""
    return _wider(reduce(np.minimum, values), reduce(np.maximum, values))


def _product(a: Interval, b: Interval) -> Interval:
    products = [np.multiply(x, y) for x in a for y in (b[:1] if b[0] is b[1] else b)]
    low, high = reduce(np.minimum, products), reduce(np.maximum, products)
    if np.isnan(low).any():
        # Zero times infinity is zero: infinity only states that there is no bound.
        return _hull(*(np.where(np.isnan(value), 0.0, value) for value in products))
    return _wider(low, high)


def _inverse(a: Interval) -> Interval:
    pole = (a[0] <= 0.0) & (a[1] >= 0.0)
    low, high = _hull(1.0 / np.asarray(a[0]), 1.0 / np.asarray(a[1]))
    return np.where(pole, -np.inf, low), np.where(pole, np.inf, high)


def _distance_from_zero(a: Interval) -> Interval:
    """Return the interval of |a|."""
    low, high = np.abs(a[0]), np.abs(a[1])
    inside = (a[0] <= 0.0) & (a[1] >= 0.0)
    return np.where(inside, 0.0, np.minimum(low, high)), np.maximum(low, high)


def _square(a: Interval) -> Interval:
    low, high = _distance_from_zero(a)
    return _wider(low**2, high**2)


def _cosine(a: Interval) -> Interval:
    low, high = _hull(np.cos(a[0]), np.cos(a[1]))
    # Widen the argument, because the multiples of π are rounded.
    first, last = (x / np.pi for x in _wider(*a))
    top = 2.0 * np.ceil(first / 2.0) <= last
    bottom = 2.0 * np.ceil((first - 1.0) / 2.0) + 1.0 <= last
    unbounded = ~(np.isfinite(a[0]) & np.isfinite(a[1]))
    return np.where(bottom | unbounded, -1.0, low), np.where(top | unbounded, 1.0, high)


def _tangent(a: Interval) -> Interval:
    low, high = _wider(np.tan(a[0]), np.tan(a[1]))
    first, last = (x / np.pi - 0.5 for x in _wider(*a))
    pole = ~(np.floor(first) == np.floor(last))
    return np.where(pole, -np.inf, low), np.where(pole, np.inf, high)


def _power(a: Interval, b: Interval) -> Interval:
    constant = np.ndim(b[0]) == 0 and b[0] == b[1]
    if constant and float(b[0]).is_integer():
        n = abs(float(b[0]))
        base = _distance_from_zero(a) if n % 2.0 == 0.0 else a
        value = _wider(np.float_power(base[0], n), np.float_power(base[1], n))
        return _inverse(value) if b[0] < 0.0 else value
    low = np.maximum(a[0], 0.0)
    logarithm = _wider(np.log(low), np.log(np.maximum(a[1], 0.0)))
    exponent = _product(logarithm, b)
    return _wider(np.exp(exponent[0]), np.exp(exponent[1]))


def _monotonic(function: Callable[[Any], Any]) -> Callable[[Interval], Interval]:
    return lambda a: _wider(function(a[0]), function(a[1]))


def _monotonic_from(function: Callable[[Any], Any], least: float) -> Any:
    return lambda a: _wider(*(function(np.maximum(x, least)) for x in a))


_HALF = 0.5 * np.pi
_INTERVALS: dict[int, Callable[..., Any]] = {
    **{op: _monotonic(function) for op, function in _INCREASING.items()},
    **{op: _monotonic_from(*entry) for op, entry in _INCREASING_FROM.items()},
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: _wider(a[0] + b[0], a[1] + b[1]),
    ca.OP_SUB: lambda a, b: _wider(a[0] - b[1], a[1] - b[0]),
    ca.OP_NEG: lambda a: (-a[1], -a[0]),
    ca.OP_TWICE: lambda a: (2.0 * a[0], 2.0 * a[1]),
    ca.OP_MUL: _product,
    ca.OP_INV: _inverse,
    ca.OP_DIV: lambda a, b: _product(a, _inverse(b)),
    ca.OP_SQ: _square,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_COS: _cosine,
    ca.OP_SIN: lambda a: _cosine(_wider(a[0] - _HALF, a[1] - _HALF)),
    ca.OP_TAN: _tangent,
    ca.OP_COSH: lambda a: _monotonic(np.cosh)(_distance_from_zero(a)),
    ca.OP_HYPOT: lambda a, b: _monotonic(np.sqrt)(
        tuple(x + y for x, y in zip(_square(a), _square(b), strict=True))
    ),
    ca.OP_ACOS: lambda a: _wider(np.arccos(a[1]), np.arccos(a[0])),
    # All conditions in an argument are points here, which are exact.
    ca.OP_IF_ELSE_ZERO: lambda c, a: tuple(np.where(np.not_equal(c[0], 0.0), x, 0.0) for x in a),
    ca.OP_NOT: lambda c: (np.asarray(np.equal(c[0], 0.0), float),) * 2,
}
_UNBOUNDED = (-np.inf, np.inf)
for _op in _POINTS.keys() - _INTERVALS.keys():
    _INTERVALS[_op] = lambda *_: _UNBOUNDED


_CONSTANT, _TIMED, _STATE = range(3)
_MOST_TERMS = 64  # largest number of functions for which sums are split into terms


class TimeFunctions:
    """The functions of time in one force model that are not linear in time.

    Attributes:
        count: Number of functions; those with an operation that NumPy lacks are left out.
        firsts: Index of the first term of each sum, (S,).
    """

    def __init__(
        self, functions: Sequence[tuple[ca.Function, int]], size: int, changing: Collection[int]
    ) -> None:
        """Collect the functions of time.

        Args:
            functions: CasADi functions with time as first input, each with the index of the input
                that has the numbers of the forces.
            size: Number of numbers p.
            changing: Indices of the numbers that change during a run.
        """
        t, p = ca.SX.sym("t"), ca.SX.sym("p", size)
        values_by_index: dict[int, _Value] = {}
        for function, numbers in functions:
            _collect(function, numbers, t, p, changing, values_by_index)
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
        inputs = self._inputs(numbers, within, spans)
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
        inputs = self._inputs(numbers, within, spans)
        bounds = self._program.bounds([(starts, ends), *((value, value) for value in inputs)])
        widths = np.empty((self.count, len(starts)))
        for row, (low, high) in zip(widths, bounds, strict=True):
            row[:] = np.subtract(high, low)
        return np.where(np.isnan(widths), np.inf, widths)

    def _inputs(self, numbers: Array, within: slice, spans: Array) -> list[Any]:
        """Return the numbers that the functions use, those of spans from `spans`."""
        first, last = within.start, within.stop
        return [spans[k - first] if first <= k < last else numbers[k] for k in self.used]


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
    changing: Collection[int],
    timed_values: dict[int, _Value],
) -> None:
    """Add the functions of time in a CasADi function to {hash: value}; see TimeFunctions."""
    work: list[Any] = [None] * function.sz_w()

    def use(value: _Value) -> None:
        if value.kind == _TIMED or value.bent:
            timed_values.setdefault(value.expression.element_hash(), value)

    for k in range(function.n_instructions()):
        op, into = function.instruction_id(k), function.instruction_output(k)
        if op == ca.OP_CONST:
            work[into[0]] = _Value(_CONSTANT, ca.SX(function.instruction_constant(k)))
            continue
        operands: Any = function.instruction_input(k)
        if op == ca.OP_INPUT:
            work[into[0]] = _input(operands, numbers, t, p, changing)
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


def _input(
    at: Sequence[int], numbers: int, t: ca.SX, p: ca.SX, changing: Collection[int]
) -> _Value:
    """Return the value of an input at (index of the input, index of the entry)."""
    argument, entry, *_ = at
    if argument == 0:
        return _Value(_TIMED, t, timed=True)
    if argument == numbers and entry not in changing:
        return _Value(_CONSTANT, p[entry])
    # Any state shows how fast the expression changes with time; numbers of one size are typical.
    return _Value(_STATE, ca.SX(0.2 + 0.7 * ((0.618 * (entry + 1)) % 1.0)))
