"""The reference solution: Pinocchio's ABA on the full state (q, v), integrated by Hairer's codes.

It shares no dynamics with the reduction: its root kinematics, its integrators, and its momenta and
energies (computed by Pinocchio) are independent. Only the force expressions are shared.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.force_values import BaseInSpace, ForceInputs
from ..forces.switch_times import time_within
from ..kernels.loads_by_pinocchio import LoadsByPinocchio
from ..scene.scene import Scene
from ..simulation.control import Control, Replay
from ..simulation.plan import stops_of
from ..simulation.sample import Sample
from ..system.system import System
from .condition_times import condition_times
from .coupling_constraints import CouplingConstraints
from .distances import Distance, FullMotion, Size
from .full_coordinates import Configuration, root_motion
from .hairer_integrators import Hairer
from .loop_errors import closed
from .system_totals import SystemTotals
from .time_budget import AbaStopped, TimeBudget

FINEST = (2e-14, 1e-16)  # tightest rtol and atol that Hairer's codes can satisfy
OFFSET = 1e-5  # least length unit, as a fraction of the distance from the origin
SPREAD_MARGIN = 10.0  # assumed ratio of round-off to the difference of two evaluations
PERTURBATION = 1e-6  # relative size of the perturbation whose growth is measured
# Smallest distance from a switch at which a condition on time is evaluated, relative to the
# duration.
_ASIDE = 1e-11


class FullState:
    """Pinocchio's forward dynamics of one scene, as an initial value problem.

    The state is y = (root, x, v): root coordinates (position; angle or quaternion), the coordinates
    of all joints (an unwrapped value, or the quaternion of a ball), and Pinocchio's velocity.
    Pinocchio computes the inputs of forces from y. Prescribed joints follow their plan. Follower
    joints obey multipliers, see coupling_constraints.py.

    Attributes:
        couplings: Constraints between followers and leaders.
        root: Kinematics of the root joint.
        totals: Energies and momenta of the whole system.
    """

    def __init__(
        self, scene: Scene, replay: Replay | None = None, budget: TimeBudget | None = None
    ) -> None:
        """Prepare Pinocchio's work space.

        Args:
            scene: The scene to simulate.
            replay: Recorded commands of controllers. Without it, every run calls them again.
            budget: Time limit of all runs together.
        """
        system, self._replay = scene.system, replay
        self._scene, self._forces = scene, scene.force_model
        self._limited_rate = budget.limit(self.rate) if budget else self.rate
        self._stops, self._switches = stops_of(scene), np.empty(0)
        self._parameters = np.empty(0) if self._forces is None else self._forces.numbers.copy()
        if self._forces is not None and self._forces.switching.conditions is not None:
            written = condition_times(self._forces, self._stops, self._parameters)
            self._stops = self._switches = np.union1d(self._stops, written)
        self._model = system.model
        self._r = system.r
        unused = np.full(system.r, np.nan)  # NaN would reveal a force that depends on it
        self._unused = unused, unused
        self._no_torque = np.zeros(system.model.nv)
        self.couplings = CouplingConstraints(system)
        self.root = root_motion(system.model)
        self.totals = SystemTotals(system.model, self.root)
        self._linear, self._size = self.root.linear, self.root.size
        self._configuration = Configuration(system.model, self.root)
        self._m = self._configuration.size
        loads = () if self._forces is None else self._forces.loads
        self._loads = LoadsByPinocchio(system, self.root.axes, loads) if loads else None
        driven = [] if self._forces is None else list(self._forces.joints)
        self._driven: list[int] = self.couplings.leads[driven].tolist()
        driven_x = self.couplings.leads_x[system.space.coordinates_of_joints(driven)]
        # Indices in y of the coordinates and rates of the prescribed joints.
        self._driven_x = self._size + driven_x
        self._driven_v = self._size + self._m + self._r + np.array(self._driven, dtype=np.intp)

    @property
    def system(self) -> System:
        """The system of the scene."""
        return self._scene.system

    @property
    def coordinates(self) -> int:
        """Number of coordinates of all joints except the root, followers included."""
        return self._m

    def set_parameters(self, parameters: Array) -> None:
        """Set the parameters (p,) of forces, including the commands of controllers."""
        self._parameters = parameters

    def state(self, pose: Array, x: Array, xi: Array, xdot: Array) -> Array:
        """Assemble y (n,).

        Args:
            pose: Pose of the base, (size,).
            x: Shape, (nx,) [rad | m | 1].
            xi: Body twist, (r,) [m/s; rad/s].
            xdot: Shape rate, (m,) [rad/s | m/s].
        Returns:
            The full state (n,).
        """
        return np.concatenate([pose, self.couplings.values(x), xi, self.couplings.rates(xdot)])

    def _apply_couplings(self, y: Array, *, close: bool = True) -> Array:
        """Return y with follower joints set from their leaders, and with closed loops."""
        size, m, couplings = self._size, self._m, self.couplings
        close = close and bool(self.system.loops)
        if not (len(couplings.J) or close):
            return y
        pose, x, xi, xdot = np.split(y, [size, size + m, size + m + self._r])
        shape, rates = couplings.shape(x), couplings.shape_rate(xdot)
        if close:
            driven = () if self._forces is None else self._forces.joints
            shape, rates = closed(self.system, shape, rates, driven)
        return self.state(pose, shape, xi, rates)

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
        end, y, t = float(times[-1]), y0, 0.0
        round_off = 1e-12 * end  # times closer than this count as reached [s]
        actions = self._replay or Control(self._scene)
        states = {0.0: y0}
        while t < end:
            stop = next((float(stop) for stop in self._stops if stop > t), end)
            stop = actions.begin(self._parameters, t, stop, partial(self.sample, y))
            if self._switches.size and self._forces is not None:
                self._parameters[self._forces.within] = time_within(t, stop)
            solver = Hairer(self._limited_rate, method, y, t, rtol, atol, self._scene.end)
            targets = times[(times > t) & (times <= stop)]
            for target in (*targets.tolist(), *([stop] if stop <= end else [])):
                if target - solver.t > round_off:
                    reached = solver.integrate(target)
                    if reached is None:
                        raise AbaStopped(
                            f"the full simulation of '{self._model.name}' cannot be integrated to "
                            f"t = {target:g} s at rtol = {rtol:g}",
                            solver.t,
                        )
                    y = reached
                states[target] = y
            t = stop
        y = np.array([states[float(t)] for t in times])
        return FullMotion(
            x=y[:, self._size : self._size + self._m].copy(),
            q=np.array([self.q(row) for row in y]),
        )

    def sample(self, y: Array) -> Sample:
        """Compute the inputs of forces at y with Pinocchio; the gravity force is set to 0."""
        size, m, r = self._size, self._m, self._r
        x, v = y[size : size + m], y[size + m :]
        q, couplings = self.q(y), self.couplings
        xi, mu = self.totals.about_com(q, v)
        base = self.base_in_space(q, y[:size], v)
        return Sample(self._shape(x), couplings.shape_rate(v[r:]), xi, mu, np.zeros(3), base)

    def _shape(self, x: Array) -> Array:
        """Return the shape (nx,), with quaternions of length one, from all coordinates."""
        shape = self.couplings.shape(x)
        return self.system.space.normalized(shape, "x", near=False)

    def base_in_space(
        self, q: Array, root: Array, v: Array, *, momenta: bool = True
    ) -> BaseInSpace:
        """Compute pose, twist and momenta of the base with Pinocchio.

        Args:
            q: Pinocchio's configuration, (nq,).
            root: Root coordinates, (size,).
            v: Pinocchio's velocity, (nv,).
            momenta: Whether momenta are needed; otherwise the momenta are NaN.
        Returns:
            The base relative to the root joint's fixed frame.
        """
        r, k = self._r, self._linear
        pose = root.copy()
        if self.root.turns == 3:
            pose[k:] /= np.linalg.norm(root[k:])
        if not momenta:
            return BaseInSpace(pose, v[:r].copy(), *self._unused)
        mu = self.totals.body_momentum(q, v)
        J = self.totals.momentum(q, v, np.zeros(3), about_pivot=True)
        return BaseInSpace(pose, v[:r].copy(), mu, J)

    def rate(self, t: float, y: Array, axes: pin.Convention = pin.Convention.LOCAL) -> Array:
        """Compute dy/dt with Pinocchio's ABA.

        Args:
            t: Time [s].
            y: Full state, (n,).
            axes: Frames in which ABA is evaluated.
        Returns:
            (n,) time derivative of y.
        """
        size, m, r = self._size, self._m, self._r
        if self._forces is None:
            v, q = y[size + m :], self._q_for(self.q(y), axes)
            a = self.couplings.acceleration(q, v, self._no_torque, axes=axes)
            return self._derivative(y, a)
        y, t = y.copy(), self._beside_switches(t)
        accelerations = np.empty(0)
        if self._driven:
            plan = self._forces.planned(t, self._parameters)
            accelerations = plan.xddot
            y[self._driven_x], y[self._driven_v] = plan.x, plan.xdot
            y = self._apply_couplings(y, close=False)
        x, v, q = y[size : size + m], y[size + m :], self.q(y)
        xi, mu = self.totals.about_com(q, v) if self._forces.sees_momentum else self._unused
        base, shape_rate = None, self.couplings.shape_rate(v[r:])
        if self._forces.sees_base:
            base = self.base_in_space(q, y[:size], v, momenta=self._forces.sees_base_momenta)
        acting, loads = self._forces.acting_apart(
            ForceInputs(t, self._shape(x), shape_rate, xi, mu, self._parameters, base)
        )
        tau = np.append(acting.wrench, self.couplings.joint_torques(acting.torque))
        if self._loads is not None:
            tau += self._loads.generalised(q, loads)
        q = self._q_for(q, axes)
        a = self.couplings.acceleration(q, v, tau, self._driven, accelerations, axes)
        return self._derivative(y, a)

    def _derivative(self, y: Array, a: Array) -> Array:
        """Return dy/dt for the acceleration a (nv,)."""
        size, m, r, numbers = self._size, self._m, self._r, y.tolist()
        root, x, v = numbers[:size], numbers[size : size + m], numbers[size + m :]
        rates = self._configuration.derivative(x, v[r:])
        return np.array([*self.root.rate(root, v[:r]), *rates, *a.tolist()])

    def _beside_switches(self, t: float) -> float:
        """Return the time; if it is too close to a switch, move it to the side of `within`.

        Conditions on time are evaluated at the returned time. Exactly at a switch, a condition can
        have the value of either side.
        """
        if not self._switches.size or self._forces is None:
            return t
        aside = _ASIDE * self._scene.end
        k = int(np.searchsorted(self._switches, t))
        nearest = self._switches[max(k - 1, 0) : k + 1]
        if np.abs(nearest - t).min() > aside:
            return t
        within = float(self._parameters[self._forces.within][0])
        return t + float(np.clip(within - t, -2.0 * aside, 2.0 * aside))

    def force_potential(self, x: Array) -> float:
        """Return the potential energy of the forces at shape x (nx,) [J]; 0 if they have none."""
        if self._forces is None or not self._forces.has_potential:
            return 0.0
        return self._forces.potential(x, self._parameters)

    def q(self, y: Array) -> Array:
        """Return Pinocchio's configuration (nq,) of y."""
        size = self._size
        return self._configuration(y[:size], y[size : size + self._m])

    def _q_for(self, q: Array, axes: pin.Convention) -> Array:
        """Return q for ABA in the given axes.

        In the world's axes, the base is moved to the origin to keep round-off small.
        """
        return self.totals.at_origin(q) if axes == pin.Convention.WORLD else q

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
