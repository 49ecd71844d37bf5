"""Jumps of derivatives at stops whose times depend on Parameters.

If a condition on time changes at t*, the state after t* depends on t* itself: with the rates f⁻
before and f⁺ after the stop, δy jumps by (f⁻ − f⁺) δt*. The derivative of t* follows from the
argument g of the condition, δt* = −g_p δp / g_t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...integrators.solution import Solution
from ...integrators.stepping.state_rows import unit_alone
from ...kernels.evaluate import evaluate
from ...kernels.kernel import Kernel
from ..plan import Plan, Span

_SAME = 1e-9  # derivatives of switch times with a smaller relative difference are equal


@dataclass(frozen=True)
class Jump:
    """The jump of derivatives at a stop whose time depends on force parameters.

    Attributes:
        time: Time of the stop [s].
        change: Rate of the state before the stop minus the rate after it, (n,).
        slopes: Derivative of the time with respect to the force parameters, (C, p): one row for
            each of the conditions that change at this time.
    """

    time: float
    change: Array
    slopes: Array

    def delay(self, numbers: Array) -> Array:
        """Return derivatives of the time along directions (p, N) of the force parameters, (N,).

        Raises:
            InputError: The time has no derivative.
        """
        delays = self.slopes @ numbers
        scale = np.abs(self.slopes) @ np.abs(numbers)
        same = np.abs(delays - delays[0]) <= _SAME * scale.max(axis=0)
        if not (np.isfinite(delays).all() and same.all()):
            raise InputError(
                f"a flow has no derivative where several conditions on time change at once with "
                f"different derivatives, or where one only touches its threshold, as here at "
                f"t = {self.time:g} s; move one of them"
            )
        return np.asarray(delays[0])

    def only_slopes(self) -> Array:
        """Return the derivative of the time by the force parameters, (p,).  Raises InputError."""
        return self.delay(np.eye(self.slopes.shape[1]))


def jumps_of(
    kernel: Kernel, plan: Plan, numbers: Array, spans: Sequence[Span], solutions: Sequence[Solution]
) -> dict[int, Jump]:
    """Return the jumps of derivatives in a run.

    Args:
        kernel: Kernel of the run.
        plan: Plan of the scene.
        numbers: Force parameters of the run, (p,).
        spans: Time spans between the stops of the run.
        solutions: Solution over each span.
    Returns:
        The jumps by the index of the span that begins with them.
    """
    if not plan.stops_vary or len(spans) < 2 or plan.forces is None:
        return {}
    rows = plan.forces.switching.slopes(np.array([span.stop for span in spans]), numbers)
    jumps = {}
    for k in range(len(spans) - 1):
        y = solutions[k + 1].states[0].copy()
        unit_alone(y, kernel.layout.quaternions)
        params = [solution.params for solution in solutions[k : k + 2]]
        jump = jump_between(kernel, params, y, float(spans[k].stop), rows[k])
        if jump is not None:
            jumps[k + 1] = jump
    return jumps


def jump_between(
    kernel: Kernel, params: Sequence[Array], y: Array, time: float, slopes: Array
) -> Jump | None:
    """Return the jump of derivatives at a stop, or None if there is none.

    Args:
        kernel: Kernel of the run.
        params: Its parameters before and after the stop, (p,) each.
        y: State at the stop, with unit quaternions, (n,).
        time: Time of the stop [s].
        slopes: Derivatives of the time; see Jump.
    """
    if not slopes.any():
        return None
    before, after = (evaluate(kernel.rate.address, own, y[None], len(y))[0] for own in params)
    change = before - after
    return Jump(time, change, slopes) if change.any() else None
