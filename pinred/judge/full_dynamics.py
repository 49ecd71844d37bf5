"""Pinocchio's forward dynamics of one scene on the full state (q, v).

It shares no dynamics with the reduction: its root kinematics, its momenta and energies (computed by
Pinocchio) are independent. Only the force expressions are shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.force_values import BaseInSpace
from ..kernels.pinocchio_terms import LoadsByPinocchio
from ..scene.scene import Scene
from ..simulation.plan import stops_of
from ..simulation.reduced_flow import Sample
from ..system.system import System
from .condition_times import condition_times
from .coupling_constraints import CouplingConstraints
from .full_coordinates import Configuration, root_motion
from .loop_errors import closed
from .rate_terms import ActingForces, FullCoordinates, Kinematics, compile_kinematics
from .system_totals import SystemTotals

# Smallest distance from a switch at which a condition on time is evaluated, relative to the
# duration.
_ASIDE = 1e-11


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
        self._changing = np.zeros(len(self._parameters), dtype=bool)
        if self._forces is not None:
            for _, where in self._forces.held:
                self._changing[where] = True
        if self._forces is not None and self._forces.switching.conditions is not None:
            written = condition_times(self._forces, self._stops, self._parameters)
            self._stops = self._switches = np.union1d(self._stops, written)
        self._model = system.sorted_model
        self._r = system.r
        self._no_torque = np.zeros(system.model.nv)
        self.couplings = CouplingConstraints(system)
        self.root = root_motion(system.sorted_model)
        self.totals = SystemTotals(system.sorted_model, self.root)
        self._linear, self._size = self.root.linear, self.root.size
        self._configuration = Configuration(system.sorted_model, self.root)
        self._m = self._configuration.size
        loads = () if self._forces is None else self._forces.loads
        self._loads = LoadsByPinocchio(system, self.root.axes, loads) if loads else None
        driven = [] if self._forces is None else list(self._forces.joints)
        self._driven: list[int] = self.couplings.leads[driven].tolist()
        driven_x = self.couplings.leads_x[system.space.coordinates_of_joints(driven)]
        # Indices in y of the coordinates and rates of the prescribed joints.
        self._driven_x = self._size + driven_x
        self._driven_v = self._size + self._m + self._r + np.array(self._driven, dtype=np.intp)
        self._full_coordinates = FullCoordinates(
            self.root, self._configuration, self.couplings, self._driven_x, self._driven_v
        )

    @cached_property
    def _kinematics(self) -> Kinematics:
        compiled = partial(compile_kinematics, self._full_coordinates, self._forces)
        is_shared = self._forces is None  # all motions without forces have the same kinematics
        function = self.system.workspace(compile_kinematics, compiled) if is_shared else compiled()
        return Kinematics(function, self._parameters)

    @cached_property
    def _acting(self) -> ActingForces | None:
        if self._forces is None:
            return None
        coordinates, at = self._full_coordinates, self._kinematics
        return ActingForces(coordinates, self._forces, self._parameters, at)

    @property
    def system(self) -> System:
        """The system of the scene."""
        return self._scene.system

    @property
    def coordinates(self) -> int:
        """Number of coordinates of all joints except the root, followers included."""
        return self._m

    def set_parameters(self, parameters: Array) -> None:
        """Set the commands of controllers and the sides of switches from parameters (p,) of forces.

        All other parameters keep the values of the scene, whatever a trajectory used.
        """
        self._parameters[self._changing] = np.asarray(parameters)[self._changing]
        if self._forces is not None and (within := parameters[self._forces.within]).size:
            self._forces.set_span(self._parameters, within[0])

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

    def _apply_couplings(self, y: Array) -> Array:
        """Return y with follower joints set from their leaders, and with closed loops."""
        couplings, close = self.couplings, bool(self.system.loops)
        if not (len(couplings.J) or close):
            return y
        pose, x, xi, xdot = self._full_coordinates.split(y)
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

    def shapes_and_velocities(self, y: Array) -> tuple[Array, Array]:
        """Return the shapes (T, nx) and Pinocchio's velocities (T, nv) of full states (T, n)."""
        x, v = np.split(y[:, self._size :], [self._m], axis=1)
        return np.array([self._shape(row) for row in x]), v

    def _shape(self, x: Array) -> Array:
        """Return the shape (nx,), with quaternions of length one, from all coordinates."""
        shape = self.couplings.shape(x)
        return self.system.space.normalized(shape, "x", near=False)

    def base_in_space(self, q: Array, root: Array, v: Array) -> BaseInSpace:
        """Compute pose, twist and momenta of the base with Pinocchio.

        Args:
            q: Pinocchio's configuration, (nq,).
            root: Root coordinates, (size,).
            v: Pinocchio's velocity, (nv,).
        Returns:
            The base relative to the root joint's fixed frame.
        """
        r, k = self._r, self._linear
        pose = root.copy()
        if self.root.turns == 3:
            pose[k:] /= np.linalg.norm(root[k:])
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
        beside = self._beside_switches(t)
        if beside == t:
            return self._rate(t, y, axes)
        # Conditions have the value of one side.  All other functions of time are extrapolated.
        return 2.0 * self._rate(beside, y, axes) - self._rate(2.0 * beside - t, y, axes)

    def _rate(self, t: float, y: Array, axes: pin.Convention) -> Array:
        at, tau = self._kinematics, self._no_torque
        at.compute(t, y)
        if self._acting is not None:
            tau = self._generalised_forces(self._acting)
        q = self._q_for(at.q, axes)
        rate, first = np.empty(len(y)), len(at.coordinate_rates)
        rate[:first] = at.coordinate_rates
        rate[first:] = self.couplings.acceleration(
            q, at.v, tau, self._driven, at.accelerations, axes
        )
        return rate

    def _generalised_forces(self, acting: ActingForces) -> Array:
        """Return the generalised forces (nv,) at the state of the kinematics."""
        q, v, forces = self._kinematics.q, self._kinematics.v, self._forces
        assert forces is not None
        if forces.sees_momentum:
            acting.xi[:], acting.mu[:] = self.totals.about_com(q, v)
        if forces.sees_base_momenta:
            acting.base_mu[:] = self.totals.body_momentum(q, v)
            acting.base_J[:] = self.totals.momentum(q, v, np.zeros(3), about_pivot=True)
        acting.compute()
        if self._loads is None:
            return acting.tau
        return acting.tau + self._loads.generalised(q, acting.loads)

    def rates(
        self,
        t: Array,
        y: Array,
        parameters: Sequence[Array],
        axes: pin.Convention = pin.Convention.LOCAL,
    ) -> Array:
        """Compute dy/dt at many times.

        Args:
            t: Times, (T,) [s].
            y: Full states, (T, n).
            parameters: Parameters (p,) of forces at each time.
            axes: Frames in which ABA is evaluated.
        Returns:
            (T, n) time derivatives of y.
        """
        rates = np.empty_like(y)
        for k, time in enumerate(t.tolist()):
            self.set_parameters(parameters[k])
            rates[k] = self.rate(time, y[k], axes)
        return rates

    def _beside_switches(self, t: float) -> float:
        """Return the time; if it is too close to a switch, move it to the side of `within`.

        Exactly at a switch, a condition can have the value of either side.
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

    def force_potential(self, x: Array) -> Array:
        """Return the potential energies of the forces, (T,) [J], at shapes x (T, nx)."""
        if self._forces is None or not self._forces.has_potential:
            return np.zeros(len(x))
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
