"""Read an MJCF file, an MjSpec or an MjModel as a pin.Model and its other contents.

Equality constraints that couple joints in proportion become couplings.  Those that close loops are
refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import ModelError
from ...lie.group import Group
from ..coupling import locked_by, with_followers
from ..locked_joints import LockedJoints, Tie
from ..robot_file_contents import Contents, Coupling, Keyframe
from .compile import compiled
from .mujoco_forces import left_out_actions, moving_tendons, passive_forces
from .mujoco_joints import Joint, joint_of
from .package import mujoco_package
from .tree import Tree, tree_of
from .world import World, robot_in


@dataclass(frozen=True)
class MujocoRobot:
    """A robot as MuJoCo compiles it.

    Attributes:
        name: Name of the model.
        model: Model with the root joint of the file; without a root joint, its first body is fixed.
        contents: Function from the group of the root to the other contents of the file.
    """

    name: str
    model: pin.Model
    contents: Callable[[Group], Contents]


def read_mujoco(
    source: Any, *, root: str | None, lock: Mapping[str, float], gravity: Array | None
) -> MujocoRobot:
    """Read the robot from a path, an MjSpec or an MjModel.

    Args:
        source: Path, MjSpec or MjModel.
        root: Name of the body attached to the world that carries the robot, if several can move.
        lock: Joints to freeze, with their values [rad | m].
        gravity: Gravity that replaces the file's, (3,) [m/s²]; None for the file's.
    Returns:
        The robot.
    Raises:
        LoadError: MuJoCo cannot read the source.
        ModelError: pinred cannot reduce the robot.
        InputError: The root or a joint is unknown.
    """
    what = str(source) if isinstance(source, (str, Path)) else "the model"
    world = robot_in(compiled(source), root, what)
    file_gravity = gravity_of(world)
    lock, ties = locked_with_followers(world, lock)
    effective = file_gravity.effective if gravity is None else gravity
    tree = tree_of(world, lock, effective)
    locked = None
    if lock:
        root_name = "" if tree.root is None else str(tree.model.names[1])
        raw = tree_of(world, lock, effective, keep_frozen=True).model
        ids = {name: joint for joint, name in enumerate(world.joint_names)}
        several = tuple(name for name in lock if world.kind(ids[name]) in ("ball", "free"))
        locked = LockedJoints(raw, lock, ties, root_name=root_name, several=several)
    constraints = constraints_of(tree)
    refuse_heavy_tendons(tree, moving_tendons(tree))
    fixed = [world.body_names[body] for body in tree.fixed_bodies]

    def contents(group: Group) -> Contents:
        return Contents(
            left_out=tuple(
                left_out_actions(tree, constraints.outside, gravcomp=file_gravity.is_uneven)
            ),
            passive=passive_forces(tree),
            keyframes=keyframes_of(tree, group, constraints.couplings),
            couplings=constraints.couplings,
            freed=fixed[0] if fixed and tree.root is None else "",
            locked=locked,
        )

    name = bytes(world.model.names).split(b"\0", 1)[0].decode(errors="replace")
    return MujocoRobot(name, tree.model, contents)


@dataclass(frozen=True, eq=False)
class Gravity:
    """The gravity of a model.

    Attributes:
        effective: Gravity, (3,) [m/s²], minus the compensation (gravcomp) that all bodies share.
        is_uneven: Whether the compensation differs between bodies; it is then not subtracted.
    """

    effective: Array
    is_uneven: bool


def gravity_of(world: World) -> Gravity:
    """Return the gravity that acts on the bodies of a robot."""
    model = world.model
    gravity = np.zeros(3) if world.disabled("GRAVITY") else np.array(model.opt.gravity)
    if not model.flg_gravcomp or world.no_passive_forces:
        return Gravity(gravity, is_uneven=False)
    heavy = [body for body in world.bodies if model.body_mass[body] > 0.0]
    shares = {float(model.body_gravcomp[body]) for body in heavy}
    if len(shares) == 1:
        return Gravity(gravity * (1.0 - shares.pop()), is_uneven=False)
    return Gravity(gravity, is_uneven=bool(shares) and bool(gravity.any()))


def keyframes_of(
    tree: Tree, group: Group, couplings: Sequence[Coupling] = ()
) -> dict[str, Keyframe]:
    """Return the keyframes by name; unnamed keyframes are called key0, key1 and so on.

    Args:
        tree: Robot.
        group: Group of the base.  If the file fixes the base, it rests at the identity.
        couplings: Couplings of followers; the file's values of followers are ignored.
    """
    followers = {coupling.follower for coupling in couplings}
    joints = [joint for joint in tree.shape if joint.name not in followers]
    model, root = tree.world.model, tree.root
    keyframes = {}
    for k in range(model.nkey):
        qpos, qvel = np.array(model.key_qpos[k]), np.array(model.key_qvel[k])
        keyframes[tree.world.name("KEY", k).replace("key ", "key")] = Keyframe(
            pose=group.identity() if root is None else root.pose(qpos),
            x=np.array([qpos[joint.q_at] for joint in joints]),
            xi=np.zeros(group.dim) if root is None else root.twist(qpos, qvel),
            xdot=np.array([qvel[joint.v_at] for joint in joints]),
            time=float(model.key_time[k]),
        )
    return keyframes


@dataclass(frozen=True)
class Constraints:
    """The active equality constraints of a robot.

    Attributes:
        couplings: Couplings of followers in proportion to their leaders.
        outside: Names of constraints that tie the robot to other bodies, or act on tendons or
            flexible bodies.
    """

    couplings: tuple[Coupling, ...]
    outside: tuple[str, ...]


@dataclass(frozen=True)
class _Constraint:
    """An active equality constraint.

    Attributes:
        kind: Kind, such as "weld".
        name: Name in the file, or kind and number.
        objects: Ids of its two objects; the second is −1 if there is only one.
        coefficients: Coefficients of the constraint's polynomial, (5,).
        on_sites: Whether the objects are sites instead of bodies.
    """

    kind: str
    name: str
    objects: tuple[int, int]
    coefficients: list[float]
    on_sites: bool


def constraints_of(tree: Tree) -> Constraints:
    """Return the constraints that act on a robot.

    Raises:
        ModelError: A constraint closes a loop, fixes a joint, or couples joints by a law that is
            not proportional.
    """
    couplings: list[Coupling] = []
    outside: list[str] = []
    for constraint in _active(tree.world):
        if constraint.kind in ("connect", "weld"):
            if _ties_outside(tree, constraint):
                outside.append(constraint.name)
        elif constraint.kind == "joint":
            couplings += _coupling(tree, constraint)
        else:
            outside.append(constraint.name)
    return Constraints(tuple(couplings), tuple(outside))


def _active(world: World) -> Iterator[_Constraint]:
    model, mj = world.model, mujoco_package()
    kinds = {
        int(kind): name.removeprefix("mjEQ_").lower() for name, kind in mj.mjtEq.__members__.items()
    }
    for k in [] if world.disabled("EQUALITY") else np.flatnonzero(model.eq_active0).tolist():
        yield _Constraint(
            kind=kinds[int(model.eq_type[k])],
            name=world.name("EQUALITY", k),
            objects=(int(model.eq_obj1id[k]), int(model.eq_obj2id[k])),
            coefficients=[float(c) for c in model.eq_data[k, :5]],
            on_sites=int(model.eq_objtype[k]) == int(mj.mjtObj.mjOBJ_SITE),
        )


def _ties_outside(tree: Tree, constraint: _Constraint) -> bool:
    """Return whether a constraint ties the robot to a body that is not part of it.

    Raises:
        ModelError: The constraint connects two bodies of the robot, or one body and the ground,
            that move relative to each other.
    """
    world, model = tree.world, tree.world.model
    bodies = list(constraint.objects)
    if constraint.on_sites:
        bodies = [int(model.site_bodyid[site]) for site in bodies]
    on_robot = [body for body in bodies if body in tree.carriers]
    ground = [body for body in bodies if _is_ground(tree, body)]
    if not on_robot:
        return False
    if len(on_robot) + len(ground) < 2:
        return True
    ends = {tree.carriers[body].joint for body in on_robot} | ({0} if ground else set())
    if len(ends) == 1:  # The two bodies do not move relative to each other.
        return False
    names = " and ".join(f"'{world.body_names[body] or 'world'}'" for body in bodies)
    raise ModelError(
        f"closed loops are not supported: equality {constraint.kind} '{constraint.name}' ties "
        f"{names}; remove it or set "
        'active="false", or lock the joints between them (lock=)'
    )


def _is_ground(tree: Tree, body: int) -> bool:
    """Return whether a body is fixed: it has no motion and is no mocap body."""
    model = tree.world.model
    while body:
        if body in tree.carriers or model.body_jntnum[body] or model.body_mocapid[body] >= 0:
            return False
        body = int(model.body_parentid[body])
    return True


def _coupling(tree: Tree, constraint: _Constraint) -> Sequence[Coupling]:
    """Return the coupling that a joint constraint defines, if the follower is not frozen.

    MuJoCo's polynomial applies to displacements from the reference configuration (qpos0).

    Raises:
        ModelError: The constraint fixes a joint, is not proportional, or its leader is frozen.
    """
    world, free = tree.world, tree.free_joints
    first, second = constraint.objects
    if first not in free and second not in free:
        return ()
    follower = joint_of(world, first)
    c0, _, *higher = constraint.coefficients
    words = f"joint '{follower.name}' by equality '{constraint.name}'"
    if second < 0:
        raise ModelError(
            f"an equality that fixes a joint is not supported: {words}; lock the joint "
            f"(lock={{'{follower.name}': {follower.q0 + c0:g}}}), or remove the constraint"
        )
    if first not in free:  # The follower is frozen, so the constraint would freeze its leader.
        return ()
    leader = joint_of(world, second)
    if any(higher):
        raise ModelError(
            f"a joint that follows '{leader.name}' nonlinearly is not supported: "
            f"{words}; lock it (lock=['{follower.name}']), write a polynomial of degree one, or "
            "remove the constraint"
        )
    if second not in free:
        raise ModelError(
            f"'{leader.name}' is the leader of {words}, but it is locked; lock the follower as "
            f"well (lock=['{follower.name}']), or remove the constraint"
        )
    return (_proportional(follower, leader, constraint),)


def _proportional(follower: Joint, leader: Joint, constraint: _Constraint) -> Coupling:
    c0, c1, *_ = constraint.coefficients
    offset = follower.q0 + c0 - c1 * leader.q0
    return Coupling(follower.name, leader.name, ratio=c1, offset=offset)


def locked_with_followers(
    world: World, lock: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, Tie]]:
    """Return locks that include the followers of locked joints, and the ties of these followers.

    Followers of locked joints may use any polynomial.

    Raises:
        InputError: A proportional follower is locked without its leader.
    """
    joints = set(world.all_joints)
    couplings: list[Coupling] = []
    nonlinear: list[tuple[str, Tie]] = []
    for constraint in _active(world):
        if constraint.kind != "joint" or not set(constraint.objects) <= joints:
            continue
        follower, leader = (joint_of(world, joint) for joint in constraint.objects)
        c0, *higher = constraint.coefficients
        if any(higher[1:]):
            law = (follower.q0 + c0, *higher)
            nonlinear.append((follower.name, Tie(leader.name, law, at=leader.q0)))
        else:
            couplings.append(_proportional(follower, leader, constraint))
    names = [world.joint_names[joint] for joint in joints]
    values, _ = with_followers(lock, couplings, names)
    ties: dict[str, Tie] = {}
    for name, tie in nonlinear:
        if tie.leader in values and name not in values:
            ties[name] = tie
            values[name], _ = tie.follow(values[tie.leader])
            values, _ = with_followers(values, couplings, names)
    for name, coupling in locked_by(values, couplings, names).items():
        ties[name] = Tie(coupling.leader, (coupling.offset, coupling.ratio))
    return values, ties


def refuse_heavy_tendons(tree: Tree, tendons: Sequence[int]) -> None:
    """Refuse tendons with armature that act on a robot.  Raises ModelError."""
    model = tree.world.model
    for tendon in tendons:
        if model.tendon_armature[tendon] or _has_rotors(model, tendon):
            raise ModelError(
                f"tendon '{tree.world.name('TENDON', tendon)}' has armature, which couples joints "
                "in the mass matrix and is not supported; set it to zero"
            )


def _has_rotors(model: Any, tendon: int) -> bool:
    """Return whether actuators on a tendon have armature."""
    kind = int(mujoco_package().mjtTrn.mjTRN_TENDON)
    on = (model.actuator_trntype == kind) & (model.actuator_trnid[:, 0] == tendon)
    return bool((on & (model.actuator_armature != 0.0)).any())
