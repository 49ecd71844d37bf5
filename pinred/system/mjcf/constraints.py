"""Equality constraints of a MuJoCo model: loops are refused, proportional joints are coupled."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.errors import ModelError
from ..contents import Coupling
from ..coupling import locked_by, with_followers
from ..locked_joints import Tie
from .mujoco_joints import Joint, joint_of
from .package import mujoco_package
from .tree import Tree
from .world import World


@dataclass(frozen=True)
class Constraints:
    """The active equality constraints of a robot.

    Attributes:
        couplings: Joints that follow others in proportion.
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
        coefficients: Coefficients of its polynomial, (5,).
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
        ModelError: A constraint closes a loop, holds a joint, or couples joints otherwise than in
            proportion.
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
        ModelError: It ties bodies of the robot, or one of them and the ground, that move against
            each other.
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
    if len(ends) == 1:  # The two bodies do not move against each other.
        return False
    names = " and ".join(f"'{world.body_names[body] or 'world'}'" for body in bodies)
    raise ModelError(
        f"closed loops are not supported: equality {constraint.kind} '{constraint.name}' ties "
        f"{names}; remove it or set "
        'active="false", or lock the joints between them (lock=)'
    )


def _is_ground(tree: Tree, body: int) -> bool:
    """Return whether a body neither moves nor is moved by the user (a mocap body)."""
    model = tree.world.model
    while body:
        if body in tree.carriers or model.body_jntnum[body] or model.body_mocapid[body] >= 0:
            return False
        body = int(model.body_parentid[body])
    return True


def _coupling(tree: Tree, constraint: _Constraint) -> Sequence[Coupling]:
    """Return the coupling of a constraint between joints, if the follower can move.

    MuJoCo's polynomial is in displacements from the position at which the file draws the joints.

    Raises:
        ModelError: The constraint holds a joint, is not proportional, or its leader is frozen.
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
            f"a joint that is held is not supported: {words}; lock it there "
            f"(lock={{'{follower.name}': {follower.q0 + c0:g}}}), or remove the constraint"
        )
    if first not in free:  # The follower is frozen, and so would be its leader.
        return ()
    leader = joint_of(world, second)
    if any(higher):
        raise ModelError(
            f"a joint that follows '{leader.name}' otherwise than in proportion is not supported: "
            f"{words}; lock it (lock=['{follower.name}']), write a polynomial of degree one, or "
            "remove the constraint"
        )
    if second not in free:
        raise ModelError(
            f"'{leader.name}', which leads {words}, cannot move; lock the follower as well "
            f"(lock=['{follower.name}']), or remove the constraint"
        )
    return (_proportional(follower, leader, constraint),)


def _proportional(follower: Joint, leader: Joint, constraint: _Constraint) -> Coupling:
    c0, c1, *_ = constraint.coefficients
    offset = follower.q0 + c0 - c1 * leader.q0
    return Coupling(follower.name, leader.name, ratio=c1, offset=offset)


def locked_with_followers(
    world: World, lock: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, Tie]]:
    """Return locks that include the followers of locked joints, and how these follow.

    Followers may use any polynomial.

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
    """Refuse tendons with armature among those that act on a robot.  Raises ModelError."""
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
