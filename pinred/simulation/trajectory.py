"""Trajectory: what a simulation returns, at the times asked for and at any other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats
from ..common.errors import InputError, NotCopyable, ShapeError
from ..system.state_fields import ShapeState, State, arrays_of, map_arrays, with_base
from .over_time import OverTime
from .plan import Plan, plan_of

if TYPE_CHECKING:
    from pathlib import Path

    from ..scene.scene import Engine, Scene
    from ..system.system import System
    from .balances import EnergyBalance, MomentumBalance
    from .control import ControlAction
    from .events import Crossings
    from .motion import Motion


@dataclass(frozen=True)
class Cost:
    """The cost of an integration.

    engine: "compiled" or "pinocchio".  method: name of the integrator.  steps: accepted.
    evaluations: of the vector field.  wall: seconds.
    """

    engine: Engine
    method: str
    steps: int
    evaluations: int
    wall: float


class Trajectory(OverTime):
    """The motion of a scene.  Fields of State over the report times; call it for any time."""

    def __init__(
        self,
        scene: Scene,
        motion: Motion | None,
        run: Cost,
        again: Callable[[], Trajectory] | None = None,
        outputs: State | ShapeState | None = None,
    ) -> None:
        """Take a scene and its motion.

        Args:
            scene: The scene.
            motion: Its motion; None if only the outputs are known.
            run: Cost of the integration.
            again: Function that simulates the scene once more, for the motion if that is None.
            outputs: States at the report times, if they are known already.
        """
        self.scene = scene
        self.run = run
        self._motion = motion
        self._again = again
        if outputs is not None:  # the constructor of a state makes unpickled arrays read-only
            vars(self)["outputs"] = type(outputs)(**arrays_of(outputs))

    def __reduce__(self) -> tuple[Any, ...]:
        return Trajectory, (self.scene, None, self.run, self._again, self.outputs)

    @property
    def motion(self) -> Motion:
        """The motion at all times; of a trajectory that was pickled, it is integrated again."""
        if self._motion is None:
            if self._again is None:
                raise NotCopyable("this motion was made by hand, and is not integrated again")
            self._motion = self._again().motion
        return self._motion

    @property
    def system(self) -> System:
        """The system that was simulated."""
        return self.scene.system

    @property
    def plan(self) -> Plan:
        """The plan of the scene: see Plan."""
        return plan_of(self.scene)

    @cached_property
    def outputs(self) -> State | ShapeState:
        """States that the scene asks for at the report times; made when first looked at."""
        return self.motion.states(self.scene.report_times)

    @property
    def _name(self) -> str:
        return self.system.name

    @property
    def t(self) -> Array:
        """Report times, (T,) [s]."""
        return self.scene.report_times

    @cached_property
    def events(self) -> Mapping[str, Crossings]:
        """Crossings of the scene's events, by name."""
        from .events import crossings_by_event

        return crossings_by_event(self.scene, self.motion.crossings, self.motion.states)

    @property
    def ended_by(self) -> str | None:
        """Name of the terminal event that ended the motion, and so its scene; None if none did."""
        end = self.motion.ended_by
        return None if end is None else self.scene.events_given[end.event].name

    @property
    def actions(self) -> tuple[ControlAction, ...]:
        """What the controllers were given and gave, call by call."""
        return self.motion.actions

    @cached_property
    def energy_balance(self) -> EnergyBalance:
        """Energy, and the work of what has no potential, over the report times.

        Raises InputError if the scene leaves out the base.
        """
        from .balances import energy_balance

        return energy_balance(self.plan, self.motion, self.states)

    @cached_property
    def momentum_balance(self) -> MomentumBalance:
        """Momentum, and the impulse of wrenches and gravity, over the report times.

        Raises InputError if the scene leaves out the base.
        """
        from .balances import momentum_balance

        return momentum_balance(self.plan, self.motion, self.states)

    @cached_property
    def driving_torques(self) -> Array:
        """Torques that the prescribed joints need, (T, k) [N·m | N], in their order."""
        from .balances import driving_torques

        return driving_torques(self.plan, self.t, self.motion.samples(self.t))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return (
            f"Trajectory({self.system.name!r}, {len(self)} times to {self.scene.end:g} s, "
            f"{self.run.steps} steps of {self.run.method}, {self.run.engine})"
        )

    def _repr_html_(self) -> str:
        from ..common.html import card, line, number, table

        out, run = self.outputs, self.run
        rows = [
            (name, float(x[0]), float(x[-1]), float(x.min()), float(x.max()))
            for name, x in zip(self.system.shape_names, out.x.T, strict=True)
        ]
        momenta = ""
        lines = [f"energy [J]: {number(out.energy[0])} → {number(out.energy[-1])}"]
        if isinstance(out, State):
            group, (first, last) = self.system.group, out.pose[[0, -1]]
            turned = float(group.error(first, last).rotation)
            moved = float(np.linalg.norm((last - first)[: group.linear]))
            lines.append(f"base: turned by {number(turned)} rad, moved by {number(moved)} m")
            J = out.spatial_momentum
            momenta = table(
                "",
                ["spatial momentum [N·s | N·m·s]", *group.twist_names],
                [["start", *J[0].tolist()], ["end", *J[-1].tolist()]],
            )
        return card(
            self.system.name,
            f"{len(self)} times to {self.scene.end:g} s, {run.steps} steps of {run.method} "
            f"({run.engine}), {run.evaluations} evaluations in {run.wall:.3g} s",
            table("shape [rad | m]", ["joint", "start", "end", "least", "greatest"], rows),
            *map(line, lines),
            momenta,
        )

    def __call__(self, t: ArrayLike) -> State:
        """Return the state at time t, or states at times (T,), within the duration [s].

        Raises InputError outside it or if the base was left out, ShapeError for anything but
        a time or a vector of them.
        """
        return with_base(self.at(t), self.system.name)

    def at(self, t: ArrayLike) -> State | ShapeState:
        """Return what the scene asks for at time t, or at times (T,), within the duration [s].

        Raises InputError outside it, ShapeError for anything but a time or a vector of them.
        """
        times = as_floats(t, "t")
        flat = np.atleast_1d(times)
        if flat.ndim != 1 or flat.size == 0:
            raise ShapeError(f"t must be a time or a vector of times, got shape {times.shape}")
        if not ((flat >= 0.0) & (flat <= self.scene.end)).all():
            raise InputError(f"t must lie between 0 and {self.scene.end:g} s, got {times}")
        state = self.motion.states(flat)
        if times.ndim:
            return state
        return map_arrays(lambda values: np.asarray(values[0]), state)

    def save(self, path: str | Path) -> None:
        """Write the states to a .npz, .csv or .zarr file (see trajectory_files.py).

        Raises InputError, OutputError, and MissingPackageError where zarr is not installed.
        """
        from .trajectory_files import save

        save(self, path)
