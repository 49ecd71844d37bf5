"""Simulation with joint stops: a sequence of modes, and the impacts between them.

A mode is a set of joints that rest at their stops. Within a mode, the motion is that of the system
with these joints locked: a smaller shape space with the same symmetry group and momentum. The
integration of a mode ends when another joint reaches its stop, or when the reaction of a stop would
pull. Between two integrations, only canonical momenta of the joints at their stops change. The base
variables of the reduced state are copied, so not even round-off changes the spatial momentum.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array, read_only
from ..common.errors import InputError, IntegrationError
from ..common.names import listed
from ..common.parameter import Parameter
from ..common.waiting import Progress
from ..forces.switch_times import time_within
from ..forces.tracking import ComputedTorque, ComputedTorqueAtRest
from ..reduction.pointwise_reduction import PointwiseReduction, symmetric
from ..scene.parse_options import list_forces
from ..scene.scene import Scene
from ..scene.stop import BallBound, Bound, place
from ..system.coordinates import Indices
from ..system.loops.kinematics import loop_jacobian
from ..system.state_fields import ShapeState, State
from ..system.system import System
from .balances import driving_torques
from .checkpoint import Checkpoint, Part
from .compiled.compiled_flow import CompiledFlow
from .events import RootSearch, Watch, cut_at
from .impacts import (
    Impact,
    ImpactTable,
    bernstein,
    first_root,
    impulses,
    solve_complementarity,
    table_of,
)
from .motion import Control, ControlAction, Motion, Solver
from .plan import Plan, plan_of
from .reduced_flow import Integrate, ModeFlow, ReducedFlow, Sample, Segment

_ROUND_OFF = 4.0 * float(np.finfo(float).eps)  # of a position, relative
_LEAST_GAP = 1e-18  # Smallest margin of a gap, for stops at zero [rad | m].
_CLINGING = 1e-14  # Pull of a stop that counts as round-off, per kinetic energy [1/rad | 1/m].
_AT_REST = 1e-13  # Rate at a stop that counts as zero, relative to the largest rate.
_SLOW = 1e-3  # Rebound above which round-off of a position cannot sustain it [rad/s | m/s].
_DEPENDENT = 1e-9  # Eigenvalue of scaled metrics below which motions of joints are dependent.
_MOST_AT_ONCE = 100  # Largest number of successive impacts without time between them.
_CHUNK = 8  # Number of steps after which stops are first looked for.
MOST_IMPACTS = 100_000  # Largest number of impacts of one run.

Rest = tuple[Bound, ...]


@dataclass(frozen=True, eq=False)
class Mode:
    """The motion with some joints at rest at their stops.

    Attributes:
        rest: The stops at which joints rest.
        moving: Bounds of the other joints.
        start: Flow of the mode, with a meaningless state.
        integrate: Integrator of the flow.
    """

    rest: Rest
    moving: tuple[Bound, ...]
    start: ModeFlow
    integrate: Integrate

    @property
    def label(self) -> str:
        """The joints at rest in words."""
        if not self.rest:
            return "no joint at rest"
        return listed([f"{bound.joint} at its {bound.side} stop" for bound in self.rest], 8)


@dataclass(frozen=True)
class Phase:
    """A part of a motion without impacts inside.

    Attributes:
        mode: The mode.
        start: Start time [s].
        flow: Flow from the state at the start.
        impact: The impact at the start, or None.
        segments: The segments.
        numbers: Force parameters of the scene, without locked joints, in each segment.
    """

    mode: Mode
    start: float
    flow: ModeFlow
    impact: Impact | None
    segments: list[Segment] = field(default_factory=list)
    numbers: list[Array] = field(default_factory=list)


class StoppedMotion(Motion):
    """A motion with stops: segments of several flows.

    At the time of an impact, the state is that before it. Force parameters are those of the scene,
    without locked joints.
    """

    def __init__(
        self,
        phases: Sequence[Phase],
        before: ModeFlow,
        watch: Watch | None,
        actions: Sequence[ControlAction],
        building: float,
    ) -> None:
        """Store a motion.

        Args:
            phases: The phases, in order of time.
            before: Flow from the initial state, before an impact at the start.
            watch: Detection of events.
            actions: Calls of the controllers.
            building: Wall time for kernels of modes [s], which are built once.
        """
        self.building = building
        segments = [segment for phase in phases for segment in phase.segments]
        super().__init__(before, segments, varies=True, actions=actions, watch=watch)
        self._phases, self._before = phases, before
        # Reduced states of all modes are filled up with zeros to one length.
        self._width = max(len(phase.flow.y0) for phase in phases)
        self._of_segment = [phase for phase in phases for _ in phase.segments]
        self._own_numbers = [numbers for phase in phases for numbers in phase.numbers]

    @cached_property
    def impacts(self) -> ImpactTable:
        """The impacts."""
        impacts, momenta, flow, y = [], [], self._before, self._before.y0
        parameters = flow.parameters
        for phase in self._phases:
            after, segments = phase.flow, phase.segments
            first = segments[0].parameters if segments else after.parameters
            if phase.impact is not None:
                t = np.array([phase.start])
                states = [flow.states(t, y[None], parameters)]
                states.append(after.states(t, after.y0[None], first))
                impacts.append(phase.impact)
                momenta.append([momentum_of(state, flow.system) for state in states])
            flow, y, parameters = after, after.y0, first
            for last in segments[-1:]:
                y, parameters = last.at(np.array([last.end]))[0], last.parameters
        shape = len(impacts), 2, self._before.system.r
        return table_of(impacts, np.array(momenta).reshape(shape))

    @property
    def work_of_drives(self) -> tuple[Array, Array]:
        """Times of the impacts, and the work of the drives in each; see Motion."""
        impacts = [phase.impact for phase in self._phases if phase.impact is not None]
        work = [impact.work_of_drives for impact in impacts]
        return np.array([impact.t for impact in impacts]), np.array(work)

    @property
    def phases(self) -> Sequence[Phase]:
        """The parts of the motion without impacts inside, in order of time."""
        return self._phases

    @property
    def modes(self) -> tuple[tuple[float, str], ...]:
        """Start time [s] and name of each mode, in order of time."""
        modes: list[tuple[float, str]] = []
        for phase in self._phases:
            if not modes or modes[-1][1] != phase.mode.label:
                modes.append((phase.start, phase.mode.label))
        return tuple(modes)

    @property
    def step_spans(self) -> tuple[Array, Array]:
        """Starts and ends of all steps; see Motion.step_spans."""
        starts = self.knots[:-1].copy()
        jumps = np.isin(starts, [phase.start for phase in self._phases])
        starts[jumps] = np.nextafter(starts[jumps], np.inf)
        return starts, self.knots[1:]

    def flow_of(self, k: int) -> ReducedFlow:
        """Return the flow of segment k."""
        return self._of_segment[k].flow

    def _numbers(self, k: int) -> Array:
        return self._own_numbers[k]

    def resting(self, t: Array) -> Iterator[tuple[Rest, Indices]]:
        """Yield the stops at which joints rest; see Motion.resting."""
        for k, indices in self._by_segment(self._which(t)):
            yield self._of_segment[k].mode.rest, indices


def momentum_of(state: State | ShapeState, system: System) -> Array:
    """Return the spatial momentum (r,) of a single state; NaN if the base is left out."""
    if isinstance(state, State):
        return np.asarray(state.spatial_momentum[0])
    return np.full(system.r, np.nan)


class _StopSearch(RootSearch):
    """The search for the next impact or release in a mode.

    Within a step, the dense output of a gap is a polynomial. If its Bernstein coefficients are
    positive, it has no root, so no contact is missed. Reactions, and gaps of prescribed joints, are
    sampled like events.
    """

    def __init__(
        self, plan: Plan, degree: int, mode: Mode, flow: ModeFlow, numbers: Array, cling: float
    ) -> None:
        """Prepare the search from the start of a phase.

        Args:
            plan: The plan of the scene.
            degree: Degree of the dense output within a step.
            mode: The mode.
            flow: Its flow.
            numbers: Force parameters of the scene, (p,).
            cling: Pull of a stop that counts as round-off.
        """
        bounds, at = mode.moving, flow.position_entries
        has_entry = [bound.surface is None and bound.v in at for bound in bounds]
        self._polynomial = [k for k, is_own in enumerate(has_entry) if is_own]
        self._driven = [k for k, is_own in enumerate(has_entry) if not is_own]
        count = len(self._driven) + len(mode.rest)
        super().__init__(np.ones(count), range(count))
        self._plan, self._mode, self._flow, self._numbers = plan, mode, flow, numbers
        self._cling = cling
        self._columns = [at[bounds[k].v] for k in self._polynomial]
        self._sides = np.array([bound.sign for bound in bounds])
        positions = np.array([bound.position for bound in bounds])
        margins = np.array([margin_of(bound) for bound in bounds])
        self._offsets = margins - self._sides * positions
        self._nodes, self._bernstein = bernstein(degree)
        self.found: list[tuple[float, Bound]] = []

    def look(self, segment: Segment) -> bool:
        """Search the new steps of a segment; return whether an impact or a release was found."""
        if self.found or segment.end <= self._reached:
            return bool(self.found)
        knots = segment.knots
        step_ends = knots[max(int(np.searchsorted(knots, self._reached)) - 1, 0) :]
        if self._polynomial:
            self._search_steps(segment, step_ends)
        if self._sampled:
            functions = [*(self._mode.moving[k] for k in self._driven), *self._mode.rest]
            crossings = self.roots(segment, step_ends)
            self.found += [(root.t, functions[root.event]) for root in crossings if not root.rising]
        self._reached = segment.end
        self.found.sort(key=lambda root: root[0])
        return bool(self.found)

    def _search_steps(self, segment: Segment, step_ends: Array) -> None:
        """Find the first roots of gaps whose dense output is a polynomial in each step."""
        starts, lengths = step_ends[:-1], np.diff(step_ends)
        times = starts[:, None] + lengths[:, None] * self._nodes
        y = segment.at(times.ravel())[:, self._columns].reshape(*times.shape, -1)
        gaps = self._sides[self._polynomial] * y + self._offsets[self._polynomial]
        coefficients = self._bernstein @ gaps
        for step in np.flatnonzero((coefficients <= 0.0).any(axis=(1, 2))).tolist():
            for k in np.flatnonzero((coefficients[step] <= 0.0).any(axis=0)).tolist():
                fraction = first_root(coefficients[step, :, k])
                if fraction is not None:
                    time = float(starts[step] + fraction * lengths[step])
                    self.found.append((time, self._mode.moving[self._polynomial[k]]))
            if self.found:
                return

    def values(self, segment: Segment, t: Array) -> Array:
        """Return the gaps of prescribed joints and the reactions of resting ones, (E, T)."""
        samples = self._flow.samples(t, segment.at(t), segment.parameters)
        x = np.array([self._mode.moving[k].values(samples.x) for k in self._driven])
        gaps = self._sides[self._driven, None] * x.reshape(-1, len(t))
        gaps += self._offsets[self._driven, None]
        if not self._mode.rest:
            return np.asarray(gaps)
        reactions = reactions_of(self._plan, self._mode.rest, t, samples, self._numbers)
        return np.asarray(np.vstack([gaps, reactions.T + self._cling]))


def margin_of(bound: Bound) -> float:
    """Return the gap that counts as contact [rad | m]."""
    # Other values than positions are sums, such as the angles of a quaternion of length one.
    size = abs(bound.position) if bound.surface is None else max(4.0, abs(bound.position))
    return max(_ROUND_OFF * size, _LEAST_GAP)


def reactions_of(plan: Plan, rest: Rest, t: Array, samples: Sample, numbers: Array) -> Array:
    """Return the reactions of the stops at which joints rest, away from the stops, (T, R).

    Args:
        plan: The plan of the scene.
        rest: The stops.
        t: Times, (T,) [s].
        samples: States that forces depend on.
        numbers: Force parameters of the scene, (p,).
    """
    torques = driving_torques(plan, t, samples, np.tile(numbers, (len(t), 1)), rest)
    return np.asarray(torques[:, len(plan.driven) :])


def locked_scene(
    scene: Scene,
    rest: Rest,
    x: Array,
    xdot: Array,
    places: Sequence[float | Parameter] | None = None,
) -> Scene:
    """Return a scene without stops in which some joints rest at their stops.

    Hinges and slides are locked.  The attitudes of balls are on a surface, like joints in loops.

    Args:
        scene: The scene.
        rest: The stops.
        x: Shape with these joints at their stops, (nx,) [rad | m | 1].
        xdot: Its rate, (m,).
        places: Positions of the joints [rad | m]; None for those of the stops.
    """
    start, names = scene.start, scene.system.shape_names
    at = [bound.position for bound in rest] if places is None else places
    surfaces = tuple(bound.surface for bound in rest if bound.surface is not None)
    plans = {
        names[bound.v]: place
        for bound, place in zip(rest, at, strict=True)
        if bound.surface is None
    }
    resting = frozenset(bound.v for bound in rest)
    forces = [
        ComputedTorqueAtRest(**vars(force), resting=resting)
        if isinstance(force, ComputedTorque)
        else force
        for force in list_forces(scene.forces)
    ]
    system = scene.system.on_surfaces(surfaces) if surfaces else scene.system
    return replace(
        scene, system=system, x0=x, xdot0=xdot, xi0=start.xi, pose0=start.pose, momentum=None,
        seed=None, keyframe=None, q0=None, v0=None, prescribed={**scene.prescribed, **plans},
        forces=forces,
    )  # fmt: skip


@dataclass(frozen=True)
class _State:
    """A state between two phases.

    Attributes:
        t: Time [s].
        flow: Flow that leads to this state.
        y: Reduced state, (k,).
        parameters: Parameters of the flow at this time, (p,).
    """

    t: float
    flow: ModeFlow
    y: Array
    parameters: Array

    @cached_property
    def values(self) -> tuple[Array, Array, Array]:
        """Shape, its rate, and its canonical momenta."""
        return self.flow.canonical_momenta(self.t, self.y, self.parameters)


@dataclass(frozen=True)
class _Contact:
    """Stops that joints touch at one time.

    Attributes:
        bounds: The stops.
        u: Rates away from the stops, (K,).
        G: Inverse reduced metric with the signs of the stops, (K, K).
        may_rest: Whether each joint may rest: False for those that are just released, (K,).
    """

    bounds: Rest
    u: Array
    G: Array
    may_rest: NDArray[np.bool_]


class RunWithStops:
    """One run with stops."""

    def __init__(
        self,
        plan: Plan,
        progress: Progress | None,
        solver: Solver,
        checkpoint: Checkpoint | None,
    ) -> None:
        """Prepare the run.

        Args:
            plan: The plan, whose scene has stops.
            progress: Called repeatedly with the completed fraction of the time, 0 to 1.
            solver: The engine.
            checkpoint: Checkpoint that the run continues and updates; or None. All parts are
                repeated from their saved integrations, which takes little time.
        """
        self._solver = solver
        self.plan, self.scene, self.bounds = plan, plan.scene, plan.scene.bounds
        self.progress, self.system = progress, plan.system
        self._free = replace(self.scene, stops=None, events=())
        free_plan = self._limited(self._free)
        self.first: ModeFlow = solver.flow(free_plan)
        integrate = solver.integrator(self.first, free_plan, progress, _CHUNK)
        self._modes: dict[Rest, Mode] = {(): Mode((), self.bounds, self.first, integrate)}
        tree = self.system.open_tree()
        self._reduction = tree.workspace(PointwiseReduction, lambda: PointwiseReduction(tree))
        # Rates that impacts change, and the index of each rate among them.
        self._rates = list(plan.free)
        self._impacts, self._at_once, self._building = 0, 0, 0.0
        watched = self.scene.watched
        self._watch = None if watched is None else Watch(self.scene, self.first, watched)
        # Force parameters of the scene, which controllers change.
        self._control, self._numbers = Control(self.scene), self.first.numbers.copy()
        self.record = (
            None if checkpoint is None else checkpoint.run(cast(CompiledFlow, self.first), plan)
        )

    def _limited(self, scene: Scene) -> Plan:
        return plan_of(scene).limited(self.plan.longest, self.plan.stops[:-1])

    def mode(self, rest: Rest, x: Array, xdot: Array) -> Mode:
        """Return a mode, built at its first use for a state with these joints at rest."""
        mode = self._modes.get(rest)
        if mode is None:
            began = time.perf_counter()
            locked = {bound.v for bound in rest if bound.surface is None}
            plan = self._limited(locked_scene(self._free, rest, x, xdot))
            flow = self.first.in_mode(plan)
            moving = tuple(b for b in self.bounds if not (b in rest or locked.issuperset(b.rates)))
            integrate = self._solver.integrator(flow, plan, self.progress, _CHUNK)
            mode = self._modes[rest] = Mode(rest, moving, flow, integrate)
            self._building += time.perf_counter() - began
        return mode

    def motion(self) -> StoppedMotion:
        """Integrate from impact to impact."""
        end, phases = self.scene.end, list[Phase]()
        x = self._free.start.x
        touching = [bound for bound in self.bounds if self._gap(bound, x) <= 0.0]
        state = _State(0.0, self.first, self.first.y0, self.first.parameters)
        phase = Phase(self._modes[()], 0.0, self.first, None)
        if touching:
            phase = self._resolve(state, (), touching, released=())
        while True:
            phases.append(phase)
            state, search = self._follow(phase)
            if state.t >= end or search is None:
                calls = self._control.calls
                return StoppedMotion(phases, self.first, self._watch, calls, self._building)
            phase = self._next(state, phase.mode, search)

    def _follow(self, phase: Phase) -> tuple[_State, _StopSearch | None]:
        """Integrate a phase to the next impact or release; without a search, it ends the motion."""
        flow, mode, t, y = phase.flow, phase.mode, phase.start, phase.flow.y0
        parameters = flow.parameters_between(t, self._stop_after(t))
        cling = self._cling(flow, t, y, parameters) if mode.rest else 0.0
        if self._watch is not None:
            self._watch.flow = flow
        while t < self.scene.end:
            stop = self._control.begin(
                self._numbers, t, self._stop_after(t), partial(flow.sample, t, y, parameters)
            )
            numbers = read_only(self._numbers.copy())
            parameters = read_only(self._commanded(flow, t, stop))
            search = _StopSearch(self.plan, self._solver.degree, mode, flow, numbers, cling)
            if self.record is not None:
                self.record.repeat(Part(t, stop, read_only(y), parameters))
            segment = mode.integrate(t, stop, read_only(y), parameters, search.look, self.record)
            is_hit = search.look(segment)
            if self.record is not None and segment.end < stop:
                self.record.interrupt()
            segments = cut_at(search.found[0][0], segment, mode.integrate) if is_hit else [segment]
            if not segments and segment.end == stop <= t + self.scene.rtol * self.scene.end:
                segments, is_hit = [segment], False  # too short for a gap above round-off
            self._at_once = 0 if segments else self._at_once + 1
            if self._at_once > _MOST_AT_ONCE:
                raise IntegrationError(
                    f"stops: '{self.system.name}' cannot leave its stop at t = {t:g} s. Increase "
                    "rest_rate, or loosen the tolerances"
                )
            if not segments:  # A force that jumps, or another impact, acts on a joint at its stop.
                return _State(t, flow, y, parameters), search
            for new_segment in segments:
                ended = self._watch is not None and self._watch.look(new_segment)
                if ended and self._watch is not None and self._watch.end is not None:
                    t = self._watch.end.t
                    cut = cut_at(t, new_segment, mode.integrate)
                    phase.segments.extend(cut)
                    phase.numbers.extend([numbers] * len(cut))
                    return _State(t, flow, y, parameters), None
                phase.segments.append(new_segment)
                phase.numbers.append(numbers)
            t = segments[-1].end
            y = np.array(segments[-1].at(np.array([t]))[0])
            if is_hit:
                return _State(t, flow, y, parameters), search
        return _State(t, flow, y, parameters), None

    def _commanded(self, flow: ModeFlow, t: float, stop: float) -> Array:
        """Return the parameters of a mode's flow from t to a stop, with held commands."""
        parameters = flow.parameters_between(t, stop)
        forces, of_mode = self.plan.forces, flow.forces
        if forces is not None and of_mode is not None:
            numbers = parameters[flow.numbers_at]
            for (_, where), (_, target) in zip(forces.held, of_mode.held, strict=True):
                numbers[target] = self._numbers[where]
        return parameters

    def _next(self, state: _State, mode: Mode, search: _StopSearch) -> Phase:
        """Return the phase after an impact or a release."""
        x, xdot, _ = state.values
        first, within = search.found[0][0], self.scene.rtol * self.scene.end
        together = {bound for time, bound in search.found if time <= first + within}
        released = tuple(bound for bound in mode.rest if bound in together)
        touching = [
            bound
            for bound in mode.moving
            if (gap := self._gap(bound, x)) <= 0.0
            or bound in together
            or gap <= -float(bound.normal(x, len(xdot)) @ xdot) * within
        ]
        self._refuse_driven(touching, state.t)
        return self._resolve(state, mode.rest, touching, released)

    def _refuse_driven(self, touching: Sequence[Bound], t: float) -> None:
        for bound in touching:
            if {*bound.rates} & {*self.plan.driven}:
                raise InputError(
                    f"prescribed: the motion of joint '{bound.joint}' runs into its {bound.side} "
                    f"stop at t = {t:g} s. Change its motion, or omit its stop"
                )

    def _resolve(
        self, state: _State, rest: Rest, touching: Sequence[Bound], released: Rest
    ) -> Phase:
        """Apply the impact at the stops that joints touch, and choose the joints that rest."""
        x, xdot, pi = map(np.copy, state.values)
        among = {*rest, *touching}
        bounds = tuple(bound for bound in self.bounds if bound in among)
        _refuse_undefined(bounds, x, state.t)
        place(bounds, x)
        normals = np.array([b.normal(x, len(pi)) for b in bounds]).reshape(-1, len(pi))
        inverse = self._inverse_metric(x, normals[:, self._rates])
        G = normals[:, self._rates] @ inverse
        self._refuse_dependent(bounds, G, state.t)
        small = _AT_REST * float(np.abs(xdot).max(initial=0.0))
        u = normals @ xdot
        u[[bound in rest for bound in bounds]] = 0.0
        may_rest = np.array([bound not in released for bound in bounds])
        contact = _Contact(bounds, np.where(np.abs(u) <= small, 0.0, u), 0.5 * (G + G.T), may_rest)
        impulse, after, resting = self._outcome(state, contact, x, xdot, inverse)
        pi += impulse @ normals
        rates = xdot.copy()
        rates[self._rates] += inverse @ impulse
        if self.system.loops or any(bound.surface is not None for bound in rest):
            pi = self._momenta_in_loops(state, x, rates)
        rests = tuple(b for b, stays in zip(bounds, resting, strict=True) if stays)
        rates[[b.v for b in rests if b.surface is None]] = 0.0
        new = self.mode(rests, x, rates)
        flow = new.start.resumed(state.t, x, pi, state.flow, state.y)
        impact = None
        if impulse.any():
            lost = -0.5 * impulse * (contact.u + after) + 0.0  # never −0
            work = self._work_of_drives(state, x, rates, float(lost.sum()))
            impact = _impact(state.t, contact, impulse, after, lost, work)
        self._count(impact, state.t)
        return Phase(new, state.t, flow, impact)

    def _outcome(
        self, state: _State, contact: _Contact, x: Array, xdot: Array, inverse: Array
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the impulses, the rates after them, and the joints that rest, (K,) each.

        Slow rebounds become rest if the joint stays at its stop. Whether it does depends on the
        other joints, so the decision is repeated without those that leave. At a contact, the joint
        is moved to its stop, which is a lift by round-off that can sustain a very slow rebound.
        Such a rebound becomes rest, too.
        """
        bounds, u, G = contact.bounds, contact.u, contact.G
        e = np.array([bound.stop.restitution for bound in bounds])
        slowest = np.array([bound.stop.rest_rate for bound in bounds])
        positions = np.array([abs(bound.position) for bound in bounds])
        allowed = self.scene.atol + self.scene.rtol * np.maximum(1.0, positions)
        sustained = 2.0 * np.array([margin_of(bound) for bound in bounds])
        sustained *= np.where(e < 1.0, e**2 / np.maximum(1.0 - e**2, _ROUND_OFF), 0.0)
        usual = impulses(G, u, e)
        rebound = np.where(usual > 0.0, -e * u, u + G @ usual)
        slow = contact.may_rest & (rebound <= np.maximum(slowest, _SLOW))
        if not slow.any():
            return usual, rebound, slow
        while True:
            chosen, impulse, after = np.flatnonzero(slow), usual.copy(), rebound.copy()
            block = G[np.ix_(chosen, chosen)]
            if rebound[chosen].any():  # project the rates onto those of resting joints
                removed = np.linalg.solve(block, -rebound[chosen])
                impulse[chosen] += removed
                after += G[:, chosen] @ removed
            after[chosen] = 0.0
            resting = np.zeros(len(bounds), dtype=bool)
            height = np.full(len(bounds), np.inf)
            if chosen.size:
                rates = xdot.copy()
                rates[self._rates] += inverse @ impulse
                chosen_bounds = tuple(bounds[k] for k in chosen)
                resting[chosen], back = self._stays(state, chosen_bounds, block, x, rates)
                height[chosen] = rebound[chosen] ** 2 / (2.0 * np.maximum(back, 1e-300))
            leaves = slow & (rebound > slowest) & ~(resting & (height <= sustained))
            if not leaves.any():
                low = np.maximum(np.where(rebound <= slowest, allowed, 0.0), sustained)
                leaves = slow & (rebound > 0.0) & ~(resting & (height <= low))
            if not leaves.any():
                return impulse, after, resting
            slow &= ~leaves

    def _stays(
        self, state: _State, rest: Rest, G: Array, x: Array, xdot: Array
    ) -> tuple[NDArray[np.bool_], Array]:
        """Return which joints stay at their stops, and their accelerations back if they left.

        The accelerations a away from the stops and the reactions R obey a = G (R − R_locked) ≥ 0,
        R ≥ 0, and a or R is zero; R_locked are the reactions if all joints stay.
        """
        sample = self._sample(state, x, xdot)
        numbers = self._numbers.copy()
        if self.plan.forces is not None:
            self.plan.forces.set_span(numbers, time_within(state.t, self._stop_after(state.t)))
        t = np.array([state.t])
        locked = reactions_of(self.plan, rest, t, sample, numbers)[0]
        energy = self._energy(x, xdot, sample.xi[0])
        back = locked / np.diag(np.linalg.inv(G))
        if (locked >= -_CLINGING * energy).all():
            return np.ones(len(rest), dtype=bool), back
        return solve_complementarity(G, -G @ locked) > 0.0, back

    def _refuse_dependent(self, bounds: Rest, G: Array, t: float) -> None:
        """Reject stops of joints that loops, balls or followers make depend on each other.

        Raises:
            IntegrationError: The inverse reduced metric G of their gaps, (K, K), is singular.
        """
        may_depend = len(bounds) > 1 and any(bound.surface is not None for bound in bounds)
        if not bounds or not (self.system.loops or may_depend):
            return
        scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
        if np.linalg.eigvalsh(scale[:, None] * G * scale)[0] > _DEPENDENT:
            return
        names = listed([f"{bound.joint} at its {bound.side} stop" for bound in bounds], 8)
        cause = "loops" if self.system.loops else "balls and followers"
        raise IntegrationError(
            f"stops: the {cause} of '{self.system.name}' leave {names} no independent motions at "
            f"t = {t:g} s, so the reactions of these stops are not determined. Omit one of them"
        )

    def _momenta_in_loops(self, state: _State, x: Array, xdot: Array) -> Array:
        """Return the canonical momenta (m,) at a state whose rates keep the loops closed.

        The multipliers of the loops are impulses, too. Their gauge begins at zero again.
        """
        r, split = self.system.r, self._reduction.split(x)
        xi = self._sample(state, x, xdot).xi[0]
        return np.asarray(split.mass_matrix[r:] @ np.concatenate([xi, xdot]))

    def _sample(self, state: _State, x: Array, xdot: Array) -> Sample:
        """Return the sample at a state with other rates of the shape and the same momentum."""
        sample = state.flow.samples(np.array([state.t]), state.y[None], state.parameters)
        split = self._reduction.split(x)
        xi = sample.xi[0] + split.local_connection @ (sample.xdot[0] - xdot)
        base = sample.base
        if base is not None:
            base = replace(base, xi=base.xi + split.local_connection @ (sample.xdot[0] - xdot))
        return replace(sample, x=x[None], xdot=xdot[None], xi=xi[None], base=base)

    def _work_of_drives(self, state: _State, x: Array, rates: Array, lost: float) -> float:
        """Return the work that prescribed joints in motion do during an impact [J].

        Args:
            state: State before the impact.
            x: Its shape, (nx,).
            rates: Rates of the shape after the impact, (m,).
            lost: Energy that the stops remove [J].
        """
        _, before, _ = state.values
        if not before[list(self.plan.driven)].any():
            return 0.0
        energies = [self._energy(x, v, self._sample(state, x, v).xi[0]) for v in (before, rates)]
        return energies[1] - energies[0] + lost

    def _stop_after(self, t: float) -> float:
        later = self.plan.stops[self.plan.stops > t]
        return float(later[0]) if later.size else self.scene.end

    def _energy(self, x: Array, xdot: Array, xi: Array) -> float:
        """Return the kinetic energy relative to the centre of mass [J]."""
        return float(self._reduction.split(x).kinetic_energy(xdot, xi))

    def _cling(self, flow: ModeFlow, t: float, y: Array, parameters: Array) -> float:
        """Return the pull of a stop that counts as round-off [N·m | N]."""
        sample = flow.sample(t, y, parameters)
        return 2.0 * _CLINGING * self._energy(sample.x, sample.xdot, sample.xi)

    def _count(self, impact: Impact | None, t: float) -> None:
        self._impacts += impact is not None
        if self._impacts > MOST_IMPACTS:
            raise IntegrationError(
                f"stops: '{self.system.name}' has more than {MOST_IMPACTS} impacts before "
                f"t = {t:g} s. Increase rest_rate, or simulate a shorter time"
            )

    def _inverse_metric(self, x: Array, normals: Array) -> Array:
        """Return the inverse reduced metric of the rates that impacts change, times normals.

        It is the block of the inverse mass matrix that belongs to these rates. The multipliers of
        closed loops keep the rates in them compatible.

        Args:
            x: Shape, (nx,).
            normals: Rates of gaps per rate, (K, f).
        Returns:
            (f, K).
        """
        system, r = self.system, self.system.r
        q = system.sorted_q(system.group.identity(), x)
        upper = pin.crba(system.sorted_model, system.sorted_data, q)
        kept = np.array([*range(r), *(r + k for k in self._rates)])
        H = system.coupled_matrix(symmetric(upper))[np.ix_(kept, kept)]
        unit = np.vstack([np.zeros((r, len(normals))), normals.T])
        response = np.linalg.solve(H, unit)[r:]
        if system.closure is not None:
            J = loop_jacobian(system, x)[system.closure.rows][:, self._rates]
            of_loops = np.linalg.solve(H, np.vstack([np.zeros((r, len(J))), J.T]))[r:]
            response -= of_loops @ np.linalg.solve(J @ of_loops, J @ response)
        return np.asarray(response)

    @staticmethod
    def _gap(bound: Bound, x: Array) -> float:
        return bound.sign * (bound.values(x).item() - bound.position) - margin_of(bound)


def _impact(
    t: float, contact: _Contact, impulse: Array, after: Array, lost: Array, work: float
) -> Impact:
    """Return the rows of an impact; other arguments are those of Impact for all stops, (K,)."""
    hit = np.flatnonzero(impulse)
    bounds, u = [contact.bounds[k] for k in hit.tolist()], contact.u[hit]
    sign = np.array([bound.sign for bound in bounds])
    ratio = np.array([bound.ratio for bound in bounds])
    return Impact(
        t=t,
        joint=tuple(bound.joint for bound in bounds),
        side=tuple(bound.side for bound in bounds),
        impulse=sign * impulse[hit] / ratio,
        rates=np.array([sign * u, sign * after[hit]]) * ratio,
        energy_lost=lost[hit],
        work_of_drives=work,
    )


def _refuse_undefined(bounds: Iterable[Bound], x: Array, t: float) -> None:
    """Reject a ball at its twist stop whose swing reaches π.

    Args:
        bounds: The stops at which joints are.
        x: Shape, (nx,) [rad | m | 1].
        t: Time [s].
    Raises:
        IntegrationError: The twist of a ball is not defined.
    """
    for bound in bounds:
        if isinstance(bound, BallBound) and bound.is_undefined(x):
            raise IntegrationError(
                f"stops: the swing of ball joint '{bound.joint}' reaches π at t = {t:g} s, "
                "where its twist is not defined. Bound its swing as well, such as "
                "BallStop(twist=…, swing=3)"
            )
