"""Integration of members with one kernel, on threads, in SIMD lanes if the method allows it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...common.errors import AccuracyWarning
from ...forces.force_numbers import SpanNumbers
from ...integrators.integrate_many import STATUS, Solutions, integrate_many
from ...integrators.lanes.integrate_in_lanes import integrate_in_lanes
from ...integrators.methods import ErrorControl, Explicit, Method
from ...kernels.build import wide_rate
from ...kernels.kernel import Kernel
from ...system.coordinates import Indices
from ..compiled.compiled_flow import CompiledFlow
from ..compiled.integrator import wild_steps
from ..longest_steps import functions_depend_on, limits_of_runs
from ..plan import Plan, joined_stops
from .trajectories import Batch, Failure

# Largest number of kernel instructions for which the state of sixteen lanes fits in registers.
_SMALL = 400
# Length of steps relative to their limits, because the steps of batches are not checked.
_SHARE = 0.5


def integrate_members(
    flow: CompiledFlow,
    plan: Plan,
    members: Indices,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
    device: str | None = None,
    *,
    tangent: bool = False,
) -> Batch:
    """Integrate members of a plan from stop to stop with one kernel.

    Args:
        flow: Flow of the members.
        plan: The plan, which states times, method and tolerance.
        members: Indices of the members, (N,) sorted.
        threads: Number of threads; as many as processors if None.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
        device: "cuda" to integrate on a CUDA device, None for the CPU.
        tangent: Whether the states and the parameters of `flow` are followed by their tangents
            along one direction for each member.
    Returns:
        The solutions of all members, in which tangents follow states, too.
    """
    began, reports, count = perf_counter(), plan.scene.report_times, len(members)
    method, stops, vary = _stops_of_members(plan, flow.numbers, flow.tables)
    # A single body that only translates has no state; integrate one zero instead.
    states = flow.y0.copy() if flow.y0.shape[1] else np.zeros((count, 1))
    status, entry, steps, evaluations = (np.zeros(count, np.int64) for _ in range(4))
    end, last = np.zeros(count), max(map(len, stops if vary else stops[:1]))
    is_whole = last == 1 and not vary  # then there is one span, whose states are those of all runs
    y = np.full((0 if is_whole else count, len(reports), states.shape[1]), np.nan)
    for k in range(last):
        done = None if progress is None else _scaled(progress, k, last)
        for runs in _together(plan, stops, status, k, vary=vary):
            own = [stops[i] for i in runs] if vary else stops[:1]
            # Copy the rows only if some members are left out: they are most of the memory.
            rows = slice(None) if len(runs) == count else runs
            part = flow if len(runs) == count else flow[runs]
            piece = _piece(own, k, reports, ends=k + 1 < last)
            initial = states[rows]
            if device is None:
                integrate = _integrate_tangents if tangent else _integrate_piece
                solutions = integrate(part, method, piece, initial, threads, done)
            else:
                solutions = _integrate_on_device(
                    part, method, piece, initial, done, tangent=tangent
                )
            if is_whole:  # singular shapes of closed loops end the states of members later
                y = solutions.y.copy() if flow.system.loops else solutions.y
            else:
                _store(y, runs, piece, solutions)
            status[runs], entry[runs] = solutions.status, solutions.entry
            steps[runs] += solutions.steps
            evaluations[runs] += solutions.evaluations
            end[runs] = piece.start + solutions.end
            if k + 1 < last:
                final = solutions.y[np.arange(len(runs)), piece.reported.sum(axis=1)]
                states[runs[solutions.ok]] = final[solutions.ok]
    alive = np.flatnonzero(status == 0)
    failures = []
    for j in np.flatnonzero(status).tolist():
        reason = STATUS[int(status[j])]
        if entry[j] >= 0:
            before, at = divmod(int(entry[j]), states.shape[1] // (1 + tangent))
            reason = f"{'a derivative of ' * before}{flow.entry_name(at)} is {reason}"
        failures.append(Failure(int(members[j]), float(end[j]), reason))
    unchecked = [] if plan.method.adaptive else alive.tolist()
    wild = ((j, wild_steps(flow.kernel, plan, y[j], reports)) for j in unchecked)
    failures += [Failure(int(members[j]), plan.scene.end, reason) for j, reason in wild if reason]
    wall = (perf_counter() - began) / count
    return Batch(members, flow, plan.method.name, y, steps, evaluations, failures, wall, device)


def lanes_of(method: Method, kernel: Kernel) -> int:
    """Return the number of members that run at once in SIMD lanes; 0 if lanes are not used."""
    if not (isinstance(method, Explicit) and kernel.layout.size):
        return 0
    return 16 if kernel.instructions <= _SMALL else 8


@dataclass(frozen=True)
class _Piece:
    """The spans of N runs between two successive stops of each; N = 1 if all have the same.

    Attributes:
        start: Start times, (N,) [s].
        stop: End times, (N,) [s].
        first: Index of the first report time in each span, (N,).
        reported: Mask of the columns of `times` that are report times, (N, W).
        times: Report times, then the stop if a span follows, counted from the start of each span;
            infinity in columns that a span does not need, (N, W) [s].
    """

    start: Array
    stop: Array
    first: Indices
    reported: NDArray[np.bool_]
    times: Array


def _piece(stops: list[Array], k: int, reports: Array, *, ends: bool) -> _Piece:
    """Return span k of runs with stops; a report time at a stop belongs to the span before it.

    Args:
        stops: Stops of each run [s].
        k: Index of the span.
        reports: Report times, (T,) [s].
        ends: Whether the states at the stops are needed, too.
    Returns:
        The span.
    """
    stop = np.array([own[k] for own in stops])
    start = np.array([own[k - 1] for own in stops]) if k else np.zeros(len(stops))
    first = np.searchsorted(reports, start, side="right") if k else np.zeros(len(stops), int)
    counts = np.searchsorted(reports, stop, side="right") - first
    columns = np.arange(counts.max() + ends)
    reported = columns < counts[:, None]
    index = np.minimum(first[:, None] + columns, len(reports) - 1)
    times = np.where(reported, reports[index] - start[:, None], np.inf)
    if ends:
        times[np.arange(len(stops)), counts] = stop - start
    return _Piece(start, stop, first, reported, times)


def _store(y: Array, runs: Indices, piece: _Piece, solutions: Solutions) -> None:
    """Store states at report times in `y`, whose first axis is that of all runs."""
    if len(piece.first) == 1:
        first, count = int(piece.first[0]), int(piece.reported.sum())
        y[runs, first : first + count] = solutions.y[:, :count]
        return
    row, column = np.nonzero(piece.reported)
    y[runs[row], piece.first[row] + column] = solutions.y[row, column]


def _stops_of_members(
    plan: Plan, numbers: Array, tables: SpanNumbers | None
) -> tuple[Method, list[Array], bool]:
    """Return the method, the stops of each member, and whether they differ.

    Lanes do not record steps, so the steps are limited before the run.
    """
    stops, vary, forces, method = (
        plan.stops_of_runs(numbers, tables),
        plan.stops_vary,
        plan.forces,
        plan.method,
    )
    if forces is None or not plan.has_time_functions:
        return method, stops, vary
    tables = forces.tables if tables is None else tables
    used = numbers[:, functions_depend_on(forces)]
    used = np.column_stack([used, tables.kinds(len(numbers))])
    _, first, which = np.unique(used, axis=0, return_index=True, return_inverse=True)
    if not isinstance(method, ErrorControl):
        for k in first:
            if notices := plan.notices_of_equal_steps(numbers[k], tables[k]):
                warnings.warn(notices[0], AccuracyWarning, stacklevel=6)
                break
        return method, stops, vary
    settings = method.rtol, method.controlled_order
    all_limits = limits_of_runs(forces, plan.scene.end, numbers[first], *settings, tables[first])
    limits = [each.shorter(_SHARE).cheapest for each in all_limits]
    longest = min(each.longest for each in limits)
    method = replace(method, max_step=min(method.max_step, longest))
    if not any(each.stops.size for each in limits):
        return method, stops, vary
    if len(first) == 1 and not vary:
        return method, [joined_stops(stops[0], limits[0].stops)] * len(stops), False
    members = zip(stops, which.ravel().tolist(), strict=True)
    return method, [joined_stops(own, limits[k].stops) for own, k in members], True


def _together(
    plan: Plan, stops: list[Array], status: NDArray[np.int64], k: int, *, vary: bool
) -> list[Indices]:
    """Return the runs that have a span k, in groups that are integrated together.

    Methods with steps of equal length divide each span differently, so that their runs are
    integrated together only if their spans have the same length.
    """
    runs = np.flatnonzero(status == 0)
    if vary:
        runs = runs[np.array([len(stops[i]) > k for i in runs], bool)]
    if plan.method.adaptive or not vary or not runs.size:
        return [runs] if runs.size else []
    lengths = np.array([stops[i][k] - (stops[i][k - 1] if k else 0.0) for i in runs])
    return [runs[lengths == length] for length in np.unique(lengths)]


def _integrate_piece(
    flow: CompiledFlow,
    method: Method,
    piece: _Piece,
    y0: Array,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> Solutions:
    """Integrate members from y0 (N, k), each over one time span."""
    kernel, (parameters, lengths, times) = flow.kernel, _inputs(flow, piece)
    lanes, quaternions = lanes_of(method, kernel), kernel.layout.quaternions
    if lanes and isinstance(method, Explicit):
        address = wide_rate(kernel, lanes, own_parameters=True).address
        return integrate_in_lanes(
            method, address, lanes, parameters, y0, lengths, times, quaternions, threads, progress
        )
    return integrate_many(
        method, flow.address(method), parameters, y0, lengths, times, quaternions, threads,
        flow.tangent, kernel.canonical, progress,
    )  # fmt: skip


def _integrate_tangents(
    flow: CompiledFlow,
    method: Method,
    piece: _Piece,
    y0: Array,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> Solutions:
    """Integrate members with tangents from y0 (N, 2 k), as `_integrate_on_device` does."""
    from ...kernels.device.few_rows import stepper_with_few_rows
    from ...kernels.flow_functions import rate_of

    assert isinstance(method, Explicit), "callers refuse others"
    parameters, lengths, times = _inputs(flow, piece)
    return integrate_many(
        method, rate_of(flow.kernel).joined.address, parameters, y0, lengths, times,
        flow.kernel.layout.quaternions, threads, progress=progress,
        stepper=stepper_with_few_rows(method, tangent=True),
    )  # fmt: skip


def _integrate_on_device(
    flow: CompiledFlow,
    method: Method,
    piece: _Piece,
    y0: Array,
    progress: Callable[[float], None] | None,
    *,
    tangent: bool,
) -> Solutions:
    """Integrate members from y0 (N, k) on CUDA devices, each over one time span."""
    from ...kernels.device.device_code import integrate_on_device

    assert isinstance(method, Explicit), "`check_device` refuses others"
    parameters, lengths, times = _inputs(flow, piece)
    return integrate_on_device(
        method, flow.kernel, parameters, y0, lengths, times, progress, tangent=tangent
    )


def _inputs(flow: CompiledFlow, piece: _Piece) -> tuple[Array, Array | float, Array]:
    """Return the parameters of members, and the length and the report times of a time span."""
    parameters = flow.parameters_between(piece.start, piece.stop)
    if len(piece.times) == 1:
        return parameters, float(piece.stop[0] - piece.start[0]), piece.times[0]
    return parameters, piece.stop - piece.start, piece.times


def _scaled(progress: Callable[[float], None], k: int, spans: int) -> Callable[[float], None]:
    return lambda part: progress((k + part) / spans)
