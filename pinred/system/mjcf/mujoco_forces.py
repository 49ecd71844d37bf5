"""Forces in a MuJoCo model: passive ones at shape joints, and actions that are not simulated.

MuJoCo's force at a hinge or slide is −(k₁ y + k₂ y² + k₃ y³) − v (d₁ + d₂ |v| + d₃ v²), with y
measured from springref, and v the rate.  Dry friction adds at most `frictionloss`.  At a ball with
rotation vector r, the spring's moment is −(k₁ + k₂ |r| + k₃ |r|²) r.  Its axes have equal
dampers and friction.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..ball_forces import BallSpring
from ..force_interface import Force
from ..passive import BASE, Damper, Friction, Spring, rate_labels
from ..robot_file_contents import LeftOut
from .actuators import actuator_damping
from .compile import mujoco_package
from .mujoco_joints import quaternion
from .tree import Tree
from .world import World


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
