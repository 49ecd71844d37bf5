"""Forces in a MuJoCo model: passive ones, actuators, and actions that are not simulated.

MuJoCo's force at a hinge or slide is −(k₁ y + k₂ y² + k₃ y³) − v (d₁ + d₂ |v| + d₃ v²), with y
measured from springref, and v the rate.  Dry friction adds at most `frictionloss`.  At a ball with
rotation vector r, the spring's moment is −(k₁ + k₂ |r| + k₃ |r|²) r.  Its axes have equal
dampers and friction.

Actuators at joints that are linear are read; others are left out with a reason.  MuJoCo also lets
actuators damp and load their joints: the damping belongs to the passive forces of the joint, and
world.py adds the armature.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ...common.arrays import Array
from ..force_interface import Force
from ..passive import BASE, BallSpring, Damper, Friction, Spring, rate_labels
from ..robot_file_contents import Actuator, LeftOut
from .compile import mujoco_package
from .tree import Tree
from .world import World, acts_on_joint, name_of, quaternion


def passive_forces(tree: Tree) -> tuple[Force, ...]:
    """Return the springs, dampers and dry friction at shape joints, joint by joint."""
    return tuple(force for joint in _shape_joints(tree) for force in _forces_at(tree.world, joint))


def left_out_actions(
    tree: Tree, outside: Sequence[str], actuators: Sequence[str], *, gravcomp: bool
) -> Iterator[LeftOut]:
    """Yield the actions on a robot that are not simulated, by kind.

    Forces at the base would change the momentum, so they are not simulated.  Plastic springs are
    not simulated either, because their force depends on the past.

    Args:
        tree: Robot.
        outside: Names of constraints that tie the robot to other bodies.
        actuators: Names of actuators that are left out.
        gravcomp: Whether gravity is compensated for some of the bodies.
    """
    world, model = tree.world, tree.world.model
    joints, shape = tree.free_joints, _shape_joints(tree)
    moving = [body for body, carrier in tree.carriers.items() if carrier.joint > 0]
    fluid = []
    if (model.opt.density or model.opt.viscosity) and not world.no_passive_forces:
        fluid.append(f"density {model.opt.density:g}, viscosity {model.opt.viscosity:g}")
    kinds: dict[str, list[str]] = {
        "actuators": [*actuators],
        "equality constraints": [] if world.disabled("EQUALITY") else [*outside],
        "tendons": [
            world.name("TENDON", k)
            for k in moving_tendons(tree)
            if _is_active(world, _tendon_numbers(model, k))
        ],
        BASE: [
            world.joint_names[joint]
            for joint in joints
            if joint not in shape and _is_active(world, _joint_numbers(world, joint))
        ],
        "plastic springs": [world.joint_names[j] for j in shape if _is_plastic(world, j)],
        "joint limits": [
            world.joint_names[joint]
            for joint in joints
            if model.jnt_limited[joint] and not world.disabled("LIMIT")
        ],
        "contact": _touching_shapes(tree),
        "fluid": [f"density {model.opt.density:g}, viscosity {model.opt.viscosity:g}"]
        * bool(fluid),
        "compensated gravity": [
            world.body_names[body] for body in moving if gravcomp and model.body_gravcomp[body]
        ],
        "plugins": [world.body_names[body] for body in moving if model.body_plugin[body] >= 0],
        "flexible bodies": [world.name("FLEX", k) for k in range(model.nflex)],
        "other bodies": [*world.others],
    }
    for what, names in kinds.items():
        if names:
            # Limits are reported after a simulation that exceeds them.
            yield LeftOut(what, tuple(names), demanded=what == "joint limits")


def moving_tendons(tree: Tree) -> list[int]:
    """Return the tendons whose length changes with the joints of a robot."""
    model, kinds = tree.world.model, mujoco_package().mjtWrap
    body_of = {
        int(kinds.mjWRAP_SITE): model.site_bodyid,
        int(kinds.mjWRAP_SPHERE): model.geom_bodyid,
        int(kinds.mjWRAP_CYLINDER): model.geom_bodyid,
    }
    free = set(tree.free_joints)
    tendons = []
    for tendon in range(model.ntendon):
        first = int(model.tendon_adr[tendon])
        # Joints of the bodies that the tendon connects.  −1 and −2 together represent a moving
        # joint on which the tendon acts directly, −3 a body outside the robot.
        ends = set()
        for wrap in range(first, first + int(model.tendon_num[tendon])):
            kind, target = int(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
            if kind == int(kinds.mjWRAP_JOINT):
                ends |= {-1, -2} if target in free else set()
            elif kind in body_of:
                body = int(body_of[kind][target])
                ends.add(tree.carriers[body].joint if body in tree.carriers else -3)
        if len(ends) > 1:  # The tendon connects bodies that move relative to each other.
            tendons.append(tendon)
    return tendons


def _shape_joints(tree: Tree) -> list[int]:
    ids = {name: joint for joint, name in enumerate(tree.world.joint_names)}
    return [ids[joint.name] for joint in tree.shape]


def _forces_at(world: World, joint: int) -> Iterator[Force]:
    name, numbers = world.joint_names[joint], _joint_numbers(world, joint)
    (k, *stiffer), (d, *thicker) = numbers["SPRING"], numbers["DAMPER"]
    (most,) = numbers["FRICTIONLOSS"]
    is_ball = world.kind(joint) == "ball"
    if _is_active(world, {"SPRING": numbers["SPRING"]}) and not _is_plastic(world, joint):
        reference = world.model.qpos_spring[world.model.jnt_qposadr[joint] :]
        higher = _without_zeros(stiffer)
        if is_ball:
            yield BallSpring(name, k, quaternion(reference), polynomial=higher)
        else:
            yield Spring(name, k, float(reference[0]), polynomial=higher)
    for label in rate_labels(name, 3 if is_ball else 1):
        if _is_active(world, {"DAMPER": numbers["DAMPER"]}):
            yield Damper(label, d, polynomial=_without_zeros(thicker))
        if most > 0.0 and not world.disabled("FRICTIONLOSS"):
            yield Friction(label, most)


def _is_active(world: World, numbers: Mapping[str, Iterable[float]]) -> bool:
    """Return whether any coefficient is nonzero and its kind of force is enabled."""
    return any(any(values) and not world.disabled(kind) for kind, values in numbers.items())


def _joint_numbers(world: World, joint: int) -> dict[str, list[float]]:
    """Return {MuJoCo flag: coefficients of the spring, damper or friction at a joint}."""
    model = world.model
    v = int(model.jnt_dofadr[joint])
    damping = np.append(model.dof_damping[v], model.dof_dampingpoly[v])
    return {
        "SPRING": [float(model.jnt_stiffness[joint]), *map(float, model.jnt_stiffnesspoly[joint])],
        "DAMPER": (damping + actuator_damping(world, joint)).tolist(),
        "FRICTIONLOSS": [float(model.dof_frictionloss[v])],
    }


def _tendon_numbers(model: Any, tendon: int) -> dict[str, list[float]]:
    """Return {MuJoCo flag: coefficients of the forces along a tendon}."""
    return {
        "SPRING": [model.tendon_stiffness[tendon], *model.tendon_stiffnesspoly[tendon]],
        "DAMPER": [model.tendon_damping[tendon], *model.tendon_dampingpoly[tendon]],
        "FRICTIONLOSS": [model.tendon_frictionloss[tendon]],
        "LIMIT": [model.tendon_limited[tendon]],
    }


def _is_plastic(world: World, joint: int) -> bool:
    """Return whether the spring at a joint is plastic."""
    spring = {"SPRING": _joint_numbers(world, joint)["SPRING"]}
    return _is_active(world, spring) and bool(world.model.jnt_springyield[joint])


def _without_zeros(coefficients: Iterable[float]) -> tuple[float, ...]:
    """Return coefficients without trailing zeros."""
    kept = list(coefficients)
    while kept and kept[-1] == 0.0:
        kept.pop()
    return tuple(kept)


def _touching_shapes(tree: Tree) -> list[str]:
    """Return the names of geoms on moving bodies that can touch other geoms."""
    world, model = tree.world, tree.world.model
    if world.disabled("CONTACT"):
        return []
    pairs = {int(geom) for geom in (*model.pair_geom1, *model.pair_geom2)}
    return [
        world.name("GEOM", geom)
        for geom in range(model.ngeom)
        if int(model.geom_bodyid[geom]) in tree.carriers
        and (model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in pairs)
    ]


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
