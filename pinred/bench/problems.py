"""What accuracy is measured on: a system, where it starts, and for how long."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Array, freeze
from ..catalogue import INSTALL_ROBOTS, has_example_robots
from ..full_state import FullMotion, FullState
from ..loading import load
from ..scene import Scene, random_state
from ..system import InitialState, System

# What Hairer's codes can do in double precision; the reference says how far its two are apart.
_RTOL, _ATOL = 2e-14, 1e-16


@dataclass(frozen=True)
class Problem:
    """An initial value problem, with its base at the identity; only its end is judged.

    about: what it is, in a line.  start: x, xdot, xi and duration.
    """

    name: str
    about: str
    system: System
    start: InitialState

    def __post_init__(self) -> None:
        freeze(self.start)

    @property
    def times(self) -> Array:
        """The end, (1,) [s]: the only time at which the state is wanted."""
        return np.array([self.start.duration])

    def scene(self, rtol: float, atol: float) -> Scene:
        """Return the problem as a Scene."""
        start = self.start
        return Scene(
            system=self.system,
            x0=start.x,
            xdot0=start.xdot,
            xi0=start.xi,
            times=self.times,
            rtol=rtol,
            atol=atol,
        )

    @cached_property
    def full(self) -> FullState:
        """Pinocchio's ABA on the full state, and its judgement of distances."""
        return FullState(self.scene(1e-10, 1e-12))

    def full_start(self) -> Array:
        """Return the full state at the start, as FullState has it."""
        start = self.start
        return self.full.state(self.system.group.identity(), start.x, start.xi, start.xdot)

    def reference(self) -> Reference:
        """Return the end by ABA at the tightest tolerance, and how far two methods are apart.

        Raises IntegrationError if it cannot be followed.
        """
        y0, times = self.full_start(), self.times
        truth = self.full.run(y0, times, _RTOL, _ATOL)
        second = self.full.run(y0, times, _RTOL, _ATOL, method="dopri5")
        apart = self.full.distance(truth, second)
        largest = max(float(a[0]) for a in (apart.shape, apart.rotation, apart.position))
        return Reference(end=truth, error=largest)


@dataclass(frozen=True)
class Reference:
    """The end of a problem.  error: largest difference of two methods there [rad | m]."""

    end: FullMotion
    error: float


def planar_joint() -> Problem:
    """Return two coupled bodies in the plane, where the joint's angle matters."""
    system = load("planar_chain5", lock=("joint2", "joint3", "joint4", "joint5"))
    start = InitialState(
        x=np.array([0.3]), xdot=np.array([1.2]), xi=np.array([0.1, 0.2, -0.3]), duration=10.0
    )
    return Problem("planar", "planar_chain5 with all joints but the first locked", system, start)


def tumbling_solo12() -> Problem:
    """Return a quadruped tumbling without gravity, from a generic state."""
    system = load("solo12", gravity=(0.0, 0.0, 0.0))
    start = random_state(system, 0)
    return Problem("solo12", "solo12 tumbling without torque or gravity, seed 0", system, start)


PROBLEMS: dict[str, Callable[[], Problem]] = {"planar": planar_joint, "solo12": tumbling_solo12}
_EXAMPLES = ("solo12",)


def default_problems() -> tuple[list[Problem], list[str]]:
    """Return the problems that can be posed, and a line on each that cannot."""
    there = has_example_robots()
    names = [name for name in PROBLEMS if there or name not in _EXAMPLES]
    missing = [f"{name} is left out: {INSTALL_ROBOTS}" for name in PROBLEMS if name not in names]
    return [PROBLEMS[name]() for name in names], missing
