"""All times at which conditions on time change, or an error if some might be missing.

The argument g of a switch is solved exactly if it is linear in time. Otherwise, intervals are
bisected until bounds of g exclude a root, or bounds of its derivative show that there is at most
one. Switches within the argument of another come first, so that g is smooth in each span.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..system.coordinates import Indices
from .root_search import MOST_TIMES, Spans, bisected_roots, linear_roots
from .span_numbers import SpanNumbers, Tables
from .time_switches import Switch
from .vector_program import VectorProgram

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
        own, segments = [numbers[k] for k in self.used], [numbers[k] for k in self._of_tables]
        self._states = VectorProgram([within, *segments, *own], [s.value for s in states])
        self._symbols, self._time, self._numbers = [s.state for s in states], t, own
        # Tables within an argument select their segment by `within`, too.
        inputs = [t, within, *segments, *self._symbols, *own]
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
        own = np.ascontiguousarray(numbers[:, self.used].T)
        times = Times(
            np.repeat(np.arange(count), len(breaks)),
            np.tile(breaks, count),
            np.full(count * len(breaks), -1),
        )
        for level in self._levels:
            spans = _spans_between(times, count, end)
            columns = self._columns(spans, own, tables)
            found = [
                self._roots(k, spans, columns, end)
                for k, switch in enumerate(self._located)
                if switch.level == level
            ]
            times = times.joined(found)
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
        return [np.array(own).reshape(-1, len(numbers)) for own in rows]

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
        own, whole, sides = numbers[self.used], self._located[switch].whole, []
        for side in within:
            inside = [side, *self.tables.at(side)[self._of_tables]]
            states = self._states(*inside, *own)
            g, rate, *rest = (float(v) for v in self._slopes[switch](time, *inside, *states, *own))
            slopes = np.zeros(len(numbers))
            with np.errstate(divide="ignore", invalid="ignore"):
                slopes[self.used] = -np.array(rest) / rate
            distance = abs(g - round(g)) if whole and np.isfinite(g) else abs(g)
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
        program, whole = self._programs[switch], self._located[switch].whole
        if self._linear[switch]:
            at, time = linear_roots(program, spans, columns, whole=whole)
        else:
            at, time = bisected_roots(
                program, spans, columns, whole=whole, tiny=0.5 * ROUND_OFF * end
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
