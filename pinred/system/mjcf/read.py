"""Read an MJCF file, an MjSpec or an MjModel as a pin.Model and its other contents."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import ModelError
from ...lie.group import Group
from ..locked_joints import LockedJoints, LockValue, separate_attitudes
from ..merge_hinges import Merge, coupled_joints, locked_hinges, merge_of
from ..robot_file_contents import Actuator, Contents, Coupling, Keyframe
from .compile import compiled, mujoco_package
from .equality_constraints import constraints_of, held_joints, locked_with_followers
from .mujoco_forces import actuators_of, left_out_actions, moving_tendons, passive_forces
from .tree import Tree, ignored_rotors, tree_of
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
    source: Any,
    *,
    root: str | None,
    lock: Mapping[str, LockValue],
    gravity: Array | None,
    balls: bool | tuple[str, ...] = False,
) -> MujocoRobot:
    """Read the robot from a path, an MjSpec or an MjModel.

    Args:
        source: Path, MjSpec or MjModel.
        root: Name of the body attached to the world that carries the robot, if several can move.
        lock: Joints to lock, with their values.
        gravity: Gravity that replaces the file's, (3,) [m/s²]; None for the file's.
        balls: Hinges to merge into balls (see `merge_of`).
    Returns:
        The robot.
    Raises:
        LoadError: MuJoCo cannot read the source.
        ModelError: pinred cannot reduce the robot.
        InputError: The root or a joint is unknown.
    """
    what = str(source) if isinstance(source, (str, Path)) else "the model"
    world = robot_in(compiled(source), root, what)
    lock = held_joints(world) | dict(lock)
    file_gravity = gravity_of(world)
    effective = file_gravity.effective if gravity is None else gravity
    if balls and lock:
        model = tree_of(world, {}, effective).model
        lock, balls = locked_hinges(model, balls, lock)
        merge_of(model, balls, kept=lock)  # Refuse balls of locked hinges.
    names = {world.joint_names[joint]: world.kind(joint) for joint in world.all_joints}
    ball_names = [name for name, kind in names.items() if kind == "ball"]
    values, attitudes = separate_attitudes(lock, ball_names, names)
    locked_values, ties, shared = locked_with_followers(world, values)
    tree = tree_of(world, locked_values, effective, attitudes=attitudes)
    couplings, outside, loops = constraints_of(tree)
    forces = passive_forces(tree)
    kept = {*locked_values, *coupled_joints(couplings)}
    merge = merge_of(tree.model, balls, passive=forces, kept=kept)
    locked = None
    if locked_values:
        frozen = tree_of(world, locked_values, effective, attitudes=attitudes, keep_frozen=True)
        locked = LockedJoints(
            merge.model(frozen.model),
            locked_values,
            ties,
            root_name="" if tree.root is None else str(tree.model.names[1]),
            several=tuple(name for name in locked_values if names[name] in ("ball", "free")),
            attitudes=attitudes,
            shared=shared,
        )
    tendons = moving_tendons(tree)
    refuse_heavy_tendons(tree, tendons)
    actuators, without = actuators_of(tree, tendons, merge.hinges)
    fixed = [world.body_names[body] for body in tree.fixed_bodies]

    def contents(group: Group) -> Contents:
        return Contents(
            left_out=(
                *left_out_actions(tree, outside, without, gravcomp=file_gravity.is_uneven),
                *merge.left_out(forces),
            ),
            passive=merge.forces(forces),
            actuators=tuple(actuators.values()),
            keyframes=keyframes_of(tree, group, couplings, merge, actuators),
            couplings=couplings,
            freed=fixed[0] if fixed and tree.root is None else "",
            warnings=(
                *(() if tree.root is None else ignored_rotors(tree.root.joints)),
                *merge.warnings(tree.model),
            ),
            locked=locked,
            merged=merge.triples,
            loops=loops,
            links=tree.links,
        )

    name = bytes(world.model.names).split(b"\0", 1)[0].decode(errors="replace")
    return MujocoRobot(name, merge.model(tree.model), contents)


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
    tree: Tree,
    group: Group,
    couplings: Sequence[Coupling] = (),
    merge: Merge | None = None,
    actuators: Mapping[int, Actuator] | None = None,
) -> dict[str, Keyframe]:
    """Return the keyframes by name; unnamed keyframes are called key0, key1 and so on.

    Args:
        tree: Robot.
        group: Group of the base.  If the file fixes the base, it rests at the identity.
        couplings: Couplings of followers; the file's values of followers are ignored.
        merge: Hinges that become balls; None for none.
        actuators: Actuators by the index of their control.
    """
    followers = {coupling.follower for coupling in couplings}
    joints = [joint for joint in tree.shape if joint.name not in followers]
    model, root = tree.world.model, tree.root
    keyframes = {}
    for k in range(model.nkey):
        qpos, qvel = np.array(model.key_qpos[k]), np.array(model.key_qvel[k])
        x, xdot = (merge or Merge()).values(
            {joint.name: joint.coordinates(qpos) for joint in joints},
            {joint.name: joint.rates(qvel) for joint in joints},
        )
        keyframes[tree.world.name("KEY", k).replace("key ", "key")] = Keyframe(
            pose=group.identity() if root is None else root.pose(qpos),
            x=np.concatenate([np.empty(0), *x.values()]),
            xi=np.zeros(group.dim) if root is None else root.twist(qpos, qvel),
            xdot=np.concatenate([np.empty(0), *xdot.values()]),
            time=float(model.key_time[k]),
            controls={
                actuator.name: float(model.key_ctrl[k, at])
                for at, actuator in (actuators or {}).items()
            },
        )
    return keyframes


def refuse_heavy_tendons(tree: Tree, tendons: Sequence[int]) -> None:
    """Reject tendons with armature that act on a robot.  Raises ModelError."""
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
