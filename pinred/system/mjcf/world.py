"""The robot among the bodies of a compiled MuJoCo model: names of its bodies, and its joints.

A massless body that is fixed to the world and carries several moving bodies is part of the world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import ChoiceError, InputError, LoadError
from ...common.names import quoted
from ..copy_model import PRISMATIC, REVOLUTE, joint_along
from ..robot_file_contents import shortened
from .compile import mujoco_package

_KINDS = ("free", "ball", "slide", "hinge")  # names of MuJoCo's mjtJoint
# Disable flags of MuJoCo that mjDSBL_CONSTRAINT implies.
_OF_CONSTRAINTS = ("EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT")


@dataclass(frozen=True)
class World:
    """A compiled model, and the body attached to the world that carries the robot.

    Attributes:
        model: The MjModel.
        top: Id of the body that carries the robot.
        bodies: Ids of that body and of its descendants, depth first.
        others: Names of other bodies attached to the world that can move.
        body_names: Unique names of all bodies by id; unnamed bodies get a generated name.
        joint_names: Unique names of all joints by id; unnamed joints get a generated name.
    """

    model: Any
    top: int
    bodies: tuple[int, ...]
    others: tuple[str, ...]
    body_names: tuple[str, ...]
    joint_names: tuple[str, ...]

    def joints(self, body: int) -> range:
        """Return the ids of a body's joints, in order."""
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    @property
    def all_joints(self) -> list[int]:
        """Ids of all joints of the robot."""
        return [joint for body in self.bodies for joint in self.joints(body)]

    def kind(self, joint: int) -> str:
        """Return the kind of a joint: "free", "ball", "slide" or "hinge"."""
        return _KINDS[self.model.jnt_type[joint]]

    def disabled(self, what: str) -> bool:
        """Return whether a flag of the file disables a kind of force.

        Args:
            what: Name of the flag in mujoco.mjtDisableBit, such as "LIMIT".
        """
        bits, flags = mujoco_package().mjtDisableBit, int(self.model.opt.disableflags)
        mask = int(getattr(bits, f"mjDSBL_{what}"))
        if what in _OF_CONSTRAINTS:
            mask |= int(bits.mjDSBL_CONSTRAINT)
        return bool(flags & mask)

    @property
    def no_passive_forces(self) -> bool:
        """Whether springs and dampers are disabled, which disables all passive forces."""
        return self.disabled("SPRING") and self.disabled("DAMPER")

    def name(self, kind: str, number: int) -> str:
        """Return the name of an element in the file, or its kind and number.

        Args:
            kind: Kind as in mujoco.mjtObj, such as "ACTUATOR".
            number: Id of the element.
        """
        return name_of(self.model, kind, number) or f"{kind.lower()} {number}"


def name_of(model: Any, kind: str, number: int) -> str:
    """Return the name of an element in the file, or "".

    Args:
        model: The MjModel.
        kind: Kind as in mujoco.mjtObj, such as "ACTUATOR".
        number: Id of the element.
    """
    mj = mujoco_package()
    name: str | None = mj.mj_id2name(model, getattr(mj.mjtObj, f"mjOBJ_{kind}"), number)
    return name or ""


def robot_in(model: Any, root: str | None = None, what: str = "the model") -> World:
    """Return the robot in a model: the body attached to the world that can move, with its tree.

    Args:
        model: The MjModel.
        root: Name of that body, if several bodies can move.
        what: Source of the model, for messages.
    Returns:
        The robot.
    Raises:
        LoadError: No body has a joint or a mass.
        ChoiceError: Several bodies can move and root is None; the message lists them.
        InputError: The root is not one of the bodies; the message lists them.
    """
    children = _children(model)
    body_names = _names(model, "BODY", model.nbody, lambda i: f"body{i}")
    joint_names = _names(model, "JOINT", model.njnt, lambda i: _joint_name(model, body_names, i))
    trees = {body: tuple(_below(children, body)) for body in _in_the_world(model, children)}
    moving = [body for body, tree in trees.items() if _moves(model, tree)]
    # Without joints, a body with mass is a rigid body that can float.
    heavy = [body for body, tree in trees.items() if sum(model.body_mass[i] for i in tree) > 0]
    candidates = moving or heavy
    names = tuple(body_names[body] for body in candidates)
    if root is None:
        if not candidates:
            raise LoadError(f"no body in {what} has a joint or a mass")
        if len(candidates) > 1:
            joints = {body: sum(model.body_jntnum[i] for i in trees[body]) for body in candidates}
            largest = sorted(candidates, key=lambda body: -joints[body])
            raise ChoiceError(
                f"several bodies in the world can move: {shortened(names, 20)}; "
                "choose the one that carries the robot with root=",
                "root",
                tuple(body_names[body] for body in largest),
            )
        top = candidates[0]
    else:
        # The user can also choose a body that is part of the world; its whole tree then floats.
        trees = {body: tuple(_below(children, body)) for body in children[0]} | trees
        at_top = {body_names[body]: body for body in trees}
        if root not in at_top:
            raise InputError(
                f"root: no body {quoted(root)} in the world; the bodies are {shortened(names, 20)}"
            )
        top = at_top[root]
    other_bodies = tuple(body_names[body] for body in moving if body not in trees[top])
    return World(model, top, trees[top], other_bodies, body_names, joint_names)


def _children(model: Any) -> list[list[int]]:
    children: list[list[int]] = [[] for _ in range(model.nbody)]
    for body in range(1, model.nbody):
        children[model.body_parentid[body]].append(body)
    return children


def _in_the_world(model: Any, children: list[list[int]]) -> list[int]:
    """Return the bodies that are attached to the world, or to a body that is part of it."""

    def under(body: int) -> list[int]:
        if model.body_jntnum[body] or model.body_mass[body] > 0.0:
            return [body]
        inner = [top for child in children[body] for top in under(child)]
        several = sum(_moves(model, _below(children, top)) for top in inner) > 1
        return inner if several else [body]

    return [top for body in children[0] for top in under(body)]


def _moves(model: Any, bodies: Iterable[int]) -> bool:
    return any(model.body_jntnum[body] for body in bodies)


def _below(children: list[list[int]], body: int) -> Iterator[int]:
    """Yield a body and its descendants, depth first, which is Pinocchio's order."""
    stack = [body]
    while stack:
        top = stack.pop()
        yield top
        stack.extend(reversed(children[top]))


def _joint_name(model: Any, body_names: tuple[str, ...], joint: int) -> str:
    """Return a name for an unnamed joint: its body and kind, numbered from the second joint on."""
    body = int(model.jnt_bodyid[joint])
    number = joint - int(model.body_jntadr[body]) + 1
    name = f"{body_names[body]}_{_KINDS[model.jnt_type[joint]]}"
    return name if number == 1 else f"{name}{number}"


def _names(model: Any, kind: str, count: int, name_for: Callable[[int], str]) -> tuple[str, ...]:
    """Return unique names of bodies or joints; generated names avoid those in the file."""
    file_names = [name_of(model, kind, i) for i in range(count)]
    used = {*file_names, "universe"}  # Pinocchio calls the world "universe".
    names = []
    for i, file_name in enumerate(file_names):
        name = file_name
        if not name or name == "universe":
            name = name or name_for(i)
            while name in used:
                name += "_"
            used.add(name)
        names.append(name)
    return tuple(names)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a body, in the frame of the body.

    Attributes:
        name: Name of the joint.
        kind: "free", "ball", "slide" or "hinge".
        point: Point about which the joint rotates, (3,) [m].
        axis: Unit axis, (3,).
        q0: Coordinate in the reference configuration of the file, MuJoCo's qpos0 [rad | m].
        q_at: Index of its first coordinate in qpos.
        v_at: Index of its first velocity in qvel.
        armature: Rotor inertia, (nv,) [kg m² | kg], including actuators with their gears.
    """

    name: str
    kind: str
    point: Array
    axis: Array
    q0: float
    q_at: int
    v_at: int
    armature: Array

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""
        return len(self.armature)

    @property
    def at_point(self) -> pin.SE3:
        """Frame of the body, translated to the point about which the joint rotates."""
        return translation(self.point)

    def motion(self, value: float) -> pin.SE3:
        """Return the body's displacement, in body axes, for the coordinate of a slide or hinge."""
        return self.at_point * self.displaced(value - self.q0) * self.at_point.inverse()

    def turned(self, attitude: Array) -> pin.SE3:
        """Return the body's displacement, in body axes, for the attitude of a ball.

        Args:
            attitude: Unit quaternion (x, y, z, w), (4,).
        """
        R = pin.Quaternion(np.asarray(attitude, dtype=float)).toRotationMatrix()
        return self.at_point * pin.SE3(R, np.zeros(3)) * self.at_point.inverse()

    def displaced(self, amount: float) -> pin.SE3:
        """Return the displacement by a slide or hinge through `amount` [m | rad]."""
        if amount == 0.0:
            return pin.SE3.Identity()
        if self.kind == "slide":
            return translation(amount * self.axis)
        return pin.SE3(pin.exp3(amount * self.axis), np.zeros(3))

    def twist(self, rate: float) -> pin.Motion:
        """Return the body's twist, in the body's frame, for a rate of a slide or hinge."""
        if self.kind == "slide":
            return pin.Motion(rate * self.axis, np.zeros(3))
        return pin.Motion(rate * np.cross(self.point, self.axis), rate * self.axis)

    def coordinates(self, qpos: Array) -> Array:
        """Return Pinocchio's coordinates of a slide, hinge or ball, (nq,), from qpos."""
        if self.kind == "ball":
            return quaternion(qpos[self.q_at :])
        return qpos[self.q_at : self.q_at + 1].copy()

    def rates(self, qvel: Array) -> Array:
        """Return Pinocchio's rates of a slide, hinge or ball, (nv,), from qvel."""
        return qvel[self.v_at : self.v_at + self.nv].copy()

    def model(self) -> pin.JointModel:
        """Return the Pinocchio joint with the axis of a slide or hinge, or of a ball.

        MuJoCo's angular velocity of a ball is in body axes, too.
        """
        if self.kind == "ball":
            return pin.JointModelSpherical()
        return joint_along(PRISMATIC if self.kind == "slide" else REVOLUTE, self.axis)


def joint_of(world: World, joint: int) -> Joint:
    """Return the joint with an id."""
    model = world.model
    kind = world.kind(joint)
    q_at, v_at = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    nv = {"free": 6, "ball": 3}.get(kind, 1)
    armature = np.array(model.dof_armature[v_at : v_at + nv])
    return Joint(
        name=world.joint_names[joint],
        kind=kind,
        point=np.array(model.jnt_pos[joint]),
        axis=np.array(model.jnt_axis[joint]),
        q0=float(model.qpos0[q_at]) if nv == 1 else 0.0,
        q_at=q_at,
        v_at=v_at,
        armature=armature + _actuator_armature(world, joint),
    )


def _actuator_armature(world: World, joint: int) -> float:
    """Return the armature that actuators add to a joint: rotor inertia times gear ratio squared."""
    model, armature = world.model, 0.0
    for actuator in np.flatnonzero(model.actuator_armature):
        if acts_on_joint(world, int(actuator)) and model.actuator_trnid[actuator, 0] == joint:
            gear = model.actuator_gear[model.actuator_outadr[actuator], 0]
            armature += float(model.actuator_armature[actuator] * gear**2)
    return armature


def acts_on_joint(world: World, actuator: int) -> bool:
    """Return whether an actuator's transmission is a joint (in the joint or the parent frame)."""
    return int(world.model.actuator_trntype[actuator]) in (0, 1)  # mjTRN_JOINT, mjTRN_JOINTINPARENT


def translation(by: Array) -> pin.SE3:
    """Return a translation by a vector (3,) [m]."""
    return pin.SE3(np.eye(3), np.array(by))


def frame(position: Array, quaternion: Array) -> pin.SE3:
    """Return the frame at a position with orientation (w, x, y, z), a quaternion of any norm."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return pin.SE3(pin.Quaternion(w, x, y, z).toRotationMatrix(), np.array(position))


def wxyz(values: Array) -> Array:
    """Return the leading quaternion (w, x, y, z) of joint coordinates; zero becomes identity."""
    leading = values[:4]
    return leading if leading.any() else np.array([1.0, 0.0, 0.0, 0.0])


def quaternion(values: Array) -> Array:
    """Convert MuJoCo's leading quaternion (w, x, y, z) to a unit quaternion (x, y, z, w)."""
    leading = wxyz(values)
    return np.asarray(np.roll(leading, -1) / np.linalg.norm(leading))
