"""Conversion of the bodies and joints of a compiled MuJoCo model to a pin.Model.

The joints of the root body become a single joint of a symmetry group.  MuJoCo has no planar joint:
a file moves a body in a plane with three joints, which become SE(2).  With an additional slide
normal to the plane they become ℝ × SE(2).  Three slides with a ball, or with three hinges, become
SE(3).  In all other cases the first joint alone is the root.

Rotors of these joints (armature) become an equivalent inertia on the base.  Pinocchio adds
armature to the diagonal of the mass matrix, which is wrong for several joints at a root.  Rotors
with equal armature in all directions act like a mass, or a moment of inertia, on the base.  This
equivalence is exact if gravity does not act on the mass.  Other rotors break the symmetry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import InputError, ModelError
from ...common.names import listed, quoted
from ...lie.group import Group
from ...lie.groups import SE2, RxSE2
from ..copy_model import Carrier, ModelBuilder
from ..joints import root_joint
from ..passive import limits_of_angle
from .world import Joint, World, frame, joint_of, quaternion, wxyz

# Values of mjtSameFrame for which MuJoCo replaces the position (_SAME_PLACE) or the rotation
# (_SAME_TURN) of a body's inertial frame by those of the body frame, because they nearly agree.
_SAME_PLACE, _SAME_TURN = (1,), (1, 3)
_EXACT = 1e-12  # sines, cosines, relative sizes and lengths [m] below this value count as zero
# Displacements from the reference configuration at which planar joints are tested [rad | m].
_GENERIC = (0.7, -0.4, 1.1, 0.2)


@dataclass
class Tree:
    """A robot as a pin.Model under construction, with the root joint of its file, if any.

    Attributes:
        world: The robot in the compiled model.
        builder: Builder of the model.
        gravity: Gravity that acts on rotors of the base, (3,) [m/s²].
        carriers: {body id: carrier}.
        root: Motion of the joints of the body that carries all others.  None if the file fixes
            this body, or if no single body carries all others.
        shape: Shape joints.
        locked: Values of locked joints by id [rad | m]; zero for balls.
        attitudes: Unit quaternions (x, y, z, w) of locked balls by name, {ball: (4,)}.
        keep_frozen: Whether locked joints whose value may vary remain joints of the model.
        links: Inertia of each body with mass, in its own frame.
    """

    world: World
    gravity: Array
    builder: ModelBuilder = field(default_factory=ModelBuilder)
    carriers: dict[int, Carrier] = field(default_factory=dict)
    root: RootMotion | None = None
    shape: list[Joint] = field(default_factory=list)
    locked: dict[int, float] = field(default_factory=dict)
    attitudes: Mapping[str, Array] = field(default_factory=dict)
    keep_frozen: bool = False
    links: dict[str, pin.Inertia] = field(default_factory=dict)

    @property
    def model(self) -> pin.Model:
        """The Pinocchio model."""
        return self.builder.model

    @property
    def fixed_bodies(self) -> list[int]:
        """The bodies that the file fixes to the world."""
        return [body for body, carrier in self.carriers.items() if carrier.joint == 0]

    def carrier(self, body: int) -> Carrier:
        """Return the joint that moves a body of the robot or of the ground."""
        at_rest = Carrier(0, _place_in_world(self.world, body))
        return self.carriers.get(body, at_rest)

    @property
    def free_joints(self) -> list[int]:
        """The ids of joints that are not locked."""
        return [joint for joint in self.world.all_joints if joint not in self.locked]


def tree_of(
    world: World,
    lock: Mapping[str, float],
    gravity: Array,
    *,
    attitudes: Mapping[str, Array] | None = None,
    keep_frozen: bool = False,
) -> Tree:
    """Build the robot's model from its bodies and joints.

    Args:
        world: The robot in the compiled model.
        lock: Joints to lock, with their values [rad | m].
        gravity: Gravity that acts on rotors of the base, (3,) [m/s²].
        attitudes: Unit quaternions of balls to lock, {ball: (4,)}; the identity if left out.
        keep_frozen: Whether locked joints other than the root remain joints of the model.
    Returns:
        The tree.
    Raises:
        InputError: A joint to lock is unknown.
        ModelError: The base has armature that breaks the symmetry.
    """
    tree = Tree(
        world,
        gravity,
        locked=_locked(world, lock),
        attitudes=attitudes or {},
        keep_frozen=keep_frozen,
    )
    tree.model.gravity.linear = gravity
    root_body = _root_body(tree)
    for body in world.bodies:
        parent = int(world.model.body_parentid[body])
        under = tree.carrier(parent)
        at = under.at * frame(world.model.body_pos[body], world.model.body_quat[body])
        carrier = Carrier(under.joint, at)
        joints = list(world.joints(body))
        if body == root_body:
            carrier, joints = _add_root(tree, carrier, joints)
        for joint in joints:
            if joint in tree.locked and not _stays_joint(tree, joint, carrier, root_body):
                carrier = Carrier(carrier.joint, carrier.at * _frozen_motion(tree, joint))
            else:
                carrier = _add_joint(tree, carrier, joint)
        tree.carriers[body] = carrier
        _add_body(tree, body)
    tree.builder.finish()
    return tree


def _place_in_world(world: World, body: int) -> pin.SE3:
    """Return the placement of a body that is part of the world."""
    at = pin.SE3.Identity()
    while body:
        at = frame(world.model.body_pos[body], world.model.body_quat[body]) * at
        body = int(world.model.body_parentid[body])
    return at


def _locked(world: World, lock: Mapping[str, float]) -> dict[int, float]:
    """Return {joint id: value} for the joints to lock.  Raises InputError."""
    ids = {world.joint_names[joint]: joint for joint in world.all_joints}
    values = {}
    for name, value in lock.items():
        if name not in ids:
            raise InputError(f"lock: no joint {quoted(name)}; the joints are {listed(ids, 60)}")
        if world.kind(ids[name]) == "free" and value != 0.0:
            raise InputError(
                f"lock: joint {quoted(name)} has several degrees of freedom and "
                "can only be locked at zero"
            )
        values[ids[name]] = value
    return values


def _root_body(tree: Tree) -> int | None:
    """Return the body whose joints form the root, because it carries all moving bodies.

    Return None if the file fixes a body with mass to the world (this body then floats), or if no
    single body carries all others.
    """
    world, fixed, carrying = tree.world, {0}, []
    for body in world.bodies:
        if int(world.model.body_parentid[body]) in fixed:
            if any(joint not in tree.locked for joint in world.joints(body)):
                carrying.append(body)
            else:
                fixed.add(body)
    if any(world.model.body_mass[body] > 0.0 for body in fixed - {0}) or len(carrying) != 1:
        return None
    return carrying[0]


def _add_root(tree: Tree, at: Carrier, joints: list[int]) -> tuple[Carrier, list[int]]:
    """Add the root joint; return the carrier of its body, and the body's remaining joints."""
    world = tree.world
    place = at.at
    # Locked joints before the first free joint only shift the placement.
    while joints and joints[0] in tree.locked:
        place, joints = place * _frozen_motion(tree, joints[0]), joints[1:]
    # If any joint is locked, several joints cannot form one root joint together.
    count = 1 if any(joint in tree.locked for joint in joints) else len(joints)
    candidates = [joint_of(world, joint) for joint in joints[:count]]
    root = root_motion(candidates, tree.gravity, place.rotation)
    before = root.before if root.in_world else place * root.before
    name = root.name
    while len(root.joints) > 1 and name in world.joint_names:
        name += "_"
    index = tree.builder.add_joint(0, root.model, before, name, armature=root.armature)
    tree.model.addJointFrame(index)
    tree.model.appendBodyToJoint(index, root.rotors, pin.SE3.Identity())
    tree.root = root
    return Carrier(index, root.behind), joints[len(root.joints) :]


def _add_joint(tree: Tree, at: Carrier, id_: int) -> Carrier:
    """Add one joint of a body; return the carrier of the body after it."""
    joint = joint_of(tree.world, id_)
    # Use MuJoCo's coordinate for Pinocchio; it is q0 in the reference configuration, in which a
    # ball has the identity.
    place = at.at * joint.at_point * joint.displaced(-joint.q0)
    model = tree.world.model
    limits = None
    if model.jnt_limited[id_] and joint.nv == 1:
        limits = model.jnt_range[id_].reshape(2, 1)
    elif model.jnt_limited[id_] and tree.world.kind(id_) == "ball":
        limits = limits_of_angle(float(model.jnt_range[id_].max()))
    index = tree.builder.add_joint(
        at.joint, joint.model(), place, joint.name, armature=joint.armature, limits=limits
    )
    tree.model.addJointFrame(index)
    tree.shape.append(joint)
    return Carrier(index, joint.at_point.inverse())


def _stays_joint(tree: Tree, joint: int, at: Carrier, root_body: int | None) -> bool:
    """Return whether a locked joint remains a joint: it is neither a ball nor before the root."""
    return (
        tree.keep_frozen
        and tree.world.kind(joint) in ("slide", "hinge")
        and (root_body is None or at.joint != 0)
    )


def _frozen_motion(tree: Tree, id_: int) -> pin.SE3:
    """Return the displacement of the body by a locked joint, in the body's frame."""
    joint = joint_of(tree.world, id_)
    if joint.nv == 1:
        return joint.motion(tree.locked[id_])
    attitude = tree.attitudes.get(joint.name)
    return pin.SE3.Identity() if attitude is None else joint.turned(attitude)


def _add_body(tree: Tree, body: int) -> None:
    """Add the inertia and the frame of a body."""
    model, carrier, mujoco = tree.model, tree.carriers[body], tree.world.model
    same = int(mujoco.body_sameframe[body])
    place = np.zeros(3) if same in _SAME_PLACE else mujoco.body_ipos[body]
    turn = np.array([1.0, 0.0, 0.0, 0.0]) if same in _SAME_TURN else mujoco.body_iquat[body]
    inertia = pin.Inertia(
        float(mujoco.body_mass[body]), np.zeros(3), np.diag(mujoco.body_inertia[body])
    )
    at, name = frame(place, turn), tree.world.body_names[body]
    model.appendBodyToJoint(carrier.joint, inertia, carrier.at * at)
    if inertia.mass > 0.0:
        tree.links[name] = at.act(inertia)
    model.addFrame(pin.Frame(name, carrier.joint, 0, carrier.at, pin.FrameType.BODY), False)


@dataclass(frozen=True, eq=False)
class RootMotion:
    """The motion of the body that carries all others, relative to the world.

    Attributes:
        joints: MuJoCo joints that produce the motion.
        model: Pinocchio joint with the same motion.
        before: Fixed frame of the joint, relative to the body in the reference configuration.
        behind: Frame of the body, relative to the moving frame of the joint.
        rotors: Inertia of the joints' rotors, in the moving frame.
        pose: Function from qpos to the pose in the group.
        twist: Function from qpos and qvel to the body twist.
        armature: Armature of the Pinocchio joint, (nv,) [kg m² | kg]; None for zero.
        in_world: Whether `before` is relative to the world instead of the body.
    """

    joints: tuple[Joint, ...]
    model: pin.JointModel
    before: pin.SE3
    behind: pin.SE3
    rotors: pin.Inertia
    pose: Callable[[Array], Array]
    twist: Callable[[Array, Array], Array]
    armature: Array | None = None
    in_world: bool = False

    @property
    def name(self) -> str:
        """Names of the joints."""
        return "+".join(joint.name for joint in self.joints)


def root_motion(joints: Sequence[Joint], gravity: Array, turn: Array) -> RootMotion:
    """Return the group motion that the first joints of the root body produce together.

    Args:
        joints: Joints of the body.
        gravity: Gravity in the world frame, (3,) [m/s²].
        turn: Rotation, (3, 3), from body axes in the reference configuration to world axes.
    Returns:
        The motion.
    Raises:
        ModelError: Armature breaks the symmetry of the base.
    """
    kinds, first = [joint.kind for joint in joints], joints[0]
    in_body = turn.T @ gravity
    if kinds == ["slide"] * 3 + ["ball"] and _rank([j.axis for j in joints[:3]]) == 3:
        return _slides_and_ball(joints, in_body)
    if (plane := _plane(joints)) is not None:
        return _planar(joints, plane, in_body)
    if _is_spatial(joints):
        return _spatial(joints, in_body)
    if first.kind == "free":
        return _free(first)
    return _ball(first) if first.kind == "ball" else _single(first, in_body)


def _single(joint: Joint, gravity: Array) -> RootMotion:
    """Return the motion of a slide or a hinge; its coordinate is unchanged."""
    slides = joint.kind == "slide"
    return RootMotion(
        joints=(joint,),
        model=joint.model(),
        before=joint.at_point * joint.displaced(-joint.q0),
        behind=joint.at_point.inverse(),
        rotors=rotors_of_slides([joint], gravity) if slides else pin.Inertia.Zero(),
        armature=None if slides else joint.armature,
        pose=lambda qpos: qpos[joint.q_at : joint.q_at + 1].copy(),
        twist=lambda _, qvel: qvel[joint.v_at : joint.v_at + 1].copy(),
    )


def _ball(joint: Joint) -> RootMotion:
    """Return the motion of a ball joint.  MuJoCo's angular velocity is in body axes too."""
    return RootMotion(
        joints=(joint,),
        model=pin.JointModelSpherical(),
        before=joint.at_point,
        behind=joint.at_point.inverse(),
        rotors=rotors_of_ball(joint),
        pose=lambda qpos: quaternion(qpos[joint.q_at :]),
        twist=lambda _, qvel: qvel[joint.v_at : joint.v_at + 3].copy(),
    )


def _free(joint: Joint) -> RootMotion:
    """Return the motion of a free joint.  MuJoCo's pose and linear velocity are in world axes."""
    q, v = joint.q_at, joint.v_at

    def twist(qpos: Array, qvel: Array) -> Array:
        turn = _rotation(qpos[q + 3 :])
        return np.concatenate([turn.T @ qvel[v : v + 3], qvel[v + 3 : v + 6]])

    return RootMotion(
        joints=(joint,),
        model=pin.JointModelFreeFlyer(),
        before=pin.SE3.Identity(),
        behind=pin.SE3.Identity(),
        rotors=pin.Inertia.Zero(),
        pose=lambda qpos: np.concatenate([qpos[q : q + 3], quaternion(qpos[q + 3 :])]),
        twist=twist,
        in_world=True,
    )


def _slides_and_ball(joints: Sequence[Joint], gravity: Array) -> RootMotion:
    """Return the motion of three slides followed by a ball."""
    *slides, ball = joints
    axes = np.array([joint.axis for joint in slides]).T

    def pose(qpos: Array) -> Array:
        shift = axes @ np.array([qpos[joint.q_at] - joint.q0 for joint in slides])
        return np.concatenate([shift, quaternion(qpos[ball.q_at :])])

    def twist(qpos: Array, qvel: Array) -> Array:
        v = axes @ np.array([qvel[joint.v_at] for joint in slides])
        turn = _rotation(qpos[ball.q_at :])
        return np.concatenate([turn.T @ v, qvel[ball.v_at : ball.v_at + 3]])

    return RootMotion(
        joints=tuple(joints),
        model=pin.JointModelFreeFlyer(),
        before=ball.at_point,
        behind=ball.at_point.inverse(),
        rotors=rotors_of_slides(slides, gravity) + rotors_of_ball(ball),
        pose=pose,
        twist=twist,
    )


def _is_spatial(joints: Sequence[Joint]) -> bool:
    """Return whether three slides and three hinges can move a body in all directions.

    The test is in the reference configuration.  Armature of these joints breaks the symmetry,
    except on slides before hinges whose axes meet in one point.
    """
    kinds = [joint.kind for joint in joints]
    if sorted(kinds) != ["hinge"] * 3 + ["slide"] * 3:
        return False
    heavy = {joint.kind for joint in joints if joint.armature.any()}
    points = [joint.point for joint in joints if joint.kind == "hinge"]
    distinct = float(np.ptp(points, axis=0).max()) > _EXACT
    if "hinge" in heavy or (heavy and (distinct or kinds[:3] != ["slide"] * 3)):
        return False
    return _moves_freely(joints, [joint.q0 for joint in joints])


def _spatial(joints: Sequence[Joint], gravity: Array) -> RootMotion:
    """Return the six-dimensional motion of three slides and three hinges, in any order."""
    first_hinge = next(joint for joint in joints if joint.kind == "hinge")
    slides = [joint for joint in joints if joint.kind == "slide"]
    weight = rotors_of_slides(slides, gravity)

    def pose(at: pin.SE3, _: Array) -> Array:
        return np.asarray(pin.SE3ToXYZQUAT(at))

    model, axes = pin.JointModelFreeFlyer(), list(range(6))
    return _combined(joints, first_hinge.at_point, model, axes, weight, pose)


def _planar(joints: Sequence[Joint], plane: _Plane, gravity: Array) -> RootMotion:
    """Return the motion of planar slides and hinges, and perhaps a slide normal to the plane.

    The joints may be in any order.

    The joint's frame has z along the hinge axes and x along the first slide in the plane, if there
    is such a slide.  Its origin is on the first hinge.
    """
    W = pin.SE3(_axes(plane.hinges[0].axis, plane.slides), plane.hinges[0].point)
    axes = list(plane.group.axes)

    def pose(at: pin.SE3, qpos: Array) -> Array:
        angles = [
            (qpos[hinge.q_at] - hinge.q0) * np.sign(hinge.axis @ W.rotation[:, 2])
            for hinge in plane.hinges
        ]
        return np.append(at.translation[axes[:-1]], sum(angles))

    model = root_joint(plane.group)
    return _combined(joints, W, model, axes, rotors_of_plane(joints, gravity), pose)


def _combined(
    joints: Sequence[Joint],
    W: pin.SE3,
    model: pin.JointModel,
    axes: list[int],
    weight: pin.Inertia,
    pose_of: Callable[[pin.SE3, Array], Array],
) -> RootMotion:
    """Combine several slides and hinges of one body into a single Pinocchio joint.

    Args:
        joints: Joints of the body.
        W: Frame of the Pinocchio joint, relative to the body.  If MuJoCo displaces the body by P,
            the pose of the joint is W⁻¹ P W.
        model: Pinocchio joint with the combined motion.
        axes: Indices of the twist components that the joint can produce.
        weight: Inertia of the rotors, in the joint's frame.
        pose_of: Function from W⁻¹ P W and qpos to the coordinates of the pose in the group.
    Returns:
        The combined motion.
    """
    inverse = W.inverse()

    def pose(qpos: Array) -> Array:
        motion = pin.SE3.Identity()
        for joint in joints:
            motion = motion * joint.motion(qpos[joint.q_at])
        return pose_of(inverse * motion * W, qpos)

    def twist(qpos: Array, qvel: Array) -> Array:
        values = [qpos[joint.q_at] for joint in joints]
        rates = [qvel[joint.v_at] for joint in joints]
        return np.asarray(inverse.act(_twist(joints, values, rates)).vector[axes])

    return RootMotion(tuple(joints), model, W, inverse, weight, pose, twist)


@dataclass(frozen=True)
class _Plane:
    """Joints that move a body in a plane, and perhaps along its normal.

    Attributes:
        group: SE(2), or ℝ × SE(2).
        hinges: Hinges normal to the plane.
        slides: Slides in the plane.
    """

    group: Group
    hinges: tuple[Joint, ...]
    slides: tuple[Joint, ...]


def _plane(joints: Sequence[Joint]) -> _Plane | None:
    """Return the planar motion that the joints produce, or None if it is not planar."""
    hinges = tuple(joint for joint in joints if joint.kind == "hinge")
    if len(joints) not in (3, 4) or {j.kind for j in joints} - {"slide", "hinge"} or not hinges:
        return None
    z = hinges[0].axis
    normal = [joint for joint in joints if np.abs(np.cross(joint.axis, z)).max() <= _EXACT]
    lifts = [joint for joint in normal if joint.kind == "slide"]
    slides = tuple(j for j in joints if j.kind == "slide" and abs(j.axis @ z) <= _EXACT)
    if len(lifts) != len(joints) - 3 or len(normal) + len(slides) != len(joints):
        return None
    # Three collinear hinges are singular in the reference configuration only, so test another one.
    values = [joint.q0 + by for joint, by in zip(joints, _GENERIC, strict=False)]
    if not _moves_freely(joints, values):
        return None
    return _Plane(RxSE2 if lifts else SE2, hinges, slides)


def _axes(z: Array, slides: Sequence[Joint]) -> Array:
    """Return the rotation whose z axis is `z`, with x along the first slide if there is one."""
    x = slides[0].axis if slides else np.eye(3)[np.argmin(np.abs(z))]
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    return np.array([np.cross(y, z), y, z]).T


def _twist(joints: Sequence[Joint], values: Sequence[float], rates: Sequence[float]) -> pin.Motion:
    """Compute the body twist of a chain of joints from joint values and rates."""
    twist = pin.Motion.Zero()
    for joint, value, rate in zip(joints, values, rates, strict=True):
        twist = joint.motion(value).actInv(twist) + joint.twist(rate)
    return twist


def _moves_freely(joints: Sequence[Joint], values: Sequence[float]) -> bool:
    """Return whether the joint twists are linearly independent at the given joint values."""
    twists = [_twist(joints, values, rates).vector for rates in np.eye(len(joints)).tolist()]
    return _rank(twists) == len(joints)


def _rank(vectors: Sequence[Array]) -> int:
    return int(np.linalg.matrix_rank(np.array(vectors), tol=1e-9))


def _rotation(values: Array) -> Array:
    return np.asarray(frame(np.zeros(3), wxyz(values)).rotation)


def rotors_of_slides(slides: Sequence[Joint], gravity: Array) -> pin.Inertia:
    """Return the rotor inertia of slides before all other joints, at the joints' origin.

    gravity: (3,) [m/s²], in the frame of the slides' axes.  Raises ModelError.
    """
    rotors = _rotors(slides)
    if not rotors.any():
        return pin.Inertia.Zero()
    axes = np.array([joint.axis for joint in slides])
    at_right_angles = np.abs(axes @ axes.T - np.eye(len(axes))).max() <= _EXACT
    if np.ptp(rotors) != 0.0 or not at_right_angles:
        _refuse(slides, "it must be the same in directions that are at right angles")
    _refuse_falling(slides, gravity, axes)
    return _mass(rotors[0])


def rotors_of_ball(joint: Joint) -> pin.Inertia:
    """Return the rotor inertia of a ball.

    It must be the same in all directions, so that it causes no gyroscopic moment.
    """
    if np.ptp(joint.armature) != 0.0:
        _refuse([joint], "it must be the same in all directions")
    return pin.Inertia(0.0, np.zeros(3), joint.armature[0] * np.eye(3))


def ignored_rotors(joints: Sequence[Joint]) -> tuple[str, ...]:
    """Return a warning for each free joint with armature.

    No motor drives a free joint, so such armature is ignored.  Files usually inherit it from the
    <default> of their other joints.
    """
    return tuple(
        f"free joint '{joint.name}' has armature {joint.armature.max():g}, which is ignored; add "
        "it to the inertia of the body to keep it"
        for joint in joints
        if joint.kind == "free" and joint.armature.any()
    )


def rotors_of_plane(joints: Sequence[Joint], gravity: Array) -> pin.Inertia:
    """Return the rotor inertia of planar slides and hinges, in axes with z normal to the plane.

    gravity: (3,) [m/s²], in the frame of the joints' axes.  Raises ModelError.
    """
    slides = [joint for joint in joints if joint.kind == "slide"]
    hinges = [joint for joint in joints if joint.kind == "hinge"]
    if len(hinges) > 1 and _rotors(hinges).any():
        _refuse(hinges, "two hinges turn the body together, and their rotors equal no inertia")
    ahead = list(joints[: len(slides)]) == slides and len(hinges) == 1
    if _rotors(slides).any() and not ahead:
        _refuse(slides, "a hinge ahead of them, or no second slide, breaks the symmetry")
    angular = np.diag([0.0, 0.0, hinges[0].armature[0]])
    return rotors_of_slides(slides, gravity) + pin.Inertia(0.0, np.zeros(3), angular)


def _mass(mass: float) -> pin.Inertia:
    return pin.Inertia(float(mass), np.zeros(3), np.zeros((3, 3)))


def _rotors(joints: Sequence[Joint]) -> Array:
    return np.concatenate([np.empty(0), *(joint.armature for joint in joints)])


def _refuse_falling(joints: Sequence[Joint], gravity: Array, axes: Array) -> None:
    """Reject armature if gravity acts along the axes, because armature has no weight."""
    if np.abs(axes @ gravity).max() > _EXACT * np.linalg.norm(gravity):
        _refuse(joints, "gravity acts along them, but armature has no weight")


def _refuse(joints: Sequence[Joint], why: str) -> NoReturn:
    names = ", ".join(f"joint '{joint.name}'" for joint in joints)
    values = ", ".join(f"{value:g}" for value in _rotors(joints))
    raise ModelError(
        f"the base has {names} with armature {values}: {why}; set it to zero, or add it to the "
        "inertia of the body"
    )
