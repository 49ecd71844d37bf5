"""The keyframes of a MuJoCo model as states of the reduced system."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...common.arrays import Array
from ...lie.group import Group
from ..contents import Coupling, Keyframe
from .joints import Joint
from .tree import Tree


def keyframes_of(
    tree: Tree, group: Group, couplings: Sequence[Coupling] = ()
) -> dict[str, Keyframe]:
    """Return the keyframes by name; those without one are called key0, key1, … by number.

    group: that of the base; where the file gives it no motion, it stands still at the identity.
    couplings: by which joints follow others, which is where they are then, whatever the file says.
    """
    followers = {each.follower for each in couplings}
    joints = [joint for joint in tree.shape if joint.name not in followers]
    model = tree.world.model
    given = [tree.world.name("KEY", k).replace("key ", "key") for k in range(model.nkey)]
    states = zip(model.key_qpos, model.key_qvel, model.key_time, strict=True)
    return {
        name: _keyframe(tree, joints, group, np.array(qpos), np.array(qvel), float(time))
        for name, (qpos, qvel, time) in zip(given, states, strict=True)
    }


def _keyframe(
    tree: Tree, joints: Sequence[Joint], group: Group, qpos: Array, qvel: Array, time: float
) -> Keyframe:
    root = tree.root
    return Keyframe(
        pose=group.identity() if root is None else root.pose(qpos),
        x=np.array([qpos[joint.q_at] for joint in joints]),
        xi=np.zeros(group.dim) if root is None else root.twist(qpos, qvel),
        xdot=np.array([qvel[joint.v_at] for joint in joints]),
        time=time,
    )
