"""Trajectory: the result of a simulation, at the report times and at any other time.

`run_plan` makes it: from a plan and an engine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats
from ..common.errors import InputError, NotCopyable, ShapeError
from ..scene.scene import Engine, Scene
from ..system.state_fields import ShapeState, State, arrays_of, map_arrays, torque_unit, with_base
from .over_time import OverTime, save
from .plan import Plan, plan_of

if TYPE_CHECKING:
    from pathlib import Path

    from ..common.waiting import Progress
    from ..system.system import System
    from .balances import EnergyBalance, MomentumBalance
    from .checkpoint import Checkpoint
    from .events import Crossings
    from .impacts import ImpactTable
    from .limit_excess import LimitTable
    from .motion import ControlAction, Motion, Solver


@dataclass(frozen=True)
class Cost:
    """The cost of an integration.

    Attributes:
        engine: "compiled" or "pinocchio".
        method: Name of the integrator.
        steps: Number of accepted steps.
        evaluations: Number of evaluations of the vector field.
        wall: Wall time [s].
        notices: Sentences on errors that the integrator does not control; empty if there are none.
    """

    engine: Engine
    method: str
    steps: int
    evaluations: int
    wall: float
    notices: tuple[str, ...] = ()


@checks_arguments
class Trajectory(OverTime):
    """The motion of a scene: fields of State at the report times; call it for other times.

    Attributes:
        scene: The scene; if an event ended the motion, the scene ends at that event.
        run: Cost of the integration, with engine, method, steps, evaluations and wall time [s].
    """

    def __init__(
        self,
        scene: Scene,
        motion: Motion | None,
        run: Cost,
        again: Callable[[], Trajectory] | None = None,
        outputs: State | ShapeState | None = None,
    ) -> None:
        """Store a scene and its motion.

        Args:
            scene: The scene.
            motion: Motion of the scene; None if only the outputs are known.
            run: Cost of the integration.
            again: Function that simulates the scene again; called if `motion` is None.
            outputs: States at the report times, if already computed.
        """
        self.scene = scene
        self.run = run
        self._motion = motion
        self._again = again
        if outputs is not None:  # the constructor of a state makes unpickled arrays read-only
            vars(self)["outputs"] = type(outputs)(**arrays_of(outputs))

    def __reduce__(self) -> tuple[Any, ...]:
        return Trajectory, (self.scene, None, self.run, self._again, self.outputs)

    def without_motion(self) -> Trajectory:
        """Return a copy with states and impacts, which integrates its motion again if needed."""
        copy = Trajectory(self.scene, None, self.run, self._again, self.outputs)
        vars(copy)["impacts"] = self.impacts
        return copy

    @property
    def motion(self) -> Motion:
        """The motion at all times; it is integrated again after unpickling."""
        if self._motion is None:
            if self._again is None:
                raise NotCopyable(
                    "this motion was modified, so it cannot be integrated again; simulate its scene"
                )
            self._motion = self._again().motion
        return self._motion

    @property
    def system(self) -> System:
        """The system that was simulated."""
        return self.scene.system

    @property
    def plan(self) -> Plan:
        """The plan of the scene; see Plan."""
        return plan_of(self.scene)

    @cached_property
    def outputs(self) -> State | ShapeState:
        """States at the report times, computed at first access."""
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
        """Crossings of the scene's events by name."""
        from .events import crossings_by_event

        return crossings_by_event(self.scene, self.motion.crossings, self.motion.states)

    @property
    def ended_by(self) -> str | None:
        """Name of the terminal event that ended the motion; None if no event ended it."""
        crossing = self.motion.ended_by
        return None if crossing is None else self.scene.events_given[crossing.event].name

    @property
    def actions(self) -> tuple[ControlAction, ...]:
        """Calls of the controllers, with the observed state and the action of each."""
        return self.motion.actions

    @cached_property
    def energy_balance(self) -> EnergyBalance:
        """Energy and the work of forces without potential at the report times.

        An InputError is raised if the scene leaves out the base.
        """
        from .balances import energy_balance

        return energy_balance(self.plan, self.motion, self.states)

    @cached_property
    def momentum_balance(self) -> MomentumBalance:
        """Momentum and the impulse of wrenches and gravity at the report times.

        An InputError is raised if the scene leaves out the base.
        """
        from .balances import momentum_balance

        return momentum_balance(self.plan, self.motion, self.states)

    @cached_property
    def driving_torques(self) -> Array:
        """Torques that drive the prescribed joints, in their order, (T, k) [N·m | N]."""
        from .balances import torques_of_motion

        return torques_of_motion(self.plan, self.motion, self.t)[0]

    @cached_property
    def impacts(self) -> ImpactTable:
        """Impacts at joint stops: times, joints, impulses, lost energies and momenta."""
        from .impacts import no_impacts

        impacts = self.motion.impacts
        return no_impacts(self.system.r) if impacts is None else impacts

    @cached_property
    def stop_reactions(self) -> Array:
        """Reactions of the stops at which joints rest, (T, m) [N·m | N]; zero for other joints."""
        from .balances import torques_of_motion

        return torques_of_motion(self.plan, self.motion, self.t)[1]

    @cached_property
    def limits(self) -> LimitTable:
        """Limits of joints in the robot's file, with the extremes of positions, rates and efforts.

        `stops="file"` enforces the position limits; no simulation enforces the others.
        """
        from .limit_excess import limit_table

        return limit_table(self.plan, self.motion)

    @cached_property
    def torques(self) -> Array:
        """Torques on the joints, (T, m) [N·m | N]: of springs, forces, controllers and loads.

        Gravity is not included.  A prescribed joint has the torque that its motion needs.  The
        torque on a joint that rests at its stop includes the reaction of the stop.
        """
        from .balances import joint_torques

        return joint_torques(self.plan, self.motion, self.t)

    def _further_variables(self) -> dict[str, Any]:
        attributes = {"units": torque_unit(self.system), "long_name": "Torques on the joints"}
        return {"torques": (("t", "joint"), self.torques, attributes)}

    @cached_property
    def loop_forces(self) -> Mapping[str, Array]:
        """Forces in closed loops, {loop: (T, 6)}: force [N] and moment [N·m] of frame a on frame b.

        They act at the origin of frame b, in the axes of frame a.  An InputError is raised if the
        scene leaves out the base.
        """
        from .closed_loops import loop_forces

        return loop_forces(self.plan, self.states, *self.motion.samples(self.t))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return (
            f"Trajectory({self.system.name!r}, {len(self)} times to {self.scene.end:g} s, "
            f"{self.run.steps} steps of {self.run.method}, {self.run.engine})"
        )

    def _repr_html_(self) -> str:
        from ..common.html import card, line, number, table

        outputs, run = self.outputs, self.run
        entries = [
            (name, float(x[0]), float(x[-1]), float(x.min()), float(x.max()))
            for name, x in zip(self.system.x_names, outputs.x.T, strict=True)
        ]
        momenta = ""
        lines = [f"energy [J]: {number(outputs.energy[0])} → {number(outputs.energy[-1])}"]
        if isinstance(outputs, State):
            group, (first, last) = self.system.group, outputs.pose[[0, -1]]
            rotation = float(group.error(first, last).rotation)
            shift = float(np.linalg.norm((last - first)[: group.linear]))
            lines.append(f"base: turned by {number(rotation)} rad, moved by {number(shift)} m")
            J = outputs.spatial_momentum
            momenta = table(
                "",
                ["spatial momentum [N·s | N·m·s]", *group.twist_names],
                [["start", *J[0].tolist()], ["end", *J[-1].tolist()]],
            )
        return card(
            self.system.name,
            f"{len(self)} times to {self.scene.end:g} s, {run.steps} steps of {run.method} "
            f"({run.engine}), {run.evaluations} evaluations in {run.wall:.3g} s",
            table("shape [rad | m]", ["joint", "start", "end", "least", "greatest"], entries),
            *map(line, (*lines, *run.notices)),
            momenta,
        )

    def __call__(self, t: ArrayLike) -> State:
        """Compute the state at any time of the motion.

        An InputError is raised for times outside the motion or if the base was left out, and a
        ShapeError if `t` is neither a time nor a vector.

        Args:
            t: A time, or times (T,), within the duration [s].
        Returns:
            The state at this time, or the states at these times.
        """
        return with_base(self.at(t), self.system.name)

    def at(self, t: ArrayLike) -> State | ShapeState:
        """Compute the state at any time of the motion, with or without the base.

        Args:
            t: A time, or times (T,), within the duration [s].
        Returns:
            The state at this time, or the states at these times; without the base if the scene
            leaves it out.
        Raises:
            InputError: A time is outside the motion.
            ShapeError: `t` is neither a time nor a vector.
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
        """Write the states to a file.

        An InputError is raised for another suffix or a missing folder, an OutputError if writing
        fails, and a MissingPackageError if h5py or zarr is not installed.

        Args:
            path: Path of the file; its suffix, .npz, .csv, .h5, .zarr or .xml, selects the format.
        """
        save(self, path)


def run_plan(
    plan: Plan,
    engine: Engine,
    progress: Progress | None,
    again: Callable[[], Trajectory],
    checkpoint: Checkpoint | None = None,
) -> Trajectory:
    """Integrate a plan, from impact to impact if its scene has joint stops, and measure the run.

    Args:
        plan: The plan.
        engine: Name of the engine.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
        again: Function that simulates the scene again; see Trajectory.
        checkpoint: Checkpoint that the run continues and updates; or None.
    Returns:
        The trajectory. If an event ended the motion, its scene ends there.
    Raises:
        InputError: A prescribed joint runs into its stop.
        IntegrationError: The integrator cannot continue, or a loop is singular.
    """
    solver = _solver_of(engine, plan)
    flow: Any
    integrate: Callable[[], Motion]
    if plan.scene.bounds:
        from .run_with_stops import RunWithStops

        stopped = RunWithStops(plan, progress, solver, checkpoint)
        flow, record, integrate = stopped.first, stopped.record, stopped.motion
    else:
        flow = solver.flow(plan)
        record = None if checkpoint is None else checkpoint.run(flow, plan)
        integrate = solver.motion(flow, plan, progress, record)
    started = time.perf_counter()
    motion = integrate()
    wall = time.perf_counter() - started - motion.building
    if plan.system.closure is not None:
        from .closed_loops import refuse_singular_loops

        refuse_singular_loops(plan.system, motion)
    end = motion.ended_by
    if checkpoint is not None and record is not None:
        checkpoint.close(record, flow, plan, cut=end is not None)
    scene = plan.scene if end is None else _until(plan.scene, end.t)
    run = Cost(engine, solver.method, motion.steps, motion.evaluations, wall, plan.notices)
    return Trajectory(scene, motion, run, again)


def _solver_of(engine: Engine, plan: Plan) -> Solver:
    """Return an engine for a plan; SciPy is imported for "pinocchio" only."""
    if engine == "compiled":
        from .compiled.integrator import compiled_solver

        return compiled_solver(plan)
    from .pinocchio_engine import SOLVER

    return SOLVER


def _until(scene: Scene, end: float) -> Scene:
    """Return the scene with an earlier end, which is also a report time."""
    t = scene.report_times
    return replace(scene, duration=end, times=np.append(t[t < end], end))
