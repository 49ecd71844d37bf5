"""The time limit of a comparison: how long ABA may integrate a motion."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

from ..common.arrays import Array
from ..common.errors import IntegrationError

Rate = Callable[[float, Array], Array]

LEAST = 30.0  # default time limit of short motions [s]
RATIO = 500.0  # default time limit relative to the wall time of the simulation


def default_budget(wall: float) -> float:
    """Return the time limit [s] of a comparison with a simulation that took `wall` [s]."""
    return max(LEAST, RATIO * wall)


class AbaStopped(IntegrationError):  # noqa: N818
    """ABA did not reach the end of the motion.

    Attributes:
        time: Last time of the motion that ABA reached [s].
    """

    def __init__(self, message: str, time: float) -> None:
        """Store the message and the time that ABA reached [s]."""
        super().__init__(f"{message}; it reached t = {time:.6g} s")
        self.time = time


class TimeBudget:
    """A time limit that starts when it is created.

    Attributes:
        seconds: Time limit [s].
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = perf_counter) -> None:
        """Start the clock.

        Args:
            seconds: Time limit [s].
            clock: Function that returns the time [s].
        """
        self.seconds, self._clock, self._start = seconds, clock, clock()

    @property
    def spent(self) -> float:
        """Time since the start [s]."""
        return self._clock() - self._start

    def limit(self, rate: Rate) -> Rate:
        """Return a vector field that raises AbaStopped when the time is up."""

        def limited(t: float, y: Array) -> Array:
            if self.spent > self.seconds:
                raise AbaStopped(f"ABA exceeded the time limit of {self.seconds:g} s", t)
            return rate(t, y)

        return limited
