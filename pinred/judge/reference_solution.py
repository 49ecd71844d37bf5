"""The reference solution: Pinocchio's ABA on the full state (q, v), integrated by Hairer's codes.

The vector field (full_dynamics.py) and the integrators share nothing with the reduction. Distances
between motions have the units of the motion's size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import IntegrationError
from ..forces.switch_times import time_within
from ..scene.scene import Scene
from ..simulation.motion import Control, Replay
from .full_dynamics import FullDynamics
from .reference_integrators import (
    AbaStopped,
    DenseOutput,
    Hairer,
    StiffIntegrator,
    TimeBudget,
    jacobian,
)


@dataclass(frozen=True)
class FullMotion:
    """A motion in Pinocchio's coordinates.

    Attributes:
        x: Coordinates of all joints over time: unwrapped values, and quaternions of balls.
        q: Pinocchio's configurations, (T, nq).
    """

    x: Array
    q: Array


@dataclass(frozen=True)
class Size:
    """Units in which errors of a motion are measured.

    Attributes:
        joints: Largest |x| of each joint, (M,); at least 1 rad, or the radius of gyration for
            slides; 1 rad for each axis of a ball [rad | m].
        position: Distance travelled by the base; at least the radius of gyration, and at least a
            small fraction of `away`, because round-off grows with `away` [m].
        away: Largest distance of the base from the origin [m].
    """

    joints: Array
    position: float
    away: float


@dataclass(frozen=True)
class Distance:
    """Distances between two motions over time.

    Attributes:
        joints: |Δx| of each joint; for a ball, the components of the rotation vector of its
            attitude relative to the other, (T, M) [rad | m].
        rotation: Norm of the rotational part of log(g⁻¹ĝ) of the base, (T,) [rad].
        position: Norm of the translational part of log(g⁻¹ĝ), (T,) [m].
    """

    joints: Array
    rotation: Array
    position: Array

    @property
    def shape(self) -> Array:
        """Largest |Δx| of any joint over time, (T,) [rad | m]."""
        return np.asarray(self.joints.max(axis=1, initial=0.0))

    def relative(self, size: Size) -> Array:
        """Return the largest of all distances at each time, (T,), in units of `size`.

        The result is NaN at times at which any distance is NaN.
        """
        shape = (self.joints / size.joints).max(axis=1, initial=0.0)
        return np.asarray(np.max([shape, self.rotation, self.position / size.position], axis=0))

    def worst(self, size: Size) -> float:
        """Return the largest distance at any time in units of `size`; NaN if one of them is NaN."""
        return float(self.relative(size).max())


FINEST = (2e-14, 1e-16)  # tightest rtol and atol that Hairer's codes can satisfy
OFFSET = 1e-5  # least length unit, as a fraction of the distance from the origin
SPREAD_MARGIN = 10.0  # assumed ratio of round-off to the difference of two evaluations
_ROUND_OFF = 1e-12  # distance of equal times, relative to the duration
PERTURBATION = 1e-6  # relative size of the perturbation whose growth is measured
_PATIENCE = 12_000  # evaluations of dop853 after which an implicit method is tried
_CHEAPER = 4.0  # gain of the implicit method from which on it is used


@dataclass(frozen=True)
class Solution:
    """A solution by Hairer's codes.

    Attributes:
        motion: The motion at the requested times.
        states: Full states at these times, (T, n).
        steps: The steps of dop853 that contain these times; None without such steps.
        parameters: Parameters of forces in each of `steps`, (p,) each.
        step_ends: Ends of all steps of dop853, (N,) [s].
        estimates: Accumulated and largest error of Radau's steps at the times, (T, 2), relative to
            the units; None for other methods.
    """

    motion: FullMotion
    states: Array
    steps: DenseOutput | None
    parameters: list[Array]
    step_ends: Array
    estimates: Array | None = None


class StiffError(IntegrationError):
    """The implicit method needs fewer evaluations than the explicit one."""


class FullState(FullDynamics):
    """Initial value problems of one scene's full state, and distances between their solutions."""

    def __init__(
        self, scene: Scene, replay: Replay | None = None, budget: TimeBudget | None = None
    ) -> None:
        """Prepare the vector field.

        Args:
            scene: The scene to simulate.
            replay: Recorded commands of controllers. Without it, every run calls them again.
            budget: Time limit of all runs together.
        """
        super().__init__(scene)
        self._replay = replay
        self._limited_rate = budget.limit(self.rate) if budget else self.rate

    def perturb(self, y0: Array, time: float, fraction: float) -> Array:
        """Change each entry of an initial state by a small fraction of its value, with random sign.

        Args:
            y0: Initial state, (n,).
            time: Duration of the motion [s].
            fraction: Relative change. The smallest change is this fraction of a radian, of the
                radius of gyration, or of the rate that covers such a distance in `time`.
        Returns:
            The perturbed state (n,); positions far from the origin count as in Size.
        """
        first_rate = self._size + self._m
        units = np.abs(y0)
        units[: self._linear] *= OFFSET
        least = np.ones(len(y0))
        radius = self.totals.radius_of_gyration(self.q(y0))
        least[: self._linear] = radius
        least[first_rate:] = 1.0 / time
        least[first_rate : first_rate + self._linear] *= radius
        sign = np.random.default_rng(0).choice([-1.0, 1.0], len(y0))
        perturbed = y0 + fraction * sign * np.maximum(units, least)
        if self.system.loops:  # the other joints must close the loops with the planned values
            perturbed[self._driven_x], perturbed[self._driven_v] = (
                y0[self._driven_x], y0[self._driven_v],
            )  # fmt: skip
        return self._apply_couplings(perturbed)

    def growth(
        self,
        y0: Array,
        motion: FullMotion,
        times: Array,
        rtol: float,
        atol: float,
        *,
        units: Array | None = None,
    ) -> Array:
        """Compute the factors by which a small perturbation of y0 has grown over time.

        Args:
            y0: Initial state, (n,).
            motion: The unperturbed motion at `times`.
            times: Times, (T,) [s].
            rtol: Relative tolerance of the perturbed run.
            atol: Absolute tolerance of the perturbed run.
            units: Units of the numbers in a state, (n,), if the equations are stiff.
        Returns:
            (T,) non-decreasing factors, at least 1.
        """
        perturbed = self.perturb(y0, self._scene.end, PERTURBATION)
        if units is None:
            other = self.run(perturbed, times, rtol, atol)
        else:
            other = self.solve_stiff(perturbed, times, rtol, units).motion
        distance = self.distance(motion, other).relative(self.size(motion))
        return np.maximum.accumulate(np.maximum(1.0, distance / PERTURBATION))

    def run(
        self, y0: Array, times: Array, rtol: float, atol: float, *, method: str = "dop853"
    ) -> FullMotion:
        """Integrate from t = 0 and return the motion at `times`.

        Args:
            y0: Initial state, (n,).
            times: Increasing times, (T,) [s].
            rtol: Relative tolerance.
            atol: Absolute tolerance.
            method: Hairer's "dop853" (order 8) or "dopri5" (order 5).
        Returns:
            The motion at `times`.
        Raises:
            AbaStopped: A time cannot be reached at this tolerance, or within the budget.
        """
        return self.solve(y0, times, rtol, atol, method=method).motion

    def run_unless_stiff(
        self, y0: Array, end: float, rtol: float, atol: float, units: Array
    ) -> None:
        """Integrate with dop853 from t = 0 to the end.

        Args:
            y0: Initial state, (n,).
            end: End [s].
            rtol: Relative tolerance.
            atol: Absolute tolerance.
            units: Units of the numbers in a state, (n,).
        Raises:
            StiffError: An implicit method needs far fewer evaluations.
            AbaStopped: The end cannot be reached at this tolerance, or within the budget.
        """
        rate, count, due, since, last = self._limited_rate, 0, _PATIENCE, 0, 0.0

        def watched(t: float, y: Array) -> Array:
            nonlocal count, due, since, last
            count += 1
            if count == due:
                most = int((count - since) / _CHEAPER)
                if self._needs_fewer(most, y, (t, min(2.0 * t - last, end)), rtol, units):
                    raise StiffError(f"an explicit method needs {count} evaluations until {t:g} s")
                due, since, last = 4 * due, count, t
            return rate(t, y)

        self._limited_rate = watched
        try:
            self.run(y0, np.array([end]), rtol, atol)
        finally:
            self._limited_rate = rate

    def _needs_fewer(
        self, most: int, y: Array, ends: tuple[float, float], tolerance: float, units: Array
    ) -> bool:
        """Return whether the implicit method integrates a span with at most `most` evaluations."""
        solver = StiffIntegrator(self._limited_rate, y, ends[0], tolerance, units, ends[1])
        solver.most_evaluations = most
        return ends[1] > ends[0] and solver.integrate(ends[1], np.empty(0))[0] is not None

    def solve(
        self, y0: Array, times: Array, rtol: float, atol: float, *, method: str = "dop853"
    ) -> Solution:
        """Integrate as `run` does, and return the steps as well."""
        y, states, spans, step_ends = y0, np.tile(y0, (len(times), 1)), list[DenseOutput](), []
        parameters: list[Array] = []
        solver = Hairer(self._limited_rate, method, y, 0.0, rtol, atol, self._scene.end)

        def advance(y: Array, reach: float, span: slice) -> Array:
            if method != "dop853":
                y, states[span] = self._stop_at_times(solver, y, reach, times[span])
                return y
            y = self._integrate(solver, reach, times[span])
            step_ends.extend(solver.step_ends)
            dense = solver.dense()
            if dense is not None:
                states[span] = dense(times[span])
                spans.append(dense)
                parameters.extend(len(dense.ends) * [self._parameters.copy()])
            return y

        self._through_stops(y0, times, states, advance)
        steps = DenseOutput.joined(spans) if spans else None
        return Solution(self._motion(states), states, steps, parameters, np.array(step_ends))

    def solve_stiff(self, y0: Array, times: Array, tolerance: float, units: Array) -> Solution:
        """Integrate with Radau IIA of order 13, for equations that are stiff for explicit methods.

        Args:
            y0: Initial state, (n,).
            times: Increasing times, (T,) [s].
            tolerance: Tolerance of a step, relative to the units.
            units: Units of the numbers in a state, (n,).
        Returns:
            The solution, with estimates of its errors.
        Raises:
            AbaStopped: A time cannot be reached at this tolerance, or within the budget.
        """
        states, ends = np.tile(y0, (len(times), 1)), [0.0]
        errors, lasting = [0.0], [0.0]
        solver = StiffIntegrator(self._limited_rate, y0, 0.0, tolerance, units, self._scene.end)

        def advance(_: Array, reach: float, span: slice) -> Array:
            reached, states[span] = solver.integrate(reach, times[span])
            ends.extend(solver.step_ends)
            errors.extend(solver.errors)
            lasting.extend(solver.lasting)
            return self._reached(reached, reach, solver.t, tolerance)

        self._through_stops(y0, times, states, advance)
        step = np.minimum(np.searchsorted(ends, times), len(ends) - 1)
        estimates = np.cumsum(lasting)[step], np.maximum.accumulate(errors)[step]
        none = np.array(ends[1:])
        return Solution(self._motion(states), states, None, [], none, np.column_stack(estimates))

    def jacobian(self, t: float, y: Array, units: Array) -> Array:
        """Return the Jacobian (n, n) of ABA at a state by difference quotients.

        Args:
            t: Time [s].
            y: State, (n,).
            units: Units of the numbers in a state, (n,).
        """
        return jacobian(self._limited_rate, t, y, units)

    def solve_step(
        self,
        y: Array,
        ends: tuple[float, float],
        inside: Array,
        tolerance: float,
        units: Array,
    ) -> tuple[Array, float]:
        """Integrate over a step of a trajectory, with the parameters of forces that are set.

        Args:
            y: State at its start, (n,).
            ends: Start and end of the step [s].
            inside: Increasing times within the step, (T,) [s].
            tolerance: Tolerance, relative to the units.
            units: Units of the numbers in a state, (n,).
        Returns:
            The states inside the step and at its end, (T + 1, n), and an estimate of their error,
            relative to the units.
        Raises:
            AbaStopped: The end cannot be reached at this tolerance, or within the budget.
        """
        a, b = ends
        solver = StiffIntegrator(self._limited_rate, y, a, tolerance, units, b, first_step=b - a)
        reached, states = solver.integrate(b, inside)
        end = self._reached(reached, b, solver.t, tolerance)
        return np.vstack([states, end]), sum(solver.errors)

    def _motion(self, states: Array) -> FullMotion:
        x = states[:, self._size : self._size + self._m].copy()
        return FullMotion(x=x, q=self.q(states))

    def _through_stops(
        self,
        y: Array,
        times: Array,
        states: Array,
        advance: Callable[[Array, float, slice], Array],
    ) -> None:
        """Integrate from stop to stop, with the parameters of forces in each span.

        Args:
            y: Initial state, (n,).
            times: Increasing times, (T,) [s].
            states: States at the times, (T, n), which are written.
            advance: Function (state, end of the span, times in it) that writes the states at these
                times and returns the state at the end.
        """
        end, t = float(times[-1]), 0.0
        actions, reached = self._replay or Control(self._scene), 0.0
        while t < end:
            stop = next((float(stop) for stop in self._stops if stop > t), end)
            parameters = self._parameters.copy()
            stop = actions.begin(parameters, t, stop, partial(self.sample, y))
            self.set_parameters(parameters)
            if self._switches.size and self._forces is not None:
                self._forces.set_span(self._parameters, time_within(t, stop))
            span = slice(*np.searchsorted(times, [t, stop], side="right"))
            reach = min(stop, end)
            if reach - reached <= _ROUND_OFF * self._scene.end:
                states[span] = y
            else:
                y = advance(y, reach, span)
                reached = reach
            t = stop

    def _stop_at_times(
        self, solver: Hairer, y: Array, end: float, times: Array
    ) -> tuple[Array, Array]:
        """Integrate with dopri5, whose dense output is less accurate than its steps.

        Args:
            solver: The integrator, which has reached y.
            y: State at the start, (n,).
            end: End of the span [s]. Times closer than round-off count as reached.
            times: Increasing times in the span, (T,) [s].
        Returns:
            The states at the end, (n,), and at the times, (T, n).
        """
        states = np.empty((len(times), len(y)))
        for target in np.union1d(times, end).tolist():
            if target - solver.t > _ROUND_OFF * self._scene.end:
                y = self._integrate(solver, target, times[:0])
            states[times == target] = y
        return y, states

    def _integrate(self, solver: Hairer, t: float, times: Array) -> Array:
        """Return the state (n,) at time t; raise AbaStopped if it cannot be reached."""
        return self._reached(solver.integrate(t, times.tolist()), t, solver.t, solver.rtol)

    def _reached(self, y: Array | None, t: float, until: float, rtol: float) -> Array:
        """Return y (n,), the state at time t; raise AbaStopped if it is None."""
        if y is None:
            raise AbaStopped(
                f"the full simulation of '{self._model.name}' cannot be integrated to "
                f"t = {t:g} s at rtol = {rtol:g}",
                until,
            )
        return y

    def distance(self, a: FullMotion, b: FullMotion) -> Distance:
        """Compute the distance between two motions over time."""
        log = np.array([pin.difference(self._model, p, q) for p, q in zip(a.q, b.q, strict=True)])
        joints = self._joint_distances(a.x, b.x, log[:, self._r :])
        log = log[:, : self._r]
        if self.root.circle:
            # Pinocchio's planar log returns no rotation where round-off makes the trace exceed 2.
            k = self._linear
            (c, s), (cb, sb) = a.q[:, k : k + 2].T, b.q[:, k : k + 2].T
            log[:, -1] = np.arctan2(c * sb - s * cb, c * cb + s * sb)
        return Distance(
            joints=joints,
            rotation=np.linalg.norm(log[:, self._linear :], axis=1),
            position=np.linalg.norm(log[:, : self._linear], axis=1),
        )

    def size(self, motion: FullMotion) -> Size:
        """Compute the units in which errors of a motion are measured."""
        position = motion.q[:, : self._linear]
        radius = self.totals.radius_of_gyration(motion.q[0])
        travelled = float(np.abs(position - position[0]).max(initial=0.0))
        away = float(np.abs(position).max(initial=0.0))
        return Size(
            joints=self.joint_error_units(motion.x, radius),
            position=max(travelled, radius, OFFSET * away),
            away=away,
        )

    def joint_error_units(self, x: Array, radius: float) -> Array:
        """Compute the units of joint errors along each rate for coordinates x, see Size.joints."""
        units = np.where([unit == "m" for unit in self.system.tree.units], radius, 1.0)
        scalar_v, scalar_x = self.system.tree.scalar_v, self.system.tree.scalar_x
        units[scalar_v] = np.maximum(np.abs(x[:, scalar_x]).max(axis=0), units[scalar_v])
        return units

    def _joint_distances(self, a: Array, b: Array, log: Array) -> Array:
        """Return the distances of coordinates a and b along each rate, (T, M).

        log: Pinocchio's differences of the configurations along each rate, used for balls.
        """
        tree, joints = self.system.tree, np.abs(log)
        joints[:, tree.scalar_v] = np.abs(b[:, tree.scalar_x] - a[:, tree.scalar_x])
        return joints
