"""read_sdf(): the robot in an SDF file (extra `sdf`).

`sdf_document` reads the file and the files that it includes, and writes copies.  Drake reads the
copies: it resolves poses, frames and nested models.  pinred takes its bodies and joints, and the
numbers of joints from the document.  One robot is everything that joints connect.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import (
    ChoiceError,
    InputError,
    LoadError,
    ModelError,
    install_command,
    optional_package,
)
from ..common.names import listed, nearest, plain_path, quoted
from .copy_model import PRISMATIC, REVOLUTE, ModelBuilder, joint_along
from .loops.loop import Loop
from .passive import Spring
from .read_urdf import FileRobot
from .robot_file_contents import Coupling, LeftOut
from .sdf_document import Axis, BallConstraint, JointWords, SdfDocument, read_document, unread_type
from .sdf_words import CONTACT

INSTALL = install_command("sdf")
_ALIGNED = 1e-12  # largest deviation of an axis from x, y or z that counts as round-off
_CUT = {"weld": "6d", "ball_rpy": "3d", "revolute": "z"}  # types that a loop can replace, its kinds
# Largest difference of sums of moments that counts as round-off, relative to their terms.
_SAME_MOMENTS = 1e-9
_REVERSIBLE = ("weld", "ball_rpy", "revolute", "prismatic")
_WORLD = 0  # index of the world among Drake's bodies
# Names of the parts of joints with two axes or more, as `split_joints` names them.
_PARTS = {"universal": (".1", ".2")}

Key: TypeAlias = tuple[str, str]  # name of a model and of a link or joint in it


@dataclass(frozen=True, eq=False)
class SdfRobot(FileRobot):
    """A robot in an SDF file.

    Attributes:
        joints: Model and name in the file of each joint.
        links: Model and name in the file of each link.
        base: Name of the link that carries the others; "" if the world carries several.
        added: Moment that the copy for Drake has in addition, and trace of the moments without
            it [kg m²], by model and name of the link.
    """

    joints: Mapping[str, Key] = field(default_factory=dict)
    links: Mapping[str, Key] = field(default_factory=dict)
    base: str = ""
    added: Mapping[Key, tuple[float, float]] = field(default_factory=dict)


def read_sdf(path: Path, folders: Sequence[str] = (), root: str | None = None) -> SdfRobot:
    """Read the robot in an SDF file.

    Args:
        path: Path of the file.
        folders: Folders in which included models are searched.
        root: Base link, or model, of the robot, if several can move.
    Returns:
        The robot.
    Raises:
        LoadError: A file cannot be read.
        ModelError: pinred cannot reduce the robot.
        ChoiceError: Several robots can move, and `root` names none.
        InputError: `root` names no robot.
        MissingPackageError: drake is not installed.
    """
    document = read_document(path, folders, tolerant=root is not None)
    plant, messages = _plant(path, document)
    assembly = _Assembly(path, plant, document)
    tree = _Tree(assembly, _chosen(assembly, root))
    model = tree.build()
    if document.gravity is not None:
        model.gravity.linear = document.gravity
    left_out = tree.left_out()
    if tree.is_weightless():
        model.gravity.linear = np.zeros(3)
    base = tree.base
    return SdfRobot(
        model=model,
        springs=tree.springs,
        warning=_warning(messages, tree.fixed),
        couplings=tree.couplings(),
        loops=tuple(tree.loops),
        left_out=left_out,
        joints={name: key for key, name in tree.joint_names.items()},
        links={name: key for key, name in tree.link_names.items()},
        base="" if base is None else tree.link_names[assembly.link(base)],
        fixed=tuple(tree.fixed),
        inertias=tree.inertias,
        lines=tree.lines,
        added=document.added,
    )


def _plant(path: Path, document: SdfDocument) -> tuple[Any, list[str]]:
    """Return Drake's plant with the models of a document, not finalised, and its warnings."""
    why = f"SDF is read by Drake's parser: {INSTALL}"
    plants = optional_package("pydrake.multibody.plant", why)
    parsing = optional_package("pydrake.multibody.parsing", why)
    plant = plants.MultibodyPlant(0.0)
    with TemporaryDirectory(prefix="pinred-") as name, drake_warnings() as messages:
        folder = Path(name)
        try:
            models = parsing.Parser(plant).AddModels(str(document.write(folder)))
        except Exception as error:  # Drake raises RuntimeError and other types.
            raise LoadError(document.drake_error(str(error).strip(), folder)) from None
        messages[:] = [document.with_own_paths(message, folder) for message in messages]
    if not models:
        raise LoadError(f"{plain_path(path)} contains no model")
    return plant, messages


@contextmanager
def drake_warnings() -> Iterator[list[str]]:
    """Collect the warnings that Drake logs, instead of printing them.

    Yields:
        The messages.
    """
    logger, messages = logging.getLogger("drake"), list[str]()
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())  # type: ignore[method-assign]
    before, logger.propagate = (logger.handlers[:], logger.propagate), False
    logger.handlers[:] = [handler]
    try:
        yield messages
    finally:
        logger.handlers[:], logger.propagate = before


@dataclass(frozen=True)
class _Robot:
    """Bodies that joints connect.

    Attributes:
        bodies: Indices of the bodies.
        joints: The joints between them, and to the world.
        constraints: Points of them that coincide.
    """

    bodies: tuple[int, ...]
    joints: tuple[Any, ...]
    constraints: tuple[BallConstraint, ...]

    @property
    def anchors(self) -> list[Any]:
        """Joints to the world."""
        return [joint for joint in self.joints if _WORLD in _ends(joint)]

    @property
    def can_move(self) -> bool:
        """Whether a body moves relative to the world."""
        return not self.anchors or any(joint.type_name() != "weld" for joint in self.joints)


class _Assembly:
    """The bodies and joints of a plant.

    Attributes:
        path: Path of the file, for messages.
        plant: Drake's plant.
        document: The document.
        robots: Bodies that joints connect.
    """

    def __init__(self, path: Path, plant: Any, document: SdfDocument) -> None:
        self.path, self.plant, self.document = path, plant, document
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        numbers = {self.link(k): k for k in range(1, plant.num_bodies())}
        pairs = [_ends(joint) for joint in joints]
        tied = []
        for constraint in document.constraints:
            keys = [(constraint.model, name) for name in constraint.links]
            for key in keys:
                if key not in numbers:
                    raise LoadError(
                        f"{plain_path(path)}, {constraint.where}: <drake:ball_constraint> names no "
                        f"link {quoted(key[1])}; write the name of a link of its model"
                    )
            tied.append((numbers[keys[0]], numbers[keys[1]]))
        components = _Parts(plant.num_bodies())
        for a, b in [*pairs, *tied]:
            if _WORLD not in (a, b):
                components.join(a, b)
        bodies: dict[int, list[int]] = {}
        for body in range(1, plant.num_bodies()):
            bodies.setdefault(components.of(body), []).append(body)
        joined: dict[int, list[Any]] = {}
        for joint, pair in zip(joints, pairs, strict=True):
            joined.setdefault(components.of(max(pair)), []).append(joint)
        self.robots = [
            _Robot(
                tuple(group),
                tuple(joined.get(component, [])),
                tuple(
                    constraint
                    for constraint, pair in zip(document.constraints, tied, strict=True)
                    if components.of(pair[0]) == component
                ),
            )
            for component, group in bodies.items()
        ]

    def link(self, body: int) -> Key:
        """Return the model and name of a body."""
        body_ = self.plant.get_body(_index("Body", body))
        return str(self.plant.GetModelInstanceName(body_.model_instance())), str(body_.name())

    def joint(self, joint: Any) -> Key:
        """Return the model of a joint, and its name in the file."""
        key = (str(self.plant.GetModelInstanceName(joint.model_instance())), str(joint.name()))
        return key[0], self.document.renamed.get(key, key[1])

    def words(self, joint: Any) -> JointWords:
        """Return the words of a joint; no numbers for joints that Drake has added."""
        nothing = JointWords(joint.type_name(), "")
        key = self.joint(joint)
        if key[0] == self.plant.GetModelInstanceName(_index("ModelInstance", 0)):
            key = ("", key[1])
        return self.document.joints.get(key, nothing)

    def bases(self, robot: _Robot) -> list[int]:
        """Return the bodies that the world carries, or the first body that no joint carries."""
        if robot.anchors:
            return [next(k for k in _ends(joint) if k != _WORLD) for joint in robot.anchors]
        children = {_ends(joint)[1] for joint in robot.joints}
        return [*(body for body in robot.bodies if body not in children), robot.bodies[0]][:1]


def _ends(joint: Any) -> tuple[int, int]:
    """Return the indices of the parent and the child of a joint."""
    return int(joint.parent_body().index()), int(joint.child_body().index())


class _Parts:
    """Connected parts of a graph, to which edges are added."""

    def __init__(self, size: int) -> None:
        self._above = [*range(size)]

    def of(self, node: int) -> int:
        """Return the part of a node, by one of its nodes."""
        while self._above[node] != node:
            self._above[node] = node = self._above[self._above[node]]
        return node

    def join(self, a: int, b: int) -> bool:
        """Add an edge; return whether it connects two parts."""
        first, second = sorted((self.of(a), self.of(b)))
        self._above[second] = first
        return first != second


def _chosen(assembly: _Assembly, root: str | None) -> _Robot:
    """Return the robot that `root` names, or the only one that can move."""
    moving = [robot for robot in assembly.robots if robot.can_move]
    path = plain_path(assembly.path)
    if root is None and len(moving) == 1:
        return moving[0]
    robots = moving or assembly.robots
    if root is None and len(robots) == 1:
        return robots[0]
    if not robots:
        raise LoadError(f"{path} contains no links")
    models, bases = dict[str, set[int]](), dict[str, set[int]]()  # robots by name
    for number, robot in enumerate(robots):
        for body in robot.bodies:
            scopes = assembly.link(body)[0].split("::")
            for k in range(len(scopes)):
                models.setdefault("::".join(scopes[: k + 1]), set()).add(number)
        for base in assembly.bases(robot):
            model, name = assembly.link(base)
            for label in (name, f"{model}::{name}"):
                bases.setdefault(label, set()).add(number)
    unique = {
        name: min(numbers)
        for names in (models, bases)
        for name, numbers in names.items()
        if len(numbers) == 1
    }
    first: dict[int, str] = {}
    for name, number in unique.items():
        first.setdefault(number, name)
    choices = sorted(first, key=lambda number: -len(robots[number].joints))
    names = [first[number] for number in choices]
    if root is not None:
        if root in unique:
            return robots[unique[root]]
        raise InputError(
            f"root: no robot of {path} has the model or base link {quoted(root)}; "
            f"{nearest(root, [*unique])}choose one of {listed(names, 60)}"
        )
    if not moving:
        raise ModelError(f"nothing moves in {path}: all links are fixed to the world")
    raise ChoiceError(
        f"{path} has several robots ({listed(names)}); choose one with root=", "root", tuple(names)
    )


class _Tree:
    """The links and joints of a robot as a pin.Model.

    Attributes:
        base: Index of the body that carries the others; None if the world carries several.
        fixed: Names of the links that the file fixes to the world.
        springs: Springs at joints.
        loops: Loops that close.
        joint_names: Name of each joint.
        link_names: Name of each link.
        inertias: Inertia of each link with mass, in its own frame.
    """

    def __init__(self, assembly: _Assembly, robot: _Robot) -> None:
        self._assembly, self._robot = assembly, robot
        self._plant, self._document = assembly.plant, assembly.document
        self._builder = ModelBuilder()
        self.fixed, self.loops = list[str](), list[Loop]()
        self.lines: dict[str, str] = {}
        self.springs: tuple[Spring, ...] = ()
        self.inertias: dict[str, pin.Inertia] = {}
        self._losses = [np.empty((2, 0))]
        self._most = [np.empty((2, 0))]  # largest rates and efforts
        self._places: dict[int, tuple[int, pin.SE3]] = {_WORLD: (0, pin.SE3.Identity())}
        self._left_out: dict[str, list[str]] = {}
        bases = assembly.bases(robot)
        self.base: int | None = bases[0] if len(bases) == 1 else None
        self.link_names = _names([assembly.link(body) for body in robot.bodies])
        moving = [joint for joint in robot.joints if joint.type_name() != "weld"]
        self.joint_names = _names([assembly.joint(joint) for joint in moving])
        for joint in moving:
            if self._name(joint) == "universe":
                raise ModelError(
                    f"{self._where(joint)}: joint 'universe' has a reserved name; rename it"
                )

    def _name(self, joint: Any) -> str:
        """Return the name of a joint."""
        return self.joint_names.get(self._assembly.joint(joint), str(joint.name()))

    def _link(self, body: int) -> str:
        """Return the name of a body."""
        return "world" if body == _WORLD else self.link_names[self._assembly.link(body)]

    def _where(self, joint: Any) -> str:
        """Return the file and the line of a joint."""
        words = self._assembly.words(joint)
        return f"{plain_path(self._assembly.path)}{f', {words.where}' if words.where else ''}"

    def build(self) -> pin.Model:
        """Return the model.

        Raises:
            ModelError: A joint, or a loop, is of a type that pinred does not read.
        """
        kept, cut = self._spanning()
        around: dict[int, list[Any]] = {}
        for joint in kept:
            for body in _ends(joint):
                around.setdefault(body, []).append(joint)
        start = _WORLD
        if not self._robot.anchors:
            assert self.base is not None
            start = self.base
            self._add_body(start, 0, pin.SE3.Identity())
        done, stack = {start}, [(start, joint) for joint in reversed(around.get(start, []))]
        while stack:
            body, joint = stack.pop()
            parent, child = _ends(joint)
            other = child if body == parent else parent
            if other in done:
                continue
            done.add(other)
            self._attach(joint, body, other)
            stack += [(other, one) for one in reversed(around.get(other, []))]
        for joint in cut:
            self._close(joint)
        for constraint in self._robot.constraints:
            self._tie(constraint)
        model = self._builder.finish()
        model.damping, model.upperDryFrictionLimit = np.concatenate(self._losses, axis=1)
        model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
        model.upperVelocityLimit, model.upperEffortLimit = np.concatenate(self._most, axis=1)
        return model

    def _spanning(self) -> tuple[list[Any], list[Any]]:
        """Return the joints of a spanning tree, in the file's order, and those that close loops.

        A joint is rather cut if a loop can replace it, if its child has another parent, and if it
        has no forces and no follower.
        """
        robot = self._robot
        parents: dict[int, int] = {}
        for joint in robot.joints:
            child = _ends(joint)[1]
            parents[child] = parents.get(child, 0) + 1
        mimics = [m for joint in robot.joints for m in self._assembly.words(joint).mimics]
        leaders = {mimic.leader for mimic in mimics}

        def cost(joint: Any) -> tuple[bool, bool, bool]:
            words = self._assembly.words(joint)
            coupled = bool(words.mimics) or self._assembly.joint(joint) in leaders
            acts = coupled or any(axis.has_forces for axis in words.axes)
            return self._can_cut(joint), parents[_ends(joint)[1]] > 1, not acts

        components, kept, cut = _Parts(self._plant.num_bodies()), set[int](), list[Any]()
        for joint in sorted(robot.joints, key=cost):
            if components.join(*_ends(joint)):
                kept.add(int(joint.index()))
            else:
                cut.append(joint)
        return [joint for joint in robot.joints if int(joint.index()) in kept], cut

    def _is_screw(self, joint: Any) -> bool:
        return self._assembly.words(joint).type == "screw"

    def _can_cut(self, joint: Any) -> bool:
        """Return whether a loop can replace a joint."""
        return joint.type_name() in _CUT and not self._is_screw(joint)

    def _add_body(self, body: int, carrier: int, at: pin.SE3) -> None:
        """Add a body at a placement on a joint."""
        model = self._builder.model
        added, trace = self._assembly.document.added.get(self._assembly.link(body), (0.0, None))
        name = self._link(body)
        inertia = _inertia(self._plant.get_body(_index("Body", body)), added)
        moments, arm = np.trace(inertia.inertia), np.sum(inertia.lever**2)
        size = abs(moments) + inertia.mass * arm + added
        if trace is not None and abs(moments - trace) > _SAME_MOMENTS * size:
            raise ModelError(
                f"{plain_path(self._assembly.path)}: link {quoted(name)} has moments "
                f"of inertia with the sum {trace:g}, but Drake reads {moments:g}; state an inertia "
                "that a rigid body has"
            )
        model.appendBodyToJoint(carrier, inertia, at)
        model.addFrame(pin.Frame(name, carrier, 0, at, pin.FrameType.BODY), False)
        if inertia.mass > 0.0:
            self.inertias[name] = inertia
        self._places[body] = (carrier, at)

    def _attach(self, joint: Any, body: int, other: int) -> None:
        """Add a body that a joint connects with a body of the tree."""
        carrier, at = self._places[body]
        is_reversed = body != _ends(joint)[0]
        frames = [_fixed_pose(joint.frame_on_parent()), _fixed_pose(joint.frame_on_child())]
        before, behind = frames[::-1] if is_reversed else frames
        if is_reversed and joint.type_name() not in _REVERSIBLE:
            raise ModelError(
                f"{self._where(joint)}: {joint.type_name()} joint {quoted(self._name(joint))} is "
                "attached against the direction of the tree; exchange its parent and child"
            )
        if joint.type_name() == "weld":
            # Only Drake's welds of static links, whose parent is the world, have a displacement.
            between = _pose(joint.X_FM())
            if body == _WORLD:
                self.fixed.append(self._link(other))
            self._add_body(other, carrier, at * before * between * behind.inverse())
            return
        index = self._add_joint(joint, carrier, at * before, is_reversed)
        self._add_body(other, index, behind.inverse())

    def _add_joint(self, joint: Any, carrier: int, at: pin.SE3, is_reversed: bool) -> int:
        """Add a joint with its armature, limits, damping and friction; return its index."""
        name, axes = self._name(joint), self._assembly.words(joint).axes
        type_name = joint.type_name()
        pinocchio_joint, nv = self._pinocchio_joint(joint, is_reversed), joint.num_velocities()
        # The numbers of a ball joint stand on its first axis.
        numbers = [axes[k] if k < len(axes) else Axis() for k in range(nv)]
        if type_name == "ball_rpy":
            numbers = [axes[0] if axes else Axis()] * nv
        limits = None
        if pinocchio_joint.nq == nv and self._assembly.words(joint).type != "continuous":
            limits = [[axis.lower for axis in numbers], [axis.upper for axis in numbers]]
        armature = np.full(nv, self._rotors.get(int(joint.index()), 0.0))
        index = self._builder.add_joint(
            carrier, pinocchio_joint, at, name, armature=armature, limits=limits
        )
        self._builder.model.addJointFrame(index)
        damping = [axis.damping for axis in numbers]
        if type_name == "planar":
            damping = list(joint.default_damping_vector())
        self._losses.append(np.array([damping, [axis.friction for axis in numbers]]))
        self._most.append(
            np.array([[axis.velocity for axis in numbers], [axis.effort for axis in numbers]])
        )
        if type_name != "ball_rpy":
            suffixes = _PARTS.get(type_name, ("",) * nv)
            self.springs += tuple(
                Spring(f"{name}{suffix}", axis.stiffness, axis.rest)
                for axis, suffix in zip(numbers, suffixes, strict=True)
                if axis.stiffness
            )
        return index

    @cached_property
    def _rotors(self) -> dict[int, float]:
        """Reflected inertia of actuators, {joint index: armature} [kg m² | kg]."""
        rotors: dict[int, float] = {}
        for index in self._plant.GetJointActuatorIndices():
            actuator = self._plant.get_joint_actuator(index)
            joint = int(actuator.joint().index())
            rotors[joint] = rotors.get(joint, 0.0) + float(actuator.default_reflected_inertia())
        return rotors

    def _pinocchio_joint(self, joint: Any, is_reversed: bool) -> pin.JointModel:
        """Return Pinocchio's joint with the motion of one of Drake's, or with its inverse."""
        type_name, sign = joint.type_name(), -1.0 if is_reversed else 1.0
        if type_name == "revolute":
            axis = sign * np.array(joint.revolute_axis())
            if self._is_screw(joint):
                pitch = self._assembly.words(joint).pitch / (2.0 * np.pi)
                return pin.JointModelHelicalUnaligned(axis / np.linalg.norm(axis), pitch)
            return joint_along(REVOLUTE, axis, _ALIGNED)
        if type_name == "prismatic":
            return joint_along(PRISMATIC, sign * np.array(joint.translation_axis()), _ALIGNED)
        if type_name == "ball_rpy":
            return pin.JointModelSpherical()
        if type_name == "universal":
            return pin.JointModelUniversal(*np.eye(3)[:2])
        if type_name == "planar":
            return pin.JointModelPlanar()
        raise ModelError(f"{self._where(joint)}: {unread_type(self._name(joint), type_name)}")

    def _close(self, joint: Any) -> None:
        """Add the loop that a joint closes."""
        name, type_name = self._name(joint), joint.type_name()
        words = self._assembly.words(joint)
        parent, child = _ends(joint)
        if not self._can_cut(joint):
            raise ModelError(
                f"{self._where(joint)}: link {quoted(self._link(child))} closes a loop of which "
                f"every joint is prismatic, universal, screw or planar (here {quoted(name)}), "
                "which pinred cannot cut; use a revolute, ball or fixed joint in the loop"
            )
        if words.mimics:
            raise ModelError(
                f"{self._where(joint)}: joint {quoted(name)} closes a loop and follows another "
                "joint; remove its <mimic>, which the loop replaces or contradicts"
            )
        if any(axis.has_forces for axis in words.axes):
            what = "springs, damping and friction of joints that close loops"
            self._left_out.setdefault(what, []).append(name)
        if any(np.isfinite([axis.lower, axis.upper]).any() for axis in words.axes):
            what = "limits of joints that close loops"
            self._left_out.setdefault(what, []).append(name)
        turn, between = pin.SE3.Identity(), pin.SE3.Identity()
        if type_name == "revolute":
            turn.rotation = _turn_to(np.array(joint.revolute_axis()))
        elif type_name == "weld":
            between = _pose(joint.X_FM())
        ends = [
            self._add_frame(
                f"{name}.parent", parent, _fixed_pose(joint.frame_on_parent()) * between * turn
            ),
            self._add_frame(f"{name}.child", child, _fixed_pose(joint.frame_on_child()) * turn),
        ]
        if words.where:
            self.lines[name] = f" ({words.where})"
        self.loops.append(Loop(ends[0], ends[1], _CUT[type_name], name))  # type: ignore[arg-type]

    def _tie(self, constraint: BallConstraint) -> None:
        """Add the loop of two points that coincide."""
        numbers = {self._assembly.link(body): body for body in self._robot.bodies}
        name = f"ball {' '.join(constraint.links)} ({constraint.where})"
        ends = [
            self._add_frame(
                f"{name}.{side}",
                numbers[constraint.model, link],
                pin.SE3(np.eye(3), point),
            )
            for side, link, point in zip("AB", constraint.links, constraint.points, strict=True)
        ]
        self.loops.append(Loop(ends[0], ends[1], "3d", name))

    def _add_frame(self, name: str, body: int, placement: pin.SE3) -> str:
        """Add a frame on a body; return its name."""
        carrier, at = self._places[body]
        frame = pin.Frame(name, carrier, 0, at * placement, pin.FrameType.OP_FRAME)
        self._builder.model.addFrame(frame, False)
        return name

    def couplings(self) -> tuple[Coupling, ...]:
        """Return the couplings of the robot's joints.

        Raises:
            ModelError: A leader is unknown, or closes a loop, or an axis does not exist.
        """
        couplings = []
        kinds = {self._assembly.joint(joint): joint for joint in self._robot.joints}
        closing = {loop.name for loop in self.loops}
        for joint in self._robot.joints:
            for mimic in self._assembly.words(joint).mimics:
                leader = kinds.get(mimic.leader)
                where = f"{plain_path(self._assembly.path)}, {mimic.where}"
                name = self._name(joint)
                if leader is None:
                    raise ModelError(
                        f"{where}: joint {quoted(name)} follows {quoted(mimic.leader[1])}, which "
                        "is no joint of the robot; name a joint, or remove the <mimic>"
                    )
                if self._name(leader) in closing:
                    raise ModelError(
                        f"{where}: joint {quoted(name)} follows {quoted(self._name(leader))}, "
                        "which closes a loop; let it follow another joint of the loop"
                    )
                if leader.type_name() == "weld":
                    raise ModelError(
                        f"{where}: joint {quoted(name)} follows {quoted(mimic.leader[1])}, which "
                        "is fixed; fix the follower, too"
                    )
                follower = self._part(joint, mimic.axis, where)
                leading = self._part(leader, mimic.leader_axis, where)
                couplings.append(Coupling(follower, {leading: mimic.ratio}, mimic.offset))
        return tuple(couplings)

    def _part(self, joint: Any, axis: int, where: str) -> str:
        """Return the name of the coordinate of an axis of a joint."""
        name, type_name = self._name(joint), joint.type_name()
        suffixes = _PARTS.get(type_name, ("",) if joint.num_velocities() == 1 else ())
        if axis >= len(suffixes):
            raise ModelError(
                f"{where}: <mimic> of {quoted(name)}: axis {axis + 1} of a {type_name} joint has "
                "no coordinate of its own; use revolute or prismatic joints"
            )
        return f"{name}{suffixes[axis]}"

    def left_out(self) -> tuple[LeftOut, ...]:
        """Return the actions that belong to the robot, by kind."""
        keys = {self._assembly.link(body) for body in self._robot.bodies}
        models = {model for model, _ in keys}
        kinds = {kind: [*names] for kind, names in self._left_out.items()}
        for report in self._document.reports:
            inside = f"{report.model}::"
            if report.model == "" or any(f"{model}::".startswith(inside) for model in models):
                kinds.setdefault(report.kind, []).append(report.name)
        weightless = [self.link_names[key] for key in keys & self._document.weightless]
        if weightless and not self.is_weightless():
            kinds["compensated gravity"] = sorted(weightless)
        other_bodies = [
            "::".join(filter(None, self._assembly.link(body)))
            for robot in self._assembly.robots
            if robot is not self._robot and robot.can_move
            for body in robot.bodies[:1]
        ]
        if other_bodies:
            kinds["other bodies"] = other_bodies
        left_out = [LeftOut(kind, tuple(names)) for kind, names in kinds.items()]
        colliding = [self.link_names[key] for key in self._document.colliding if key in keys]
        if colliding:
            left_out.append(LeftOut(CONTACT, tuple(colliding), demanded=True))
        return tuple(left_out)

    def is_weightless(self) -> bool:
        """Return whether the file switches gravity off for all links."""
        return {self._assembly.link(k) for k in self._robot.bodies} <= self._document.weightless


def _names(keys: Sequence[Key]) -> dict[Key, str]:
    """Return unique names: the name in the file, with the nested models if others have it, too."""
    names = [name for _, name in keys]
    tops = {model.partition("::")[0] for model, _ in keys}
    unique: dict[Key, str] = {}
    for model, name in keys:
        scope = model if len(tops) > 1 else model.partition("::")[2]
        is_nested = scope and (names.count(name) > 1)
        unique[model, name] = f"{scope}::{name}" if is_nested else name
    return unique


def _turn_to(axis: Array) -> Array:
    """Return a rotation, (3, 3), that turns z to an axis."""
    axis = axis / np.linalg.norm(axis)
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(across, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _index(what: str, number: int) -> Any:
    """Return a number as Drake's index of a "Body" or a "ModelInstance"."""
    return getattr(optional_package("pydrake.multibody.tree", INSTALL), f"{what}Index")(number)


def _pose(pose: Any) -> pin.SE3:
    """Convert Drake's rigid transform."""
    return pin.SE3(np.array(pose.GetAsMatrix4()))


def _fixed_pose(frame: Any) -> pin.SE3:
    """Return the placement of a frame on its body."""
    return _pose(frame.GetFixedPoseInBodyFrame())


def _inertia(body: Any, added: float) -> pin.Inertia:
    """Return the inertia of a body, in its frame, less a moment that was added about all axes."""
    spatial = body.default_spatial_inertia()
    mass, com = float(spatial.get_mass()), np.array(spatial.get_com())
    if mass == 0.0:
        return pin.Inertia.Zero()
    about_origin: Array = np.array(spatial.CalcRotationalInertia().CopyToFullMatrix3())
    moments = about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com))
    return pin.Inertia(mass, com, moments - added * np.eye(3))


def _warning(messages: list[str], fixed: list[str]) -> str:
    """Return a warning about what Drake ignores, and about bodies fixed to the world; or ""."""
    reasons = []
    if fixed:
        reasons.append(f"the file fixes {listed(fixed)} to the world, but here it is free")
    ignored = list(dict.fromkeys(m.partition("warning: ")[2] or m for m in messages))
    if ignored:
        more = f" (and {len(ignored) - 1} more)" if len(ignored) > 1 else ""
        reasons.append(f"Drake reads the file with warnings: {ignored[0].strip()}{more}")
    return "; ".join(reasons)
