"""Problems on which accuracy is measured: a system, its start, and for how long."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...common.arrays import Array, freeze
from ...judge.distances import FullMotion
from ...judge.reference_solution import FullState
from ...scene.scene import Scene
from ...system.coordinates import InitialState
from ...system.system import System


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

    @property
    def q0(self) -> Array:
        """Pinocchio's configuration at the start, (nq,)."""
        return self.system.q(self.system.group.identity(), self.start.x)

    @property
    def v0(self) -> Array:
        """Pinocchio's velocity at the start, (n,)."""
        return self.system.v(self.start.xi, self.start.xdot)

    def scene(self, **options: Any) -> Scene:
        """Return the problem as a Scene.  options: further ones."""
        start = self.start
        return Scene(
            system=self.system,
            x0=start.x,
            xdot0=start.xdot,
            xi0=start.xi,
            times=self.times,
            **options,
        )

    @cached_property
    def full(self) -> FullState:
        """Pinocchio's ABA on the full state, and its judgement of distances."""
        return FullState(self.scene())

    def full_start(self) -> Array:
        """Return the full state at the start, as FullState has it."""
        start = self.start
        return self.full.state(self.system.group.identity(), start.x, start.xi, start.xdot)

    def apart(self, a: FullMotion, b: FullMotion) -> float:
        """Return how far two ends are apart: the largest of shape, rotation and position."""
        d = self.full.distance(a, b)
        return float(np.max([d.shape[0], d.rotation[0], d.position[0]]))
