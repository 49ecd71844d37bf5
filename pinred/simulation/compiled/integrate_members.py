"""Integrate many compiled flows of one kernel, in lanes where the method can, from stop to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...integrators.integrate_many import STATUS, Solutions
from ...integrators.integrate_many import integrate_many as _integrate_many
from ...integrators.lanes.integrate_in_lanes import integrate_in_lanes
from ...integrators.methods import Explicit, Method
from ...kernels.kernel import Kernel
from ...kernels.wide_rate import wide_rate
from ..plan import Plan
from .compiled_flow import CompiledFlow, CompiledFlows
from .integrator import wild_steps

_SMALL = 400  # instructions of a kernel


@dataclass(frozen=True)
class ManyRuns:
    """Runs of one kernel.

    y: (N, T, k).  steps, evaluations: (N,).  failures: (member, last time [s], reason) of each.
    """

    y: Array
    steps: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    failures: list[tuple[int, float, str]]


class _Course:
    """What has become of members, stretch by stretch."""

    def __init__(self, count: int, times: int, size: int) -> None:
        self.y = np.full((count, times, size), np.nan)
        self.status, self.entry = np.zeros(count, np.int64), np.full(count, -1, np.int64)
        self.end = np.zeros(count)
        self.steps, self.evaluations = np.zeros(count, np.int64), np.zeros(count, np.int64)
        self.alive = np.arange(count)

    def add(self, begin: float, rows: NDArray[np.intp], found: Solutions) -> Array:
        """Take a stretch of those that are alive; return where those begin that go on."""
        alive = self.alive
        self.y[np.ix_(alive, rows)] = found.y[:, : len(rows)]
        for name in ("status", "entry"):
            getattr(self, name)[alive] = getattr(found, name)
        for name in ("steps", "evaluations"):
            getattr(self, name)[alive] += getattr(found, name)
        self.end[alive] = begin + found.end
        self.alive = alive[found.ok]
        return np.ascontiguousarray(found.y[found.ok, -1])


def integrate_members(
    flows: CompiledFlows,
    plan: Plan,
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> ManyRuns:
    """Integrate flows of one kernel, with the times and tolerance of one plan, over threads."""
    kernel, scene = flows.kernel, plan.scene
    # One body that only translates carries a zero, which costs nothing.
    y0 = flows.y0 if flows.y0.shape[1] else np.zeros((len(flows.y0), 1))
    asked, course = scene.report_times, _Course(len(y0), len(scene.report_times), y0.shape[1])
    begin, parts = 0.0, len(plan.stops)
    for k, stop in enumerate(plan.stops.tolist()):
        # Where a stretch ends, the next begins only after it.
        inside = (asked > begin) & (asked <= stop) | ((asked == 0.0) & (k == 0))
        rows = np.flatnonzero(inside)
        times = asked[rows] - begin
        if k + 1 < parts and not (times.size and times[-1] == stop - begin):
            times = np.append(times, stop - begin)
        told = None if progress is None else _told(progress, k, parts)
        numbers = flows.parameters[course.alive]
        if parts > 1 and plan.forces is not None:
            first = numbers.shape[1] - len(plan.numbers)
            numbers[:, first:][:, plan.forces.within] = 0.5 * (begin + stop)
        found = _stretch(flows, plan.method, (numbers, y0, stop - begin, times), threads, told)
        y0, begin = course.add(begin, rows, found), stop
        if not course.alive.size:
            break
    failures = []
    for j in np.flatnonzero(course.status).tolist():
        reason = STATUS[int(course.status[j])]
        if course.entry[j] >= 0:
            name = CompiledFlow.of(flows, j).entry_name(int(course.entry[j]))
            reason = f"{name} is {reason}"
        failures.append((int(j), float(course.end[j]), reason))
    wild = ((j, wild_steps(kernel, plan, course.y[j], asked)) for j in course.alive.tolist())
    failures += [(j, scene.end, why) for j, why in wild if why]
    return ManyRuns(course.y, course.steps, course.evaluations, failures)


def lanes_of(method: Method, kernel: Kernel) -> int:
    """Return how many members run at once, 0 for one after another.

    A small kernel in sixteen lanes still has its numbers in registers.
    """
    if not (isinstance(method, Explicit) and kernel.layout.size):
        return 0
    return 16 if kernel.instructions <= _SMALL else 8


def _stretch(
    flows: CompiledFlows,
    method: Method,
    asked: tuple[Array, Array, float, Array],
    threads: int | None,
    progress: Callable[[float], None] | None,
) -> Solutions:
    """Integrate members over one stretch.  asked: parameters, y0, span, and times in it."""
    kernel, (parameters, y0, span, times) = flows.kernel, asked
    lanes, quaternion = lanes_of(method, kernel), kernel.layout.quaternion
    if lanes and isinstance(method, Explicit):
        address = wide_rate(kernel, lanes, own_parameters=True).address
        return integrate_in_lanes(
            method, address, lanes, parameters, y0, span, times, quaternion, threads, progress
        )
    first = CompiledFlow.of(flows, 0)
    return _integrate_many(
        method, first.address(method), parameters, y0, span, times, quaternion,
        threads, first.tangent, kernel.layout.canonical, progress,
    )  # fmt: skip


def _told(progress: Callable[[float], None], k: int, parts: int) -> Callable[[float], None]:
    return lambda part: progress((k + part) / parts)
