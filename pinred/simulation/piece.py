"""A flow, and one run of an integrator along it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from ..common.arrays import Array
from ..system.state_fields import ShapeState, State
from .sample import Sample


class Flow(Protocol):
    """The flow of a scene on one of the routes: see ReducedFlow and CompiledFlow."""

    y0: Array
    numbers: Array

    def sample(self, t: float, y: Array, numbers: Array) -> Sample:
        """Return what forces see at one time.  numbers: those in the forces then."""

    def states(self, t: Array, y: Array, numbers: Array) -> State | ShapeState:
        """Return the full states at times (T,) of reduced states (T, k)."""

    def rates(self, t: Array, y: Array, numbers: Array) -> Array:
        """Return dy/dt (T, k) at times (T,) of reduced states (T, k)."""


@dataclass(frozen=True)
class Piece:
    """One run of an integrator.

    knots: (K,) times of the ends of its steps, or of parts of long ones, from its start on [s].
    at: from times (T,) within to reduced states (T, k).  numbers: those in the forces, during
    it.
    """

    knots: Array
    at: Callable[[Array], Array]
    numbers: Array
    steps: int
    evaluations: int

    @property
    def end(self) -> float:
        """The time at which it ends [s]."""
        return float(self.knots[-1])


class Integrate(Protocol):
    """What integrates a flow from one time to another."""

    def __call__(
        self, start: float, end: float, y0: Array, watch: Callable[[Piece], bool] | None = None
    ) -> Piece:
        """Return the run from a state at the start.

        watch: is given what there is of it now and then, and says whether it is to stop there; it
        is asked before a failure, too.  Raises IntegrationError.
        """
