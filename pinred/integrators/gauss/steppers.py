"""Steppers of Gauss's methods by their number of stages: their loops, and their rows."""

from __future__ import annotations

from ...common.arrays import Array
from ..stepping.step_loop import Loops
from ..stepping.stepper import Stepper
from . import adaptive as adaptive_steps
from . import fixed_step as equal_steps
from . import newton
from .stages import work_rows
from .tables import lanes_of


def fixed_step(stages: int, *, needs_tangent: bool) -> Stepper:
    """Return what makes steps of one length."""
    return _stepper(equal_steps.LOOPS, stages, needs_tangent=needs_tangent)


def adaptive(stages: int) -> Stepper:
    """Return what makes steps by their error."""
    return _stepper(adaptive_steps.LOOPS, stages, needs_tangent=False, kept=lanes_of(stages))


def _stepper(loops: Loops, stages: int, *, needs_tangent: bool, kept: int = 0) -> Stepper:
    def rows(n: int, tangent: bool) -> Array:
        work = work_rows(stages, n, newton.room(n, stages) if tangent else 0)
        if tangent:
            newton.fill(work, stages)
        return work

    return Stepper(loops, rows, stages=kept, needs_tangent=needs_tangent)
