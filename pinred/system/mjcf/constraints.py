"""Equality constraints of a MuJoCo model: loops are refused by name, couplings become values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.errors import ModelError
from ..contents import Coupling
from ..coupling import locked_by, with_followers
from ..locked_joints import Tie
from .joints import Joint, joint_of
from .package import mujoco_package
from .tree import Tree
from .world import World


@dataclass(frozen=True)
class Constraints:
    """The result of the active equality constraints of a robot.

    couplings: joints that follow others in proportion.  outside: names of constraints that tie
    the robot to what is not part of it, or act on tendons or flexible bodies.
    """

    couplings: tuple[Coupling, ...]
    outside: tuple[str, ...]


def constraints_of(tree: Tree) -> Constraints:
    """Return the constraints that act on a robot.

    Raises ModelError, naming it, for one that closes a loop, holds a joint, or couples joints
    otherwise than in proportion.
    """
    model = tree.world.model
    kinds = {
        int(kind): name.removeprefix("mjEQ_").lower()
        for name, kind in mujoco_package().mjtEq.__members__.items()
    }
    couplings: list[Coupling] = []
    outside: list[str] = []
    active = [] if tree.world.disabled("EQUALITY") else np.flatnonzero(model.eq_active0).tolist()
    for number in active:
        kind, name = kinds[int(model.eq_type[number])], tree.world.name("EQUALITY", number)
        if kind in ("connect", "weld"):
            if _ties_outside(tree, number, f"{kind} '{name}'"):
                outside.append(name)
        elif kind == "joint":
            couplings += _coupling(tree, number, name)
        else:
            outside.append(name)
    return Constraints(tuple(couplings), tuple(outside))


def _ties_outside(tree: Tree, number: int, who: str) -> bool:
    """Return whether a constraint ties the robot to a body that is not part of it.

    Raises ModelError if it ties bodies of the robot, or one of them and the ground, that
    move against each other.
    """
    world, model = tree.world, tree.world.model
    bodies = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
    if int(model.eq_objtype[number]) == int(mujoco_package().mjtObj.mjOBJ_SITE):
        bodies = [int(model.site_bodyid[site]) for site in bodies]
    inside = [body for body in bodies if body in tree.carriers]
    # The ground is what neither moves nor is moved by a hand (a mocap body).
    ground = [body for body in bodies if _is_ground(tree, body)]
    if not inside:
        return False
    if len(inside) + len(ground) < 2:
        return True
    ends = {tree.carriers[body].joint for body in inside} | ({0} if ground else set())
    if len(ends) == 1:  # the two stand still against each other
        return False
    names = " and ".join(f"'{world.body_names[body] or 'world'}'" for body in bodies)
    raise ModelError(
        f"closed loops are not supported: equality {who} ties {names}; remove it or set "
        'active="false", or lock the joints between them (lock=)'
    )


def _is_ground(tree: Tree, body: int) -> bool:
    model = tree.world.model
    while body:
        if body in tree.carriers or model.body_jntnum[body] or model.body_mocapid[body] >= 0:
            return False
        body = int(model.body_parentid[body])
    return True


def _coupling(tree: Tree, number: int, name: str) -> Sequence[Coupling]:
    """Return the coupling that a constraint between joints is, if the follower can move.

    MuJoCo's polynomial is in displacements from where the file has the joints drawn.
    """
    world, model = tree.world, tree.world.model
    first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
    own = tree.free_joints
    if first not in own and second not in own:
        return ()
    follower = joint_of(world, first)
    c0, c1, *higher = (float(c) for c in model.eq_data[number, :5])
    way_out = (
        f"lock it (lock=['{follower.name}']), write a polynomial of degree one, or remove the "
        "constraint"
    )
    who = f"joint '{follower.name}' by equality '{name}'"
    if second < 0:
        raise ModelError(
            f"a joint that is held is not supported: {who}; lock it there "
            f"(lock={{'{follower.name}': {follower.q0 + c0:g}}}), or remove the constraint"
        )
    if first not in own:  # frozen, and so would be its leader
        return ()
    leader = joint_of(world, second)
    if any(higher):
        raise ModelError(
            f"a joint that follows '{leader.name}' otherwise than in proportion is not supported: "
            f"{who}; {way_out}"
        )
    if second not in own:
        raise ModelError(
            f"'{leader.name}', which leads {who}, cannot move; lock the follower as well "
            f"(lock=['{follower.name}']), or remove the constraint"
        )
    return (_in_proportion(follower, leader, c0, c1),)


def _in_proportion(follower: Joint, leader: Joint, c0: float, c1: float) -> Coupling:
    offset = follower.q0 + c0 - c1 * leader.q0
    return Coupling(follower.name, leader.name, ratio=c1, offset=offset)


def locked_with_followers(
    world: World, lock: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, Tie]]:
    """Return locks with those of the joints that follow locked ones, and how these do.

    They may do so by whatever polynomial.
    Raises InputError for followers in proportion that are locked alone.
    """
    own = {joint for body in world.bodies for joint in world.joints(body)}
    straight, bent = [], []
    for number in [] if world.disabled("EQUALITY") else np.flatnonzero(world.model.eq_active0):
        ends = int(world.model.eq_obj1id[number]), int(world.model.eq_obj2id[number])
        is_joint = int(world.model.eq_type[number]) == int(mujoco_package().mjtEq.mjEQ_JOINT)
        if not is_joint or not set(ends) <= own:
            continue
        follower, leader = (joint_of(world, end) for end in ends)
        factors = [float(c) for c in world.model.eq_data[number, :5]]
        if any(factors[2:]):
            bent.append((follower, leader, factors))
        else:
            straight.append(_in_proportion(follower, leader, factors[0], factors[1]))
    names = [world.joint_names[joint] for joint in own]
    out, _ = with_followers(lock, straight, names)
    ties: dict[str, Tie] = {}
    for follower, leader, factors in bent:
        if leader.name in out and follower.name not in out:
            law = (follower.q0 + factors[0], *factors[1:])
            ties[follower.name] = Tie(leader.name, law, at=leader.q0)
            out[follower.name], _ = ties[follower.name].follow(out[leader.name])
            out, _ = with_followers(out, straight, names)
    for name, each in locked_by(out, straight, names).items():
        ties[name] = Tie(each.leader, (each.offset, each.ratio))
    return out, ties


def refuse_heavy_tendons(tree: Tree, tendons: Sequence[int]) -> None:
    """Refuse tendons with armature, of those that act on a robot.  Raises ModelError."""
    model = tree.world.model
    for tendon in tendons:
        if model.tendon_armature[tendon] or _rotors_on(model, tendon):
            raise ModelError(
                f"tendon '{tree.world.name('TENDON', tendon)}' has armature, which couples joints "
                "in the mass matrix and is not supported; set it to zero"
            )


def _rotors_on(model: Any, tendon: int) -> bool:
    """Return whether actuators on a tendon have armature."""
    kind = int(mujoco_package().mjtTrn.mjTRN_TENDON)
    on = (model.actuator_trntype == kind) & (model.actuator_trnid[:, 0] == tendon)
    return bool((on & (model.actuator_armature != 0.0)).any())
