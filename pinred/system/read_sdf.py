"""read_sdf(): the model in an SDF file, as Drake reads it (extra `sdf`).

Drake resolves poses, frames, included and nested models.  pinred takes its bodies and joints, and
refuses closed loops and several floating models.  Dry friction, which Drake leaves out, is read
from the text.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import LoadError, ModelError
from ..common.names import listed, plain_path, quoted
from ..common.optional_packages import install_command, optional_package
from .passive import Spring
from .rebuild import PRISMATIC, REVOLUTE, ModelBuilder, joint_along
from .robot_files import read_text, read_xml

INSTALL = install_command("sdf")
_JOINTS = "revolute, continuous, prismatic, universal, screw, ball or fixed joints"
_ALIGNED = 1e-12  # largest deviation of an axis from x, y or z that counts as round-off


@dataclass(frozen=True, eq=False)
class SdfRobot:
    """A robot in an SDF file.

    Attributes:
        model: Model with the root joint of the file; without one, its first body is fixed.
        springs: Springs at joints.
        warning: Warning about parts of the file that are not read, or "".
    """

    model: pin.Model
    springs: tuple[Spring, ...]
    warning: str


def read_sdf(path: Path) -> SdfRobot:
    """Read the robot in an SDF file.

    Args:
        path: Path of the file.
    Returns:
        The robot.
    Raises:
        LoadError: Drake cannot read the file.
        ModelError: pinred cannot reduce the robot.
        MissingPackageError: drake is not installed.
    """
    read_xml(path)  # rejects files that are too large or too deeply nested
    text = ElementTree.fromstring(read_text(path).strip())
    plant, messages = _plant(path)
    if followers := list(text.iter("mimic")):
        raise ModelError(
            f"{plain_path(path)} has {len(followers)} joints that follow others (<mimic>), which "
            "pinred does not read from SDF; convert the file to URDF, or remove the element"
        )
    tree = _Tree(plant, _frictions(text))
    model = tree.build(path)
    gravity = text.find("world/gravity")
    if gravity is not None:
        model.gravity.linear = np.array([float(word) for word in (gravity.text or "").split()])
    return SdfRobot(model, tree.springs(), _warning(messages, tree.fixed))


def _plant(path: Path) -> tuple[Any, list[str]]:
    """Return Drake's plant with the file's models, before it is finished, and its warnings."""
    why = f"SDF is read by Drake's parser: {INSTALL}"
    plants = optional_package("pydrake.multibody.plant", why)
    parsing = optional_package("pydrake.multibody.parsing", why)
    plant = plants.MultibodyPlant(0.0)
    with _drake_warnings() as messages:
        try:
            models = parsing.Parser(plant).AddModels(str(path))
        except Exception as error:  # Drake raises RuntimeError and other types.
            reason = str(error).strip().splitlines()[0].partition("error: ")
            words = f"Drake cannot read {plain_path(path)}: {reason[2] or reason[0]}"
            remedy = f"; use {_JOINTS}" if "Joint type" in words else ""
            raise LoadError(f"{words.removesuffix('.')}{remedy}") from None
    if not models:
        raise LoadError(f"{plain_path(path)} contains no model")
    if plant.num_constraints():
        raise ModelError(
            f"{plain_path(path)} has {plant.num_constraints()} constraints between bodies, which "
            "close loops; remove them"
        )
    return plant, messages


@contextmanager
def _drake_warnings() -> Iterator[list[str]]:
    """Collect the warnings that Drake logs, instead of printing them."""
    logger, messages = logging.getLogger("drake"), list[str]()
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())  # type: ignore[method-assign]
    before, logger.propagate = (logger.handlers[:], logger.propagate), False
    logger.handlers[:] = [handler]
    try:
        yield messages
    finally:
        logger.handlers[:], logger.propagate = before


class _Tree:
    """The bodies and joints of a plant as a pin.Model.

    Attributes:
        fixed: Names of the bodies that the file fixes to the world.
    """

    def __init__(self, plant: Any, frictions: dict[str, float]) -> None:
        """Find the joint that carries each body.

        Args:
            plant: Drake's plant.
            frictions: Dry friction by joint [N·m | N].
        Raises:
            ModelError: Joints close a loop.
        """
        self._plant, self._frictions = plant, frictions
        self._builder, self.fixed = ModelBuilder(), list[str]()
        self._losses = [np.empty((2, 0))]
        self._most = [np.empty((2, 0))]  # largest rates and efforts
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        self._on: dict[int, list[Any]] = {}
        carriers: dict[int, Any] = {}
        for joint in joints:
            child = int(joint.child_body().index())
            if child in carriers or child == 0:
                other = carriers[child].name() if child in carriers else "the world"
                raise ModelError(
                    f"closed loops are not supported: link {quoted(joint.child_body().name())} "
                    f"is carried by {quoted(joint.name())} and by {quoted(other)}; remove one"
                )
            carriers[child] = joint
            self._on.setdefault(int(joint.parent_body().index()), []).append(joint)
        bodies = [plant.get_body(_index("Body", k)) for k in range(1, plant.num_bodies())]
        self._floating = [body for body in bodies if int(body.index()) not in carriers]

    def build(self, path: Path) -> pin.Model:
        """Return the model.

        Args:
            path: Path of the file, for messages.
        Raises:
            ModelError: Several bodies float, or one floats beside bodies on the world.
        """
        anchored = [joint.child_body().name() for joint in self._on.get(0, [])]
        names = [body.name() for body in self._floating]
        if len(names) + bool(anchored) > 1:
            raise ModelError(
                f"{plain_path(path)} has several robots ({listed([*names, *anchored])}); "
                "keep one model in the file"
            )
        at = pin.SE3.Identity()
        if names:
            self._add_body(self._floating[0], 0, at)
        else:
            self._add_children(0, 0, at)
        model = self._builder.finish()
        model.damping, model.upperDryFrictionLimit = np.concatenate(self._losses, axis=1)
        model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
        model.upperVelocityLimit, model.upperEffortLimit = np.concatenate(self._most, axis=1)
        return model

    def springs(self) -> tuple[Spring, ...]:
        """Return the springs of the plant; all are at revolute or prismatic joints."""
        plant, springs = self._plant, []
        names = {
            "RevoluteSpring": ("default_stiffness", "default_nominal_angle"),
            "PrismaticSpring": ("stiffness", "nominal_position"),
        }
        for index in range(plant.num_force_elements()):
            element = plant.get_force_element(_index("ForceElement", index))
            type_name = type(element).__name__.partition("_")[0]
            if type_name in names:
                stiffness, rest_position = (getattr(element, name)() for name in names[type_name])
                springs.append(Spring(element.joint().name(), stiffness, rest_position))
        return tuple(springs)

    def _add_body(self, body: Any, carrier: int, at: pin.SE3) -> None:
        """Add a body at a placement on a joint, and the bodies that it carries."""
        model = self._builder.model
        model.appendBodyToJoint(carrier, _inertia(body), at)
        frame = pin.Frame(body.name(), carrier, 0, at, pin.FrameType.BODY)
        model.addFrame(frame, False)
        self._add_children(int(body.index()), carrier, at)

    def _add_children(self, parent: int, carrier: int, at: pin.SE3) -> None:
        """Add the bodies that a body carries, which is at a placement on a joint."""
        for joint in self._on.get(parent, []):
            before = at * _pose(joint.frame_on_parent().GetFixedPoseInBodyFrame())
            behind = _pose(joint.frame_on_child().GetFixedPoseInBodyFrame()).inverse()
            on = carrier
            if joint.type_name() == "weld":
                behind = before * _pose(joint.X_FM()) * behind
                if carrier == 0 and parent == 0:
                    self.fixed.append(joint.child_body().name())
            else:
                on = self._add_joint(joint, carrier, before)
            self._add_body(joint.child_body(), on, behind)

    def _add_joint(self, joint: Any, carrier: int, at: pin.SE3) -> int:
        """Add a joint with its armature, limits, damping and friction; return its index."""
        pinocchio_joint, nv = _pinocchio_joint(joint), joint.num_velocities()
        limits = None
        if pinocchio_joint.nq == nv:
            limits = [joint.position_lower_limits(), joint.position_upper_limits()]
        armature = np.full(nv, self._rotors().get(int(joint.index()), 0.0))
        index = self._builder.add_joint(
            carrier, pinocchio_joint, at, joint.name(), armature=armature, limits=limits
        )
        self._builder.model.addJointFrame(index)
        damping = np.broadcast_to(joint.default_damping_vector(), nv)
        friction = np.full(nv, self._frictions.get(joint.name(), 0.0))
        self._losses.append(np.array([damping, friction]))
        effort = np.full(nv, self._efforts().get(int(joint.index()), np.inf))
        self._most.append(np.array([joint.velocity_upper_limits(), effort]))
        return index

    def _rotors(self) -> dict[int, float]:
        """Return the reflected inertia of actuators, {joint index: armature}."""
        rotors: dict[int, float] = {}
        for index in self._plant.GetJointActuatorIndices():
            actuator = self._plant.get_joint_actuator(index)
            joint = int(actuator.joint().index())
            rotors[joint] = rotors.get(joint, 0.0) + actuator.default_reflected_inertia()
        return rotors

    def _efforts(self) -> dict[int, float]:
        """Return the effort limits of actuators, {joint index: torque or force}."""
        plant = self._plant
        actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
        return {int(one.joint().index()): one.effort_limit() for one in actuators}


def _pinocchio_joint(joint: Any) -> pin.JointModel:
    """Return Pinocchio's joint with the motion of one of Drake's.  Raises ModelError."""
    type_name = joint.type_name()
    if type_name == "revolute":
        return joint_along(REVOLUTE, np.array(joint.revolute_axis()), _ALIGNED)
    if type_name == "prismatic":
        return joint_along(PRISMATIC, np.array(joint.translation_axis()), _ALIGNED)
    if type_name == "ball_rpy":
        return pin.JointModelSpherical()
    if type_name == "universal":
        return pin.JointModelUniversal(*np.eye(3)[:2])
    if type_name == "screw":
        pitch = joint.screw_pitch() / (2.0 * np.pi)
        return pin.JointModelHelicalUnaligned(_screw_axis(joint), pitch)
    raise ModelError(
        f"joint {quoted(joint.name())} is of type {type_name}, which pinred does not read from "
        f"SDF; use {_JOINTS}"
    )


def _screw_axis(joint: Any) -> Array:
    """Return the unit axis of a screw joint, (3,), which Drake states by its motion only."""
    plant = joint.GetParentPlant()
    if not plant.is_finalized():
        plant.Finalize()
    context = plant.CreateDefaultContext()
    q = plant.GetPositions(context)
    q[joint.position_start()] = 1.0
    plant.SetPositions(context, q)
    displacement = _pose(joint.frame_on_child().CalcPose(context, joint.frame_on_parent()))
    axis = pin.log3(displacement.rotation)
    return np.asarray(axis / np.linalg.norm(axis))


def _index(what: str, number: int) -> Any:
    """Return a number as Drake's index of a "Body" or a "ForceElement"."""
    return getattr(optional_package("pydrake.multibody.tree", INSTALL), f"{what}Index")(number)


def _pose(pose: Any) -> pin.SE3:
    """Convert Drake's rigid transform."""
    return pin.SE3(np.array(pose.GetAsMatrix4()))


def _inertia(body: Any) -> pin.Inertia:
    """Return the inertia of a body, in its frame."""
    spatial = body.default_spatial_inertia()
    mass, com = float(spatial.get_mass()), np.array(spatial.get_com())
    if mass == 0.0:
        return pin.Inertia.Zero()
    about_origin: Array = np.array(spatial.CalcRotationalInertia().CopyToFullMatrix3())
    moments = about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com))
    return pin.Inertia(mass, com, moments)


def _frictions(text: ElementTree.Element) -> dict[str, float]:
    """Return the dry friction in the text of a file, {joint: torque or force}."""
    frictions = {}
    for joint in text.iter("joint"):
        friction = joint.findtext("axis/dynamics/friction")
        if friction is not None:
            frictions[joint.get("name", "")] = float(friction)
    return frictions


def _warning(messages: list[str], fixed: list[str]) -> str:
    """Return a warning about what Drake ignores, and about bodies fixed to the world; or ""."""
    parts = []
    if fixed:
        parts.append(f"the file fixes {listed(fixed)} to the world, but here it is free")
    ignored = list(dict.fromkeys(m.partition("warning: ")[2] or m for m in messages))
    if ignored:
        more = f" (and {len(ignored) - 1} more)" if len(ignored) > 1 else ""
        parts.append(f"Drake reads the file with warnings: {ignored[0].strip()}{more}")
    return "; ".join(parts)
