"""The functions of time in the expressions of forces, evaluated with NumPy at many times.

A function of time is a part of an expression that depends on time and on numbers, but not on the
state. In `6 exp(−(t − 1)²) x`, it is the factor of x.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from .vector_program import VectorProgram

_CONSTANT, _TIMED, _STATE = range(3)


class TimeFunctions:
    """The functions of time in one force model that are not linear in time.

    Attributes:
        count: Number of functions; those with an operation that NumPy lacks are left out.
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
        found: dict[int, ca.SX] = {}
        for function, numbers in functions:
            _collect(function, numbers, t, p, held, found)
        timed = [e for e in found.values() if ca.depends_on(ca.jacobian(e, t), t)]
        timed = [e for e in timed if _is_known([t, p], e)]
        self.count = len(timed)
        self.used = [k for k in range(size) if any(ca.depends_on(e, p[k]) for e in timed)]
        self._program = VectorProgram([t, *(p[k] for k in self.used)], timed)

    def __call__(self, times: Array, numbers: Array, within: slice, spans: Array | float) -> Array:
        """Return the values of all functions.

        Args:
            times: Times, (T,) [s].
            numbers: Numbers of the forces, (p,).
            within: Slice of the number that selects the segments of tables.
            spans: Value of that number at each time, (T,) or one for all [s].
        Returns:
            The values, (count, T).
        """
        first, last = within.start, within.stop
        own: list[Any] = [spans if first <= k < last else numbers[k] for k in self.used]
        values = np.empty((self.count, len(times)))
        for row, value in zip(values, self._program(times, *own), strict=True):
            row[:] = value
        return values


def _is_known(inputs: Sequence[ca.SX], expression: ca.SX) -> bool:
    """Return whether NumPy has all operations of an expression."""
    try:
        VectorProgram(inputs, [expression])
    except InputError:
        return False
    return True


def _collect(
    function: ca.Function,
    numbers: int,
    t: ca.SX,
    p: ca.SX,
    held: Collection[int],
    found: dict[int, ca.SX],
) -> None:
    """Add the functions of time in a CasADi function to {hash: expression}; see TimeFunctions."""
    work: list[Any] = [None] * function.sz_w()

    def use(value: tuple[int, Any]) -> None:
        kind, expression = value
        if kind == _TIMED:
            found.setdefault(expression.element_hash(), expression)

    for k in range(function.n_instructions()):
        op, into = function.instruction_id(k), function.instruction_output(k)
        if op == ca.OP_CONST:
            work[into[0]] = _CONSTANT, ca.SX(function.instruction_constant(k))
            continue
        given: Any = function.instruction_input(k)
        if op == ca.OP_INPUT:
            work[into[0]] = _input(given, numbers, t, p, held)
        elif op == ca.OP_OUTPUT:
            use(work[given[0]])
        else:
            values = [work[i] for i in given]
            kind = max(value[0] for value in values)
            if kind == _STATE:
                for value in values:
                    use(value)
                work[into[0]] = _STATE, None
                continue
            operation = ca.SX.unary if len(values) == 1 else ca.SX.binary
            work[into[0]] = kind, operation(op, *(value[1] for value in values))


def _input(
    given: Sequence[int], numbers: int, t: ca.SX, p: ca.SX, held: Collection[int]
) -> tuple[int, Any]:
    """Return kind and expression of entry given[1] of input given[0]."""
    if given[0] == 0:
        return _TIMED, t
    if given[0] == numbers and given[1] not in held:
        return _CONSTANT, p[given[1]]
    return _STATE, None
