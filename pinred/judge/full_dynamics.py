"""Pinocchio's forward dynamics of one scene on the full state (q, v).

It shares no dynamics with the reduction: its root kinematics, its momenta and energies (computed by
Pinocchio) are independent. Only the force expressions are shared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.force_values import BaseInSpace, ForceInputs
from ..kernels.loads_by_pinocchio import LoadsByPinocchio
from ..scene.scene import Scene
from ..simulation.plan import stops_of
from ..simulation.sample import Sample
from ..system.system import System
from .condition_times import condition_times
from .coupling_constraints import CouplingConstraints
from .full_coordinates import Configuration, root_motion
from .loop_errors import closed
from .system_totals import SystemTotals

# Smallest distance from a switch at which a condition on time is evaluated, relative to the
# duration.
_ASIDE = 1e-11
_NONE = np.empty(0)  # accelerations of no prescribed joints


class FullDynamics:
    """Pinocchio's forward dynamics of one scene, as a vector field.

    The state is y = (root, x, v): root coordinates (position; angle or quaternion), the coordinates
    of all joints (an unwrapped value, or the quaternion of a ball), and Pinocchio's velocity.
    Pinocchio computes the inputs of forces from y. Prescribed joints follow their plan. Follower
    joints obey multipliers, see coupling_constraints.py.

    Attributes:
        couplings: Constraints between followers and leaders.
        root: Kinematics of the root joint.
        totals: Energies and momenta of the whole system.
    """

    def __init__(self, scene: Scene) -> None:
        """Prepare Pinocchio's work space for a scene."""
        system = scene.system
        self._scene, self._forces = scene, scene.force_model
        self._stops, self._switches = stops_of(scene), np.empty(0)
        self._parameters = np.empty(0) if self._forces is None else self._forces.numbers.copy()
        if self._forces is not None and self._forces.switching.conditions is not None:
            written = condition_times(self._forces, self._stops, self._parameters)
            self._stops = self._switches = np.union1d(self._stops, written)
        self._model = system.model
        self._r = system.r
        self._sees_base = self._forces is not None and self._forces.sees_base
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
        """Assemble y (..., n).

        Args:
            pose: Pose of the base, (..., size).
            x: Shape, (..., nx) [rad | m | 1].
            xi: Body twist, (..., r) [m/s; rad/s].
            xdot: Shape rate, (..., m) [rad/s | m/s].
        Returns:
            The full state (..., n).
        """
        values, rates = self.couplings.values(x), self.couplings.rates(xdot)
        return np.concatenate([pose, values, xi, rates], axis=-1)

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
        size, m, r, forces = self._size, self._m, self._r, self._forces
        if forces is None:
            v, q = y[size + m :], self._q_for(self.q(y), axes)
            a = self.couplings.acceleration(q, v, self._no_torque, axes=axes)
            return self._derivative(y, a)
        y, t, accelerations = y.copy(), self._beside_switches(t), _NONE
        if self._driven:
            x, rates, accelerations = forces.planned(t, self._parameters)
            y[self._driven_x], y[self._driven_v] = x, rates
            y = self._apply_couplings(y, close=False)
        x, v, q, base = y[size : size + m], y[size + m :], self.q(y), None
        xi, mu = self.totals.about_com(q, v) if forces.sees_momentum else self._unused
        if self._sees_base:
            base = self.base_in_space(q, y[:size], v, momenta=forces.sees_base_momenta)
        shape_rate = self.couplings.shape_rate(v[r:])
        torque, wrench, loads = forces.acting_apart(
            ForceInputs(t, self._shape(x), shape_rate, xi, mu, self._parameters, base)
        )
        tau = np.concatenate((wrench, self.couplings.joint_torques(torque)))
        if self._loads is not None:
            tau += self._loads.generalised(q, loads)
        q = self._q_for(q, axes)
        a = self.couplings.acceleration(q, v, tau, self._driven, accelerations, axes)
        return self._derivative(y, a)

    def rates(
        self,
        t: Array,
        y: Array,
        parameters: Sequence[Array],
        axes: pin.Convention = pin.Convention.LOCAL,
    ) -> Array:
        """Compute dy/dt at many times; without forces this is faster than `rate` at each time.

        Args:
            t: Times, (T,) [s].
            y: Full states, (T, n).
            parameters: Parameters (p,) of forces at each time.
            axes: Frames in which ABA is evaluated.
        Returns:
            (T, n) time derivatives of y.
        """
        if self._forces is None:
            q, v = self._q_for(self.q(y), axes), y[:, self._size + self._m :]
            accelerate, none = self.couplings.acceleration, self._no_torque
            a = [accelerate(*state, none, axes=axes) for state in zip(q, v, strict=True)]
            return self._derivative(y.T, np.array(a).reshape(v.shape).T, list).T
        rates = np.empty_like(y)
        for k, time in enumerate(t.tolist()):
            self.set_parameters(parameters[k])
            rates[k] = self.rate(time, y[k], axes)
        return rates

    def _derivative(
        self, y: Array, a: Array, entries: Callable[[Array], list[Any]] = np.ndarray.tolist
    ) -> Array:
        """Return dy/dt for the acceleration a (nv,), or for T states y (n, T) and a (nv, T).

        entries: Function that returns the entries as numbers, or for T states as arrays (T,).
        """
        size, first, r = self._size, self._size + self._m, self._r
        derivative, x, v = np.empty(y.shape), y[size:first], y[first:]
        derivative[:size] = self.root.rate(entries(y[:size]), entries(v[:r]))
        derivative[size:first] = (
            self._configuration.derivative(entries(x), entries(v[r:]))
            if self._configuration.balls
            else v[r:]
        )
        derivative[first:] = a
        return derivative

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

    @property
    def has_force_potential(self) -> bool:
        """Whether any force has a potential."""
        return self._forces is not None and self._forces.has_potential

    def force_potential(self, x: Array) -> float:
        """Return the potential energy of the forces at shape x (nx,) [J]; 0 if they have none."""
        if self._forces is None or not self._forces.has_potential:
            return 0.0
        return self._forces.potential(x, self._parameters)

    def q(self, y: Array) -> Array:
        """Return Pinocchio's configuration (..., nq) of y (..., n)."""
        size = self._size
        return self._configuration(y[..., :size], y[..., size : size + self._m])

    def _q_for(self, q: Array, axes: pin.Convention) -> Array:
        """Return q for ABA in the given axes.

        In the world's axes, the base is moved to the origin to keep round-off small.
        """
        return self.totals.at_origin(q) if axes == pin.Convention.WORLD else q
