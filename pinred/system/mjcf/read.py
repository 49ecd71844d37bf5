"""An MJCF file, an MjSpec or an MjModel becomes a pin.Model and what else is in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...lie.group import Group
from ..contents import Contents
from ..locked_joints import LockedJoints
from .acting import acting_on, tendons_on
from .compile import compiled
from .constraints import constraints_of, locked_with_followers, refuse_heavy_tendons
from .keyframes import keyframes_of
from .passive import passive_forces
from .tree import tree_of
from .world import World, robot_in


@dataclass(frozen=True)
class MujocoRobot:
    """A robot as MuJoCo compiles it.

    name: the model's.  model: on the root that the file gives it; without one, its first body
    is the world's.  contents: of the group on which it is put, what else stands in the file.
    """

    name: str
    model: pin.Model
    contents: Callable[[Group], Contents]


def read_mujoco(
    source: Any, *, root: str | None, lock: Mapping[str, float], gravity: Array | None
) -> MujocoRobot:
    """Return the robot in a path, an MjSpec or an MjModel.

    root: the body of the world that carries it, where several can move.  lock: joints to
    freeze with their values.  gravity: (3,) [m/s²] instead of the file's.
    Raises LoadError if MuJoCo cannot read it, ModelError for what cannot be reduced,
    InputError for a root or a joint that is not there.
    """
    what = str(source) if isinstance(source, (str, Path)) else "the model"
    world = robot_in(compiled(source), root, what)
    weight = gravity_of(world)
    lock, ties = locked_with_followers(world, lock)
    felt = weight.felt if gravity is None else gravity
    tree = tree_of(world, lock, felt)
    locked = None
    if lock:
        root_name = "" if tree.root is None else str(tree.model.names[1])
        raw = tree_of(world, lock, felt, whole=True).model
        ids = {name: joint for joint, name in enumerate(world.joint_names)}
        several = tuple(name for name in lock if world.kind(ids[name]) in ("ball", "free"))
        locked = LockedJoints(raw, lock, ties, root_name=root_name, several=several)
    constraints = constraints_of(tree)
    refuse_heavy_tendons(tree, tendons_on(tree))
    still = [world.body_names[body] for body in tree.still]

    def contents(group: Group) -> Contents:
        return Contents(
            left_out=tuple(acting_on(tree, constraints.outside, gravcomp=weight.partly)),
            passive=passive_forces(tree),
            keyframes=keyframes_of(tree, group, constraints.couplings),
            couplings=constraints.couplings,
            freed=still[0] if still and tree.root is None else "",
            locked=locked,
        )

    name = bytes(world.model.names).split(b"\0", 1)[0].decode(errors="replace")
    return MujocoRobot(name, tree.model, contents)


@dataclass(frozen=True, eq=False)
class Gravity:
    """The gravity of a model.

    felt: (3,) [m/s²]; where it is compensated for all bodies alike, what is left of it.
    partly: whether it is compensated for some bodies otherwise than for others, which is
    not in `felt`.
    """

    felt: Array
    partly: bool


def gravity_of(world: World) -> Gravity:
    """Return the gravity that acts on the bodies of a robot."""
    model = world.model
    gravity = np.zeros(3) if world.disabled("GRAVITY") else np.array(model.opt.gravity)
    if not model.flg_gravcomp or world.no_passive_forces:
        return Gravity(gravity, partly=False)
    heavy = [body for body in world.bodies if model.body_mass[body] > 0.0]
    shares = {float(model.body_gravcomp[body]) for body in heavy}
    if len(shares) == 1:
        return Gravity(gravity * (1.0 - shares.pop()), partly=False)
    return Gravity(gravity, partly=bool(shares) and bool(gravity.any()))
