"""The step loop of explicit methods with few work rows, which threads of a device execute.

A thread keeps its work rows in local memory, whose latency limits its speed.  Here, a rate that no
later sum needs gives its row to another one, and rows of the dense output that are written last
are those of its stages.  Operations and numbers are those of `explicit/runge_kutta.py`.

A run may carry a tangent: its rows then contain n numbers of a state, followed by the n numbers of
its derivative along one direction.  The errors of the state alone determine the steps, so they are
those of the run without a tangent.

A group of threads may divide a state (`equal_limbs.py`): the first run.pairs entries of each thread
are its own, and the others copies, which all run.lanes threads have.  Sums over the state are added
up across the group, so that all threads have the same errors, steps and outcomes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir

from ...common.arrays import Array
from ...common.memo import once_for_all
from ...integrators.explicit.row_programs import Rate, Sum, row_program
from ...integrators.explicit.runge_kutta import (
    Tableau,
    accept_step,
    begin_run,
    digest,
    fill_dense_rows,
    next_end_time,
)
from ...integrators.explicit.step_formulas import SCALAR, add_formulas, dense_value, next_step
from ...integrators.methods.method import Explicit
from ...integrators.stepping.compiling import (
    Bindings,
    bind_globals,
    inlined,
    make_intrinsic,
    numba_core,
    unbound,
)
from ...integrators.stepping.run_state import (
    DENSE,
    DONE,
    NEW,
    STEP,
    Run,
    Y,
    across,
    copy_an_end,
    first_entries,
    first_not_finite,
    inverse_length,
    padded_rows,
    quaternions_of,
    reject_step,
    unit_alone,
)
from ...integrators.stepping.step_loop import Hooks, Stepper, loops


@dataclass(frozen=True)
class Rows:
    """Rows of the states, rates and dense-output terms of a step, most of them shared.

    Attributes:
        rates: Row of each rate of the tableau.
        stage: Row of the states of the dense output's stages; other stages use row NEW.
        errors: Error rows.
        first: First row of dense output.
        count: Number of rows.
    """

    rates: tuple[int, ...]
    stage: int
    errors: tuple[int, ...]
    first: int
    count: int

    @classmethod
    def of(cls, tableau: Tableau) -> Rows:
        """Assign rows: each rate gives its row away after the last sum that reads it."""
        s, size = tableau.stages, len(tableau.A)
        needs_end = bool(tableau.errors[:, s].any())
        # Sums in order: stages 1 … s − 1, the end (s), errors, stages and terms of dense output.
        at_errors, at_dense = s + 1, size + 1
        last = dict.fromkeys(range(size), 0)
        for k in range(size):
            readers = np.flatnonzero(tableau.A[:, k]).tolist()
            readers = [row if row <= s else row + 1 for row in readers]
            readers += [at_errors] * bool(k <= s and tableau.errors[:, k].any())
            readers += [at_dense] * bool(tableau.dense[:, k].any())
            last[k] = max(readers, default=0)
        rates, free, count = {0: max(Y, NEW) + 1}, list[int](), max(Y, NEW) + 2

        def take() -> int:
            nonlocal count
            if free:
                return free.pop(0)
            count += 1
            return count - 1

        def release(position: int) -> None:
            """Free the rows of rates that no later sum reads; both ends of a step stay."""
            for k in [k for k in rates if k not in (0, s) and last[k] <= position]:
                if rates[k] not in free:
                    free.append(rates[k])
                last[k] = size + 2  # released once

        for k in range(1, s):
            release(k)
            rates[k] = take()
        release(s)
        if needs_end:
            rates[s] = take()
        errors = tuple(take() for _ in tableau.errors)
        free.extend(errors[1:])
        release(at_errors)
        if not needs_end:  # The first step uses the error row beside the rate at its end.
            rates[s] = take()
        free.append(errors[0])
        extra = size - s - 1
        stage = take() if extra else NEW
        # Hermite's three terms are written last, where the last stages were.
        rates |= {s + 1 + k: count + k for k in range(extra)}
        first = count + max(extra - 3, 0)
        rows = first + 3 + len(tableau.dense)
        return cls(tuple(rates[k] for k in range(size)), stage, errors, first, rows)


# --- names that a tableau binds -----------------------------------------------------------------


END_RATE, ROW = 0, 0
fill_step = fill_end = fill_errors = estimate = find_in_stages = program = find_later = unbound
first_step = unbound


# --- hooks of the step loop ---------------------------------------------------------------------


def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:
    """Compute a step and its error; return DONE, or AGAIN with a shorter step (hook)."""
    h = t_new - run.t  # includes the round-off of t, so that the state belongs to the stored time
    run.evaluations += fill_step(run.address, params, work, h)
    fill_errors(run.address, params, work, 1.0)
    run.error = estimate(run, work, h)
    if run.error <= 1.0:
        run.evaluations += fill_end(run.address, params, work, h)
        if first_not_finite(work[END_RATE], run.n) < 0:
            return DONE
    if not 1.0 < run.error < np.inf:  # an entry is not finite
        run.entry = find_in_stages(run, params, work, h)
        if run.entry < 0 and run.error <= 1.0:
            fill_end(run.address, params, work, h)
            run.entry = first_not_finite(work[END_RATE], run.n)
    return reject_step(run, next_step(run.error, h, False, False, run.max_step))


def find_entry(run: Run, params: Array, work: Array, h: float) -> int:
    """Repeat a stage of a failed step, and later ones while all entries are finite.

    The rows of the first stages have other contents when the step ends.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows, with the state in row Y.
        h: Length of the step [s].
    Returns:
        The entry that first became non-finite, −1 for none.
    """
    program(run.address, params, work, h)
    entry: int = first_not_finite(work[ROW], run.n)
    return entry if entry >= 0 else find_later(run, params, work, h)


def find_nothing(run: Run, params: Array, work: Array, h: float) -> int:  # noqa: ARG001
    """Return -1: no stage has entries that are not finite."""
    return -1


def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write a state inside the step, computed with the dense output (hook)."""
    if not copy_an_end(run, work, time, t_new, out):
        h = t_new - run.t
        if run.known == STEP:
            run.known = DENSE
            fill_dense_rows(run, params, work, h)
        x = (time - run.t) / h
        for i in range(run.n):
            out[i] = dense_value(work, i, x)
    unit_alone(out, quaternions_of(run))
    return DONE


# --- states with a tangent ----------------------------------------------------------------------


# Index of the first quaternion, number of quaternions, and number of entries of the state.
Places: TypeAlias = tuple[int, int, int]


@inlined
def places_of(run: Run) -> Places:
    """Return the quaternions of the state, and the index of the tangent in a row."""
    return run.quaternions_at, run.quaternion_count, run.n // 2


@inlined
def unit_alone_with_tangent(y: Array, places: Places) -> None:
    """Normalise the quaternions of a state, with the derivative of this for the tangent."""
    first, count, n = places
    across(y, (first, count), y[n : 2 * n], 1)
    unit_alone(y, (first, count))


@inlined
def unit_with_tangent(y: Array, rate: Array, places: Places) -> None:
    """Normalise the quaternions of a state with its tangent, and scale their rates likewise.

    The rate k of a quaternion q becomes k/|q|, whose derivative is (δk − k q·δq/|q|²)/|q|.
    """
    first, count, n = places
    for at in first_entries((first, count)):
        factor = inverse_length(y, at)
        radial = 0.0
        for i in range(at, at + 4):
            radial += y[i] * factor * y[n + i]
        for i in range(at, at + 4):
            rate[i] *= factor
            rate[n + i] = factor * (rate[n + i] - rate[i] * radial)
    unit_alone_with_tangent(y, places)


def first_step_of_state(run: Run, params: Array, work: Array) -> float:
    """Return the first step of a run without a tangent."""
    run.n = run.n // 2
    h: float = first_step(run, params, work)
    run.n = 2 * run.n
    return h


def error_of_state(run: Run, work: Array, h: float) -> float:
    """Return the error of the state alone, in units of the tolerance."""
    run.n = run.n // 2
    error: float = estimate(run, work, h)
    run.n = 2 * run.n
    return error


# --- states that a group of threads divides -----------------------------------------------------

# A step loop calls functions of the group at these addresses, which become names: the sum of a
# number over the threads, the first of their indices (see `equal_limbs.exchange_ir`), and the index
# in the state of an entry of the thread.
GROUP_CALLS = {1 << 20: "pinred.sum", 1 << 21: "pinred.first", 1 << 22: "pinred.entry"}
PLACES, PART = 0, 0  # rows: index in the state of each entry of the thread; entries for a report
_SUM, _FIRST, _ENTRY = GROUP_CALLS


def _group_call(address: int, number: Any) -> Any:
    """Return numba's signature and code generator of a function at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
        kind = arguments[0].type
        function = ir.FunctionType(kind, [kind]).as_pointer()
        place = ir.Constant(ir.IntType(64), address)
        return builder.call(builder.inttoptr(place, function), arguments)

    return number(number), generate


@make_intrinsic
def sum_of_group(typing: Any, number: Any) -> Any:  # noqa: ARG001
    """Return the sum of a float over the threads of a group."""
    return _group_call(_SUM, numba_core.types.float64)


@make_intrinsic
def first_of_group(typing: Any, index: Any) -> Any:  # noqa: ARG001
    """Return the smallest of the threads' indices that is not negative, −1 for none."""
    return _group_call(_FIRST, numba_core.types.int64)


@make_intrinsic
def entry_of_state(typing: Any, index: Any) -> Any:  # noqa: ARG001
    """Return the index in the state of an entry of the thread."""
    return _group_call(_ENTRY, numba_core.types.int64)


@inlined
def share_of_thread(run: Run, i: int, term: float) -> float:
    """Return the share of a thread in a sum over the state: of its own entries, and of copies."""
    return term if i < run.pairs else term / run.lanes


@inlined
def whole_of_group(share_of_run: float) -> float:
    """Return a sum over the state from the shares of all threads."""
    total: float = sum_of_group(share_of_run)
    return total


@inlined
def entries_of_group(run: Run) -> int:
    """Return the number of entries of the state."""
    return run.n + (run.lanes - 1) * run.pairs


@inlined
def first_not_finite_of_group(row: Array, n: int) -> int:
    """Return the first entry of the state that is not finite in any thread, −1 for none."""
    own = -1
    if first_not_finite(row, n) >= 0:
        for i in range(n):
            if row[i] - row[i] != 0.0:
                entry = entry_of_state(i)
                own = entry if own < 0 else min(own, entry)
    first: int = first_of_group(own)
    return first


def write_part(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write the entries of a thread to a state inside the step (hook)."""
    status: int = write_state(run, params, work, time, t_new, work[PART])
    for i in range(run.n):
        out[int(work[PLACES, i])] = work[PART, i]
    return status


# --- loops from tableaux ------------------------------------------------------------------------


def stepper_with_few_rows(
    method: Explicit, *, tangent: bool = False, group: bool = False
) -> Stepper:
    """Return the stepper of a method for devices; it stores no stages.

    Args:
        method: The method.
        tangent: Whether a run carries a tangent: its kernel maps states and parameters, each
            followed by their directions, to rates followed by their derivatives.
        group: Whether a group of threads divides the state. The last work row of each contains the
            places of its entries.
    Returns:
        The stepper.
    """
    return _stepper(type(method).__name__, method.order, method.tableau(), tangent, group)


@once_for_all
def _stepper(name: str, order: int, tableau: Tableau, tangent: bool, group: bool) -> Stepper:
    rows, s = Rows.of(tableau), tableau.stages
    # Bitcode in caches belongs to this file, too.
    version = sha256(Path(__file__).read_bytes()).hexdigest()[:12]
    prefix = (
        f"{name}_few_{digest(order, tableau)}_{version}{'_tangent' * tangent}{'_group' * group}"
    )

    def weighted(out: int, base: int | None, weights: Array) -> Sum:
        rates = zip(rows.rates, weights.tolist(), strict=False)
        return Sum(out, base, [(row, weight) for row, weight in rates if weight != 0.0])

    def stages(row: int, indices: range) -> Iterator[list[Sum | Rate]]:
        for k in indices:
            yield [weighted(row, Y, tableau.A[k]), Rate(row, rows.rates[k])]

    parts: list[list[Sum | Rate]] = [*stages(NEW, range(1, s)), [weighted(NEW, Y, tableau.A[s])]]
    at_end: list[Sum | Rate] = [Rate(NEW, rows.rates[s])]
    if needs_end := bool(tableau.errors[:, s].any()):
        parts.append(at_end)
    dense = [step for part in stages(rows.stage, range(s + 1, len(tableau.A))) for step in part]
    dense += [weighted(rows.first + 3 + k, None, w) for k, w in enumerate(tableau.dense)]
    finite = {"first_not_finite": first_not_finite_of_group} if group else {}
    bindings = Bindings(
        prefix,
        BEGIN_RATE=rows.rates[0],
        END_RATE=rows.rates[s],
        STAGE=NEW,
        ERROR=rows.errors[0],
        ERROR3=rows.errors[-1],
        HALVINGS=(order & -order).bit_length() - 1,
        REST=order // (order & -order),
        FIRST=rows.first,
        TERMS=3 + len(tableau.dense),
        fill_step=row_program([step for part in parts for step in part]),
        fill_end=row_program([] if needs_end else at_end),
        fill_errors=row_program([
            weighted(row, None, weights)
            for row, weights in zip(rows.errors, tableau.errors, strict=True)
        ]),
        fill_dense=row_program(dense),
        find_in_stages=_finder(prefix, parts, rows.rates[0], **finite),
        PART=rows.count,
        PLACES=rows.count + 1,
        **SCALAR,
        **finite,
    )  # fmt: skip
    if group:
        bindings.values |= {
            "share": share_of_thread, "whole": whole_of_group, "entries": entries_of_group,
        }  # fmt: skip
    add_formulas(bindings, len(tableau.errors))
    bindings.add(fill_dense_rows)
    if tangent:
        bindings.add(first_step_of_state, name="first_step")
        bindings.add(error_of_state, name="estimate")
        bindings.values |= {
            "unit": unit_with_tangent, "unit_alone": unit_alone_with_tangent,
            "quaternions_of": places_of,
        }  # fmt: skip
    hooks = [begin_run, next_end_time, attempt_step, accept_step, write_state]
    bound = [bindings.add(hook) for hook in hooks]
    if group:
        bound[-1] = bindings.add(write_part)
    return Stepper(
        loops(prefix, Hooks(*bound)),
        partial(padded_rows, rows.count + 2 * group),
    )


def _finder(prefix: str, parts: list[list[Sum | Rate]], begin: int, **names: Any) -> Any:
    """Return the function that finds the first entry that is not finite, stage by stage."""
    finder: Any = inlined(bind_globals(find_nothing, f"{prefix}_find_nothing"))
    for k, part in reversed([*enumerate([list[Sum | Rate](), *parts])]):
        row = part[-1].out if part else begin
        finder = inlined(
            bind_globals(
                find_entry, f"{prefix}_find_{k}", program=row_program(part), ROW=row,
                find_later=finder, **names,
            )
        )  # fmt: skip
    return finder
