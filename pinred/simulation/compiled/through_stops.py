"""Integration of a compiled flow through all stops of its plan, with one call of compiled code."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import IntegrationError
from ...forces.switch_times import time_within
from ...integrators.integrate import Parts, integrate_parts
from ...integrators.methods import ErrorControl
from ..plan import Plan
from ..reduced_flow import Segment, Segments
from .compiled_flow import CompiledFlow
from .integrator import divisions_of, explained, refined

_compiled_methods: set[type[ErrorControl]] = set()


def through_stops(
    flow: CompiledFlow, plan: Plan, progress: Callable[[float], None] | None
) -> Callable[[], Segments] | None:
    """Return the function that integrates a flow through all stops of its plan.

    Args:
        flow: The flow of the plan.
        plan: The plan, for which `passes_stops` is true.
        progress: Called repeatedly with the completed fraction of the stops, 0 to 1.
    Returns:
        The function; None for methods without step control, whose steps depend on each span.
    """
    method = plan.method
    if not isinstance(method, ErrorControl):
        return None

    def run(stops: Array) -> PartSegments:
        starts = np.append(0.0, stops[:-1])
        params = flow.parameters_within(time_within(starts, stops))

        def explain(stop: IntegrationError, k: int) -> IntegrationError:
            return explained(stop, flow, plan.scene, float(starts[k]), params[k])

        kernel = flow.kernel
        parts = integrate_parts(
            method, flow.address(method), params, flow.y0 if flow.y0.size else np.zeros(1),
            read_only(stops - starts), kernel.layout.quaternions, kernel.canonical, flow.tangent,
            progress, explain,
        )  # fmt: skip
        return PartSegments(parts, starts, stops, divisions_of(plan))

    def through() -> Segments:
        return run(plan.stops)

    if type(method) not in _compiled_methods:
        # The first integration compiles the method; this time must not count as run time.
        _compiled_methods.add(type(method))
        with suppress(IntegrationError):  # the real run raises the same error
            run(1e-9 * plan.stops[:1])
    return through


class PartSegments(Segments):
    """The segments of a run over parts of time; each is created at first access."""

    def __init__(self, parts: Parts, starts: Array, stops: Array, divisions: int) -> None:
        """Store the solutions.

        Args:
            parts: Solutions of the S parts.
            starts: Start times of the parts, (S,) [s].
            stops: End times of the parts, (S,) [s].
            divisions: Number of parts into which each long step is divided.
        """
        self._parts, self._starts, self._divisions = parts, starts, divisions
        self.ends, self.steps, self.evaluations = stops, parts.steps, parts.evaluations

    @cached_property
    def knots(self) -> Array:
        """Times of all step ends, (K,) sorted [s]."""
        parts, counts = self._parts, np.diff(self._parts.first)
        times = parts.knots[: parts.first[-1]] + np.repeat(self._starts, counts)
        times[parts.first[1:] - 1] = self.ends  # exact, despite round-off in sums of step lengths
        return np.unique(refined(np.unique(times), self._divisions))

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        k = range(len(self))[k]
        solution, start = self._parts[k], float(self._starts[k])
        knots = refined(solution.knots + start, self._divisions)
        knots[-1] = self.ends[k]

        def at(t: Array) -> Array:
            return solution.at(np.clip(t - start, 0.0, solution.knots[-1]))

        return Segment.stored(knots, at, solution.params, solution.steps, solution.evaluations)
