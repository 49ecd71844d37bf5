"""Comparison of a system with MuJoCo's independent reading of the same file.

MuJoCo reads the file itself; bodies and joints are matched by name. At random MuJoCo coordinates
the pose of pinred's group follows from the position of one body by Newton's method, and velocities
follow from its Jacobian. So only the compared model depends on pinred's reader. If the
file fixes a base that floats in pinred, the MuJoCo model gets a free joint at that base.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import LoadError, PinredError
from ...reduction.pointwise_reduction import symmetric
from ...system.mjcf.compile import compiled, mujoco_package, warnings_kept
from ...system.mjcf.read import gravity_of
from ...system.mjcf.world import robot_in
from ...system.robot_files import EVERYTHING, library_output, read_text
from ...system.system import System

STATES = 3
# Springs and dampers stay enabled, because MuJoCo disables gravity compensation with them.
_OFF = ("CONSTRAINT", "EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT", "ACTUATION")
_NEWTON = 60  # largest number of Newton iterations for the pose
_CANCELS = 1e-3  # fraction of cancelling moments that is added to the scale of force errors
_ROUND_OFF = 1e-12  # relative position step below which Newton's method has converged


@dataclass(frozen=True)
class Differences:
    """Largest relative differences between two readings over some random states.

    Attributes:
        places: Difference of body positions, relative to the robot's reach.
        mass: Difference of the mass matrix, relative to its largest entry.
        forces: Difference of bias forces and of forces at random accelerations, relative to the
            magnitudes of the terms in their sums.
    """

    places: float
    mass: float
    forces: float


def differences(
    system: System, file: str, kind: str, root: str | None, *, weightless: bool = False
) -> Differences:
    """Compare a system with MuJoCo's reading of its file.

    Args:
        system: The system that pinred loaded.
        file: The file.
        kind: "urdf" or "mjcf".
        root: The chosen root body, if there was a choice.
        weightless: Whether the system was loaded without the file's gravity.
    Returns:
        The largest differences.
    Raises:
        LoadError: MuJoCo does not read the file, or bodies cannot be matched.
        PinredError: pinred rejects a part of the file.
    """
    with library_output(EVERYTHING), warnings_kept():
        try:
            model = _read(system, file, kind, root)
        except PinredError:
            raise
        except Exception as error:  # MuJoCo raises ValueError, RuntimeError and its own types
            words = str(error).strip().splitlines() or [type(error).__name__]
            raise LoadError(f"MuJoCo: {words[0].removeprefix('Error: ')}") from None
        if weightless:
            model.opt.gravity[:] = 0.0
        for joint in np.flatnonzero(model.jnt_type == int(mujoco_package().mjtJoint.mjJNT_FREE)):
            first = model.jnt_dofadr[joint]
            model.dof_armature[first : first + 6] = 0.0  # pinred ignores it with a warning
        pair = _Pair(system, model, root)
        if kind == "urdf":
            pair.take_armature()
        rng = np.random.default_rng(0)
        samples = [pair.at_random(rng) for _ in range(STATES)]
    names = ("places", "mass", "forces")
    return Differences(*(max(getattr(sample, name) for sample in samples) for name in names))


def _body(spec: Any, name: str) -> Any:
    """Return a body of an MjSpec; a body without a name is called by its number."""
    return spec.body(name) or next(b for k, b in enumerate(spec.bodies) if f"body{k}" == name)


def _read(system: System, file: str, kind: str, root: str | None) -> Any:
    """Read a file with MuJoCo; add a free joint to the base if it floats in pinred."""
    mj = mujoco_package()
    spec = mj.MjSpec.from_file(file)
    spec.compiler.fusestatic = False
    if kind == "urdf":
        if "quat_xyzw" in read_text(Path(file)):
            raise LoadError("MuJoCo does not read the attribute quat_xyzw")
        spec.compiler.inertiafromgeom = int(mj.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE)
        for element in (*spec.geoms, *spec.meshes):
            spec.delete(element)
    # MuJoCo splits a root joint with several degrees of freedom into joints with longer names.
    joints = [joint.name for joint in spec.joints]
    free = kind == "urdf" and not any(
        name.startswith(root_joint) for name in joints for root_joint in system.root_name.split("+")
    )
    if free and system.model.existBodyName("world"):
        raise LoadError("MuJoCo takes the link 'world' for the fixed world and ignores its mass")
    if free or system.contents.freed:
        tops = [_body(spec, root)] if root else _top_bodies(spec, system)
        if len(tops) != 1:
            raise LoadError("several bodies of MuJoCo's world could be the floating base")
        tops[0].add_freejoint()
    try:
        return spec.compile()
    except Exception:
        if kind == "urdf":
            raise
        return compiled(spec)  # compile without missing meshes that define no mass


def _top_bodies(spec: Any, system: System) -> list[Any]:
    """Return the children of MuJoCo's world that are in a system's model."""
    tops, body = [], spec.worldbody.first_body()
    while body is not None:
        if not body.name or system.model.existBodyName(body.name):
            tops.append(body)
        body = spec.worldbody.next_body(body)
    return tops


class _Pair:
    """A system and MuJoCo's model of the same file."""

    def __init__(self, system: System, model: Any, root: str | None) -> None:
        """Match bodies and joints by name; raise LoadError if one is missing."""
        self._mj = mj = mujoco_package()
        self._system, self._model = system, model
        for word in _OFF:
            model.opt.disableflags |= int(getattr(mj.mjtDisableBit, f"mjDSBL_{word}"))
        model.opt.enableflags = 0
        self._data, self._pin = mj.MjData(model), system.model.createData()
        world = robot_in(model, root)
        self._felt = gravity_of(world)
        ids = {world.joint_names[j]: j for body in world.bodies for j in world.joints(body)}
        # Followers move independently in both models here, so all joints are matched.
        names = [str(name) for name in system.model.names[2:]]
        if missing := [name for name in names if name not in ids]:
            raise LoadError(f"MuJoCo has no joint '{missing[0]}'")
        self._shape = [ids[name] for name in names]
        self._shape_v = _dofs(model, self._shape)
        locked = system.contents.locked
        self._held = _held(
            mj, model, {} if locked is None else {ids[k]: v for k, v in locked.frozen.items()}
        )
        self._dofs = _dofs(model, [j for j in world.all_joints if j not in self._held])
        frames = system.model.frames
        self._bodies = [
            (system.model.getFrameId(world.body_names[body], pin.FrameType.BODY), body)
            for body in world.bodies
            if system.model.existBodyName(world.body_names[body])
        ]
        moving = [pair for pair in self._bodies if frames[pair[0]].parentJoint > 0]
        if not moving:
            raise LoadError("MuJoCo has no body of the same name")
        # The position of the body nearest to the root has the smallest round-off.
        self._ref = min(moving, key=lambda pair: frames[pair[0]].parentJoint)

    def take_armature(self) -> None:
        """Give MuJoCo's joints the armature of pinred's, which MuJoCo does not read from URDF."""
        model = self._system.model
        for joint, number in zip(list(model.joints)[2:], self._shape, strict=True):
            values = model.armature[joint.idx_v : joint.idx_v + joint.nv]
            self._model.dof_armature[_dofs(self._model, [number])] = values

    def at_random(self, rng: np.random.Generator) -> Differences:
        """Compute the differences at a random state."""
        mj, m, d = self._mj, self._model, self._data
        model, data = self._system.model, self._pin
        d.qpos[:] = m.qpos0 + rng.uniform(-1.0, 1.0, m.nq)
        d.qvel[:] = rng.normal(size=m.nv)
        for joint, value in self._held.items():
            d.qpos[m.jnt_qposadr[joint]], d.qvel[m.jnt_dofadr[joint]] = value, 0.0
        mj.mj_normalizeQuat(m, d.qpos)
        mj.mj_forward(m, d)
        rates = d.qvel[self._dofs]
        q = self._configuration([self._coordinates(joint) for joint in self._shape])
        T, drift = self._velocities(q)
        M = np.zeros((m.nv, m.nv))
        mj.mj_fullM(m, d, M)
        M = M[np.ix_(self._dofs, self._dofs)]
        H = symmetric(pin.crba(model, data, q))
        a, v = rng.normal(size=len(rates)), T @ rates
        compensation = 0.0 if self._felt.is_uneven else d.qfrc_gravcomp
        bias = (d.qfrc_bias - compensation)[self._dofs]
        own_bias = T.T @ pin.rnea(model, data, q, v, drift)
        total = T.T @ pin.rnea(model, data, q, v, T @ a + drift)
        scale = self._force_terms(T, q, v, T @ a + drift)
        errors = np.append((own_bias - bias) / scale, (total - M @ a - bias) / scale)
        pin.framesForwardKinematics(model, data, q)
        reach = max(np.linalg.norm(data.oMf[f].translation) for f, _ in self._bodies)
        place_errors = [
            max(
                np.abs(data.oMf[f].rotation - d.xmat[body].reshape(3, 3)).max(),
                np.abs(data.oMf[f].translation - d.xpos[body]).max() / max(reach, 1e-3),
            )
            for f, body in self._bodies
        ]
        return Differences(
            places=float(np.max(place_errors)),
            mass=float(np.abs(T.T @ H @ T - M).max() / np.abs(M).max()),
            forces=float(np.abs(errors).max()),
        )

    def _coordinates(self, joint: int) -> Array:
        """Return the quaternion (x, y, z, w) of a ball, or the value of another joint."""
        first = int(self._model.jnt_qposadr[joint])
        if self._model.jnt_type[joint] == int(self._mj.mjtJoint.mjJNT_BALL):
            return np.roll(self._data.qpos[first : first + 4], -1)
        return np.array(self._data.qpos[first : first + 1])

    def _configuration(self, x: Sequence[Array]) -> Array:
        """Solve by Newton's method for the q that places the reference body as in MuJoCo."""
        system, model, data = self._system, self._system.model, self._pin
        group, (frame, body) = system.group, self._ref
        d = self._data
        target = pin.SE3(d.xmat[body].reshape(3, 3), d.xpos[body].copy())
        pose = group.identity()
        for _ in range(_NEWTON):
            q = self._place(pose, x)
            J = self._jacobian(q)[:, : system.r]
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[frame].actInv(target)).vector
            step = np.linalg.lstsq(J, error)[0]
            pose = group.compose(pose, group.exp(step))
            if np.linalg.norm(J @ step) < _ROUND_OFF * (1.0 + np.linalg.norm(target.translation)):
                break
        return self._place(pose, x)

    def _place(self, pose: Array, x: Sequence[Array]) -> Array:
        """Return Pinocchio's q for a pose and the coordinates of all joints."""
        system, model = self._system, self._system.model
        q = system.q(pose, system.space.neutral)
        for joint, value in zip(list(model.joints)[2:], x, strict=True):
            entry = [np.cos(value[0]), np.sin(value[0])] if joint.nq == 2 else value
            q[joint.idx_q : joint.idx_q + joint.nq] = entry
        return q

    def _velocities(self, q: Array) -> tuple[Array, Array]:
        """Return T = ∂v/∂qvel from MuJoCo's to Pinocchio's velocities, and v̇ − T q̈vel."""
        mj, m, d, model, data = self._mj, self._model, self._data, self._system.model, self._pin
        frame, body = self._ref
        r, n = self._system.r, model.nv
        jac, dot = np.zeros((6, m.nv)), np.zeros((6, m.nv))
        mj.mj_jacBody(m, d, jac[:3], jac[3:], body)
        mj.mj_jacDot(m, d, dot[:3], dot[3:], d.xpos[body], body)
        to_body = np.kron(np.eye(2), d.xmat[body].reshape(3, 3).T)
        P = np.zeros((n - r, len(self._dofs)))
        for row, dof in enumerate(self._shape_v):
            P[row, list(self._dofs).index(dof)] = 1.0
        J = self._jacobian(q)
        root = np.linalg.lstsq(J[:, :r], (to_body @ jac)[:, self._dofs] - J[:, r:] @ P)[0]
        T = np.vstack([root, P])
        pin.forwardKinematics(model, data, q, T @ d.qvel[self._dofs], np.zeros(n))
        classical = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).vector
        rate = np.linalg.lstsq(J[:, :r], to_body @ dot @ d.qvel - classical)[0]
        return T, np.append(rate, np.zeros(n - r))

    def _jacobian(self, q: Array) -> Array:
        """Return the Jacobian of the reference body in its own frame, (6, n)."""
        J = pin.computeFrameJacobian(self._system.model, self._pin, q, self._ref[0])
        # Pinocchio returns a matrix with a single column as a one-dimensional array.
        return np.asarray(J).reshape(6, self._system.model.nv)

    def _force_terms(self, T: Array, q: Array, v: Array, a: Array) -> Array:
        """Return the sum of magnitudes of the terms in each coordinate's force, (n,).

        The terms of a body are its mass times the terms of its acceleration, and its moments of
        inertia times angular acceleration and squared rate, projected on all axes that move it.
        MuJoCo sums moments about the robot's centre of mass, where the moments of a distant small
        heavy wheel cancel. Therefore a fraction of these moments is added.
        """
        model, data = self._system.model, self._pin
        terms, com = np.zeros(model.nv), pin.centerOfMass(model, data, q).copy()
        pin.forwardKinematics(model, data, q, v, a)
        g = np.linalg.norm(model.gravity.linear)
        for i in range(1, model.njoints):
            body, w = model.inertias[i], np.linalg.norm(data.v[i].angular)
            angular = np.linalg.norm(data.a[i].angular) + w**2
            lever = np.linalg.norm(body.lever)
            linear = np.linalg.norm(data.a[i].linear) + w * np.linalg.norm(data.v[i].linear)
            force = body.mass * (linear + g + lever * angular)
            far = np.linalg.norm(data.oMi[i].act(body.lever) - com)
            moment = np.linalg.norm(body.inertia) * angular + lever * force
            moment += _CANCELS * far * (force + body.mass * far * angular)
            S = np.abs(pin.computeJointJacobian(model, data, q, i)).reshape(6, model.nv)
            terms += S[:3].sum(axis=0) * force + S[3:].sum(axis=0) * moment
        terms += model.armature * np.abs(a)
        return np.asarray(np.abs(T).T @ terms + 1e-300)


def _held(mj: Any, model: Any, frozen: Mapping[int, float]) -> dict[int, float]:
    """Return the values of the joints that equality constraints hold, by number.

    Args:
        mj: The module mujoco.
        model: MuJoCo's model.
        frozen: Values by pinred.  MuJoCo's own numbers replace them, except for tendons.
    """
    held = dict(frozen)
    for k in np.flatnonzero(model.eq_active0).tolist():
        joint = int(model.eq_obj1id[k])
        is_joint = model.eq_type[k] == int(mj.mjtEq.mjEQ_JOINT)
        if is_joint and joint in held and model.eq_obj2id[k] < 0:
            held[joint] = float(model.qpos0[model.jnt_qposadr[joint]] + model.eq_data[k, 0])
    return held


def _dofs(model: Any, joints: Iterable[int]) -> Array:
    """Return the indices of the degrees of freedom of joints in MuJoCo."""
    sizes = (6, 3, 1, 1)  # degrees of freedom by mjtJoint
    dofs = [int(model.jnt_dofadr[j]) + k for j in joints for k in range(sizes[model.jnt_type[j]])]
    return np.array(dofs, dtype=int)
