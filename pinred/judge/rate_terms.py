"""Kinematics and forces of the full state, compiled with CasADi.

They are evaluated thousands of times, and numpy's operations on arrays of ten numbers take longer
than Pinocchio's ABA. So the functions of numpy arrays that define the kinematics are called once
with symbols, and the resulting expressions are compiled.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..forces.force_model import ForceModel
from ..forces.force_values import FunctionBuffers
from ..system.coordinates import Indices
from .coupling_constraints import CouplingConstraints
from .full_coordinates import Configuration, RootMotion, normalise


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
