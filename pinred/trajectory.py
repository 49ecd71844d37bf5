"""Trajectory: what a simulation returns, at the times asked for and at any other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, as_floats, freeze
from .errors import InputError, ShapeError

if TYPE_CHECKING:
    from pathlib import Path

    from .scene import Scene
    from .system import System


@dataclass(frozen=True)
class State:
    """The system at one time, or at many with time as the first axis; arrays are read-only.

    t: [s].  x, xdot: (…, m) shape and rate.  xi: (…, r) body twist [linear; angular].
    pose: (…, size) of the base.  q, v: (…, nq), (…, n), Pinocchio's.
    body_momentum: (…, r) μ in the body's frame.  spatial_momentum: (…, r) J = Ad*_{g⁻¹} μ
    in the root joint's fixed frame, about its origin.
    energy: (…,) kinetic and potential, of falling too, zero height at the world's origin [J].
    """

    t: Array
    x: Array
    xdot: Array
    xi: Array
    pose: Array
    q: Array
    v: Array
    body_momentum: Array
    spatial_momentum: Array
    energy: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Run:
    """What an integration cost.

    engine: "compiled" or "pinocchio".  method: name of the integrator.  steps: accepted.
    evaluations: of the vector field.  wall: seconds.
    """

    engine: str
    method: str
    steps: int
    evaluations: int
    wall: float


class Trajectory:
    """The motion of a scene.  Fields of State over the report times; call it for any time."""

    def __init__(self, scene: Scene, state: Callable[[Array], State], run: Run) -> None:
        """Take the scene, a function from times (T,) to states, and what the run cost."""
        self.scene = scene
        self.run = run
        self._state = state

    @property
    def system(self) -> System:
        """The system that was simulated."""
        return self.scene.system

    @cached_property
    def states(self) -> State:
        """The states at the report times, time first; made when first looked at."""
        return self._state(self.scene.report_times)

    @property
    def t(self) -> Array:
        """Report times, (T,) [s]."""
        return self.scene.report_times

    @property
    def x(self) -> Array:
        """Shape, (T, m) [rad | m]."""
        return self.states.x

    @property
    def xdot(self) -> Array:
        """Shape rate, (T, m)."""
        return self.states.xdot

    @property
    def xi(self) -> Array:
        """Body twist of the base, (T, r) [linear; angular]."""
        return self.states.xi

    @property
    def pose(self) -> Array:
        """Pose of the base, (T, size)."""
        return self.states.pose

    @property
    def q(self) -> Array:
        """Pinocchio's configuration, (T, nq)."""
        return self.states.q

    @property
    def v(self) -> Array:
        """Pinocchio's velocity, (T, n)."""
        return self.states.v

    @property
    def body_momentum(self) -> Array:
        """Body momentum μ, (T, r)."""
        return self.states.body_momentum

    @property
    def spatial_momentum(self) -> Array:
        """Spatial momentum J = Ad*_{g⁻¹} μ, (T, r)."""
        return self.states.spatial_momentum

    @property
    def energy(self) -> Array:
        """Total energy, (T,) [J]."""
        return self.states.energy

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return (
            f"Trajectory({self.system.name!r}, {len(self)} times to {self.scene.end:g} s, "
            f"{self.run.steps} steps of {self.run.method}, {self.run.engine})"
        )

    def __call__(self, t: ArrayLike) -> State:
        """Return the state at time t, or states at times (T,), within the duration [s].

        Raises InputError outside it, ShapeError for anything but a time or a vector of them.
        """
        times = as_floats(t, "t")
        flat = np.atleast_1d(times)
        if flat.ndim != 1 or flat.size == 0:
            raise ShapeError(f"t must be a time or a vector of times, got shape {times.shape}")
        if not ((flat >= 0.0) & (flat <= self.scene.end)).all():
            raise InputError(f"t must lie between 0 and {self.scene.end:g} s, got {times}")
        state = self._state(flat)
        if times.ndim:
            return state
        return State(**{f.name: np.asarray(getattr(state, f.name)[0]) for f in fields(State)})

    def save(self, path: str | Path) -> None:
        """Write the states to a .npz or .csv file (see export.py).  Raises InputError."""
        from .export import save

        save(self, path)
