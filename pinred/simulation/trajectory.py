"""Trajectory: the result of a simulation, at the report times and at any other time.

`run_plan` makes it: from a plan and an engine.  A LimitTable shows where it exceeds the limits of
joints in the robot's file, which no simulation enforces.  Balls have no such limits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats
from ..common.errors import InputError, NotCopyable, ShapeError
from ..common.memo import is_first, once
from ..common.names import listed
from ..scene.parse_options import list_forces
from ..scene.scene import Engine, Scene
from ..system.passive import StatedLimit, limits_of
from ..system.state_fields import ShapeState, State, arrays_of, map_arrays, torque_unit, with_base
from ..system.system import nominal
from .plan import Plan, plan_of
from .saved_states import OverTime, save

if TYPE_CHECKING:
    from pathlib import Path

    from ..common.waiting import Progress
    from ..system.system import System
    from .balances import EnergyBalance, MomentumBalance
    from .checkpoint import Checkpoint
    from .events import Crossings
    from .impacts import ImpactTable
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


# --- limits of joints ----------------------------------------------------------------------------

_INSIDE = 3  # number of points within each step at which positions and rates are compared
_MOST_TIMES = 20_000  # largest number of times at which positions and rates are compared
_MOST_EFFORTS = 500  # largest number of times at which efforts are computed
_QUICK_EFFORTS = 6  # the same number in the check after each simulation
_ROUND_OFF = 1e-9  # excess, relative to the limit, that counts as round-off


@dataclass(frozen=True)
class LimitUse:
    """How a motion uses a limit of the robot's file.

    Attributes:
        limit: The limit.
        unit: Unit of the values.
        least: Least value in the motion.
        greatest: Greatest value in the motion.
        excess: Largest excess beyond the limit; 0 if the motion keeps it.
        t: Time of the largest excess, or of the value nearest to the limit [s].
    """

    limit: StatedLimit
    unit: str
    least: float
    greatest: float
    excess: float
    t: float


@dataclass(frozen=True)
class LimitTable:
    """The limits of the robot's file, with the extremes of a motion.

    Values are compared at the report times, at the ends of steps and at three points within each
    step; efforts at 500 of these times at most.

    Attributes:
        rows: One entry for each limit.
    """

    rows: tuple[LimitUse, ...]

    @property
    def exceeded(self) -> tuple[LimitUse, ...]:
        """The limits that the motion exceeds, the largest relative excess first."""
        beyond = [use for use in self.rows if use.excess > 0.0]
        return tuple(sorted(beyond, key=lambda use: -_relative(use)))

    def __iter__(self) -> Iterator[LimitUse]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        head = ("joint", "kind", "lower", "upper", "least", "greatest", "excess", "at t [s]")
        lines = [head, *map(_cells, self.rows)]
        widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        heads = ["joint", "kind", "lower", "upper", "least", "greatest", "excess", "at t [s]"]
        cells = [_cells(use) for use in self.rows]
        return card("limits of the file", f"{len(self.exceeded)} exceeded", table("", heads, cells))


def limit_table(plan: Plan, motion: Motion) -> LimitTable:
    """Compare a motion with the limits of its robot's file.

    Args:
        plan: The plan of the scene.
        motion: The motion.
    Returns:
        The limits, with the extremes of the motion.
    """
    ends = np.concatenate([[0.0], motion.knots])
    ends = ends[ends <= plan.scene.end]
    fractions = np.linspace(0.0, 1.0, _INSIDE + 2)[:-1]
    inside = (ends[:-1, None] + np.diff(ends)[:, None] * fractions).ravel()
    t = _some(np.unique(np.concatenate([inside, ends, plan.scene.report_times])), _MOST_TIMES)
    times = _some(t, _MOST_EFFORTS)
    is_bounded = any(limit.kind == "effort" for limit in limits_of(plan.system))
    efforts = _efforts(plan, motion, times) if is_bounded else {}
    return LimitTable(tuple(_uses(plan.system, motion.states(t), times, efforts)))


def excess_notice(plan: Plan, motion: Motion, states: ShapeState | State) -> str:
    """Return a sentence on limits of the file that a motion exceeds at report times, or "".

    Dense output between them costs more than a short motion, so only `limit_table` evaluates it.
    A robot's sentence on the same limits is returned once.  Efforts are computed for the first
    motion of a set of forces only, because they cost more than the motion.

    Args:
        plan: The plan of the scene.
        motion: The motion.
        states: Its states at the report times, which are compared.
    Returns:
        The sentence.
    """
    system = plan.system
    bounds = once(system, _Bounds, lambda: _bounds_of(system))
    if not bounds.are_stated:
        return ""
    few, efforts = states.t[:0], dict[str, Array]()
    forces = plan.forces
    if forces is not None and bounds.efforts and is_first(forces, LimitTable):
        few = _some(states.t, _QUICK_EFFORTS)
        efforts = _efforts(plan, motion, few)
    columns = _columns_beyond(bounds, states)
    # Without efforts and followers, the entries beyond bounds decide which limits are named.
    if not (efforts or bounds.of_followers) and (
        b"\x01" not in columns or not is_first(nominal(system), (_Bounds, columns))
    ):
        return ""
    uses = LimitTable(tuple(_uses(system, states, few, efforts))).exceeded
    names = frozenset((use.limit.joint, use.limit.kind) for use in uses)
    if not names or not is_first(nominal(system), (LimitUse, names)):
        return ""
    words = [
        f"{use.limit.kind} of {use.limit.joint} by {use.excess:.3g} {use.unit} at t = {use.t:.3g} s"
        for use in uses
    ]
    return (
        f"'{system.name}' goes beyond the limits of its file, of which only stops='file' enforces "
        f"those of positions: {listed(words, 3)}, at report times (traj.limits looks between "
        "them, too)"
    )


class _Bounds(NamedTuple):
    """The limits of a robot's file as bounds of the fields of a state.

    Attributes:
        are_stated: Whether the file states a limit.
        x: Lowest and highest shapes, less and more by round-off, (2, nx) [rad | m | 1].
        xdot: The same of shape rates, (2, m) [rad/s | m/s].
        efforts: Whether a limit of an effort is stated.
        of_followers: Whether a follower, which is no entry of the state, has a limit.
    """

    are_stated: bool
    x: Array
    xdot: Array
    efforts: bool
    of_followers: bool


def _bounds_of(system: System) -> _Bounds:
    x, xdot = (np.tile([[-np.inf], [np.inf]], size) for size in (system.nx, system.m))
    joints, limits = {joint.name: joint for joint in system.space.joints}, limits_of(system)
    for limit in limits:
        joint = joints.get(limit.joint)
        if joint is not None and limit.kind == "position":
            x[:, joint.x] = [[limit.lower], [limit.upper]]
        elif joint is not None and limit.kind == "rate":
            xdot[:, joint.v] = [[limit.lower], [limit.upper]]
    for low, high in (x, xdot):
        low -= _ROUND_OFF * np.maximum(np.abs(low), 1e-3)
        high += _ROUND_OFF * np.maximum(np.abs(high), 1e-3)
    efforts = any(limit.kind == "effort" for limit in limits)
    of_followers = any(limit.joint not in joints for limit in limits)
    return _Bounds(bool(limits), x, xdot, efforts, of_followers)


def _columns_beyond(bounds: _Bounds, states: ShapeState | State) -> bytes:
    """Return which entries of x and ẋ exceed their bounds, a byte 0 or 1 for each."""
    (low, high), (slow, fast) = bounds.x, bounds.xdot
    x: Array = ((states.x < low) | (states.x > high)).any(axis=0)
    xdot: Array = ((states.xdot < slow) | (states.xdot > fast)).any(axis=0)
    return x.tobytes() + xdot.tobytes()


def _uses(
    system: System, states: ShapeState | State, t_effort: Array, efforts: Mapping[str, Array]
) -> Iterator[LimitUse]:
    """Yield the use of each limit by states (T,), and by efforts at times t_effort."""
    t, limits = states.t, limits_of(system)
    if not limits:
        return
    position, rate = dict[str, Array](), dict[str, Array]()
    model = system.sorted_model
    q = system.sorted_q(system.group.identity(), states.x)
    v = system.sorted_v(np.zeros((len(t), system.r)), states.xdot)
    for name in {limit.joint for limit in limits}:
        joint = model.joints[model.getJointId(name)]
        position[name], rate[name] = q[:, joint.idx_q], v[:, joint.idx_v]
    units = dict(zip(system.shape_names, system.units, strict=True))
    for limit in limits:
        angle = units.get(limit.joint, "rad") == "rad"
        values, times = {
            "position": (position.get(limit.joint), t),
            "rate": (rate.get(limit.joint), t),
            "effort": (efforts.get(limit.joint), t_effort),
        }[limit.kind]
        if values is None:
            continue
        beyond = np.maximum(values - limit.upper, limit.lower - values)
        k = int(np.argmax(beyond))
        bound = limit.upper if values[k] >= limit.upper else limit.lower
        excess = float(beyond[k]) if beyond[k] > _ROUND_OFF * max(abs(bound), 1e-3) else 0.0
        unit = {
            "position": "rad" if angle else "m",
            "rate": "rad/s" if angle else "m/s",
            "effort": "N·m" if angle else "N",
        }[limit.kind]
        extremes = float(values.min()), float(values.max())
        yield LimitUse(limit, unit, *extremes, excess, float(times[k]))


def _efforts(plan: Plan, motion: Motion, t: Array) -> dict[str, Array]:
    """Return what drives the joints at times (T,), {joint: (T,)} [N·m | N].

    Prescribed joints need their driving torques.  Other joints are driven by the forces of the
    scene without springs, dampers and friction, which no motor exerts.
    """
    forces = plan.forces
    if forces is None:
        return {}
    from ..forces.force_model_cache import cached_force_model
    from ..forces.kinds import Damper, Friction, Spring
    from .balances import driving_torques

    scene, space, efforts = plan.scene, plan.system.space, dict[str, Array]()
    samples, numbers = motion.samples(t)
    own_forces = list_forces(scene.forces)
    passive = [force for force in own_forces if isinstance(force, (Spring, Damper, Friction))]
    if len(passive) < len(own_forces) or scene.controls:
        torque = forces.acting(samples.force_inputs(t, numbers)).torque
        if passive or scene.springs or scene.own_forces:
            model = cached_force_model(
                scene.system, scene.springs, [*passive, *scene.own_forces], {}, scene.varied
            ).with_values(scene.parameters)
            own_numbers = np.tile(model.numbers_from(0.0, scene.end), (len(t), 1))
            torque = torque - model.acting(samples.force_inputs(t, own_numbers)).torque
        for joint in space.joints:
            column = torque[:, joint.v]
            if joint.kind.m == 1 and column.any():
                efforts[joint.name] = column[:, 0]
    driven = driving_torques(plan, t, samples, numbers)
    for k, column in zip(plan.driven, driven.T, strict=True):
        efforts[plan.system.shape_names[k]] = column
    return efforts


def _some(t: Array, most: int) -> Array:
    """Return at most `most` of the times, with the first and the last."""
    if len(t) <= most:
        return t
    return np.asarray(t[np.unique(np.linspace(0, len(t) - 1, most).round().astype(int))])


def _relative(use: LimitUse) -> float:
    limit = use.limit
    bound = limit.upper if use.greatest - limit.upper >= limit.lower - use.least else limit.lower
    return use.excess / max(abs(bound), 1e-300)


def _cells(use: LimitUse) -> Sequence[str]:
    limit = use.limit
    values = (limit.lower, limit.upper, use.least, use.greatest, use.excess)
    numbers = [f"{value:.4g}" for value in values]
    return limit.joint, f"{limit.kind} [{use.unit}]", *numbers, f"{use.t:.4g}"
