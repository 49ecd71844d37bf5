"""The reference solution: Pinocchio's ABA on the full state (q, v), integrated by Hairer's codes.

The vector field (full_dynamics.py) and the integrators share nothing with the reduction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.switch_times import time_within
from ..scene.scene import Scene
from ..simulation.control import Control, Replay
from .distances import Distance, FullMotion, Size
from .full_dynamics import FullDynamics
from .hairer_dense_output import DenseOutput
from .hairer_integrators import Hairer
from .time_budget import AbaStopped, TimeBudget

FINEST = (2e-14, 1e-16)  # tightest rtol and atol that Hairer's codes can satisfy
OFFSET = 1e-5  # least length unit, as a fraction of the distance from the origin
SPREAD_MARGIN = 10.0  # assumed ratio of round-off to the difference of two evaluations
_ROUND_OFF = 1e-12  # distance of equal times, relative to the duration
PERTURBATION = 1e-6  # relative size of the perturbation whose growth is measured


@dataclass(frozen=True)
class Solution:
    """A solution by Hairer's codes.

    Attributes:
        motion: The motion at the requested times.
        steps: The steps of dop853 that contain these times; None without such steps.
        parameters: Parameters of forces in each of `steps`, (p,) each.
        step_ends: Ends of all steps of dop853, (N,) [s].
    """

    motion: FullMotion
    steps: DenseOutput | None
    parameters: list[Array]
    step_ends: Array


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
        self, y0: Array, motion: FullMotion, times: Array, rtol: float, atol: float
    ) -> Array:
        """Compute the factors by which a small perturbation of y0 has grown over time.

        Args:
            y0: Initial state, (n,).
            motion: The unperturbed motion at `times`.
            times: Times, (T,) [s].
            rtol: Relative tolerance of the perturbed run.
            atol: Absolute tolerance of the perturbed run.
        Returns:
            (T,) non-decreasing factors, at least 1.
        """
        perturbed = self.run(self.perturb(y0, self._scene.end, PERTURBATION), times, rtol, atol)
        distance = self.distance(motion, perturbed).relative(self.size(motion))
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

    def solve(
        self, y0: Array, times: Array, rtol: float, atol: float, *, method: str = "dop853"
    ) -> Solution:
        """Integrate as `run` does, and return the steps as well."""
        end, y, t = float(times[-1]), y0, 0.0
        states, spans, step_ends = np.tile(y0, (len(times), 1)), [], []
        parameters: list[Array] = []
        actions = self._replay or Control(self._scene)
        solver = Hairer(self._limited_rate, method, y, t, rtol, atol, self._scene.end)
        while t < end:
            stop = next((float(stop) for stop in self._stops if stop > t), end)
            stop = actions.begin(self._parameters, t, stop, partial(self.sample, y))
            if self._switches.size and self._forces is not None:
                self._parameters[self._forces.within] = time_within(t, stop)
            span = slice(*np.searchsorted(times, [t, stop], side="right"))
            reach = min(stop, end)
            if reach - solver.t <= _ROUND_OFF * self._scene.end:
                states[span] = y
            elif method == "dop853":
                y = self._integrate(solver, reach, times[span])
                step_ends += solver.step_ends
                dense = solver.dense()
                if dense is not None:
                    states[span] = dense(times[span])
                    spans.append(dense)
                    parameters += len(dense.ends) * [self._parameters.copy()]
            else:
                y, states[span] = self._stop_at_times(solver, y, reach, times[span])
            t = stop
        motion = FullMotion(x=states[:, self._size : self._size + self._m].copy(), q=self.q(states))
        steps = DenseOutput.joined(spans) if spans else None
        return Solution(motion, steps, parameters, np.array(step_ends))

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
        reached = solver.integrate(t, times.tolist())
        if reached is None:
            raise AbaStopped(
                f"the full simulation of '{self._model.name}' cannot be integrated to "
                f"t = {t:g} s at rtol = {solver.rtol:g}",
                solver.t,
            )
        return reached

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
