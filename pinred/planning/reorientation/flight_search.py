"""FlightPlan: the joint motion of least effort that lands a flying robot, and the search for it.

Coarse programs are solved from several seeded starts.  The best solutions are refined to finer
splines.  Then the attitude is integrated exactly, and the program is solved again with the target
shifted by the error, until the motion itself reaches the target.  Limits that the motion exceeds
between nodes are tightened in the same rounds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, NoOptimum
from ...forces.signals.signal import Spline
from ...lie.rotations import (
    conjugate,
    quaternion_exp,
    quaternion_log,
    quaternion_product,
    rotation,
    unit,
)
from ...reduction.pointwise_reduction import PointwiseReduction
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.passive import joint_limits
from ...system.system import System
from ..optimisation.limits import Limits
from ..optimisation.objective import TargetAim
from .flight_program import Bounded, FlightProgram, Problem, Solution
from .turning_loop import SimulatedPlan

TOLERANCES = (1e-11, 1e-13)  # relative and absolute tolerance of a plan's simulation


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class FlightPlan(SimulatedPlan):
    """A joint motion in flight, from rest to rest of the joints, with the least effort found.

    Attributes:
        system: The system.
        momentum: Initial body momentum, (r,).
        duration: Time of flight [s].
        aim: The target.
        times: Times of the knots of the cubic splines of the joints, (K,) [s].
        shapes: Shapes at these times, (K, m) [rad | m]; the rates at both ends are zero.
        effort: "torque" or "rate".
        cost: Mean over time of the sum of squared torques or rates.
        reached: Whether the target is reached; otherwise the plan ends at the nearest attitude
            that was found.
        remaining: Remaining rotation from the final attitude to the target [rad].
        kkt: Largest entry of the gradient of the Lagrangian of the nonlinear program, relative to
            the largest entry of the gradient of its objective.
        violation: Largest violation of an equation or a bound of the nonlinear program.
        starts: Cost, on a coarse grid, of the solution from each start; NaN without a solution.
        margins: Smallest distance to the limits of joints, speeds and torques.
        active: Kind and joint of the limits that the motion reaches.
        shortest: If the target is not reached, the shortest longer duration found that suffices
            [s], or NaN if none was found; otherwise None.
    """

    system: System
    momentum: Array
    duration: float
    aim: TargetAim = field(repr=False)
    times: Array
    shapes: Array
    effort: str
    cost: float
    reached: bool
    remaining: float
    kkt: float
    violation: float
    starts: Array
    margins: Mapping[str, float]
    active: tuple[str, ...]
    shortest: float | None = field(default=None)

    @property
    def prescribed(self) -> dict[str, Spline]:
        """Motion of each joint, for `prescribed` of a Scene."""
        columns = zip(self.system.shape_names, self.shapes.T, strict=True)
        return {name: Spline(self.times, values, end="clamped") for name, values in columns}

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion, simulated with a free base.

        The trajectory's `driving_torques` are the joint torques that the plan requires.
        """
        rtol, atol = TOLERANCES
        return simulate(
            self.system, x0=self.shapes[0], momentum=self.momentum, duration=self.duration,
            prescribed=self.prescribed, rtol=rtol, atol=atol,
        )  # fmt: skip

    def __repr__(self) -> str:
        remain = f"{self.remaining:.1e} rad remain"
        return f"<FlightPlan of {self.system.name}: {self.duration:g} s, {remain}>"

    def __str__(self) -> str:
        costs = ", ".join(f"{cost:.4g}" for cost in np.sort(self.starts) if np.isfinite(cost))
        solved = self.starts[np.isfinite(self.starts)]
        quantity = "mean Σ torque²" if self.effort == "torque" else "mean Σ rate²"
        lines = [
            f"{self.system.name} lands after {self.duration:g} s",
            f"  remaining [rad]         {self.remaining:.1e}",
            f"  {quantity:<23} {self.cost:.6g}",
            f"  starts                  {len(solved)} of {len(self.starts)} solved",
            f"  of each, coarse grid    {costs or 'none'}",
            f"  KKT residual            {self.kkt:.1e}, equations {self.violation:.1e}",
            *(f"  margin to {name:<13} {value:.3g}" for name, value in self.margins.items()),
            f"  active limits           {', '.join(self.active) or 'none'}",
        ]
        if not self.reached:
            suffices = "no longer duration that was tried suffices"
            if self.shortest is not None and np.isfinite(self.shortest):
                suffices = f"{self.shortest:.4g} s suffice"
            lines.append(
                "  out of reach            the nearest attitude found misses the target by "
                f"{self.remaining:.4g} rad; {suffices}"
            )
        return "\n".join([*lines, "  not considered          collisions between links"])


_COARSE, _MIDDLE = 8, 16  # numbers of spline segments while searching
_FINE, _FINE_OF_MANY = 32, 24  # number of segments of a plan, and of one with many joints
_STARTS, _FEWER = 6, 3  # number of random starts, and of those for many joints
_MANY = 24  # number of joints from which on there are fewer starts and segments
_AMPLITUDES = (0.3, 0.6)  # amplitudes of random loops, relative to the room up to the limits
_LARGEST = 1.0  # largest room that random loops use [rad | m]
_REFINED = 2  # number of coarse solutions that are refined
_DIFFERENT = 1e-3  # relative difference of the costs of different solutions
_STEPS = 2  # number of steps of the integration of the attitude in each segment
_ROUNDS = 8  # largest number of corrections of target and limits
_TRIALS = 2  # number of starts without a solution after which the nearest attitude is sought
_FAR = 0.02  # miss of a nearest attitude on the coarse grid that ends the search [rad]
_NEAR = 1e-3  # miss of the nearest attitude at which the target counts as reachable [rad]
_SOLVED = 1e-6  # violation of the equations of a nearest attitude that is accepted
_REACHED = 1e-9  # error of the final attitude at which corrections end [rad]
_INSIDE = 8  # number of points in each segment at which torques are computed
_DENSE = 65  # number of times in each segment at which they are interpolated
_ACTIVE = 5e-3  # distance to a limit, relative to the limit, below which it is active
_TIGHTEST = 0.5  # smallest factor on a limit at the nodes; less means that corrections diverge
_MARGIN = 1e-5  # smallest distance to limits at the nodes, relative to the limit
_OBJECTIVE = 50.0  # objective of the first guess, after scaling
_ON_EFFORT = 1e-4  # weight of the effort in the search for the nearest attitude
_GROWTH, _LONGEST = 1.3, 10  # factor between durations that are tried, and their number
_RESOLUTION = 0.01  # relative resolution of the shortest duration
_CLOSE = 0.6  # use of a limit, relative to it, above which finer programs consider the limit
_KINDS = ("limits", "speeds", "torques")
# Values at _DENSE times of a segment by those at its points, (_DENSE, _INSIDE + 1).
_INTERPOLATION = np.linalg.solve(
    chebvander(np.linspace(-1.0, 1.0, _INSIDE + 1), _INSIDE).T,
    chebvander(np.linspace(-1.0, 1.0, _DENSE), _INSIDE).T,
).T


def file_limits(system: System, limits: Limits, *, speeds: bool, torques: bool) -> Limits:
    """Return limits with the rates and efforts of the robot's file where none are stated.

    Args:
        system: The system.
        limits: The limits.
        speeds: Whether limits of speeds are stated.
        torques: Whether limits of torques are stated.
    Returns:
        The limits.
    """
    stated = joint_limits(system)
    return Limits(
        limits.shape,
        limits.speed if speeds else np.abs(stated.rate).min(axis=1),
        limits.torque if torques else np.abs(stated.effort).min(axis=1),
    )


@dataclass(frozen=True, eq=False)
class FlightRequest:
    """The validated arguments of a flight.

    Attributes:
        system: The system, without balls and closed loops.
        turn: Requested rotation, (turns,) [rad].
        momentum: Initial body momentum, (r,).
        duration: Time of flight [s].
        ends: First and last shape, (m,).
        limits: Limits of joints, speeds and torques.
        effort: "torque" or "rate".
    """

    system: System
    turn: Array
    momentum: Array
    duration: float
    ends: tuple[Array, Array]
    limits: Limits
    effort: str


def plan_flight(request: FlightRequest) -> FlightPlan:
    """Plan a flight.

    Args:
        request: The request.
    Returns:
        The plan, which ends at the nearest attitude if the target is out of reach.
    Raises:
        InputError: The robot has balls or loops.
    """
    system = request.system
    if system.space.balls or system.loops:
        kind = "ball joints" if system.space.balls else "closed loops"
        raise InputError(f"effort: a motion of least effort needs a robot without {kind}")
    flight = _Flight(request)
    solutions: list[Solution] = []
    for k in range(flight.starts):
        solutions.append(flight.solve(_COARSE, flight.start(k)))
        # Programs without a solution take long, so look for the nearest attitude instead.
        if k + 1 == _TRIALS and not any(solution.solved for solution in solutions):
            near = flight.nearest(_COARSE)
            if flight.miss(near) > _FAR:
                break
            solutions.append(flight.solve(_COARSE, near.coefficients))
    costs = np.array([flight.cost(s) if s.solved else np.nan for s in solutions])
    best = flight.best_of(solutions, costs)
    if best is not None:
        return flight.plan(best, costs, None)
    near = flight.nearest(flight.fine)
    if flight.miss(near) < _NEAR:
        again = flight.solve(_COARSE, flight.finer(near, _COARSE))
        costs = np.append(costs, flight.cost(again) if again.solved else np.nan)
        best = flight.best_of([again], costs[-1:])
        if best is not None:
            return flight.plan(best, costs, None)
    return flight.plan(near, costs, flight.shortest(near))


class _Flight:
    """The search for one flight."""

    def __init__(self, request: FlightRequest) -> None:
        self.request, self.system = request, request.system
        self.duration, self.limits = request.duration, request.limits
        self.turns, self.linear = self.system.group.turns, self.system.group.linear
        self.near: Solution | None = None  # the coarse solution nearest to the target
        many = self.system.m >= _MANY
        self.starts, self.fine = (_FEWER, _FINE_OF_MANY) if many else (_STARTS, _FINE)
        self.sizes = np.array([self.limits.reach, self.limits.speed, self.limits.torque])
        # Factors on the limits at the nodes.
        self.tight = np.full(self.sizes.shape, 1.0 - _MARGIN)
        self.programs: dict[int, tuple[Bounded, FlightProgram]] = {}
        self.bounded = self.close = _joints(np.isfinite(self.sizes))
        inertia = PointwiseReduction(self.system).locked_inertia(request.ends[0])
        linear, momentum = self.linear, request.momentum
        # The angular momentum about the centre of mass.
        lever = np.linalg.solve(inertia[:linear, :linear], momentum[:linear])
        self.L = momentum[linear:] - inertia[linear:, :linear] @ lever
        self.aim = self.aim_at(request.duration)

    def aim_at(self, duration: float) -> Array:
        """Return the target attitude; of angles with momentum, the one next to that at rest.

        Args:
            duration: Duration, which determines how far the base turns with joints at rest [s].
        Returns:
            Quaternion (4,), or angle (1,).
        """
        turn = self.request.turn
        if self.turns == 3:
            return quaternion_exp(turn)
        if not self.L.any():
            return turn
        program = self.program(_COARSE)
        still = program.fit(np.tile(self.request.ends[0], (_COARSE + 1, 1)))
        reached = self.turned(program, still, duration, turn, _COARSE)[-1]
        return np.asarray(turn + 2.0 * np.pi * np.round(reached / (2.0 * np.pi)))

    def program(self, count: int) -> FlightProgram:
        """Return the program with a number of segments."""
        if count == _COARSE:
            key = "flight", self.bounded
            return self.system.workspace(
                key, lambda: FlightProgram(self.system, count, self.bounded)
            )
        cached = self.programs.get(count)
        if cached is None or cached[0] != self.close:
            cached = self.close, FlightProgram(self.system, count, self.close)
            self.programs[count] = cached
        return cached[1]

    def program_of(self, solution: Solution) -> FlightProgram:
        """Return a program with the number of segments of a solution."""
        return self.program(len(solution.coefficients) - 3)

    def start(self, k: int) -> Array:
        """Return the coefficients of a straight motion with a random loop."""
        random = np.random.default_rng(k)
        f = np.linspace(0.0, 1.0, _COARSE + 1)[:, None]
        first, last = self.request.ends
        shapes = first + (last - first) * f**2 * (3.0 - 2.0 * f)
        low, high = self.limits.shape.T
        room = np.minimum(np.minimum(first - low, high - first), _LARGEST)
        room = np.maximum(room, 0.1 * np.minimum(high - low, _LARGEST))
        room *= _AMPLITUDES[k % len(_AMPLITUDES)]
        for wave in range(1, 4):
            loop = np.sin(np.pi * f) * np.sin(wave * np.pi * f)
            shapes = shapes + loop * room * random.uniform(-1.0, 1.0, len(first))
        return self.program(_COARSE).fit(np.clip(shapes, low, high))

    def solve(
        self,
        count: int,
        coefficients: Array,
        *,
        before: Solution | None = None,
        aim: Array | None = None,
        duration: float | None = None,
        near: bool = False,
        effort: str | None = None,
    ) -> Solution:
        """Solve a program.

        Args:
            count: Number of segments.
            coefficients: Initial coefficients, (count + 3, m).
            before: Solution of a similar problem of the same size, or None.
            aim: Target attitude; None for that of the request.
            duration: Duration [s]; None for that of the request.
            near: Whether to find the nearest attitude instead of the least effort.
            effort: "torque" or "rate"; None for that of the request.
        Returns:
            The solution.
        """
        program = self.program(count)
        duration = self.duration if duration is None else duration
        aim, effort = self.aim if aim is None else aim, effort or self.request.effort
        if before is None:
            q = self.turned(program, coefficients, duration, aim, program.nodes - 1)
        else:
            q = before.q
        first = -aim
        if self.turns == 3:
            first = conjugate(aim)
            first = first if first @ q[0] > 0.0 else -first
        middle, reach = self.limits.middle, self.limits.reach * self.tight[0]
        problem = Problem(
            duration=duration, momentum=self.momentum_about(aim), first=first,
            ends=self.request.ends, shape=np.array([middle - reach, middle + reach]),
            speed=self.limits.speed * self.tight[1], torque=self.limits.torque * self.tight[2],
            on_rate=float(effort == "rate"), on_torque=float(effort == "torque"),
        )  # fmt: skip
        scale = program.objective(problem, coefficients, q)
        weight = (_ON_EFFORT if near else _OBJECTIVE) / max(scale, 1e-9)
        problem = replace(
            problem, on_rate=weight * problem.on_rate, on_torque=weight * problem.on_torque,
            on_miss=_OBJECTIVE if near else None,
        )  # fmt: skip
        if before is not None:
            return program.solve(problem, coefficients, q, "finish", before.multipliers)
        return program.solve(problem, coefficients, q, "search" if count == _COARSE else "refine")

    def cost(self, solution: Solution) -> float:
        """Return the mean over time of the sum of squared torques or rates."""
        return solution.mean_torque if self.request.effort == "torque" else solution.mean_rate

    def attitudes(self, solution: Solution) -> Array:
        """Integrate the attitude of a solution to the ends of its segments; see `turned`."""
        program, coefficients = self.program_of(solution), solution.coefficients
        steps = _STEPS * program.count
        return self.turned(program, coefficients, self.duration, self.aim, steps)[::_STEPS]

    def turned(
        self,
        program: FlightProgram,
        coefficients: Array,
        duration: float,
        aim: Array,
        steps: int,
    ) -> Array:
        """Integrate the attitude relative to a target by the method of order 8 of DOP853.

        Args:
            program: The program.
            coefficients: Coefficients of the splines.
            duration: Duration [s].
            aim: Target attitude.
            steps: Number of steps.
        Returns:
            Attitudes at the ends of the steps, (steps + 1, size).
        """
        from scipy.integrate import DOP853

        A, B, c = DOP853.A[:12, :12], DOP853.B, DOP853.C[:12]
        h, splines = duration / steps, program.splines(coefficients, duration)
        t = ((np.arange(steps)[:, None] + c) * h).ravel()
        locked, drift = program.dynamics.rates(splines(t), splines.derivative()(t))
        L, rate = self.momentum_about(aim), program.dynamics.attitude_rate
        q = conjugate(aim) if self.turns == 3 else -aim
        rows = [q]
        for k in range(steps):
            slopes = np.zeros((12, len(q)))
            for i in range(12):
                at = q + h * (A[i, :i] @ slopes[:i])
                slopes[i] = rate(at, locked[12 * k + i], drift[12 * k + i], L)
            q = q + h * (B @ slopes)
            q = unit(q) if self.turns == 3 else q
            rows.append(q)
        attitudes = np.array(rows)
        return -attitudes if self.turns == 3 and attitudes[-1, 3] < 0.0 else attitudes

    def momentum_about(self, aim: Array) -> Array:
        """Return the angular momentum in the axes of a target attitude, (turns,)."""
        return rotation(unit(aim)).T @ self.L if self.turns == 3 else self.L

    def error(self, final: Array) -> Array:
        """Return the rotation from the target to a relative attitude, (turns,)."""
        return quaternion_log(unit(final)) if self.turns == 3 else final

    def miss(self, solution: Solution) -> float:
        """Return the rotation to the target [rad] of the exact motion."""
        return float(np.linalg.norm(self.error(self.attitudes(solution)[-1])))

    def finer(self, solution: Solution, count: int) -> Array:
        """Return the coefficients of a motion with another number of segments."""
        splines = self.program_of(solution).splines(solution.coefficients, 1.0)
        return self.program(count).fit(splines(np.linspace(0.0, 1.0, count + 1)))

    def best_of(self, found: list[Solution], costs: Array) -> Solution | None:
        """Return the best refined solution whose motion reaches the target within all limits."""
        chosen: list[int] = []
        for k in np.argsort(costs)[: np.isfinite(costs).sum()]:
            least = costs[chosen[-1]] * (1.0 + _DIFFERENT) if chosen else -np.inf
            if len(chosen) < _REFINED and costs[k] > least:
                chosen.append(k)
        if not chosen:
            return None
        self.consider([found[k] for k in chosen])
        refined = [self.solve(_MIDDLE, self.finer(found[k], _MIDDLE)) for k in chosen]
        for solution in sorted((s for s in refined if s.solved), key=self.cost):
            self.consider([solution])
            final = self.correct(self.solve(self.fine, self.finer(solution, self.fine)))
            if final is not None:
                return final
        return None

    def correct(self, solution: Solution, *, near: bool = False) -> Solution | None:
        """Correct target and limits by those of the exact motion; None if this fails."""
        aim = self.aim
        self.tight[:] = 1.0 - _MARGIN
        for _ in range(_ROUNDS):
            if not solution.solved:
                return None
            q = self.attitudes(solution)
            error, before = self.error(q[-1]), self.close
            exceeds = self.tighten(solution, q)
            if not exceeds and solution.finished and (near or np.linalg.norm(error) < _REACHED):
                return solution
            if self.tight.min() < _TIGHTEST:
                return None
            if not near:
                correction = quaternion_exp(-error) if self.turns == 3 else -error
                aim = (
                    unit(quaternion_product(aim, correction))
                    if self.turns == 3
                    else aim + correction
                )
            start = solution if self.close == before else None
            solution = self.solve(
                self.fine, solution.coefficients, before=start, aim=aim, near=near
            )
        return None

    def consider(self, solutions: list[Solution]) -> None:
        """Let finer programs consider the limits that solutions come close to."""
        used = np.max([self.uses(s, self.attitudes(s)) for s in solutions], axis=0)
        self.close = _joints(used > _CLOSE * self.sizes)

    def nearest(self, count: int) -> Solution:
        """Return a solution with the final attitude nearest to the target, within all limits.

        Args:
            count: Number of segments, _COARSE or that of a plan.
        Returns:
            The solution.
        Raises:
            NoOptimum: The search did not converge.
        """
        self.tight[:] = 1.0 - _MARGIN
        if self.near is None:
            self.near = self.nearest_at(self.duration, [self.start(k) for k in range(self.starts)])
        best = self.near
        if count == _COARSE:
            return best
        for finer in (_MIDDLE, self.fine):
            self.consider([best])
            best = self.solve(finer, self.finer(best, finer), near=True)
        final = self.correct(best, near=True)
        if final is None:
            raise NoOptimum(
                f"the search for the nearest attitude of '{self.system.name}' did not converge; "
                f"equations are violated by {best.violation:.1e}. Give wider limits or another x0"
            )
        return final

    def nearest_at(self, duration: float, starts: list[Array]) -> Solution:
        """Return the coarse solution nearest to the target at a duration."""
        aim = self.aim_at(duration)
        candidates = [
            self.solve(_COARSE, start, aim=aim, duration=duration, near=True) for start in starts
        ]
        return min(candidates, key=lambda s: (s.violation > _SOLVED, self.collocated_miss(s)))

    def collocated_miss(self, solution: Solution) -> float:
        """Return the rotation to the target [rad] of the attitudes of the program."""
        return float(np.linalg.norm(self.error(solution.q[-1])))

    def uses(self, solution: Solution, q: Array) -> Array:
        """Return the largest uses of limits of joints, speeds, torques at all times, (3, m).

        Args:
            solution: The solution.
            q: Attitudes at the ends of segments.
        Returns:
            The largest distances to the middle of the joint ranges, rates and torques.
        """
        program = self.program_of(solution)
        splines, count = program.splines(solution.coefficients, self.duration), program.count
        t = np.linspace(0.0, self.duration, _INSIDE * count + 1)
        x, u, w = (np.asarray(splines.derivative(k)(t) if k else splines(t)) for k in range(3))
        L = self.momentum_about(self.aim)
        rows = zip(q, *program.dynamics.rates(x[::_INSIDE], u[::_INSIDE]), strict=True)
        slopes = np.array([program.dynamics.attitude_rate(*row, L) for row in rows])
        between = CubicHermiteSpline(t[::_INSIDE], q, slopes)(t)
        torque = program.dynamics.at(x, u, w, between, L).torque
        h, middle = self.duration / count, self.limits.middle
        shape, rate = _extremes(x[::_INSIDE] - middle, u[:: _INSIDE // 2], h)
        return np.array([shape, rate, _peaks(torque)])

    def tighten(self, solution: Solution, q: Array) -> bool:
        """Tighten the limits that a motion exceeds; return whether there are any."""
        used = self.uses(solution, q)
        excess = used / self.sizes - 1.0
        beyond = excess > 0.0
        self.tight[beyond] -= 1.1 * excess[beyond] + _MARGIN
        close = used > _CLOSE * self.sizes
        for row, joints in zip(close, self.close, strict=True):
            row[list(joints)] = True
        if (beyond & ~_flags(self.close, self.sizes.shape)).any():
            self.close = _joints(close)
        return bool(beyond.any())

    def shortest(self, near: Solution) -> float:
        """Return the shortest longer duration found that reaches the target; NaN if none does.

        Durations are bisected by whether the nearest attitude is the target.  The result is a
        duration at which the program with a fixed final attitude was solved.
        """
        self.tight[:] = 1.0 - _MARGIN
        guess, feasible = self.finer(near, _COARSE), self.duration

        def reaches(seconds: float) -> Solution | None:
            solution = self.nearest_at(seconds, [guess, self.start(0), self.start(1)])
            if solution.violation > _SOLVED or self.collocated_miss(solution) > _NEAR:
                return None
            solution = self.solve(
                _COARSE, solution.coefficients, aim=self.aim_at(seconds), duration=seconds,
                effort="rate",
            )  # fmt: skip
            return solution if solution.solved else None

        for _ in range(_LONGEST):
            high = _GROWTH * feasible
            solution = reaches(high)
            if solution is not None:
                break
            feasible = high
        else:
            return float("nan")
        while high - feasible > _RESOLUTION * high:
            guess, middle = solution.coefficients, 0.5 * (feasible + high)
            shorter = reaches(middle)
            if shorter is None:
                feasible = middle
            else:
                high, solution = middle, shorter
        return high

    def plan(self, solution: Solution, costs: Array, shortest: float | None) -> FlightPlan:
        """Return the plan of a solution."""
        splines = self.program_of(solution).splines(solution.coefficients, self.duration)
        q = self.attitudes(solution)
        rows = list(zip(_KINDS, self.sizes, self.uses(solution, q), strict=True))
        margins = {
            kind: float((limit - use).min())
            for kind, limit, use in rows
            if np.isfinite(limit).any()
        }
        active = tuple(
            f"{kind} of {name}"
            for kind, limit, use in rows
            for name, near in zip(
                self.system.shape_names, use > (1.0 - _ACTIVE) * limit, strict=True
            )
            if near
        )
        times = np.linspace(0.0, self.duration, self.fine + 1)
        return FlightPlan(
            system=self.system, momentum=self.request.momentum, duration=self.duration,
            aim=TargetAim(self.system.group, self.aim, None), times=times,
            shapes=np.asarray(splines(times)),
            effort=self.request.effort, cost=self.cost(solution), reached=shortest is None,
            remaining=float(np.linalg.norm(self.error(q[-1]))), kkt=solution.kkt,
            violation=solution.violation, starts=costs, margins=margins, active=active,
            shortest=shortest,
        )  # fmt: skip


def _joints(limited: NDArray[np.bool_]) -> Bounded:
    """Return the joints with limits of shapes, rates and torques from flags (3, m)."""
    shape, rate, torque = (tuple(np.flatnonzero(row).tolist()) for row in limited)
    return shape, rate, torque


def _flags(joints: Bounded, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    flags = np.zeros(shape, dtype=bool)
    for row, columns in zip(flags, joints, strict=True):
        row[list(columns)] = True
    return flags


def _extremes(x: Array, u: Array, h: float) -> tuple[Array, Array]:
    """Return the largest values of |x| and |u| of cubic splines, (m,).

    Args:
        x: Values at the ends of K segments, (K + 1, m).
        u: Derivatives at ends and middles of segments, (2K + 1, m).
        h: Length of a segment.
    """
    u0, middle, u1 = u[:-1:2], u[1::2], u[2::2]
    b, c = 4.0 * middle - 3.0 * u0 - u1, 2.0 * (u0 + u1 - 2.0 * middle)  # u = u0 + b s + c s²
    with np.errstate(divide="ignore", invalid="ignore"):
        root = -0.5 * (b + np.copysign(np.sqrt(b**2 - 4.0 * c * u0), b))
        places = [root / c, u0 / root, -0.5 * b / c]
    s1, s2, vertex = (np.clip(np.where(np.isfinite(s), s, 0.0), 0.0, 1.0) for s in places)
    largest = np.abs(x).max(axis=0)
    for s in (s1, s2):
        inside = x[:-1] + h * s * (u0 + s * (b / 2.0 + s * c / 3.0))
        largest = np.maximum(largest, np.abs(inside).max(axis=0))
    rates = np.abs(u0 + vertex * (b + vertex * c)).max(axis=0)
    return largest, np.maximum(np.abs(u).max(axis=0), rates)


def _peaks(values: Array) -> Array:
    """Return the largest magnitudes, (m,), of samples (N, m) that are smooth within each segment.

    Polynomials through the samples of each segment are evaluated at _DENSE times, and parabolas
    through three of these values estimate maxima between them.
    """
    pieces = [values[k : len(values) - _INSIDE + k : _INSIDE] for k in range(_INSIDE + 1)]
    dense = np.abs(np.einsum("dk,knm->dnm", _INTERPOLATION, np.array(pieces)))
    before, at, after = dense[:-2], dense[1:-1], dense[2:]
    bend = before - 2.0 * at + after
    top = (at >= before) & (at >= after) & (bend < 0.0)
    raised = at - np.where(top, (before - after) ** 2 / (8.0 * np.where(top, bend, -1.0)), 0.0)
    return np.asarray(np.maximum(dense.max(axis=(0, 1)), raised.max(axis=(0, 1))))
