"""Pinocchio's forward dynamics of one scene on the full state (q, v).

It shares no dynamics with the reduction: its root kinematics, its momenta and energies (computed by
Pinocchio) are independent. Only the force expressions are shared.

Kinematics and forces are evaluated thousands of times, and numpy's operations on arrays of ten
numbers take longer than Pinocchio's ABA. So the functions of numpy arrays that define the
kinematics are called once with symbols, and CasADi compiles the resulting expressions.

Times at which conditions on time change are found by sampling the forces' conditions, independent
of the search for the stops of integrators. All conditions are sampled densely, with a bisection
between samples that differ, so a pulse that is shorter than the sample spacing can be missed. Such
a pulse is detected if the motion stops at both of its ends, because the middle of each span is
sampled, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.force_model import ForceModel
from ..forces.force_numbers import BaseInSpace, FunctionBuffers
from ..kernels.reference_state import LoadsByPinocchio
from ..scene.scene import Scene
from ..simulation.plan import stops_of
from ..simulation.reduced_flow import Sample
from ..system.coordinates import Indices
from ..system.system import System
from .full_system import (
    Configuration,
    CouplingConstraints,
    RootMotion,
    SystemTotals,
    closed,
    normalise,
    root_motion,
)

_SAMPLES = 1 << 14
_RESOLUTION = 1e-14  # length at which bisection ends, as a fraction of the duration


def condition_times(forces: ForceModel, stops: Array, numbers: Array) -> Array:
    """Return the sorted times before the last stop at which a condition on time changes.

    Args:
        forces: The forces.
        stops: Sorted times at which the motion stops, its end included, (S,) [s].
        numbers: Force parameters, (p,).
    Returns:
        The times, (K,) [s].
    """
    conditions = forces.switching.conditions
    if conditions is None:
        return np.empty(0)
    end = float(stops[-1])
    span_ends = np.concatenate([[0.0], stops])
    middles = 0.5 * (span_ends[1:] + span_ends[:-1])
    times = np.union1d(np.linspace(0.0, end, _SAMPLES), middles)
    values = _values(forces, conditions, times, numbers)
    changes = np.flatnonzero((values[1:] != values[:-1]).any(axis=1))
    a, b, at_a, at_b = times[changes], times[changes + 1], values[changes], values[changes + 1]
    while a.size and (b - a).max() > _RESOLUTION * end:
        middle = 0.5 * (a + b)
        at = _values(forces, conditions, middle, numbers)
        lower, upper = (at != at_a).any(axis=1), (at != at_b).any(axis=1)
        a, b = np.append(a[lower], middle[upper]), np.append(middle[lower], b[upper])
        at_a, at_b = (
            np.concatenate(halves)
            for halves in ((at_a[lower], at[upper]), (at[lower], at_b[upper]))
        )
    return np.unique(b)


def _values(forces: ForceModel, conditions: ca.Function, times: Array, numbers: Array) -> Array:
    """Return the values of all conditions, (T, C), at times (T,)."""
    mapped, parameters = conditions.map(len(times)), np.repeat(numbers[None], len(times), axis=0)
    forces.set_span(parameters, times)
    conditions_at_times = mapped(times[None], parameters.T)
    return np.asarray(conditions_at_times.T)


@dataclass(frozen=True)
class FullCoordinates:
    """The layout of the full state y = (root, x, v).

    Attributes:
        root: Kinematics of the root joint.
        joints: Coordinates of all other joints.
        couplings: Constraints between followers and leaders.
        driven_x: Indices in y of the coordinates of prescribed joints.
        driven_v: Indices in y of the rates of prescribed joints.
    """

    root: RootMotion
    joints: Configuration
    couplings: CouplingConstraints
    driven_x: Indices
    driven_v: Indices

    @property
    def r(self) -> int:
        """Number of velocities of the root joint."""
        return int(self.root.axes.shape[1])

    @property
    def size(self) -> int:
        """Length n of y."""
        return self.root.size + self.joints.size + self.r + self.joints.rates

    def split(self, y: Array) -> tuple[Array, Array, Array, Array]:
        """Split y (n,) into root coordinates, joint coordinates, body twist and joint rates."""
        first = self.root.size + self.joints.size
        pose, x, xi, xdot = np.split(y, [self.root.size, first, first + self.r])
        return pose, x, xi, xdot


class Kinematics:
    """Kinematic quantities of one full state. Each call of `compute` overwrites them.

    Attributes:
        t: Time, (1,) [s].
        state: y with prescribed joints and their followers in place, (n,).
        q: Pinocchio's configuration of `state`, (nq,).
        v: Pinocchio's velocity in `state`, (nv,).
        coordinate_rates: Rates of the coordinates in `state`, (n - nv,).
        accelerations: Accelerations of the prescribed joints, (k,).
    """

    def __init__(self, function: ca.Function, parameters: Array) -> None:
        """Allocate the arrays.

        Args:
            function: Result of `compile_kinematics`.
            parameters: Parameters of the forces, (p,), which are read at each call.
        """
        buffers = FunctionBuffers(function, {2: parameters})
        self.t, self._y, _ = buffers.inputs
        self.state, self.q, self.coordinate_rates, self.accelerations = (
            output[:, 0] for output in buffers.outputs
        )
        self.v, self._run = self.state[len(self.coordinate_rates) :], buffers.run

    def compute(self, t: float, y: Array) -> None:
        """Compute all quantities at time t [s] and full state y (n,)."""
        self.t[0] = t
        self._y[:] = y
        self._run()


class ActingForces:
    """Forces at the last state of a `Kinematics`. Each call of `compute` overwrites them.

    Attributes:
        xi: Body twist about the centre of mass, (r,), to set if the forces depend on it.
        mu: Body momentum about the centre of mass, (r,), likewise.
        base_mu: Body momentum of the base in space, (r,), likewise.
        base_J: Spatial momentum, (r,), likewise.
        tau: Generalised forces without loads on links, (nv,).
        loads: Loads on links, (9, L).
        compute: Function without arguments that computes `tau` and `loads`.
    """

    def __init__(
        self,
        coordinates: FullCoordinates,
        forces: ForceModel,
        parameters: Array,
        kinematics: Kinematics,
    ) -> None:
        """Compile the forces.

        Args:
            coordinates: Layout of the full state.
            forces: Forces and prescribed joints.
            parameters: Parameters of the forces, (p,), which are read at each call.
            kinematics: Kinematics, whose time and state are read at each call.
        """
        shared = {0: kinematics.t, 1: kinematics.state, 2: parameters}
        buffers = FunctionBuffers(_acting(coordinates, forces), shared)
        momenta = buffers.inputs[len(shared) :]
        for momentum in momenta:
            momentum[:] = np.nan  # would reveal a force that depends on it
        self.xi, self.mu, self.base_mu, self.base_J = momenta
        self.tau, self.loads, self.compute = (
            buffers.outputs[0][:, 0],
            buffers.outputs[1],
            buffers.run,
        )


def compile_kinematics(at: FullCoordinates, forces: ForceModel | None) -> ca.Function:
    """Compile (t, y, parameters) → (state, q, coordinate_rates, accelerations).

    Args:
        at: Layout of the full state.
        forces: Forces and prescribed joints.
    Returns:
        The function.
    """
    t, y, p = ca.SX.sym("t"), ca.SX.sym("y", at.size), _parameters(forces)
    state, accelerations = _entries(y), ca.SX(0, 1)
    if forces is not None and len(at.driven_v):
        planned_x, planned_rates, accelerations = forces.planned_function(t, p)
        state[at.driven_x], state[at.driven_v] = _entries(planned_x), _entries(planned_rates)
        pose, x, xi, xdot = at.split(state)
        x = at.couplings.values(at.couplings.shape(x))
        xdot = at.couplings.rates(at.couplings.shape_rate(xdot))
        state = np.concatenate([pose, x, xi, xdot])
    pose, x, xi, xdot = at.split(state)
    coordinate_rates = [*at.root.rate(pose, xi), *at.joints.derivative(x, xdot)]
    outputs = [
        _column(state),
        _column(at.joints(pose, x)),
        _column(coordinate_rates),
        accelerations,
    ]
    return ca.Function("kinematics", [t, y, p], [ca.densify(output) for output in outputs])


def _acting(at: FullCoordinates, forces: ForceModel) -> ca.Function:
    """Compile (t, state, parameters, momenta) → (tau, loads)."""
    t, y, p = ca.SX.sym("t"), ca.SX.sym("y", at.size), _parameters(forces)
    momenta = [ca.SX.sym(name, at.r) for name in ("xi", "mu", "base_mu", "base_J")]
    xi, mu, base_mu, base_J = momenta
    pose, x, twist, rates = at.split(_entries(y))
    if at.root.turns == 3:
        normalise(pose[at.root.linear :])
    shape, shape_rate = at.couplings.shape(at.joints.normalised(x)), at.couplings.shape_rate(rates)
    base = _column(pose), _column(twist), base_mu, base_J
    torque, wrench, loads = forces.apart_function(
        t, _column(shape), _column(shape_rate), xi, mu, p, *base, forces.robot
    )
    tau = ca.vertcat(wrench, _column(at.couplings.joint_torques(_entries(torque))))
    return ca.Function("acting", [t, y, p, *momenta], [ca.densify(tau), ca.densify(loads)])


def _parameters(forces: ForceModel | None) -> ca.SX:
    return ca.SX.sym("p", 0 if forces is None else len(forces.numbers))


def _entries(column: ca.SX) -> Array:
    """Return the entries of a column as an array of symbols, which numpy's functions accept."""
    entries = np.empty(column.numel(), dtype=object)
    for k, entry in enumerate(ca.vertsplit(column)):
        entries[k] = entry
    return entries


def _column(entries: Iterable[ca.SX]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *entries)


# Smallest distance from a switch at which a condition on time is evaluated, relative to the
# duration.
_ASIDE = 1e-11


class FullDynamics:
    """Pinocchio's forward dynamics of one scene, as a vector field.

    The state is y = (root, x, v): root coordinates (position; angle or quaternion), the coordinates
    of all joints (an unwrapped value, or the quaternion of a ball), and Pinocchio's velocity.
    Pinocchio computes the inputs of forces from y. Prescribed joints follow their plan. Follower
    joints obey multipliers, see full_system.py.

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
        coordinates, rates = self.couplings.values(x), self.couplings.rates(xdot)
        return np.concatenate([pose, coordinates, xi, rates], axis=-1)

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
