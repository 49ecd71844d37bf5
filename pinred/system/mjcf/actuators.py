"""Actuators of a MuJoCo model: linear ones at joints are read, others are left out with a reason.

MuJoCo also lets actuators damp and load their joints.  The damping belongs to the passive forces
of the joint; mujoco_joints.py adds the armature.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from ...common.arrays import Array
from ..robot_file_contents import Actuator
from .compile import mujoco_package
from .mujoco_joints import acts_on_joint
from .tree import Tree
from .world import World, name_of


def actuators_of(
    tree: Tree, tendons: Collection[int], merged: Collection[str] = ()
) -> tuple[dict[int, Actuator], list[str]]:
    """Return the actuators that act on a robot, and names and reasons of those left out.

    Args:
        tree: Robot.
        tendons: Tendons that move with the joints of the robot.
        merged: Names of hinges that become balls.
    Returns:
        Actuators by the index of their control, and the names and reasons.
    """
    world, model = tree.world, tree.world.model
    read: dict[int, Actuator] = {}
    left_out: list[str] = []
    if world.disabled("ACTUATION"):
        return read, left_out
    names = _names(world)
    for k in range(model.nactuator):
        if not _acts(tree, k, tendons) or _is_disabled(world, k):
            continue
        reason = _obstacle(tree, k)
        if not reason and world.joint_names[int(model.actuator_trnid[k, 0])] in merged:
            reason = "merged hinge"
        if reason:
            left_out.append(f"{names[k]} ({reason})")
        else:
            read[int(model.actuator_ctrladr[k])] = _actuator(tree, k, names[k])
    return read, left_out


def _names(world: World) -> list[str]:
    """Return the names of all actuators; one without a name has that of its joint, if unused."""
    model, count = world.model, world.model.nactuator
    names = [name_of(model, "ACTUATOR", k) for k in range(count)]
    for k in range(count):
        if not names[k]:
            on_joint = acts_on_joint(world, k)
            joint = world.joint_names[int(model.actuator_trnid[k, 0])] if on_joint else ""
            names[k] = joint if on_joint and joint not in names else f"actuator {k}"
    return names


def actuator_damping(world: World, joint: int) -> Array:
    """Return the coefficients of |v|⁰, |v|¹ and |v|² in the damping that actuators add to a joint.

    MuJoCo multiplies all of them by the square of the gear.
    """
    model = world.model
    damping = np.zeros(1 + model.actuator_dampingpoly.shape[1])
    for k in range(model.nactuator):
        if acts_on_joint(world, k) and int(model.actuator_trnid[k, 0]) == joint:
            gear = model.actuator_gear[model.actuator_outadr[k], 0]
            damping += gear**2 * np.append(model.actuator_damping[k], model.actuator_dampingpoly[k])
    return damping


def _acts(tree: Tree, k: int, tendons: Collection[int]) -> bool:
    """Return whether an actuator acts on bodies of the robot that can move."""
    model, kinds = tree.world.model, mujoco_package().mjtTrn
    kind, target = int(model.actuator_trntype[k]), int(model.actuator_trnid[k, 0])
    if acts_on_joint(tree.world, k):
        return target in tree.free_joints
    if kind == int(kinds.mjTRN_TENDON):
        return target in tendons
    if kind in (int(kinds.mjTRN_SITE), int(kinds.mjTRN_SLIDERCRANK)):
        return int(model.site_bodyid[target]) in tree.carriers
    return kind != int(kinds.mjTRN_BODY) or target in tree.carriers


def _is_disabled(world: World, k: int) -> bool:
    """Return whether the group of an actuator is disabled."""
    group = int(world.model.actuator_group[k])
    return 0 <= group <= 30 and bool(int(world.model.opt.disableactuator) >> group & 1)


def _obstacle(tree: Tree, k: int) -> str:
    """Return why an actuator is left out; "" if it is read."""
    model, mj = tree.world.model, mujoco_package()

    def word(enum: Any, prefix: str, value: int) -> str:
        names = {int(getattr(enum, n)): n for n in dir(enum) if n.startswith(prefix)}
        return names[int(value)].removeprefix(prefix).lower()

    if not acts_on_joint(tree.world, k):
        return word(mj.mjtTrn, "mjTRN_", model.actuator_trntype[k])
    gain = word(mj.mjtGain, "mjGAIN_", model.actuator_gaintype[k])
    bias = word(mj.mjtBias, "mjBIAS_", model.actuator_biastype[k])
    dynamics = word(mj.mjtDyn, "mjDYN_", model.actuator_dyntype[k])
    if int(model.actuator_plugin[k]) >= 0:
        return "plugin"
    if gain not in ("fixed", "affine"):
        return gain
    if bias not in ("none", "affine"):
        return f"{bias} bias"
    if dynamics != "none":
        return f"activation {dynamics}"
    if model.actuator_delay[k] or model.actuator_history[k, 0]:
        return "delay"
    joint = int(model.actuator_trnid[k, 0])
    root = () if tree.root is None else tree.root.joints
    is_compound = len(root) > 1 or (root and root[0].kind not in ("slide", "hinge"))
    if is_compound and tree.world.joint_names[joint] in [root_part.name for root_part in root]:
        return "several degrees of freedom of the base"
    if model.jnt_actgravcomp[joint] and model.jnt_actfrclimited[joint]:
        return "its limits also bound the gravity compensation"
    return ""


def _actuator(tree: Tree, k: int, name: str) -> Actuator:
    """Return an actuator that is linear and acts at one joint."""
    world, model, mj = tree.world, tree.world.model, mujoco_package()
    joint = int(model.actuator_trnid[k, 0])
    is_ball = world.kind(joint) == "ball"
    gain, bias = (
        np.array(values[k, :3]) for values in (model.actuator_gainprm, model.actuator_biasprm)
    )
    if int(model.actuator_gaintype[k]) == int(mj.mjtGain.mjGAIN_FIXED):
        gain[1:] = 0.0
    if int(model.actuator_biastype[k]) == int(mj.mjtBias.mjBIAS_NONE):
        bias[:] = 0.0
    control, gear = int(model.actuator_ctrladr[k]), model.actuator_gear[model.actuator_outadr[k]]
    is_clamped = model.actuator_ctrllimited[control] and not world.disabled("CLAMPCTRL")
    root = () if tree.root is None else tree.root.joints
    return Actuator(
        name,
        world.joint_names[joint],
        tuple(gear[: 3 if is_ball else 1].tolist()),
        tuple(gain.tolist()),
        tuple(bias.tolist()),
        control_limits=_pair(is_clamped, model.actuator_ctrlrange[control]),
        force_limits=_pair(model.actuator_forcelimited[k], model.actuator_forcerange[k]),
        torque_limits=_pair(model.jnt_actfrclimited[joint], model.jnt_actfrcrange[joint]),
        in_parent=is_ball and int(model.actuator_trntype[k]) == int(mj.mjtTrn.mjTRN_JOINTINPARENT),
        on_base=world.joint_names[joint] in [root_part.name for root_part in root],
    )


def _pair(is_limited: bool, limits: Array) -> tuple[float, float] | None:
    """Return limits as numbers; None without limits."""
    return (float(limits[0]), float(limits[1])) if is_limited else None
