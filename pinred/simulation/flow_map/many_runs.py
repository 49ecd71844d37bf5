"""Many runs of a flow map at once, in lanes: their outputs, and where things stand in them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError
from ...kernels.evaluate import evaluate_each
from ...system.coordinates import Indices
from ...system.state_fields import Outcome
from ..compiled.compiled_flow import CompiledFlows
from ..compiled.integrate_members import integrate_members
from .runs import OVERFLOWS, Course


def entries(course: Course, rows: Iterable[Outcome]) -> Indices:
    """Return where fields of State stand in the outputs of the kernel."""
    where = course.kernel.where
    every = np.arange(where.size)
    return np.concatenate([every[where.fields[row]] for row in rows])


def outputs_of_many(course: Course, state: Array, constants: Array, threads: int | None) -> Array:
    """Return the outputs (N, T, ·) of many runs, in lanes where the method has them.

    state, constants: (N, …), as in Given.  They are those of `run` within round-off times the
    stretch of the flow.  Raises IntegrationError for the first member that fails.
    """
    kernel, count, size = course.kernel, len(state), course._sizes[0]
    apart = [course._apart(row) for row in constants]
    rest, falls = (np.array(each) for each in zip(*apart, strict=True))
    begun = evaluate_each(course._begin_at, state, rest, course._begun)
    if not np.isfinite(begun).all():
        raise InputError(OVERFLOWS)
    y, head, start = np.split(begun, np.cumsum(course._sizes[:2]), axis=1)
    line, parameters = np.hstack([start, falls]), np.hstack([head, rest])
    stretches = course._stretches
    parameters = np.array([course._within(row, *stretches[0][:2]) for row in parameters])
    flows = CompiledFlows.made(kernel, np.ascontiguousarray(y), parameters, line)
    found = integrate_members(flows, course.plan, threads, None)
    if found.failures:
        k, time, why = min(found.failures)
        raise IntegrationError(f"member {k} of {count} stopped at t = {time:g} s: {why}")
    parts, at = [], 0
    for begin, stop, times in stretches:
        rows = found.y[:, at : at + len(times), :size].reshape(count * len(times), size)
        at += len(times)
        if not course._clock:
            rows = np.hstack([rows, np.tile(begin + times, count)[:, None]])
        here = np.array([course._within(row, begin, stop) for row in parameters])
        every = np.repeat(np.hstack([here, line]), len(times), axis=0)
        out = evaluate_each(kernel.outputs.address, rows, every, kernel.where.size)
        parts.append(out.reshape(count, len(times), kernel.where.size))
    return np.concatenate(parts, axis=1)
