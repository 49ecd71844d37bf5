"""The stepper of a method: its compiled loops, and the rows that they work on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...common.arrays import Array
from .step_loop import Loops


@dataclass(frozen=True)
class Stepper:
    """The compiled loops of a method.

    rows: of (n, tangent) the rows for n numbers in the state, with room for what Newton's
    method takes besides where `tangent` is true.  kept: numbers at a knot for one in the state.
    stages: those besides where stages are kept, 0 if they cannot be.
    needs_tangent: whether nothing goes without the derivative of the kernel.
    """

    loops: Loops
    rows: Callable[[int, bool], Array]
    kept: int = 1
    stages: int = 0
    needs_tangent: bool = False

    def work(self, n: int, *, tangent: bool = False) -> Array:
        """Return the rows (…, stride) that the loops work on, for n numbers in the state."""
        return self.rows(n, tangent or self.needs_tangent)

    def widened(self, n: int, work: Array) -> Array:
        """Return rows that hold what `work` does, with room for Newton's method."""
        larger = self.work(n, tangent=True)
        larger[: len(work)] = work
        return larger
