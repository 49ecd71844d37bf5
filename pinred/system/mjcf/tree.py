"""The bodies and joints of a compiled MuJoCo model as a pin.Model, numbers as MuJoCo uses them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import InputError, ModelError
from ...common.plain_names import listed, quoted
from .joints import Joint, frame, joint_of
from .root import RootMotion, root_motion
from .world import World

# How MuJoCo takes the inertial frame of a body (mjtSameFrame): it passes over its place and
# turn where they are nearly the body's own.
_SAME_PLACE, _SAME_TURN = (1,), (1, 3)


@dataclass(frozen=True)
class Carrier:
    """The Pinocchio joint that moves a body (0 is the world), and where the body sits on it."""

    joint: int
    at: pin.SE3


@dataclass
class Tree:
    """A robot as a pin.Model, on the root that its file gives it, if any.

    carriers: by body.  root: the motion of the joints of the carrying body; None if that is
    fixed in the file, or if several bodies hang on what is.  shape: the joints of the shape.
    locked: ids of joints that are frozen.  whole: whether those of them that may vary are joints
    of the model all the same.
    """

    world: World
    model: pin.Model
    gravity: Array
    carriers: dict[int, Carrier] = field(default_factory=dict)
    root: RootMotion | None = None
    shape: list[Joint] = field(default_factory=list)
    locked: dict[int, float] = field(default_factory=dict)
    whole: bool = False

    @property
    def still(self) -> list[int]:
        """The bodies that the file fixes to the world."""
        return [body for body, carrier in self.carriers.items() if carrier.joint == 0]

    @property
    def free_joints(self) -> list[int]:
        """The ids of joints that are not frozen."""
        world = self.world
        joints = [joint for body in world.bodies for joint in world.joints(body)]
        return [joint for joint in joints if joint not in self.locked]


def tree_of(
    world: World, lock: Mapping[str, float], gravity: Array, *, whole: bool = False
) -> Tree:
    """Return the robot's bodies on their joints.

    lock: joints to freeze, with their values.  gravity: (3,) [m/s²], what acts on rotors
    of the base.  whole: whether to keep frozen joints behind the root as joints of the model.
    Raises InputError for a joint to lock that is not there, ModelError for joints inside the
    tree that have several degrees of freedom, and for armature that the base cannot have.
    """
    tree = Tree(world, pin.Model(), gravity, locked=_locked(world, lock), whole=whole)
    tree.model.gravity.linear = gravity
    moved = _first_moved(tree)
    armature: list[Array] = []
    limits: list[Array] = []
    for body in world.bodies:
        parent = int(world.model.body_parentid[body])
        under = tree.carriers.get(parent) or Carrier(0, _fixed_at(world, parent))
        at = under.at * frame(world.model.body_pos[body], world.model.body_quat[body])
        carrier = Carrier(under.joint, at)
        todo = list(world.joints(body))
        if body == moved:
            carrier, todo = _add_root(tree, carrier, todo, armature, limits)
        for joint in todo:
            if joint in tree.locked and not _kept(tree, joint, carrier, moved):
                carrier = Carrier(carrier.joint, carrier.at * _frozen(tree, joint))
            else:
                carrier = _add_joint(tree, carrier, joint, armature, limits)
        tree.carriers[body] = carrier
        _add_body(tree, body)
    tree.model.armature = np.concatenate([np.empty(0), *armature])
    low, high = (np.concatenate([np.empty(0), *(pair[k] for pair in limits)]) for k in (0, 1))
    tree.model.lowerPositionLimit, tree.model.upperPositionLimit = low, high
    return tree


def _fixed_at(world: World, body: int) -> pin.SE3:
    """Return where a body is that is part of the world."""
    at = pin.SE3.Identity()
    while body:
        at = frame(world.model.body_pos[body], world.model.body_quat[body]) * at
        body = int(world.model.body_parentid[body])
    return at


def _locked(world: World, lock: Mapping[str, float]) -> dict[int, float]:
    """Return the joints to freeze by id.  Raises InputError."""
    own = {world.joint_names[j]: j for body in world.bodies for j in world.joints(body)}
    out = {}
    for name, value in lock.items():
        if name not in own:
            raise InputError(f"lock: no joint {quoted(name)}; the joints are {listed(own, 60)}")
        if world.kind(own[name]) in ("ball", "free") and value != 0.0:
            raise InputError(
                f"lock: joint {quoted(name)} has several degrees of freedom and freezes "
                "at zero only"
            )
        out[own[name]] = value
    return out


def _first_moved(tree: Tree) -> int | None:
    """Return the body whose joints are the root: all hangs on it, and nothing heavy is fixed.

    None if the file fixes a body with mass to the world, which then floats, or if there is no
    such body.
    """
    world, fixed, moved = tree.world, {0}, []
    for body in world.bodies:
        if int(world.model.body_parentid[body]) in fixed:
            if any(joint not in tree.locked for joint in world.joints(body)):
                moved.append(body)
            else:
                fixed.add(body)
    if any(world.model.body_mass[body] > 0.0 for body in fixed - {0}) or len(moved) != 1:
        return None
    return moved[0]


def _add_root(
    tree: Tree, at: Carrier, joints: list[int], armature: list[Array], limits: list[Array]
) -> tuple[Carrier, list[int]]:
    """Add the root joint; return where the body sits on it, and the joints that are left."""
    world = tree.world
    place = at.at
    # Frozen joints ahead of the first are part of the place.
    while joints and joints[0] in tree.locked:
        place, joints = place * _frozen(tree, joints[0]), joints[1:]
    free = [joint for joint in joints if joint not in tree.locked]
    pattern = joints == free  # a frozen joint among them breaks it
    found = [joint_of(world, joint) for joint in (joints if pattern else joints[:1])]
    root = root_motion(found, tree.gravity, place.rotation)
    before = root.before if root.fixed else place * root.before
    name = root.name
    while len(root.joints) > 1 and name in world.joint_names:
        name += "_"
    index = tree.model.addJoint(0, root.model, before, name)
    tree.model.addJointFrame(index)
    tree.model.appendBodyToJoint(index, root.weight, pin.SE3.Identity())
    armature.append(root.armature)
    limits.append(_no_limits(root.model))
    tree.root = root
    return Carrier(index, root.behind), joints[len(root.joints) :]


def _add_joint(
    tree: Tree, at: Carrier, joint: int, armature: list[Array], limits: list[Array]
) -> Carrier:
    """Add one joint of a body; return where the body sits behind it."""
    world = tree.world
    found = joint_of(world, joint)
    if found.nv != 1:
        raise ModelError(
            f"joint {quoted(found.name)} is a {found.kind} joint inside the tree, with {found.nv} "
            f"degrees of freedom; lock it (lock=[{quoted(found.name)}]), or write three "
            "hinges in its place"
        )
    # Its coordinate is MuJoCo's, which is q0 where the file has the joint drawn.
    place = at.at * found.at_point * found.turned(-found.q0)
    index = tree.model.addJoint(at.joint, found.model(), place, found.name)
    tree.model.addJointFrame(index)
    tree.shape.append(found)
    armature.append(found.armature)
    limits.append(_limits(world, joint))
    return Carrier(index, found.at_point.inverse())


def _kept(tree: Tree, joint: int, at: Carrier, moved: int | None) -> bool:
    """Return whether a frozen joint is one of the model: not ahead of the root, and not a ball."""
    return (
        tree.whole
        and tree.world.kind(joint) in ("slide", "hinge")
        and (moved is None or at.joint != 0)
    )


def _frozen(tree: Tree, joint: int) -> pin.SE3:
    """Return how a frozen joint moves its body, in the body's frame."""
    found = joint_of(tree.world, joint)
    return found.motion(tree.locked[joint]) if found.nv == 1 else pin.SE3.Identity()


def _limits(world: World, joint: int) -> Array:
    """Return the lower and upper limit of a joint, (2, 1)."""
    limited = bool(world.model.jnt_limited[joint])
    ends = world.model.jnt_range[joint] if limited else (-np.inf, np.inf)
    return np.array(ends, dtype=float).reshape(2, 1)


def _no_limits(joint: pin.JointModel) -> Array:
    alone = pin.Model()
    alone.addJoint(0, joint, pin.SE3.Identity(), "root")
    return np.array([[-np.inf] * alone.nq, [np.inf] * alone.nq])


def _add_body(tree: Tree, body: int) -> None:
    """Add a body's inertia and its frame."""
    model, carrier, mujoco = tree.model, tree.carriers[body], tree.world.model
    same = int(mujoco.body_sameframe[body])
    place = np.zeros(3) if same in _SAME_PLACE else mujoco.body_ipos[body]
    turn = np.array([1.0, 0.0, 0.0, 0.0]) if same in _SAME_TURN else mujoco.body_iquat[body]
    on_body = frame(place, turn)
    inertia = pin.Inertia(
        float(mujoco.body_mass[body]), np.zeros(3), np.diag(mujoco.body_inertia[body])
    )
    model.appendBodyToJoint(carrier.joint, inertia, carrier.at * on_body)
    name = tree.world.body_names[body]
    model.addFrame(pin.Frame(name, carrier.joint, 0, carrier.at, pin.FrameType.BODY), False)
