"""The stepper of a method: its compiled loops, and the allocation of its work rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...common.arrays import Array
from .step_loop import Loops


@dataclass(frozen=True)
class Stepper:
    """The compiled loops of a method, and its memory needs.

    Attributes:
        loops: Compiled loops.
        rows: Function of (n, tangent) that allocates the work rows for n entries of the state. If
            `tangent` is true they have space for Newton's method.
        kept: Numbers stored at a step end per entry of the state.
        stages: Additional numbers per entry if stages are stored, 0 if they cannot be.
        needs_tangent: Whether the method always needs the derivative of the kernel.
    """

    loops: Loops
    rows: Callable[[int, bool], Array]
    kept: int = 1
    stages: int = 0
    needs_tangent: bool = False

    def work(self, n: int, *, tangent: bool = False) -> Array:
        """Allocate the work rows (…, stride) for n entries of the state."""
        return self.rows(n, tangent or self.needs_tangent)

    def widened(self, n: int, work: Array) -> Array:
        """Copy `work` to rows that also have space for Newton's method."""
        larger = self.work(n, tangent=True)
        larger[: len(work)] = work
        return larger
