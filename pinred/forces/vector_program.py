"""VectorProgram: a CasADi expression evaluated with NumPy, at many points or over many intervals.

An interval contains all values that the expression takes while each input varies within its own
interval. Every operation widens its result by its round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

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
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def _hull(*values: Any) -> Interval:
    """Return the interval that the values span."""
    rows = np.stack(np.broadcast_arrays(*values))
    return _wider(rows.min(axis=0), rows.max(axis=0))


def _product(a: Interval, b: Interval) -> Interval:
    products = (np.multiply(x, y) for x in a for y in b)
    # Zero times infinity is zero: infinity only states that there is no bound.
    return _hull(*(np.where(np.isnan(value), 0.0, value) for value in products))


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
