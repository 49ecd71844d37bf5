"""The time limit of a comparison: how long ABA may integrate a motion.

The limit counts processor time, so a verdict does not depend on other programs of the machine.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter, thread_time

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
        seconds: Time limit, in processor time of the current thread [s].
    """

    def __init__(
        self,
        seconds: float,
        clock: Callable[[], float] = thread_time,
        wall: Callable[[], float] = perf_counter,
    ) -> None:
        """Start the clock.

        Args:
            seconds: Time limit [s].
            clock: Function that returns the processor time [s].
            wall: Function that returns the wall time [s], which advances at least as fast.
        """
        self.seconds, self._clock, self._wall = seconds, clock, wall
        self._start, self._due = clock(), wall() + seconds

    def is_exceeded(self) -> bool:
        """Return whether the time is up.  The processor time is read only if it can be."""
        now = self._wall()
        if now <= self._due:
            return False
        left = self.seconds - (self._clock() - self._start)
        self._due = now + left
        return left < 0.0

    def limit(self, rate: Rate) -> Rate:
        """Return a vector field that raises AbaStopped when the time is up."""

        def limited(t: float, y: Array) -> Array:
            if self.is_exceeded():
                raise AbaStopped(f"ABA exceeded {self.seconds:g} s of processor time", t)
            return rate(t, y)

        return limited
