"""Integration of members with one kernel, on threads, in SIMD lanes if the method allows it."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from ...common.arrays import Array
from ...integrators.integrate_many import STATUS, Solutions, integrate_many
from ...integrators.lanes.integrate_in_lanes import integrate_in_lanes
from ...integrators.methods import Explicit, Method
from ...kernels.derived_code import wide_rate
from ...kernels.kernel import Kernel
from ...system.coordinates import Indices
from ..compiled.compiled_flow import CompiledFlow
from ..compiled.integrator import wild_steps
from ..plan import Plan, Span, spans_between
from .trajectories import Batch, Failure

# Largest number of kernel instructions for which the state of sixteen lanes fits in registers.
_SMALL = 400


def integrate_members(
    flow: CompiledFlow,
    plan: Plan,
    members: Indices,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Batch:
    """Integrate members of a plan from stop to stop with one kernel.

    Args:
        flow: Flow of the members.
        plan: The plan, which states times, method and tolerance.
        members: Indices of the members, (N,) sorted.
        threads: Number of threads; as many as processors if None.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
    Returns:
        The solutions of all members.
    """
    sets: dict[bytes, list[int]] = {}
    stops = plan.stops_of_runs(flow.numbers)
    for k, row in enumerate(stops):
        sets.setdefault(row.tobytes(), []).append(k)
    parts = []
    for group in map(np.array, sets.values()):
        spans = spans_between(stops[group[0]], plan.scene.report_times)
        own = flow if len(sets) == 1 else flow[group]
        parts.append(_integrate_spans(own, plan, spans, members[group], threads, progress))
    return parts[0] if len(parts) == 1 else _joined(flow, members, list(sets.values()), parts)


def _joined(
    flow: CompiledFlow, members: Indices, groups: list[list[int]], parts: list[Batch]
) -> Batch:
    """Return the results of groups of members with different stops as one batch."""
    order = np.argsort(np.concatenate(groups))
    y, steps, evaluations = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("y", "steps", "evaluations")
    )
    failures = [failure for part in parts for failure in part.failures]
    wall = sum(part.wall * len(part.members) for part in parts) / len(members)
    return Batch(members, flow, parts[0].method, y, steps, evaluations, failures, wall)


def _integrate_spans(
    flow: CompiledFlow,
    plan: Plan,
    spans: list[Span],
    members: Indices,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> Batch:
    """Integrate members with equal stops; see `integrate_members`."""
    began, reports, count = perf_counter(), plan.scene.report_times, len(members)
    # A single body that only translates has no state; integrate one zero instead.
    y0 = flow.y0 if flow.y0.shape[1] else np.zeros((count, 1))
    y = np.full((count, len(reports), y0.shape[1]), np.nan)
    status, entry, steps, evaluations = (np.zeros(count, np.int64) for _ in range(4))
    end, alive = np.zeros(count), np.arange(count)
    for k, span in enumerate(spans):
        done = None if progress is None else _scaled(progress, k, len(spans))
        solutions = _integrate_span(flow[alive], plan.method, span, y0, threads, done)
        y[alive, span.rows] = solutions.y[:, : len(span.times)]
        status[alive], entry[alive] = solutions.status, solutions.entry
        steps[alive] += solutions.steps
        evaluations[alive] += solutions.evaluations
        end[alive] = span.start + solutions.end
        alive = alive[solutions.ok]
        y0 = np.ascontiguousarray(solutions.y[solutions.ok, -1])
        if not alive.size:
            break
    failures = []
    for j in np.flatnonzero(status).tolist():
        reason = STATUS[int(status[j])]
        if entry[j] >= 0:
            reason = f"{flow.entry_name(int(entry[j]))} is {reason}"
        failures.append(Failure(int(members[j]), float(end[j]), reason))
    wild = ((j, wild_steps(flow.kernel, plan, y[j], reports)) for j in alive.tolist())
    failures += [Failure(int(members[j]), plan.scene.end, reason) for j, reason in wild if reason]
    wall = (perf_counter() - began) / count
    return Batch(members, flow, plan.method.name, y, steps, evaluations, failures, wall)


def lanes_of(method: Method, kernel: Kernel) -> int:
    """Return the number of members that run at once in SIMD lanes; 0 if lanes are not used."""
    if not (isinstance(method, Explicit) and kernel.layout.size):
        return 0
    return 16 if kernel.instructions <= _SMALL else 8


def _integrate_span(
    flow: CompiledFlow,
    method: Method,
    span: Span,
    y0: Array,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> Solutions:
    """Integrate members from y0 (N, k) over one span, and report their states at its end, too."""
    kernel, length, times = flow.kernel, span.stop - span.start, span.times
    if not (times.size and times[-1] == length):
        times = np.append(times, length)
    parameters = flow.parameters_between(span.start, span.stop)
    lanes, quaternion = lanes_of(method, kernel), kernel.layout.quaternion
    if lanes and isinstance(method, Explicit):
        address = wide_rate(kernel, lanes, own_parameters=True).address
        return integrate_in_lanes(
            method, address, lanes, parameters, y0, length, times, quaternion, threads, progress
        )
    return integrate_many(
        method, flow.address(method), parameters, y0, length, times, quaternion, threads,
        flow.tangent, kernel.layout.canonical, progress,
    )  # fmt: skip


def _scaled(progress: Callable[[float], None], k: int, spans: int) -> Callable[[float], None]:
    return lambda part: progress((k + part) / spans)
