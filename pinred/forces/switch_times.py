"""Times at which forces change: conditions on time, their sign changes, and the search for roots.

A switch is a comparison, abs, sign, copysign, floor, ceil, min, max, fmod or remainder whose
arguments depend only on time and on numbers. Its argument g determines when it switches: at the
zeros of g, or where g is a whole number. Between two switches, each condition has one value. It is
evaluated at a time `within` this span, so that a step that ends exactly at a switch uses the values
of its own span.

The argument g is solved exactly if it is linear in time. Otherwise, intervals are bisected until
bounds of g exclude a root, or bounds of its derivative show that there is at most one. Switches
within the argument of another come first, so that g is smooth in each span. An error is raised if
some times might be missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..system.coordinates import Indices
from .force_numbers import SpanNumbers, Tables
from .time_functions import VectorProgram

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
    arguments = [t, within, *numbers]
    hashes = {symbol.element_hash() for symbol in arguments}
    unknown = [s for s in ca.symvar(column) if s.element_hash() not in hashes]
    function = ca.Function("f", [ca.vertcat(*arguments, *unknown)], [column])
    if not _has_switches(function, len(arguments)):
        return None
    walk = _Walk(t, within)
    inputs = [
        *(_Node(s, timed=k == 0, level=0, stated=s, written=s) for k, s in enumerate(arguments)),
        *map(_Node, unknown),
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
        operands = function.instruction_input(k)
        if op == ca.OP_INPUT:
            work[into[0]] = timed if operands[1] == 0 else other * (operands[1] >= known)
            continue
        if op in KINKS and any(work[i] == timed for i in operands):
            decides = (
                work[operands[0]] if op == ca.OP_IF_ELSE_ZERO else max(work[i] for i in operands)
            )
            if decides == timed:
                return True
        kind = 0
        for i in operands:
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
            operands = function.instruction_input(k)
            if op == ca.OP_INPUT:
                work[into[0]] = inputs[operands[1]]
            elif op == ca.OP_OUTPUT:
                outputs[into[1]] = work[operands[0]].now
            else:
                work[into[0]] = self._node(op, [work[i] for i in operands])
        return outputs

    def _node(self, op: int, operands: list[_Node]) -> _Node:
        if op == ca.OP_IF_ELSE_ZERO:
            return self._selected(*operands)
        if any(node.level < 0 for node in operands):
            self.has_kinks |= op in KINKS
            return _Node(_applied(op, *(node.now for node in operands)))
        if op in KINKS and not all(node.now.is_constant() for node in operands):
            return self._switch(op, operands)
        return _combined(op, operands)

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

    def _switch(self, op: int, operands: list[_Node]) -> _Node:
        """Return a condition on time and numbers, and store its switches."""
        first, second = operands[0], operands[-1]
        if op in (ca.OP_FABS, ca.OP_SIGN):
            sign = self._add(ca.OP_SIGN, operands, first)
            return sign if op == ca.OP_SIGN else _combined(ca.OP_MUL, [sign, first])
        if op in (ca.OP_FMIN, ca.OP_FMAX):
            is_less = self._add(ca.OP_LT, operands, _combined(ca.OP_SUB, operands))
            chosen, other = (first, second) if op == ca.OP_FMIN else (second, first)
            is_not = _combined(ca.OP_NOT, [is_less])
            summands = [
                _combined(ca.OP_IF_ELSE_ZERO, [is_less, chosen]),
                _combined(ca.OP_IF_ELSE_ZERO, [is_not, other]),
            ]
            return _combined(ca.OP_ADD, summands)
        if op in (ca.OP_FMOD, ca.OP_REMAINDER):
            quotient = _combined(ca.OP_DIV, operands)
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
            return self._add(op, operands, _combined(ca.OP_SUB, operands))
        # Equality and logical operations on numbers change their values only at isolated times.
        is_rounding = op in (ca.OP_FLOOR, ca.OP_CEIL)
        return self._add(op, operands, first if is_rounding else None, whole=is_rounding)

    def _towards_zero(self, quotient: _Node, count: _Node) -> _Node:
        negative = self._add(ca.OP_LT, [count, _constant(0.0)], None)
        is_whole = self._add(ca.OP_EQ, [count, quotient], None)
        fraction = _combined(ca.OP_NOT, [is_whole])
        return _combined(ca.OP_ADD, [count, _combined(ca.OP_MUL, [negative, fraction])])

    def _add(
        self, op: int, operands: list[_Node], argument: _Node | None, *, whole: bool = False
    ) -> _Node:
        """Store a switch with the value op(operands), and return its value."""
        symbol = ca.SX.sym("state")
        timed = any(node.timed for node in operands)
        value = _applied(op, *(node.now for node in operands))
        if timed:
            value = ca.substitute(value, self._t, self._within)
        g = argument.stated if timed and argument is not None else None
        written = _applied(op, *(node.written for node in operands))
        level = max(node.level for node in operands) + (g is not None)
        self.switches.append(Switch(symbol, value, g, whole, level, written))
        return _Node(value, level=level, stated=symbol, written=written)


def _constant(value: float) -> _Node:
    number = ca.SX(value)
    return _Node(number, level=0, stated=number, written=number)


def _combined(op: int, operands: list[_Node]) -> _Node:
    """Return the result of an operation on nodes that depend on time and numbers only."""
    return _Node(
        _applied(op, *(node.now for node in operands)),
        timed=any(node.timed for node in operands),
        level=max(node.level for node in operands),
        stated=_applied(op, *(node.stated for node in operands)),
        written=_applied(op, *(node.written for node in operands)),
    )


def _applied(op: int, *operands: ca.SX) -> ca.SX:
    """Return the result of a CasADi operation."""
    operation = ca.SX.unary if len(operands) == 1 else ca.SX.binary
    return operation(op, *operands)


MOST_TIMES = 100_000  # largest number of switches of all runs that are prepared together
_MOST_INTERVALS = 1 << 16  # largest number of intervals in which g is undecided
_ITERATIONS = 100  # largest number of steps of Newton's method and of bisection


@dataclass(frozen=True)
class Spans:
    """Spans of time, (P,), in which an argument is smooth.

    Attributes:
        run: Index of the run.
        start: Start time [s].
        stop: End time [s].
    """

    run: Indices
    start: Array
    stop: Array


def linear_roots(
    program: VectorProgram, spans: Spans, columns: list[Array], *, whole: bool
) -> tuple[Indices, Array]:
    """Return the indices of spans, and the roots in them, of an argument linear in time."""
    shape = spans.start.shape
    offset, slope = (np.broadcast_to(v, shape) for v in program(0.0, *columns))
    if not whole:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.arange(len(offset)), -offset / slope
    ends = np.array([offset + slope * spans.start, offset + slope * spans.stop])
    at, target = _whole_numbers(ends.min(axis=0), ends.max(axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return at, (target - offset[at]) / slope[at]


def _whole_numbers(low: Array, high: Array) -> tuple[Indices, Array]:
    """Return all whole numbers in intervals [low, high], with the indices of their intervals."""
    first = np.ceil(low)
    counts = np.maximum(np.floor(high) - first + 1.0, 0.0)
    total = float(counts.sum())
    if not total <= MOST_TIMES:
        raise InputError(
            f"forces: a condition on time changes {total:g} times, more than {MOST_TIMES}. Shorten "
            "the motion, or use a smooth function"
        )
    number = counts.astype(int)
    at = np.repeat(np.arange(len(low)), number)
    within = np.arange(len(at)) - np.repeat(np.cumsum(number) - number, number)
    return at, first[at] + within


def bisected_roots(
    program: VectorProgram, spans: Spans, columns: list[Array], *, whole: bool, tiny: float
) -> tuple[Indices, Array]:
    """Return the indices of spans, and the roots in them, by bisection with bounds.

    Args:
        program: The argument g and its derivative.
        spans: The spans.
        columns: All inputs of g except time, (P,) each.
        whole: Whether roots are the times at which g is a whole number.
        tiny: Length of intervals that are not bisected further [s].
    Returns:
        Indices and roots.
    Raises:
        InputError: There are too many roots, or g stays too close to zero.
    """
    at, a, b = np.arange(len(spans.start)), spans.start, spans.stop
    roots: list[tuple[Indices, Array]] = []
    while at.size:
        if at.size > _MOST_INTERVALS:
            raise InputError(
                "forces: a condition on time cannot be decided, because its argument stays close "
                f"to its threshold near t = {float(a[0]):g} s. State the times as a Hold"
            )
        constant_columns = [(column[at], column[at]) for column in columns]
        bounds = [
            [np.broadcast_to(side, a.shape) for side in pair]
            for pair in program.bounds([(a, b), *constant_columns])
        ]
        (low, high), (least, most) = bounds
        possible = (np.ceil(low) <= np.floor(high)) if whole else (low <= 0.0) & (high >= 0.0)
        possible &= ~((least == 0.0) & (most == 0.0))  # g is zero throughout: no change
        single = possible & ((least > 0.0) | (most < 0.0))
        short = possible & ~single & (b - a <= tiny)
        if short.any():
            roots.append((at[short], 0.5 * (a[short] + b[short])))
        if single.any():
            roots.append(_in_brackets(program, columns, at[single], a[single], b[single], whole))
        split = possible & ~single & ~short
        at, a, b = at[split], a[split], b[split]
        middle = 0.5 * (a + b)
        at, a, b = np.tile(at, 2), np.append(a, middle), np.append(middle, b)
    if not roots:
        return np.empty(0, int), np.empty(0)
    at, time = (np.concatenate(rows) for rows in zip(*roots, strict=True))
    return _changes(program, spans, columns, at, time, whole=whole)


def _changes(
    program: VectorProgram,
    spans: Spans,
    columns: list[Array],
    at: Indices,
    time: Array,
    *,
    whole: bool,
) -> tuple[Indices, Array]:
    """Return the roots at which the condition changes.

    Where g only touches zero, round-off makes it zero many times. Between such roots, g is zero up
    to round-off. They count as one root, which is left out if g has the same sign on both sides.
    """
    order = np.lexsort((time, at))
    at, time = at[order], time[order]
    is_first = np.append(True, np.diff(at) > 0)[: len(at)]
    is_last = np.append(np.diff(at) > 0, True)[-len(at) :]
    last_time = np.where(is_first, spans.start[at], np.append(0.0, time[:-1]))
    next_time = np.where(is_last, spans.stop[at], np.append(time[1:], 0.0))
    sides = []
    for middle in (0.5 * (last_time + time), 0.5 * (time + next_time)):
        points = [(column[at], column[at]) for column in columns]
        low, high = (
            np.broadcast_to(side, time.shape)
            for side in program.bounds([(middle,) * 2, *points])[0]
        )
        low, high = (np.floor(low), np.floor(high)) if whole else (np.sign(low), np.sign(high))
        sides.append(np.where((low == high) & (whole | (low != 0.0)), low, np.nan))
    before, after = sides
    first = np.flatnonzero(is_first | ~np.isnan(before))
    last = np.append(first[1:], len(at)) - 1
    keep = ~(before[first] == after[last])
    chosen = ((first + last) // 2)[keep]
    return at[chosen], time[chosen]


def _in_brackets(
    program: VectorProgram, columns: list[Array], at: Indices, a: Array, b: Array, whole: bool
) -> tuple[Indices, Array]:
    """Return the roots in intervals in which g is monotonic."""

    def g(time: Array, at: Indices) -> tuple[Array, Array]:
        value, slope = program(time, *(column[at] for column in columns))
        return np.broadcast_to(value, time.shape), np.broadcast_to(slope, time.shape)

    at_a, at_b = g(a, at)[0], g(b, at)[0]
    if whole:
        which, target = _whole_numbers(np.minimum(at_a, at_b), np.maximum(at_a, at_b))
    else:
        which = np.flatnonzero(np.sign(at_a) * np.sign(at_b) <= 0.0)
        target = np.zeros(len(which))
    at, a, b, rising = at[which], a[which], b[which], (at_b > at_a)[which]
    time = 0.5 * (a + b)
    for _ in range(_ITERATIONS):
        value, slope = g(time, at)
        above: NDArray[np.bool_] = (value > target) == rising
        a, b = np.where(above, a, time), np.where(above, time, b)
        with np.errstate(all="ignore"):
            newton = time - (value - target) / slope
        inside = (newton >= a) & (newton <= b)
        following = np.where(inside, newton, 0.5 * (a + b))
        change = np.abs(following - time)
        time = following
        if (change <= np.spacing(np.abs(time))).all():
            break
    return at, time


_FRACTION = 0.3819660112501051  # golden section of a span
_REMEMBERED = 16  # number of runs whose times are cached
_NEAR = 1e-9  # distance of g from a root that is round-off, relative to the terms of g
ROUND_OFF = 1e-12  # times closer than this fraction of the duration are merged


@dataclass(frozen=True)
class Times:
    """Times at which switches change, sorted by run and time.

    Attributes:
        run: Index of the run, (K,).
        time: Times, (K,) [s].
        switch: Index of the switch, (K,); −1 for the breaks of tables.
    """

    run: Indices
    time: Array
    switch: Indices

    def joined(self, others: Sequence[Times]) -> Times:
        """Merge these times with others, sorted."""
        rows = (self, *others)
        run, time, switch = (
            np.concatenate([getattr(r, name) for r in rows]) for name in ("run", "time", "switch")
        )
        order = np.lexsort((time, run))
        return Times(run[order], time[order], switch[order])


class SwitchTimes:
    """The times at which the functions of time in one force model are not smooth.

    Attributes:
        used: Indices of the numbers on which these times depend, without those of tables.
        tables: The tables in the functions of time.
        conditions: (t, numbers) → the values of all conditions on time, as the forces are written;
            None if there are none.
    """

    def __init__(
        self,
        switches: Sequence[Switch],
        t: ca.SX,
        within: ca.SX,
        numbers: Sequence[ca.SX],
        tables: Tables,
    ) -> None:
        """Prepare the search.

        Args:
            switches: The switches, inner ones first.
            t: Time.
            within: The time at which conditions are evaluated.
            numbers: Symbols of the numbers, (p,); if there are tables, their numbers come first.
            tables: The tables in the functions of time.
        Raises:
            InputError: A condition contains an operation that has no bounds.
        """
        self.tables = tables
        self._known: dict[tuple[float, SpanNumbers | None, bytes], Array] = {}
        self.conditions: ca.Function | None = None
        self._located = [s for s in switches if s.argument is not None]
        arguments = [s.argument for s in self._located if s.argument is not None]
        if arguments:
            written = ca.vertcat(*(s.written for s in self._located))
            values = ca.densify(ca.substitute(written, within, t))
            self.conditions = ca.Function("conditions", [t, ca.vertcat(*numbers)], [values])
        inside = _symbols_in(arguments)
        states = [s for s in switches if s.state.element_hash() in inside]
        inside |= _symbols_in([s.value for s in states])
        inside -= {within.element_hash()}
        used = [k for k, number in enumerate(numbers) if number.element_hash() in inside]
        first = tables.size if tables.signals else 0
        self.used = [k for k in used if k >= first]
        self._of_tables = [k for k in used if k < first]
        used_numbers = [numbers[k] for k in self.used]
        segments = [numbers[k] for k in self._of_tables]
        self._states = VectorProgram([within, *segments, *used_numbers], [s.value for s in states])
        self._symbols, self._time, self._numbers = [s.state for s in states], t, used_numbers
        # Tables within an argument select their segment by `within`, too.
        inputs = [t, within, *segments, *self._symbols, *used_numbers]
        rates = [ca.jacobian(g, t) for g in arguments]
        self._linear = [not ca.depends_on(rate, t) for rate in rates]
        self._programs = [
            VectorProgram(inputs, [g, rate]) for g, rate in zip(arguments, rates, strict=True)
        ]
        self._slopes: dict[int, VectorProgram] = {}
        self._inputs, self._arguments = inputs, arguments
        self._levels = sorted({s.level for s in self._located})

    def with_tables(self, tables: Tables) -> SwitchTimes:
        """Return the search for other tables of the same kinds; compiled functions are shared."""
        other = copy(self)
        vars(other).update(tables=tables, _known={})
        return other

    def breaks(self, end: float, numbers: Array, tables: SpanNumbers | None = None) -> Array:
        """Return the sorted times before `end` at which a function of time is not smooth.

        Args:
            end: End time [s].
            numbers: Numbers of one run, (p,).
            tables: Tables of the run, with the same breaks; None for those of the model.
        Returns:
            The times; times that differ by round-off are one [s].
        """
        key = (end, tables if self._of_tables else None, numbers[self.used].tobytes())
        breaks = self._known.get(key)
        if breaks is None:
            times = self.find(end, numbers[None], tables).time
            distinct = np.append(np.diff(times) > ROUND_OFF * end, True)[: len(times)]
            breaks = read_only(np.asarray(times[distinct]))
            while len(self._known) >= _REMEMBERED:
                self._known.pop(next(iter(self._known)), None)
            self._known[key] = breaks
        return breaks

    def find(self, end: float, numbers: Array, tables: SpanNumbers | None = None) -> Times:
        """Find all times between 0 and `end`, with the breaks of tables.

        Args:
            end: End time [s].
            numbers: Numbers of N runs, (N, p).
            tables: Tables of the runs, with the same breaks; None for those of the model.
        Returns:
            The times; a time at which several switches change is repeated.
        Raises:
            InputError: There are too many times, or a condition cannot be decided.
        """
        count, breaks = len(numbers), self.tables.breaks
        breaks = breaks[(breaks > 0.0) & (breaks < end)]
        tables = self.tables if tables is None else tables
        used_numbers = np.ascontiguousarray(numbers[:, self.used].T)
        times = Times(
            np.repeat(np.arange(count), len(breaks)),
            np.tile(breaks, count),
            np.full(count * len(breaks), -1),
        )
        for level in self._levels:
            spans = _spans_between(times, count, end)
            columns = self._columns(spans, used_numbers, tables)
            roots = [
                self._roots(k, spans, columns, end)
                for k, switch in enumerate(self._located)
                if switch.level == level
            ]
            times = times.joined(roots)
            if len(times.time) > MOST_TIMES:
                raise InputError(
                    f"forces: conditions on time change more than {MOST_TIMES} times until "
                    f"{end:g} s. Shorten the motion, or use a smooth function"
                )
        return times

    def slopes(self, stops: Array, numbers: Array) -> list[Array]:
        """Return the derivatives of stops with respect to the numbers.

        Args:
            stops: Sorted times at which integration stops, its end included, (S,) [s].
            numbers: Numbers of the run, (p,).
        Returns:
            For each stop, an array (C, p) with a row for each function of time that changes there.
        """
        times, starts = self.find(float(stops[-1]), numbers[None]), np.append(0.0, stops)
        rows: list[list[Array]] = [[] for _ in stops]
        for time, switch in zip(times.time.tolist(), times.switch.tolist(), strict=True):
            # A stop is the last of the times that differ by round-off.
            k = min(int(np.searchsorted(stops, time)), len(stops) - 1)
            if switch < 0:
                rows[k].append(np.zeros(len(numbers)))
                continue
            spans = [
                (starts[k], stops[k]),
                *zip(stops[k : k + 1], stops[k + 1 : k + 2], strict=False),
            ]
            rows[k] += self._slopes_at(
                switch, time, [time_within(*span) for span in spans], numbers
            )
        return [np.array(row).reshape(-1, len(numbers)) for row in rows]

    def _slopes_at(
        self, switch: int, time: float, within: Sequence[float], numbers: Array
    ) -> list[Array]:
        """Return the derivatives of a time with respect to the numbers, (p,) each.

        Where an inner switch changes at the same time, g can have its root on one side only: in
        `floor(a*fmod(t, c))`, g jumps to zero at t = c.

        Args:
            switch: Index of the switch.
            time: Time at which it changes [s].
            within: A time in the span before it, and one in the span after it [s].
            numbers: Numbers of the run, (p,).
        Returns:
            One derivative for each side on which g has the root, or that of the side before; not
            finite where g only touches zero.
        """
        if switch not in self._slopes:
            argument, column = self._arguments[switch], ca.vertcat(self._time, *self._numbers)
            outputs = [argument, *ca.horzsplit(ca.jacobian(argument, column))]
            self._slopes[switch] = VectorProgram(self._inputs, outputs)
        used_numbers, is_whole, sides = numbers[self.used], self._located[switch].whole, []
        for side in within:
            inside = [side, *self.tables.at(side)[self._of_tables]]
            states = self._states(*inside, *used_numbers)
            g, rate, *derivatives = (
                float(v) for v in self._slopes[switch](time, *inside, *states, *used_numbers)
            )
            slopes = np.zeros(len(numbers))
            with np.errstate(divide="ignore", invalid="ignore"):
                slopes[self.used] = -np.array(derivatives) / rate
            distance = abs(g - round(g)) if is_whole and np.isfinite(g) else abs(g)
            sides.append((distance <= _NEAR * (abs(g) + abs(rate) * time), slopes))
        return [slopes for is_root, slopes in sides if is_root] or [sides[0][1]]

    def _columns(self, spans: Spans, own: Array, tables: SpanNumbers) -> list[Array]:
        """Return all inputs of the arguments except time, (P,) each."""
        numbers = list(own[:, spans.run])
        within = time_within(spans.start, spans.stop)
        inside = [within]
        if self._of_tables:
            inside += list(tables.at(within, spans.run)[:, self._of_tables].T)
        states = (np.broadcast_to(v, within.shape) for v in self._states(*inside, *numbers))
        return [*inside, *states, *numbers]

    def _roots(self, switch: int, spans: Spans, columns: list[Array], end: float) -> Times:
        program, is_whole = self._programs[switch], self._located[switch].whole
        if self._linear[switch]:
            at, time = linear_roots(program, spans, columns, whole=is_whole)
        else:
            at, time = bisected_roots(
                program, spans, columns, whole=is_whole, tiny=0.5 * ROUND_OFF * end
            )
        keep = (time > ROUND_OFF * end) & (time < (1.0 - ROUND_OFF) * end)
        keep &= (time >= spans.start[at]) & (time <= spans.stop[at])
        at, time = at[keep], time[keep]
        return Times(spans.run[at], time, np.full(len(time), switch))


def time_within(start: Any, stop: Any) -> Any:
    """Return the times [s] in spans at which conditions on time are evaluated.

    Midpoints are avoided, because symmetric functions often touch a threshold there.
    """
    return start + _FRACTION * (stop - start)


def _symbols_in(expressions: Sequence[ca.SX]) -> set[int]:
    """Return the hashes of all symbols in expressions."""
    column = ca.vertcat(ca.SX(0, 1), *expressions)
    return {symbol.element_hash() for symbol in ca.symvar(column)}


def _spans_between(times: Times, count: int, end: float) -> Spans:
    """Return the spans between the times of each run; times that differ by round-off are one."""
    runs = np.arange(count)
    run = np.concatenate([times.run, runs, runs])
    time = np.concatenate([times.time, np.zeros(count), np.full(count, end)])
    order = np.lexsort((time, run))
    run, time = run[order], time[order]
    start, stop = time[:-1], time[1:]
    keep = (run[:-1] == run[1:]) & (stop - start > ROUND_OFF * end)
    return Spans(run[:-1][keep], start[keep], stop[keep])


class SignChanges:
    """The sign changes of an expression that depends on time and numbers only."""

    def __init__(self, expression: ca.SX, t: ca.SX, numbers: Sequence[ca.SX]) -> None:
        """Prepare the search.

        Args:
            expression: The expression, a scalar.
            t: Time.
            numbers: Symbols of the numbers, (p,).
        Raises:
            InputError: The expression contains an operation that has no bounds.
        """
        within = ca.SX.sym("within")
        separated = separate([ca.sign(expression)], t, within, numbers)
        switches = [] if separated is None else separated.switches
        self._switches = SwitchTimes(switches, t, within, numbers, Tables())
        self._value = ca.Function("g", [t, ca.vertcat(ca.SX(0, 1), *numbers)], [expression])

    def spans(self, end: float, numbers: Array) -> tuple[Array, Array]:
        """Return the times at which the sign may change, and values between them.

        Args:
            end: End time [s].
            numbers: Numbers, (p,).
        Returns:
            Starts of spans of constant sign, (S,) [s], and a value of the expression in each, (S,).
        Raises:
            InputError: There are too many times, or a sign cannot be decided.
        """
        starts = np.append(0.0, self._switches.breaks(end, numbers))
        within = time_within(starts, np.append(starts[1:], end))
        repeated = np.repeat(numbers[:, None], len(within), axis=1)
        return starts, np.asarray(self._value(within[None], repeated)).ravel()
