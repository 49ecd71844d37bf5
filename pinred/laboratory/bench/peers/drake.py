"""Drake on the same model: a continuous MultibodyPlant, integrated by RK5."""

from __future__ import annotations

import faulthandler
import os
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from ....common.arrays import Array
from ....common.errors import IntegrationError, UnsupportedOperationError
from ....system.system import System
from ..problems import End, PreparedRun, Problem, Solver, decades
from .aba import PeerModel, missing_unless_equal


def check_in_child_process(run: Callable[[], object], who: str) -> None:
    """Run a function once in a child process.

    Some libraries abort instead of raising. Exceptions of `run` are ignored here; the timed run
    raises them again.

    Args:
        run: Function to call.
        who: Name of the tool in messages.
    Raises:
        IntegrationError: The child process was killed.
    """
    with warnings.catch_warnings():  # JAX warns about fork, but the child does not use JAX
        warnings.simplefilter("ignore", RuntimeWarning)
        child = os.fork()
    if child == 0:
        try:
            faulthandler.disable()
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            run()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        raise IntegrationError(f"{who} aborts (signal {os.WTERMSIG(status)})")


_MAX_STEP = 0.1  # largest step [s], Drake's default


class DrakeModel(PeerModel):
    """A MultibodyPlant of a system, and the conversion of coordinates.

    The base must be a single joint of Drake's that has no singularity: free, with a quaternion,
    planar, or with one axis.
    """

    def __init__(
        self,
        system: System,
        step: float = 0.0,
        limits: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    ) -> None:
        """Build the plant.

        Args:
            system: The system.
            step: Step of Drake's discrete solver [s]; 0 for a continuous plant.
            limits: Lower and upper stops of joints by name [rad | m], which only the discrete
                solver respects.
        Raises:
            UnsupportedOperationError: The base is another joint than those of the class.
        """
        self.system = system
        group = system.group
        self._is_free = group.turns == 3 and bool(group.linear)
        if not (self._is_free or group.dim == 1 or (bool(group.plane) and group.linear == 2)):
            raise UnsupportedOperationError(
                "its base must float, move in a plane, or have one axis"
            )
        tree = import_module("pydrake.multibody.tree")
        math = import_module("pydrake.math")
        self.plant = import_module("pydrake.multibody.plant").MultibodyPlant(time_step=step)
        plant, model = self.plant, system.model
        plant.mutable_gravity_field().set_gravity_vector(system.gravity)
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        bodies, joints = [plant.world_body()], []
        for i in range(1, model.njoints):
            body = plant.AddRigidBody(f"body{i}", _inertia(tree, model.inertias[i]))
            placement, parent = model.jointPlacements[i], bodies[model.parents[i]].body_frame()
            rotation = math.RotationMatrix(placement.rotation)
            offset = math.RigidTransform(rotation, placement.translation)
            frame = plant.AddFrame(tree.FixedOffsetFrame(f"frame{i}", parent, offset))
            S = np.array(data.joints[i].S).reshape(6, -1)
            ends = (f"joint{i}", frame, body.body_frame())
            joint = plant.AddJoint(self._joint(tree, S, ends))
            if (name := str(model.names[i])) in limits:
                joint.set_position_limits(*([limit] for limit in limits[name]))
            armature = float(model.armature[model.joints[i].idx_v])
            if armature:
                plant.AddJointActuator(f"rotor{i}", joint).set_default_rotor_inertia(armature)
            bodies.append(body)
            joints.append(joint)
        plant.Finalize()
        self.context = plant.CreateDefaultContext()
        r, m = system.r, system.m
        # Indices of the root's and the shape's coordinates in Drake's q and v.
        first = plant.GetJointByName("joint1")
        self._root_q, self._root_v = first.position_start(), first.velocity_start()
        self._root_nq = plant.num_positions() - m
        self._x = np.array([joint.position_start() for joint in joints[1:]], dtype=np.intp)
        shape = [joint.velocity_start() for joint in joints[1:]]
        self._v = np.array([*range(self._root_v, self._root_v + r), *shape], dtype=np.intp)
        self._size = self._root_nq + m

    def _joint(self, tree: Any, S: Array, ends: tuple[Any, ...]) -> Any:
        if S.shape[1] == 1:
            if S[:3].any():
                return tree.PrismaticJoint(*ends, S[:3, 0])
            return tree.RevoluteJoint(*ends, S[3:, 0])
        return (tree.QuaternionFloatingJoint if self._is_free else tree.PlanarJoint)(*ends)

    def positions(self, q: Array, x: Array) -> Array:
        """Convert Pinocchio's q and the unwrapped shape to Drake's positions."""
        pose, positions = self.system.configuration(q).pose, np.empty(self._size)
        if self._is_free:
            pose = np.concatenate([pose[6:], pose[3:6], pose[:3]])
        positions[self._root_q : self._root_q + self._root_nq] = pose
        positions[self._x] = x
        return positions

    def velocities(self, q: Array, v: Array) -> Array:
        """Convert Pinocchio's v to Drake's velocities."""
        velocities = np.empty(self.system.n)
        velocities[self._v] = self.turn(q) @ v
        return velocities

    def end(self, y: Array, rates: Array, evaluations: float) -> End:
        """Convert a final state to Pinocchio's coordinates."""
        pose = y[self._root_q : self._root_q + self._root_nq].copy()
        if self._is_free:
            attitude = np.append(pose[1:4], pose[0])
            pose = np.concatenate([pose[4:], attitude / np.linalg.norm(attitude)])
        x = y[self._x].copy()
        q = self.system.q(pose, x)
        return End(x, q, self.turn(q).T @ rates[self._v], evaluations)

    def equations(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return Drake's mass matrix and accelerations without torques."""
        plant, order = self.plant, self._v
        plant.SetPositions(self.context, self.positions(q, self.system.configuration(q).x))
        plant.SetVelocities(self.context, self.velocities(q, v))
        rates = plant.EvalTimeDerivatives(self.context).get_generalized_velocity()
        H = plant.CalcMassMatrix(self.context)[np.ix_(order, order)]
        return H, rates.CopyToVector()[order]

    def turn(self, q: Array) -> Array:
        """Return the matrix that maps Pinocchio's velocities to Drake's: first those of turns."""
        T = super().turn(q)
        if self._is_free:
            T[:3, 3:6] = T[3:6, :3] = T[:3, :3]
            T[:3, :3] = T[3:6, 3:6] = 0.0
        return T


def _inertia(tree: Any, body: pin.Inertia) -> Any:
    I = body.inertia
    central = tree.RotationalInertia(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
    return tree.SpatialInertia.MakeFromCentralInertia(body.mass, body.lever, central)


def _prepare(problem: Problem, tolerance: float) -> PreparedRun:
    analysis = import_module("pydrake.systems.analysis")
    bridge, duration = DrakeModel.of(problem.system), problem.start.duration
    plant = bridge.plant
    simulator = analysis.Simulator(plant, plant.CreateDefaultContext())
    integrator = analysis.ResetIntegratorFromFlags(simulator, "runge_kutta5", _MAX_STEP)
    integrator.set_target_accuracy(tolerance)
    context = simulator.get_mutable_context()
    q0 = bridge.positions(problem.q0, problem.start.x)
    v0 = bridge.velocities(problem.q0, problem.v0)

    def run() -> tuple[Array, Array, float]:
        context.SetTime(0.0)
        plant.SetPositions(context, q0)
        plant.SetVelocities(context, v0)
        try:
            simulator.Initialize()
            integrator.ResetStatistics()
            simulator.AdvanceTo(duration)
        except RuntimeError as error:
            raise IntegrationError(f"Drake: {' '.join(str(error).split())[:200]}") from None
        count = float(integrator.get_num_derivative_evaluations())
        return plant.GetPositions(context), plant.GetVelocities(context), count

    # Drake aborts the process if a trial step overflows.
    check_in_child_process(run, "Drake")
    return PreparedRun(run, lambda result: bridge.end(*result))


DRAKE = (
    Solver(
        "drake-rk5",
        "Drake's MultibodyPlant under RungeKutta5, Simulator.AdvanceTo",
        decades(2, 13),
        _prepare,
        missing_unless_equal("pydrake", "Drake", DrakeModel.of),
    ),
)
