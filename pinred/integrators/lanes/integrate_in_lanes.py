"""integrate_in_lanes(): integrate a batch with an explicit method, in SIMD lanes and threads.

Each member has its own step length. All threads take members from one queue. A thread takes as
many members at a time as it has lanes, and computes their initial rates and first steps together. A
lane uses only its own values, so the result of a member depends neither on the lane nor on the
other members.

Vectors and masks contain one number, or one truth value, per SIMD lane. Expressions such as
`a + b`, `a <= b`, `sqrt(a)` and `choose` are computed in all lanes at once. A row stores the value
of entry i in lane j as number i·width + j. Kernels that evaluate several states at once use the
same layout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from math import ceil, sqrt
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numpy.typing import ArrayLike, NDArray

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.memo import once_for_all
from ..explicit.row_programs import Rate, Sum
from ..explicit.runge_kutta import Tableau, bind_formulas, digest, steps_of
from ..explicit.step_formulas import (
    BEGIN_RATE,
    END_RATE,
    RATES,
    dense_value,
    fill_hermite,
    first_step,
    get,
    next_step,
    put,
    same,
)
from ..integrate import begun_by
from ..integrate_many import Solutions, checked_batch, over_threads, solutions
from ..methods.method import Explicit
from ..stepping.compiling import compiled, make_intrinsic, numba_core, unbound
from ..stepping.intrinsics import FUSED, VectorRows, call, splat
from ..stepping.run_state import (
    DONE,
    NEW,
    NOT_CANONICAL,
    NOT_FINITE,
    TOO_MANY,
    UNDERFLOW,
    Quaternions,
    Run,
    Runs,
    Y,
    first_entries,
    quaternions_of,
    unit_alone,
)
from ..stepping.step_loop import Batch

# --- vectors -------------------------------------------------------------------------------

_DOUBLE, _INT32 = ir.DoubleType(), ir.IntType(32)


def _vector_types() -> Any:
    """Import the module of numba's types; numba must know the operators before it compiles."""
    from . import vector_types

    return vector_types


def vector_type(width: int) -> Any:
    """Return numba's type of vectors with a number of lanes."""
    return _vector_types().Vector(width)


_in_lanes: Callable[..., Any] = partial(make_intrinsic, prepare=_vector_types)


@_in_lanes
def choose(typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Return `yes` in the lanes where the mask is true, else `no`; both are numbers or vectors."""
    number, vector = numba_core.types.float64, vector_type(mask.width)
    width = mask.width
    branch_types = [number if branch_type == number else vector for branch_type in (yes, no)]

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        branches = [
            value if branch_type == vector else splat(builder, value, width)
            for branch_type, value in zip(sig.args[1:], args[1:], strict=True)
        ]
        return builder.select(args[0], *branches)

    return vector(mask, *branch_types), generate


@_in_lanes
def bits(typing: Any, mask: Any) -> Any:
    """Return the mask as an integer with lane 0 in its lowest bit."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        packed = builder.bitcast(args[0], ir.IntType(mask.width))
        return builder.zext(packed, ir.IntType(64))

    return numba_core.types.int64(mask), generate


@_in_lanes
def power(typing: Any, base: Any, exponent: Any) -> Any:
    """Return base to the power `exponent`, for each lane."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        callee = builder.module.declare_intrinsic("llvm.pow", [_DOUBLE])
        result = ir.Constant(args[0].type, ir.Undefined)
        for lane in range(base.width):
            position = _INT32(lane)
            value = builder.call(callee, [builder.extract_element(args[0], position), args[1]])
            result = builder.insert_element(result, value, position)
        return result

    return base(base, numba_core.types.float64), generate


@_in_lanes
def fetch_and_add(typing: Any, counter: Any, count: Any) -> Any:
    """Add `count` atomically to the int64 in `counter`, (1,), and return the previous value."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        array = context.make_array(sig.args[0])(context, builder, args[0])
        return builder.atomic_rmw("add", array.data, args[1], "monotonic")

    types = numba_core.types
    return types.int64(counter, types.int64), generate


@cache
def functions_of_width(width: int) -> dict[str, Any]:
    """Return the functions of step_formulas.py that depend on the number of lanes.

    They are same(number), get(rows, row, i) and put(rows, row, i, vector), for rows (R, n width).
    """

    @_in_lanes
    def same(typing: Any, number: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return splat(builder, args[0], width)

        return vector_type(width)(numba_core.types.float64), generate

    @_in_lanes
    def get(typing: Any, rows: Any, row: Any, i: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            work = VectorRows(context, builder, sig.args[0], args[0], width)
            return work.load(args[1], builder.mul(args[2], args[2].type(width)))

        types = numba_core.types
        return vector_type(width)(rows, types.int64, types.int64), generate

    @_in_lanes
    def put(typing: Any, rows: Any, row: Any, i: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            work = VectorRows(context, builder, sig.args[0], args[0], width)
            work.store(args[3], args[1], builder.mul(args[2], args[2].type(width)))
            return context.get_dummy_value()

        types = numba_core.types
        return types.void(rows, types.int64, types.int64, vector_type(width)), generate

    return {"same": same, "get": get, "put": put, "choose": choose, "power": power}


# --- lanes ---------------------------------------------------------------------------------

# Rows of the lane registers, all stored as floats: time and length of the next step [s]; whether
# the last trial step was rejected; numbers of accepted steps, rejected steps and evaluations; the
# next report time [s] and its index; the index of the entry that is not finite, −1 for none;
# whether the lane has a member, and the index of this member; its end time [s].
TIME, STEP, AGAIN, STEPS, REJECTED, EVALUATIONS = range(6)
NEXT_TIME, NEXT, ENTRY, LIVE, MEMBER, END, REGISTERS = range(6, 13)
# Rows of the registers of prepared members: length of the first step, index of the member, index of
# the entry that is not finite. Rows COUNT and USED contain one number each: how many members are
# prepared, and how many of them have entered lanes.
FIRST_STEP, READY_MEMBER, READY_ENTRY, COUNT, USED, READY_REGISTERS = range(6)
READY_ROWS = RATES  # number of rows for states of prepared members: the rows that `first_step` uses

_EPS = float(np.finfo(float).eps)


class Workspace(NamedTuple):
    """The arrays of a thread; rows (R, n width) and parameters (p width,) are stored in lanes.

    Attributes:
        work: States and rates.
        params: Parameters of the members that are in lanes.
        registers: Lane registers, (REGISTERS, width).
        ready: States and rates of prepared members.
        ready_params: Parameters of the prepared members.
        ready_registers: Registers of the prepared members, (READY_REGISTERS, width).
    """

    work: Array
    params: Array
    registers: Array
    ready: Array
    ready_params: Array
    ready_registers: Array


# --- names that a tableau and a width bind ------------------------------------------------------


WIDTH, STAGES, OUT = 1, 1, 0
# Numbers of evaluations: to begin a member, per step, at its end, for dense output.
BEGUN, AT_STEP, AT_END, AT_DENSE = 2.0, 1.0, 1.0, 0.0


fill_step = fill_end = fill_errors = fill_dense = estimate = unbound


# --- operations on rows -----------------------------------------------------------------------


def normalise(run: Run, rows: Array, y: int, rate: int, lanes: Any) -> None:
    """Normalise the quaternions in row y in some lanes, and scale their rates.

    Args:
        run: Registers of the run.
        rows: Rows in lanes.
        y: Row of the states.
        rate: Row of the rates.
        lanes: Mask of the lanes.
    """
    for first in first_entries(quaternions_of(run)):
        square = same(0.0)
        for i in range(first, first + 4):
            square = square + get(rows, y, i) * get(rows, y, i)
        factor = choose(lanes, 1.0 / sqrt(square), 1.0)
        for i in range(first, first + 4):
            put(rows, y, i, get(rows, y, i) * factor)
            put(rows, rate, i, get(rows, rate, i) * factor)


def is_finite(run: Run, rows: Array, row: int) -> Any:
    """Return the mask of the lanes in which all entries of a row are finite."""
    total = same(0.0)
    for i in range(run.n):
        value = get(rows, row, i)
        total = total + (value - value)  # NaN for infinities and NaN, else zero
    return total == 0.0


def accept_steps(run: Run, work: Array, accepted: Any) -> None:
    """Continue from the step ends in the accepted lanes."""
    for i in range(run.n):
        put(work, Y, i, choose(accepted, get(work, NEW, i), get(work, Y, i)))
        rate = choose(accepted, get(work, END_RATE, i), get(work, BEGIN_RATE, i))
        put(work, BEGIN_RATE, i, rate)
    normalise(run, work, Y, BEGIN_RATE, accepted)


# --- members enter and leave lanes --------------------------------------------------------------


def prepare_members(
    run: Run, batch: Batch, queue: NDArray[np.int64], space: Workspace, most: int
) -> int:
    """Take up to `most` members from the queue, prepare their first steps; return their number."""
    ready, params, registers = space.ready, space.ready_params, space.ready_registers
    size = batch.y0.shape[0]
    first: int = fetch_and_add(queue, most)
    count: int = min(most, size - first)
    if count <= 0:
        registers[COUNT, 0] = registers[USED, 0] = 0.0
        return 0
    for lane in range(WIDTH):
        member = first + min(lane, count - 1)
        registers[READY_MEMBER, lane] = member
        for i in range(run.n):
            ready[Y, i * WIDTH + lane] = batch.y0[member, i]
        for i in range(batch.params.shape[1]):
            params[i * WIDTH + lane] = batch.params[member, i]
    call(run.address, ready[Y], params, ready[BEGIN_RATE])
    normalise(run, ready, Y, BEGIN_RATE, same(0.0) == 0.0)
    put(registers, FIRST_STEP, 0, first_step(run, params, ready))
    for lane in range(count):
        registers[READY_ENTRY, lane] = -1.0
        for i in range(run.n):
            rate = ready[BEGIN_RATE, i * WIDTH + lane]
            if rate - rate != 0.0:
                registers[READY_ENTRY, lane] = i
                break
    registers[COUNT, 0], registers[USED, 0] = count, 0.0
    return count


def enter_lane(
    run: Run, batch: Batch, queue: NDArray[np.int64], space: Workspace, lane: int, most: int
) -> bool:
    """Put the next member into a lane; return whether the queue had a member."""
    work, registers = space.work, space.registers
    ready, ready_registers = space.ready, space.ready_registers
    while True:
        used_up = ready_registers[USED, 0] >= ready_registers[COUNT, 0]
        if used_up and prepare_members(run, batch, queue, space, most) == 0:
            # The lane idles: it takes steps of length zero from a finite state.
            registers[LIVE, lane] = registers[TIME, lane] = registers[STEP, lane] = 0.0
            registers[NEXT_TIME, lane] = np.inf
            for i in range(run.n):
                work[Y, i * WIDTH + lane] = batch.y0[0, i]
                work[BEGIN_RATE, i * WIDTH + lane] = 0.0
            for i in range(batch.params.shape[1]):
                space.params[i * WIDTH + lane] = batch.params[0, i]
            return False
        k = int(ready_registers[USED, 0])
        ready_registers[USED, 0] += 1.0
        member = int(ready_registers[READY_MEMBER, k])
        entry = int(ready_registers[READY_ENTRY, k])
        if entry >= 0:
            outcome = batch.outcomes[member]
            outcome.t, outcome.entry, outcome.evaluations = 0.0, entry, 1
            outcome.status = NOT_FINITE
            continue
        for i in range(run.n):
            work[Y, i * WIDTH + lane] = ready[Y, i * WIDTH + k]
            work[BEGIN_RATE, i * WIDTH + lane] = ready[BEGIN_RATE, i * WIDTH + k]
        for i in range(batch.params.shape[1]):
            space.params[i * WIDTH + lane] = space.ready_params[i * WIDTH + k]
        for row in range(REGISTERS):
            registers[row, lane] = 0.0
        registers[STEP, lane] = ready_registers[FIRST_STEP, k]
        registers[EVALUATIONS, lane] = BEGUN
        registers[ENTRY, lane] = -1.0
        registers[LIVE, lane], registers[MEMBER, lane] = 1.0, member
        registers[END, lane] = batch.ends[member]
        registers[NEXT_TIME, lane] = report_time(batch, member, 0)
        while registers[NEXT_TIME, lane] <= 0.0:
            report_state(run, batch, space, lane, Y)
        return True


def report_time(batch: Batch, member: int, j: int) -> float:
    """Return report time j of a member, infinity after the last one [s]."""
    time: float = np.inf
    if j < batch.times.shape[1]:
        time = batch.times[member % batch.times.shape[0], j]
    return time


def report_state(run: Run, batch: Batch, space: Workspace, lane: int, row: int) -> None:
    """Store the state in a row as the result for the next report time of a lane."""
    registers = space.registers
    j, member = int(registers[NEXT, lane]), int(registers[MEMBER, lane])
    out = batch.y[member, j]
    for i in range(run.n):
        out[i] = space.work[row, i * WIDTH + lane]
    unit_alone(out, quaternions_of(run))
    registers[NEXT, lane] = j + 1
    registers[NEXT_TIME, lane] = report_time(batch, member, j + 1)


def non_finite_entry(run: Run, work: Array, lane: int) -> int:
    """Return the entry that first became non-finite in a trial step of a lane, −1 for none."""
    for k in range(STAGES + 2):
        row = BEGIN_RATE
        if 0 < k < STAGES:
            row = RATES + k - 1
        elif k >= STAGES:
            row = NEW if k == STAGES else END_RATE
        for i in range(run.n):
            value = work[row, i * WIDTH + lane]
            if value - value != 0.0:
                return i
    return -1


@compiled
def leave_lane(run: Run, batch: Batch, registers: Array, lane: int) -> None:
    """Store the outcome of the member in a lane."""
    outcome = batch.outcomes[int(registers[MEMBER, lane])]
    outcome.t, outcome.entry = registers[TIME, lane], int(registers[ENTRY, lane])
    outcome.steps, outcome.rejected = int(registers[STEPS, lane]), int(registers[REJECTED, lane])
    outcome.evaluations = int(registers[EVALUATIONS, lane])
    if registers[TIME, lane] >= registers[END, lane]:
        outcome.status = DONE
    elif registers[STEPS, lane] + registers[REJECTED, lane] >= run.max_steps:
        outcome.status = TOO_MANY
    else:
        outcome.status = NOT_FINITE if outcome.entry >= 0 else UNDERFLOW


# --- the loop -----------------------------------------------------------------------------------


def run_members(
    batch: Batch, initial_run: Runs, queue: NDArray[np.int64], space: Workspace, most: int
) -> None:
    """Integrate members of the queue until it is empty or batch.stop is not zero.

    Args:
        batch: Members, and the arrays of their results.
        initial_run: Registers of a run before its first step.
        queue: Number of members taken so far, (1,); all threads share it.
        space: Workspace of this thread.
        most: Largest number of members to take from the queue at once.
    """
    run: Run = initial_run[0]
    work, registers, params = space.work, space.registers, space.params
    space.ready_registers[COUNT, 0] = space.ready_registers[USED, 0] = 0.0
    live = 0
    for lane in range(WIDTH):
        live += enter_lane(run, batch, queue, space, lane, most)
    while live > 0 and batch.stop[0] == 0:
        t, planned = get(registers, TIME, 0), get(registers, STEP, 0)
        t_end = get(registers, END, 0)
        t_new = choose(t + 1.01 * planned >= t_end, t_end, t + planned)
        t_new = choose(get(registers, LIVE, 0) == 1.0, t_new, 0.0)
        h = t_new - t
        fill_step(run.address, params, work, h)
        fill_errors(run.address, params, work, same(1.0))
        error = estimate(run, work, h)
        fill_end(run.address, params, work, h)
        small = error <= 1.0
        accepted = small & is_finite(run, work, END_RATE)
        counted = get(registers, EVALUATIONS, 0) + choose(small, AT_STEP + AT_END, AT_STEP)
        next_time = get(registers, NEXT_TIME, 0)
        inside = accepted & (next_time < t_new)
        if bits(inside) != 0:
            fill_dense(run.address, params, work, h)
            fill_hermite(run, work, h)
            counted = choose(inside, counted + AT_DENSE, counted)
            due = bits(inside)
            while due != 0:
                x = (next_time - t) / h
                for i in range(run.n):
                    put(work, OUT, i, dense_value(work, i, x))
                for lane in range(WIDTH):
                    if (due >> lane) & 1:
                        report_state(run, batch, space, lane, OUT)
                next_time = get(registers, NEXT_TIME, 0)
                due = bits(accepted & (next_time < t_new))
        due = bits(accepted & (next_time <= t_new))
        for lane in range(WIDTH if due else 0):
            if (due >> lane) & 1:
                end = registers[NEXT_TIME, lane]
                while registers[NEXT_TIME, lane] <= end:
                    report_state(run, batch, space, lane, NEW)
        non_finite = bits(~accepted & ~((error > 1.0) & (error < np.inf)))
        for lane in range(WIDTH if non_finite else 0):
            if (non_finite >> lane) & 1:
                registers[ENTRY, lane] = non_finite_entry(run, work, lane)
        accept_steps(run, work, accepted)
        again = get(registers, AGAIN, 0) == 1.0
        step = next_step(error, h, accepted, again, run.max_step)
        put(registers, ENTRY, 0, choose(accepted & ~again, -1.0, get(registers, ENTRY, 0)))
        t = choose(accepted, t_new, t)
        steps = get(registers, STEPS, 0) + choose(accepted, 1.0, 0.0)
        rejected = get(registers, REJECTED, 0) + choose(accepted, 0.0, 1.0)
        put(registers, TIME, 0, t)
        put(registers, STEP, 0, step)
        put(registers, AGAIN, 0, choose(accepted, 0.0, same(1.0)))
        put(registers, STEPS, 0, steps)
        put(registers, REJECTED, 0, rejected)
        put(registers, EVALUATIONS, 0, counted)
        spent = steps + rejected >= float(run.max_steps)
        stopped = (t >= t_end) | spent | (0.1 * step <= _EPS * t)
        over = bits((get(registers, LIVE, 0) == 1.0) & stopped)
        for lane in range(WIDTH if over else 0):
            if (over >> lane) & 1:
                leave_lane(run, batch, registers, lane)
                live -= 1
                live += enter_lane(run, batch, queue, space, lane, most)


INLINED = (normalise, is_finite, accept_steps, report_time, report_state)
COMPILED = (prepare_members, non_finite_entry, enter_lane, run_members)


WIDTHS = (8, 16)  # supported numbers of SIMD lanes
_CACHE_LINE = 64  # alignment of vectors of eight floats [bytes]


def integrate_in_lanes(
    method: Explicit,
    address: int,
    width: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: ArrayLike,
    times: ArrayLike,
    quaternions: Quaternions = (0, 0),
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for all members i, several at once in SIMD lanes.

    Steps and results of a member do not depend on the other members, their order or the number
    of threads. They equal the steps and results of `integrate` up to round-off. A failing member
    reports a status and does not affect the others.

    Args:
        method: Explicit method.
        address: Address of a kernel of f at `width` states at once, each with its parameters.
            Entry j of state k is number j·width + k of y, params and rates.
        width: Number of SIMD lanes, one of WIDTHS.
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        t_end: End time, or one for each member, (N,) [s].
        times: Sorted report times, (T,) or (N, T), as for `integrate_many` [s].
        quaternions: As for `integrate`.
        threads: Number of threads, None for all processors.
        progress: Called with the finished fraction of the members.
    Returns:
        The solutions, member first.
    Raises:
        InputError: An argument is invalid.
    """
    if width not in WIDTHS:
        raise InputError(f"width must be one of {WIDTHS}, got {width!r}")
    asked = checked_batch(address, params, y0, t_end, times, quaternions, threads)
    batch = asked.batch
    (size, n), parameters = batch.y0.shape, batch.params.shape[1]
    loop = _lane_loop(type(method).__name__, method.order, method.tableau(), width)
    initial_run = begun_by(method, address, n, asked.end, quaternions, NOT_CANONICAL)
    queue = np.zeros(1, dtype=np.int64)
    most = min(width, max(1, ceil(size / asked.threads)))

    def run_members() -> None:
        loop.members(batch, initial_run, queue, loop.workspace(n, parameters), most)

    over_threads([run_members] * asked.threads, asked, progress)
    return solutions(method, batch)


@dataclass(frozen=True)
class LaneLoop:
    """The compiled loop over members in SIMD lanes of one method.

    Attributes:
        width: Number of lanes.
        members: Compiled function, see run_members.
        rows: Number of rows of `work`.
    """

    width: int
    members: Callable[..., None]
    rows: int

    def workspace(self, n: int, parameters: int) -> Workspace:
        """Return the workspace of a thread for states with n entries and a number of parameters."""
        width = self.width
        return Workspace(
            work=_aligned(self.rows, n * width),
            params=_aligned(1, parameters * width)[0],
            registers=_aligned(REGISTERS, width),
            ready=_aligned(READY_ROWS, n * width),
            ready_params=_aligned(1, parameters * width)[0],
            ready_registers=_aligned(READY_REGISTERS, width),
        )


@once_for_all
def _lane_loop(name: str, order: int, tableau: Tableau, width: int) -> LaneLoop:
    """Compile the loop of a method for a number of lanes."""
    steps = steps_of(tableau)

    def calls(program: list[Sum | Rate]) -> float:
        return float(sum(isinstance(step, Rate) for step in program))

    numbers: dict[str, Any] = {
        **functions_of_width(width),
        "WIDTH": width,
        "OUT": steps.rows,
        "AT_STEP": calls(steps.to_end),
        "AT_END": calls(steps.at_end),
        "AT_DENSE": calls(steps.dense),
    }
    prefix = f"{name}_{digest(order, tableau)}_{width}_lanes"
    bindings = bind_formulas(
        prefix,
        order,
        tableau,
        numbers,
        width=width,
        lane_steps=partial(vector_type, width),
        flags=FUSED,
    )
    for function in INLINED:
        bindings.add(function)
    for compiled_function in COMPILED:
        bindings.add(compiled_function, compiled)
    return LaneLoop(width, bindings.values["run_members"], steps.rows + 1)


def _aligned(rows: int, size: int) -> Array:
    """Return zeros, (rows, size), aligned to a cache line."""
    raw = np.zeros(rows * size + _CACHE_LINE // 8)
    first = -(raw.ctypes.data // 8) % (_CACHE_LINE // 8)
    return raw[first : first + rows * size].reshape(rows, size)
