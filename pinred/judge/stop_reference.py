"""The reference solution of a scene with joint stops: ABA between impacts, and its own impulses.

It shares nothing with the reduced simulation but the stops themselves. The state is the full one.
SciPy's DOP853 integrates it, contacts are found on its dense output, and an impact solves
H Δv = Eᵀλ with the full mass matrix of Pinocchio's CRBA, the rows E of the stops, and the rows of
followers and prescribed joints as constraints. Reactions of joints at rest are multipliers of ABA.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations
from typing import cast

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.switch_times import time_within
from ..scene.scene import Scene
from ..scene.stop import BallBound, BallStop, Stop
from ..simulation.motion import Replay
from ..simulation.trajectory import Trajectory
from ..system.loops.kinematics import LoopKinematics
from .full_system import RANK, mass_matrix
from .reference_integrators import AbaStopped, TimeBudget
from .reference_solution import PERTURBATION, FullMotion, FullState

_LEAST_RTOL = 2.3e-14  # tightest relative tolerance of SciPy's DOP853
_SAMPLES = 16  # number of times in a step at which gaps and reactions are evaluated
_SHORTER = 0.5 ** np.arange(1, 41)  # parts of an interval in which a joint may leave and return
_MOST_TRIED = 12  # largest number of stops for which all sets of impulses are tried
_SLOW = 1e-3  # rebound above which round-off of a position cannot sustain it [rad/s | m/s]
_LIFT = 4.0 * float(np.finfo(float).eps)  # of a joint by round-off at its stop, relative
_AFFECTED = 10.0  # ratio of speeds that this lift changes to the speed that it sustains
_CLINGING = 1e-14  # pull of a stop that counts as round-off, per kinetic energy [1/rad | 1/m]
NEVER = 1e300  # growth of perturbations after they change the order of impacts

Rows = tuple[int, ...]


@dataclass(frozen=True)
class StopRow:
    """One side of the stops of a joint, sign (value − position) ≥ 0.

    Attributes:
        joint: Name of the joint.
        side: "lower" or "upper".
        x: Index of its coordinate in the full state.
        v: Index of its rate among the velocities.
        sign: 1 for a lower stop, −1 for an upper one.
        position: Position of the stop [rad | m].
        stop: The stops of the joint.
        kind: "position", or the bounded angle of a ball: "angle", "swing" or "twist".
    """

    joint: str
    side: str
    x: int
    v: int
    sign: float
    position: float
    stop: Stop | BallStop
    kind: str = "position"

    @property
    def coordinates(self) -> slice:
        """Indices of the coordinates of the joint in the full state."""
        return slice(self.x, self.x + (1 if self.kind == "position" else 4))

    def values(self, y: Array) -> Array:
        """Return the bounded values at full states, (…)."""
        if self.kind == "position":
            return np.asarray(y[..., self.x])
        quaternions = y[..., self.coordinates].reshape(-1, 4)
        values = [self._angle(attitude_of(q)) for q in quaternions]
        return np.array(values).reshape(y.shape[:-1])

    def _angle(self, R: Array) -> float:
        """Return the bounded angle of a ball at an attitude [rad]."""
        if self.kind == "angle":
            return float(np.linalg.norm(pin.log3(R)))
        n = np.array(cast("BallStop", self.stop).axis)
        tilt, cosine = np.cross(n, R @ n), n @ R @ n
        sine = float(np.linalg.norm(tilt))
        if self.kind == "swing":
            return float(np.arctan2(sine, cosine))
        swing = pin.exp3(tilt / max(sine, 1e-300) * np.arctan2(sine, cosine))
        return float(n @ pin.log3(swing.T @ R))

    def rates(self, y: Array) -> Array:
        """Return the rate of the bounded value per rate of the joint, (1,) or (3,)."""
        if self.kind == "position":
            return np.ones(1)
        R = attitude_of(y[self.coordinates])
        if self.kind == "angle":
            turn = pin.log3(R)
            return np.asarray(turn / max(float(np.linalg.norm(turn)), 1e-300))
        n = np.array(cast("BallStop", self.stop).axis)
        parent = R.T @ n  # the axis of the parent in the child
        if self.kind == "swing":
            tilt = np.cross(parent, n)
            return np.asarray(tilt / max(float(np.linalg.norm(tilt)), 1e-300))
        return np.asarray((n + parent) / (1.0 + n @ parent))

    def turning(self, y: Array, omega: Array) -> float:
        """Return the second derivative of the bounded value of a ball at constant rates (3,)."""
        R, n = attitude_of(y[self.coordinates]), np.array(cast("BallStop", self.stop).axis)
        if self.kind == "angle":
            turn = pin.log3(R)
            length = np.linalg.norm(turn)
            unit, rate = turn / length, pin.Jlog3(R) @ omega
            return float((rate - (unit @ rate) * unit) @ omega / length)
        parent = R.T @ n
        rate = np.cross(parent, omega)
        if self.kind == "twist":
            size, direction = 1.0 + n @ parent, n + parent
            return float((rate / size - direction * (n @ rate) / size**2) @ omega)
        tilt, change = np.cross(parent, n), np.cross(rate, n)
        length = np.linalg.norm(tilt)
        unit = tilt / length
        return float((change - (unit @ change) * unit) @ omega / length)


def attitude_of(quaternion: Array) -> Array:
    """Return the rotation matrix of a quaternion (x, y, z, w) of any length."""
    unit = quaternion / np.linalg.norm(quaternion)
    return np.asarray(pin.Quaternion(unit).toRotationMatrix())


@dataclass(frozen=True)
class Hit:
    """An impulse on one joint.

    Attributes:
        t: Time [s].
        joint: Name of the joint.
        side: The stop, "lower" or "upper".
        impulse: Impulse on the joint [N·m·s | N·s].
        speed: Rate towards the stop before the impact [rad/s | m/s].
        pull: Size of the acceleration before the impact [rad/s² | m/s²].
    """

    t: float
    joint: str
    side: str
    impulse: float
    speed: float
    pull: float = 0.0


@dataclass(frozen=True)
class HybridSolution:
    """A solution with stops.

    Attributes:
        motion: The motion at the requested times.
        states: Full states at these times, (T, n).
        hits: Impulses, in order of time.
        grazes: Times [s] just before minima of gaps and slow impacts, with the change of position
            that adds or removes an impact [rad | m].
    """

    motion: FullMotion
    states: Array
    hits: list[Hit]
    grazes: list[tuple[float, float]]


class StoppedFullState(FullState):
    """The full state of a scene with stops, whose resting joints are locked by multipliers.

    Attributes:
        rows: The stops.
        at_rest: Stops at which joints rest in an own integration; None for those of a trajectory.
        lifted: Speed of impacts that round-off of positions changes, in the last solution but
            perturbed ones [rad/s | m/s].
    """

    def __init__(
        self,
        scene: Scene,
        resting: Callable[[float], Rows],
        budget: TimeBudget | None = None,
        replay: Replay | None = None,
    ) -> None:
        """Prepare the vector field.

        Args:
            scene: The scene.
            resting: Function from a time to the stops at which joints rest then.
            budget: Time limit of all runs together.
            replay: Recorded commands of controllers; None without controllers.
        """
        super().__init__(replace(scene, stops=None), replay, budget)
        self.rows = _rows_of(scene, self._size, self._r)
        self.at_rest: Rows | None = None
        self.lifted = 0.0
        self._rest_of = resting
        driven = np.zeros((len(self._driven), self._model.nv))
        driven[np.arange(len(self._driven)), self._r + np.array(self._driven, dtype=np.intp)] = 1.0
        self._constraints = np.vstack([self.couplings.J, driven])
        loops = scene.system.loops
        self._loops = LoopKinematics(self._model, loops) if loops else None

    def _rate(self, t: float, y: Array, axes: pin.Convention) -> Array:
        rate = super()._rate(t, y, axes)
        resting = self._rest_of(t) if self.at_rest is None else self.at_rest
        if not resting:
            return rate
        first = len(rate) - self._model.nv
        push = self.normals(resting, y).T @ self._reactions(y, rate[first:], resting)
        rate[first:] += self.response(self.q(y)) @ push
        return rate

    def _reactions(self, y: Array, free: Array, rest: Rows) -> Array:
        """Return the reactions that keep joints at rest, (K,), with accelerations without them."""
        normals, response = self.normals(rest, y), self.response(self.q(y))
        needed = normals @ free
        for k, side in enumerate(self.rows[side] for side in rest):
            if side.kind != "position":  # the direction of the gap turns with the ball
                first = len(y) - self._model.nv + side.v
                needed[k] += side.sign * side.turning(y, y[first : first + 3])
        return np.asarray(np.linalg.solve(normals @ response @ normals.T, -needed))

    @property
    def scene(self) -> Scene:
        """The scene, without its stops."""
        return self._scene

    @property
    def nv(self) -> int:
        """Number of velocities."""
        return int(self._model.nv)

    def limited_rate(self, t: float, y: Array, rest: Rows) -> Array:
        """Return dy/dt with joints at rest; raise AbaStopped at the end of the budget."""
        self.at_rest = rest
        try:
            return self._limited_rate(t, y)
        finally:
            self.at_rest = None

    def set_span(self, t: float, end: float, y: Array) -> float:
        """Set the parameters of forces after a time; return the time to which they apply [s]."""
        stop = next((float(stop) for stop in self._stops if stop > t), end)
        if self._replay is not None:
            parameters = self._parameters.copy()
            stop = self._replay.begin(parameters, t, stop, partial(self.sample, y))
            self.set_parameters(parameters)
        if self._forces is not None:
            self._forces.set_span(self._parameters, time_within(t, stop))
        return min(stop, end)

    def normals(self, rows: Rows, y: Array) -> Array:
        """Return the directions away from stops, as rows of the velocities, (K, nv)."""
        normals = np.zeros((len(rows), self._model.nv))
        for k, side in enumerate(self.rows[side] for side in rows):
            rates = side.rates(y)
            normals[k, side.v : side.v + len(rates)] = side.sign * rates
        return normals

    def mass_matrix(self, q: Array) -> Array:
        """Return Pinocchio's mass matrix at a configuration, (nv, nv)."""
        return mass_matrix(self._model, self.system.sorted_data, q)

    def kinetic_energy(self, y: Array) -> float:
        """Return the kinetic energy at a full state [J]."""
        v = y[-self.nv :]
        return float(0.5 * v @ self.mass_matrix(self.q(y)) @ v)

    def response(self, q: Array) -> Array:
        """Return the matrix from generalised impulses to changes of the velocity, (nv, nv)."""
        H, C = self.mass_matrix(q), self._constraints
        if self._loops is not None:  # the equations of loops may be redundant
            _, sizes, directions = np.linalg.svd(np.vstack([C, self._loops.jacobian(q)]))
            free = directions[int((sizes > RANK * sizes[0]).sum()) :]
            return np.asarray(free.T @ np.linalg.solve(free @ H @ free.T, free))
        inverse = np.linalg.inv(H)
        if not len(C):
            return np.asarray(inverse)
        return np.asarray(inverse - inverse @ C.T @ np.linalg.solve(C @ inverse @ C.T, C @ inverse))

    def reactions(self, t: float, y: Array, rows: Rows) -> Array:
        """Return the reactions of stops at which joints rest, away from the stops, (K,)."""
        self.at_rest = ()
        try:
            free = self.rate(t, y)[len(y) - self._model.nv :]
        finally:
            self.at_rest = None
        return self._reactions(y, free, rows)

    def gaps(self, y: Array) -> Array:
        """Return the gaps of all stops at full states, (…, R)."""
        gaps = [side.sign * (side.values(y) - side.position) for side in self.rows]
        return np.stack(gaps, axis=-1)

    def solve_with_stops(self, y0: Array, times: Array, rtol: float, atol: float) -> HybridSolution:
        """Integrate from impact to impact.

        Args:
            y0: Initial state, (n,).
            times: Increasing times, (T,) [s].
            rtol: Relative tolerance.
            atol: Absolute tolerance.
        Returns:
            The solution.
        Raises:
            AbaStopped: The end cannot be reached at this tolerance, or within the budget.
        """
        self.lifted = 0.0
        run = _HybridRun(self, times, rtol, atol)
        run.integrate(y0)
        return HybridSolution(self._motion(run.states), run.states, run.hits, run.grazes)

    def growth_with_stops(
        self, y0: Array, solution: HybridSolution, times: Array, rtol: float, atol: float
    ) -> tuple[Array, float]:
        """Compute the growth of a small perturbation, and until when it keeps the impacts.

        Args:
            y0: Initial state, (n,).
            solution: The unperturbed solution at `times`.
            times: Times, (T,) [s].
            rtol: Relative tolerance of the perturbed run.
            atol: Absolute tolerance of the perturbed run.
        Returns:
            Factors, (T,) non-decreasing, and the time of the first impact that differs [s].
        """
        perturbed = self.perturb(y0, self._scene.end, PERTURBATION)
        for side, gap, before in zip(self.rows, self.gaps(perturbed), self.gaps(y0), strict=True):
            if gap < 0.0 or before <= PERTURBATION:
                perturbed[side.coordinates] = y0[side.coordinates]
        perturbed = self._apply_couplings(perturbed)
        lifted = self.lifted
        other = self.solve_with_stops(perturbed, times, rtol, atol)
        distance = self.distance(solution.motion, other.motion).relative(self.size(solution.motion))
        growth = np.maximum.accumulate(np.maximum(1.0, distance / PERTURBATION))
        self.lifted = max(lifted, self.lifted)
        until = first_difference(solution.hits, other.hits, self.slowest)
        self.lifted = lifted
        return growth, until

    @property
    def slowest(self) -> float:
        """Speed below which impacts of an accumulation are not compared [rad/s | m/s]."""
        return max(self.lifted, *(10.0 * side.stop.rest_rate for side in self.rows))


def stopped_full_state(traj: Trajectory, budget: TimeBudget | None = None) -> StoppedFullState:
    """Return the full simulation of a trajectory's scene with its joint stops.

    Args:
        traj: The trajectory.
        budget: Time limit of all runs together.
    """

    def resting(t: float) -> Rows:
        rest, _ = next(iter(traj.motion.resting(np.array([t]))))
        return tuple(map(traj.scene.bounds.index, rest))

    return StoppedFullState(traj.scene, resting, budget, _commands(traj))


def _commands(traj: Trajectory) -> Replay | None:
    """Return the commands of the controllers of a trajectory, which change between impacts."""
    forces, motion = traj.scene.force_model, traj.motion
    if forces is None or not forces.held:
        return None
    ends = motion.segments.ends
    numbers = motion.numbers(ends)
    changes = np.any(np.diff(numbers, axis=0) != 0.0, axis=1)
    last = np.flatnonzero(np.append(changes, True))
    return Replay(ends[last], [numbers[k] for k in last])


class _HybridRun:
    """One integration with stops; see StoppedFullState.solve_with_stops."""

    def __init__(self, full: StoppedFullState, times: Array, rtol: float, atol: float) -> None:
        self.full, self.times, self.end = full, times, float(times[-1])
        self.rtol, self.atol = max(rtol, _LEAST_RTOL), atol
        self.hits: list[Hit] = []
        self.grazes: list[tuple[float, float]] = []
        self._recent: list[tuple[float, Array, Rows]] = []
        self.states = np.empty((len(times), 0))
        self._cling = 0.0  # pull of a stop that counts as round-off [N·m | N]

    def integrate(self, y: Array) -> None:
        """Integrate to the last time."""
        full, t = self.full, 0.0
        self.states = np.tile(y, (len(self.times), 1))
        rest: Rows = ()
        touching = tuple(np.flatnonzero(full.gaps(y) <= 1e-12).tolist())
        full.set_span(0.0, self.end, y)
        if touching:
            y, rest = self._impact(0.0, y, (), touching, ())
            self.states[self.times == 0.0] = y
        while t < self.end:
            t, y, functions = self._piece(t, y, rest)
            if functions:
                count = len(full.rows)
                released = tuple(rest[k - count] for k in functions if k >= count)
                touching = tuple(k for k in functions if k < count)
                y, rest = self._impact(t, y, rest, touching, released)

    def _functions(self, t: float, y: Array, rest: Rows) -> Array:
        """Return gaps of moving joints, 1 for resting ones, and reactions of resting ones."""
        gaps = self.full.gaps(y)
        gaps[list(rest)] = 1.0
        moving = {side.x for side in (self.full.rows[k] for k in rest) if side.kind == "position"}
        for k, side in enumerate(self.full.rows):
            if side.x in moving:
                gaps[k] = 1.0
        if not rest:
            return gaps
        return np.append(gaps, self.full.reactions(t, y, rest) + self._cling)

    def _function(self, k: int, dense: Callable[[float], Array], rest: Rows, t: float) -> float:
        return float(self._functions(t, dense(t), rest)[k])

    def _piece(self, t: float, y: Array, rest: Rows) -> tuple[float, Array, list[int]]:
        """Integrate to the next contact, release, switch of forces, or the end."""
        from scipy.integrate import DOP853
        from scipy.optimize import brentq

        full, reach = self.full, self.full.set_span(t, self.end, y)
        solver = DOP853(
            lambda s, z: full.limited_rate(s, z, rest), t, y, reach, rtol=self.rtol, atol=self.atol
        )
        self._cling = 2.0 * _CLINGING * full.kinetic_energy(y)
        before = self._functions(t, y, rest)
        small = 1e-12 * (1.0 + np.abs(before).max())
        pulls = np.flatnonzero(before[len(full.rows) :] < -small) + len(full.rows)
        if pulls.size:  # a force that jumps at this time pulls joints away from their stops
            return t, y, pulls.tolist()
        was = np.where(np.abs(before) <= small, 1.0, before)
        while True:
            message = solver.step()
            if solver.status == "failed":
                raise AbaStopped(f"the full simulation cannot be integrated: {message}", solver.t)
            dense, earlier, roots = solver.dense_output(), float(solver.t_old), []
            samples = np.linspace(solver.t_old, solver.t, _SAMPLES + 1)[1:].tolist()
            for s in samples:
                functions = self._functions(s, dense(s), rest)
                self._find_minima(s, functions, rest)
                crossed = np.flatnonzero((functions < 0.0) & (was > 0.0))
                for k in crossed.tolist():
                    function = partial(self._function, k, dense, rest)
                    # A gap that begins at zero may be positive for a short time only.
                    inside = earlier + (s - earlier) * _SHORTER
                    low = next((r for r in (earlier, *inside) if function(r) > 0.0), s)
                    root = brentq(function, low, s, xtol=1e-15, rtol=1e-14) if low < s else earlier
                    roots.append((float(root), k))
                if roots:
                    break
                was, earlier = np.where(functions > 0.0, functions, was), s
            stop = min(roots)[0] if roots else float(solver.t)
            passed = slice(*np.searchsorted(self.times, [solver.t_old, stop], side="right"))
            for k in range(passed.start, passed.stop):
                self.states[k] = dense(float(self.times[k]))
            if roots:
                return stop, dense(stop), [k for s, k in roots if s <= stop + 1e-13 * self.end]
            if solver.status == "finished":
                return float(solver.t), solver.y, []

    def _find_minima(self, t: float, values: Array, rest: Rows) -> None:
        """Store the minima of gaps, by parabolas through three samples of one mode."""
        count = len(self.full.rows)
        self._recent = [sample for sample in self._recent if sample[2] == rest][-2:]
        self._recent.append((t, values[:count], rest))
        if len(self._recent) < 3:
            return
        (a, first, _), (b, second, _), (c, third, _) = self._recent
        for k in np.flatnonzero((second < first) & (second < third) & (second > 0.0)).tolist():
            curve = np.polyfit([a - b, 0.0, c - b], [first[k], second[k], third[k]], 2)
            least = float(second[k] - curve[1] ** 2 / (4.0 * curve[0]))
            self.grazes.append((2.0 * a - c, max(least, 0.0)))

    def _impact(
        self, t: float, y: Array, rest: Rows, touching: Rows, released: Rows
    ) -> tuple[Array, Rows]:
        """Return the state after an impact or a release, and the joints that rest."""
        full, y = self.full, y.copy()
        lifts = np.array([max(_LIFT * abs(side.position), 1e-18) for side in full.rows])
        touching = tuple({*touching, *np.flatnonzero(full.gaps(y) <= lifts).tolist()} - {*rest})
        first, S = len(y) - full.nv, tuple(sorted({*rest, *touching}))
        self._recent.clear()
        rates = full.rate(t, y)[first:]
        v, sides = y[first:].copy(), [full.rows[k] for k in S]
        normals, response = full.normals(S, y), full.response(full.q(y))
        G, u = normals @ response @ normals.T, normals @ v
        u[[k in rest for k in S]] = 0.0
        for k in touching:  # the depth that the joint would reach without its stop
            speed, pull = normals[S.index(k)] @ v, normals[S.index(k)] @ rates
            if speed < 0.0 < pull and -speed > self.full.slowest:
                self.grazes.append((float(t + 2.0 * speed / pull), float(speed**2 / (2.0 * pull))))
        last, within = self.hits[-1] if self.hits else None, full.scene.rtol * self.end
        if last is not None and touching and 1e-13 * self.end < t - last.t <= within:
            # The simulation takes them as one impact, whose impulses may differ from those of two.
            self.grazes.append((last.t, 0.0))
        e = np.array([side.stop.restitution for side in sides])
        usual = complementary(G, (1.0 + e) * u)
        rebound = np.where(usual > 0.0, -e * u, u + G @ usual)
        scene, energy = full.scene, full.kinetic_energy(y)
        chosen = [
            k
            for k, side in enumerate(sides)
            if rebound[k] <= max(side.stop.rest_rate, _SLOW) and S[k] not in released
        ]
        slow = rebound <= [side.stop.rest_rate for side in sides]
        # Round-off of the position sustains rebounds of this height; a stop at zero has none.
        least = np.array([2.0 * _LIFT * abs(side.position) for side in sides])
        least *= np.where(e < 1.0, e**2 / np.maximum(1.0 - e**2, _LIFT), 0.0)
        usual_least = [scene.atol + scene.rtol * max(1.0, abs(side.position)) for side in sides]
        height = np.where(slow, np.maximum(least, usual_least), least)
        while True:
            impulse, block = usual.copy(), G[np.ix_(chosen, chosen)]
            impulse[chosen] -= np.linalg.solve(block, rebound[chosen])
            y[first:] = v + response @ normals.T @ impulse
            locked_sides = tuple(S[k] for k in chosen)
            locked = full.reactions(t, y, locked_sides) if locked_sides else np.empty(0)
            stays = complementary(block, -block @ locked) > 0.0
            stays |= (locked >= -_CLINGING * energy).all()
            back = locked / np.diag(np.linalg.inv(block)) if locked_sides else locked
            leaves = [
                k
                for k, stay, a in zip(chosen, stays, back, strict=True)
                if rebound[k] > 0.0 and not (stay and rebound[k] ** 2 / (2.0 * a) <= height[k])
            ]
            if not leaves:
                fast = [abs(u[k]) for k in chosen if rebound[k] > 0.0 and not slow[k]]
                self.full.lifted = max([self.full.lifted, *(_AFFECTED * speed for speed in fast)])
                break
            leaves = [k for k in leaves if not slow[k]] or leaves
            chosen = [k for k in chosen if k not in leaves]
        for k, side in enumerate(sides):
            if impulse[k]:
                strength = side.sign * float(impulse[k])
                pull = float(abs(normals[k] @ rates))
                self.hits.append(Hit(t, side.joint, side.side, strength, float(-u[k]), pull))
        for side in sides:
            if side.kind == "position":
                y[side.x] = side.position
        return y, tuple(side for side, stay in zip(locked_sides, stays, strict=True) if stay)


def _rows_of(scene: Scene, size: int, r: int) -> list[StopRow]:
    """Return the stops of a scene, for full states with `size` root coordinates."""
    joints = {joint.name: joint for joint in scene.system.tree.joints}
    sides = []
    for bound in scene.bounds:
        joint = joints[bound.joint]
        at = size + joint.x.start, r + joint.v.start
        if isinstance(bound, BallBound):
            place = bound.sign, bound.position
            sides.append(StopRow(bound.joint, bound.side, *at, *place, bound.stop, bound.kind))
            continue
        assert isinstance(bound.stop, Stop)
        sign = bound.sign * (1.0 if bound.ratio > 0.0 else -1.0)
        position = bound.stop.lower if sign > 0.0 else bound.stop.upper
        sides.append(StopRow(joint.name, bound.side, *at, sign, position, bound.stop))
    return sides


def complementary(G: Array, q: Array) -> Array:
    """Solve G z + q ≥ 0, z ≥ 0, z · (G z + q) = 0 by trying sets of positive entries.

    For many entries, projected relaxation finds the set.

    Args:
        G: Positive definite matrix, (K, K).
        q: Right side, (K,).
    Returns:
        z, (K,).
    """
    K = len(q)
    if K > _MOST_TRIED:
        z = np.zeros(K)
        for _ in range(10_000):
            for k in range(K):
                z[k] = max(0.0, z[k] - (G[k] @ z + q[k]) / G[k, k])
        sets: Sequence[Sequence[int]] = [np.flatnonzero(z > 0.0).tolist()]
    else:
        sets = list(chain.from_iterable(combinations(range(K), k) for k in range(K + 1)))
    best, least = np.zeros(K), np.inf
    for chosen in map(list, sets):
        z = np.zeros(K)
        if chosen:
            z[chosen] = np.linalg.solve(G[np.ix_(chosen, chosen)], -q[chosen])
        violation = -float(np.concatenate([z, G @ z + q]).min(initial=0.0))
        if violation < least:
            best, least = z, violation
    return best


def first_difference(hits: Sequence[Hit], others: Sequence[Hit], slowest: float) -> float:
    """Return the time of the first impact that only one of two motions has, or inf.

    Slow impacts, with which an accumulation ends, may be missing in either.

    Args:
        hits: Impulses of one motion.
        others: Impulses of the other.
        slowest: Speed below which an impact may be missing [rad/s | m/s].
    """
    return matched(hits, others, slowest)[1]


def matched(
    hits: Sequence[Hit], others: Sequence[Hit], slowest: float
) -> tuple[list[tuple[Hit, Hit]], float]:
    """Return the pairs of equal impacts up to the first difference, and the time of that, or inf.

    Args:
        hits: Impulses of one motion.
        others: Impulses of the other.
        slowest: Speed below which an impact may be missing [rad/s | m/s].
    Returns:
        The pairs, and the time [s].
    """
    first = [hit for hit in hits if hit.speed > slowest]
    second = [hit for hit in others if hit.speed > slowest]
    pairs, i, j = list[tuple[Hit, Hit]](), 0, 0
    while i < len(first) and j < len(second):
        a, b = first[i], second[j]
        if (a.joint, a.side) == (b.joint, b.side):
            pairs.append((a, b))
            i, j = i + 1, j + 1
        elif a.speed <= 3.0 * slowest:
            i += 1
        elif b.speed <= 3.0 * slowest:
            j += 1
        else:
            return pairs, min(a.t, b.t)
    unpaired = [hit for hit in (*first[i:], *second[j:]) if hit.speed > 3.0 * slowest]
    return pairs, min((hit.t for hit in unpaired), default=np.inf)
