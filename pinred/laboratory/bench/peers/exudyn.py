"""Exudyn on the same model: a kinematic tree in minimal coordinates, with explicit integrators.

Exudyn attaches trees to the ground, so a floating base is modelled by six joints with Euler angles.
A rotation is R = R₁(θ₁) R₂(θ₂) R₃(θ₃) about the axes x, y, z in some order. Of the six orders,
`best_order` selects the order whose singularity cos θ₂ = 0 is farthest from the motion.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ....common.arrays import Array
from ....common.errors import IntegrationError
from ....system.system import System
from ..problems import ATOL, UNKNOWN, End, PreparedRun, Problem, Solver, decades, halvings, steps_of
from .aba import frame_rotation_term, missing_unless_equal

Order = tuple[int, int, int]
ORDERS: tuple[Order, ...] = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
_SAMPLES = 400  # number of times at which the motion is evaluated


def _sequence(order: Order) -> str:
    """Return SciPy's name of rotations about moving axes."""
    return "".join("XYZ"[axis] for axis in order)


def angles_of(R: Array, order: Order) -> Array:
    """Compute the three angles of a rotation matrix, the second in [−π/2, π/2]."""
    return np.asarray(Rotation.from_matrix(R).as_euler(_sequence(order)))


def rotation_of(angles: Array, order: Order) -> Array:
    """Compute the rotation matrix of three angles."""
    return np.asarray(Rotation.from_euler(_sequence(order), angles).as_matrix())


def spin_matrix(angles: Array, order: Order) -> Array:
    """Compute the matrix (3, 3) that maps angle rates to the body's angular velocity."""
    unit = np.eye(3)
    third = Rotation.from_rotvec(angles[2] * unit[order[2]]).as_matrix().T
    second = third @ Rotation.from_rotvec(angles[1] * unit[order[1]]).as_matrix().T
    return np.column_stack([second @ unit[order[0]], third @ unit[order[1]], unit[order[2]]])


def spin_rate(angles: Array, rates: Array, order: Order) -> Array:
    """Compute the time derivative of the spin matrix times the angle rates, (3,)."""
    E = spin_matrix(angles, order)
    last = E[:, 2] * rates[2]
    last_two = last + E[:, 1] * rates[1]
    return np.asarray(-np.cross(last_two, E[:, 0]) * rates[0] - np.cross(last, E[:, 1]) * rates[1])


def best_order(problem: Problem) -> Order:
    """Return the order of axes whose singularity is farthest from the motion."""
    times = np.linspace(0.0, problem.start.duration, _SAMPLES)[1:]
    motion = problem.full.run(problem.full_start(), times, 1e-6, 1e-8)
    group = problem.system.group
    poses = problem.system.configuration(motion.q).pose
    k = group.linear
    R = np.array([group.matrix(pose)[:3, :3] for pose in poses]) if k + 4 == group.size else None
    if R is None:
        return ORDERS[0]
    return min(ORDERS, key=lambda order: float(np.abs(R[:, order[0], order[2]]).max()))


class ExudynModel:
    """An Exudyn system of one kinematic tree, and the conversion of coordinates.

    order: axes of the Euler angles, for a base with three rotations.
    """

    def __init__(self, system: System, order: Order = ORDERS[0]) -> None:
        """Build the model."""
        self.exu = import_module("exudyn")
        self.system, self.order = system, order
        self._m, self._has_quaternion = system.m, system.group.turns == 3
        self.container = self.exu.SystemContainer()
        self.mbs = self.container.AddSystem()
        self._build()
        self.mbs.Assemble()

    def _build(self) -> None:
        exu, model, system = self.exu, self.system.model, self.system
        items = import_module("exudyn.itemInterface")
        kinds, joints, parents = exu.JointType, [], []
        turns, offsets, moments, coms, masses = [], [], [], [], []
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        last, frames = [-1], [np.eye(3)]  # link index and frame of each Pinocchio joint
        armature: list[float] = []

        def add(kind: Any, parent: int, turn: Array, offset: Array) -> None:
            joints.append(kind)
            parents.append(parent)
            turns.append(turn)
            offsets.append(offset)
            moments.append(np.zeros((3, 3)))
            coms.append(np.zeros(3))
            masses.append(0.0)

        for i in range(1, model.njoints):
            place, parent = model.jointPlacements[i], model.parents[i]
            S = np.array(data.joints[i].S).reshape(6, -1)
            A = np.eye(3)
            turn, offset = frames[parent].T @ place.rotation, frames[parent].T @ place.translation
            link = last[parent]
            if S.shape[1] == 1:
                A = _to_z(S[:3, 0] + S[3:, 0])
                kind = kinds.PrismaticZ if S[:3].any() else kinds.RevoluteZ
                add(kind, link, turn @ A, offset)
                armature.append(float(model.armature[model.joints[i].idx_v]))
            else:
                for kind in self._root():
                    add(kind, link, turn, offset)
                    link, turn, offset = len(joints) - 1, np.eye(3), np.zeros(3)
                    armature.append(0.0)
            body = model.inertias[i]
            masses[-1], coms[-1] = float(body.mass), A.T @ body.lever
            moments[-1] = A.T @ body.inertia @ A
            last.append(len(joints) - 1)
            frames.append(A)
        n = len(joints)
        self.node = self.mbs.AddNode(
            items.NodeGenericODE2(
                referenceCoordinates=[0.0] * n,
                initialCoordinates=[0.0] * n,
                initialCoordinates_t=[0.0] * n,
                numberOfODE2Coordinates=n,
            )
        )
        self.mbs.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=self.node,
                gravity=system.gravity.tolist(),
                jointTypes=joints,
                linkParents=np.array(parents),
                jointTransformations=exu.Matrix3DList(turns),
                jointOffsets=exu.Vector3DList(offsets),
                linkInertiasCOM=exu.Matrix3DList(moments),
                linkCOMs=exu.Vector3DList(coms),
                linkMasses=np.array(masses),
            )
        )
        if any(armature):
            self.mbs.AddObject(
                items.ObjectGenericODE2(nodeNumbers=[self.node], massMatrix=np.diag(armature))
            )

    def _root(self) -> list[Any]:
        kinds = self.exu.JointType
        slides = [kinds.PrismaticX, kinds.PrismaticY, kinds.PrismaticZ]
        turns = [kinds.RevoluteX, kinds.RevoluteY, kinds.RevoluteZ]
        axes, k = self.system.group.axes, self.system.group.linear
        about = self.order if self._has_quaternion else [axis - 3 for axis in axes[k:]]
        return [*(slides[axis] for axis in axes[:k]), *(turns[axis] for axis in about)]

    def coordinates(self, q: Array, x: Array) -> Array:
        """Convert Pinocchio's q and the unwrapped shape to Exudyn's coordinates."""
        pose, group = self.system.configuration(q).pose, self.system.group
        if self._has_quaternion:
            R = group.matrix(pose)[:3, :3]
            pose = np.concatenate([pose[: group.linear], angles_of(R, self.order)])
        return np.concatenate([pose, x])

    def rates(self, q: Array, v: Array) -> Array:
        """Convert Pinocchio's v to rates of Exudyn's coordinates."""
        y = self.coordinates(q, self.system.configuration(q).x)
        return np.asarray(np.linalg.solve(self._turn(y), v))

    def end(self, y: Array, rates: Array, evaluations: float) -> End:
        """Convert a final state to Pinocchio's coordinates."""
        r, group = self.system.r, self.system.group
        pose, x = y[:r].copy(), y[r:].copy()
        if self._has_quaternion:
            R = rotation_of(pose[-3:], self.order)
            quaternion = pin.Quaternion(R).normalized().coeffs()
            pose = np.concatenate([pose[: group.linear], quaternion])
        return End(x, self.system.q(pose, x), self._turn(y) @ rates, evaluations)

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix (n, n) with respect to Pinocchio's velocities."""
        y = self.coordinates(q, self.system.configuration(q).x)
        H, _ = self._equations(y, np.zeros(len(y)))
        inverse = np.linalg.inv(self._turn(y))
        return np.asarray(inverse.T @ H @ inverse)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return Pinocchio's dv/dt without torques, (n,)."""
        y, rates = self.coordinates(q, self.system.configuration(q).x), self.rates(q, v)
        H, load = self._equations(y, rates)
        a = self._turn(y) @ np.linalg.solve(H, load)
        k = self.system.group.linear
        if self._has_quaternion:
            a[k : k + 3] += spin_rate(y[k : k + 3], rates[k : k + 3], self.order)
        a[:k] -= frame_rotation_term(self.system, v)
        return np.asarray(a)

    def _turn(self, y: Array) -> Array:
        """Return the matrix that maps rates of Exudyn's coordinates to Pinocchio's velocities."""
        T, group = np.eye(self.system.n), self.system.group
        k = group.linear
        if group.plane:
            T[:k, :k] = group.turned_back(y[k : k + 1], np.eye(k)).T
        elif self._has_quaternion:
            T[k : k + 3, k : k + 3] = spin_matrix(y[k : k + 3], self.order)
            if k:
                T[:3, :3] = rotation_of(y[3:6], self.order).T
        return T

    def _equations(self, y: Array, rates: Array) -> tuple[Array, Array]:
        """Return mass matrix and generalized forces in Exudyn's coordinates."""
        exu = self.exu
        self.start(y, rates)
        solver = exu.MainSolverExplicit()
        settings = self.settings()
        solver.InitializeSolver(self.mbs, settings)
        self.mbs.systemData.SetODE2Coordinates(y)
        self.mbs.systemData.SetODE2Coordinates_t(rates)
        solver.ComputeMassMatrix(self.mbs)
        H = np.array(solver.GetSystemMassMatrix())
        solver.ComputeODE2RHS(self.mbs)
        load = np.array(solver.GetSystemResidual())[: len(y)]
        solver.FinalizeSolver(self.mbs, settings)
        return H, load

    def start(self, y: Array, rates: Array) -> None:
        """Set the initial state of the next simulation."""
        initial, state = self.exu.ConfigurationType.Initial, self.mbs.systemData
        state.SetODE2Coordinates(y, initial)
        state.SetODE2Coordinates_t(rates, initial)

    def settings(self) -> Any:
        """Return settings of a simulation without output files."""
        settings = self.exu.SimulationSettings()
        settings.solutionSettings.writeSolutionToFile = False
        settings.timeIntegration.verboseMode = 0
        settings.timeIntegration.solverType = self.exu.DynamicSolverType.RK44
        settings.parallel.numberOfThreads = 1
        return settings


def _to_z(axis: Array) -> Array:
    """Return a rotation whose last column is a unit vector."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(other, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def exudyn_model(problem: Problem) -> ExudynModel:
    """Return Exudyn's model of a problem's system, with the best order of angles for it."""
    return problem.system.workspace(
        ("exudyn", problem.name), lambda: ExudynModel(problem.system, best_order(problem))
    )


def _prepare(problem: Problem, value: float, solver: str, stages: float) -> PreparedRun:
    """Prepare a run.

    Args:
        problem: The problem.
        value: Tolerance; for fixed steps, their length relative to the duration.
        solver: Name of Exudyn's solver type.
        stages: Evaluations of a fixed step; 0 for an adaptive solver.
    Returns:
        The prepared run.
    """
    bridge = exudyn_model(problem)
    settings = bridge.settings()
    steps = settings.timeIntegration
    steps.endTime = problem.start.duration
    steps.automaticStepSize = not stages
    steps.numberOfSteps = steps_of(value) if stages else 1
    if not stages:
        steps.relativeTolerance, steps.absoluteTolerance = value, ATOL * value
        steps.minimumStepSize = 1e-10 * problem.start.duration
        steps.initialStepSize = 1e-3 * problem.start.duration
    y0 = bridge.coordinates(problem.q0, problem.start.x)
    rates = bridge.rates(problem.q0, problem.v0)
    kind = getattr(bridge.exu.DynamicSolverType, solver)

    def run() -> tuple[Array, Array]:
        bridge.start(y0, rates)
        try:
            bridge.mbs.SolveDynamic(settings, solverType=kind)
        except Exception as error:  # Exudyn raises exceptions of various types
            raise IntegrationError(f"Exudyn: {' '.join(str(error).split())[:200]}") from None
        state = bridge.mbs.systemData
        return np.array(state.GetODE2Coordinates()), np.array(state.GetODE2Coordinates_t())

    def end(state: tuple[Array, Array]) -> End:
        evaluations = stages * steps_of(value) if stages else UNKNOWN
        return bridge.end(state[0], state[1], evaluations)

    return PreparedRun(run, end)


_missing = missing_unless_equal("exudyn", "Exudyn", ExudynModel)

EXUDYN = (
    Solver(
        "exudyn-rk67",
        "Exudyn's kinematic tree with RK67, equal steps, SolveDynamic",
        halvings(20, 13),
        partial(_prepare, solver="RK67", stages=10),
        _missing,
        fixed=True,
    ),
    Solver(
        "exudyn-dopri5",
        "Exudyn's kinematic tree with DOPRI5, SolveDynamic",
        decades(2, 13),
        partial(_prepare, solver="DOPRI5", stages=0),
        _missing,
    ),
)
