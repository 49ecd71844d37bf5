"""Problems of the accuracy benchmark: a system, its initial state and duration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, freeze
from ...judge.distances import FullMotion
from ...judge.reference_solution import FullState
from ...scene.scene import Scene
from ...system.coordinates import InitialState
from ...system.system import System


@checks_arguments
@dataclass(frozen=True)
class Problem:
    """An initial value problem with the base at the identity; only its final state is compared.

    Attributes:
        name: Name of the problem.
        about: Description in one line.
        system: The system.
        start: Initial shape x, initial shape rate, initial body twist, and the duration [s].
    """

    name: str
    about: str
    system: System
    start: InitialState

    def __post_init__(self) -> None:
        freeze(self.start)
        if self.system.model is not self.system.sorted_model:  # the peers need depth-first order
            vars(self)["system"] = replace(self.system, model=self.system.sorted_model)

    @property
    def times(self) -> Array:
        """The final time, (1,) [s]; no other state is requested."""
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
        """Return the problem as a Scene.

        Args:
            **options: Further options of Scene.
        Returns:
            The scene.
        """
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
        """Full simulation by Pinocchio's ABA, which also measures distances of motions."""
        return FullState(self.scene())

    def full_start(self) -> Array:
        """Return the initial full state, see FullState."""
        start = self.start
        return self.full.state(self.system.group.identity(), start.x, start.xi, start.xdot)

    def apart(self, a: FullMotion, b: FullMotion) -> float:
        """Return the largest of shape, rotation and position error between two final states.

        Args:
            a: Motion with one time.
            b: Motion with one time.
        Returns:
            The distance [rad | m].
        """
        d = self.full.distance(a, b)
        return float(np.max([d.shape[0], d.rotation[0], d.position[0]]))
