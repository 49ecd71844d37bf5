"""Conversion of the bodies and joints of a compiled MuJoCo model to a pin.Model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed, quoted
from ..passive import limits_of_angle
from ..rebuild import Carrier, ModelBuilder
from .root import RootMotion, root_motion
from .world import Joint, World, frame, joint_of

# Values of mjtSameFrame for which MuJoCo replaces the position (_SAME_PLACE) or the rotation
# (_SAME_TURN) of a body's inertial frame by those of the body frame, because they nearly agree.
_SAME_PLACE, _SAME_TURN = (1,), (1, 3)


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
