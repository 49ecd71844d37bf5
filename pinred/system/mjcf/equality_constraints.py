"""Equality constraints of an MJCF file.

Constraints that couple joints linearly become couplings.  Other polynomials of joints, and
constraints between two links of the robot, become loops.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.errors import ModelError
from ..coupling import ties_of, with_constants, with_followers
from ..locked_joints import Tie
from ..loops.loop import HEAVY_GROUND, JointPolynomial, Loop, LoopKind
from ..loops.loop import Constraint as LoopConstraint
from ..robot_file_contents import Coupling
from .linear_laws import (
    Constraint,
    active_constraints,
    couples_joints,
    joints_of,
    not_linear,
    proportional,
    proportional_couplings,
    tendon_laws,
)
from .mujoco_forces import moving_tendons
from .mujoco_joints import frame, joint_of
from .tree import Tree
from .world import World


@dataclass(frozen=True)
class Constraints:
    """The active equality constraints of a robot.

    Attributes:
        couplings: Couplings of followers in proportion to their leaders.
        outside: Names of constraints that tie the robot to other bodies, or act on tendons or
            flexible bodies.
        loops: Constraints that close kinematic loops, and polynomials of joints; the frames of
            loops are in the model.
    """

    couplings: tuple[Coupling, ...]
    outside: tuple[str, ...]
    loops: tuple[LoopConstraint, ...] = ()


def constraints_of(tree: Tree) -> Constraints:
    """Return the constraints that act on a robot, and add the frames of loops to its model.

    Raises:
        ModelError: A constraint attaches the robot to the world, or contradicts another one.
    """
    couplings: list[Coupling] = []
    outside: list[str] = []
    loops: list[LoopConstraint] = []
    for constraint in active_constraints(tree.world):
        if constraint.kind in ("connect", "weld"):
            if _ties_outside(tree, constraint):
                outside.append(constraint.name)
            elif _closes_loop(tree, constraint):
                loops.append(_loop(tree, constraint))
        elif constraint.kind == "joint":
            for law in _laws(tree, constraint):
                if isinstance(law, Coupling):
                    couplings.append(law)
                else:
                    loops.append(law)
        elif constraint.kind != "tendon" or _is_outside(tree, constraint):
            outside.append(constraint.name)
    return Constraints((*couplings, *_tendon_couplings(tree)), tuple(outside), tuple(loops))


def _is_outside(tree: Tree, constraint: Constraint) -> bool:
    """Return whether the constraint of a tendon acts on another body than the robot.

    Raises:
        ModelError: The constraint is not linear in the joints of the robot.
    """
    world, moving = tree.world, set(moving_tendons(tree))
    if moving.isdisjoint(constraint.objects):
        return False
    why = not_linear(world, constraint)
    if why:
        raise ModelError(
            f"{why}: equality tendon '{constraint.name}' is not supported; only fixed tendons in "
            "proportion couple joints. Lock the joints that the tendon moves (lock=), remove it or "
            'set active="false"'
        )
    return not set(joints_of(world, constraint)) <= set(world.all_joints)


def _tendon_couplings(tree: Tree) -> list[Coupling]:
    """Return the couplings of free joints that fixed tendons define."""
    world = tree.world
    values = {world.joint_names[joint]: value for joint, value in tree.locked.items()}
    laws = tendon_laws(world, proportional_couplings(world))
    free = [coupling for coupling in laws.couplings if coupling.follower not in values]
    return [with_constants(coupling, values) for coupling in free]


def _bodies(tree: Tree, constraint: Constraint) -> list[int]:
    """Return the ids of the two bodies of a connect or weld."""
    if not constraint.on_sites:
        return list(constraint.objects)
    return [int(tree.world.model.site_bodyid[site]) for site in constraint.objects]


def _ties_outside(tree: Tree, constraint: Constraint) -> bool:
    """Return whether a constraint ties the robot to a body that is neither robot nor ground.

    Raises:
        ModelError: The constraint attaches a body of the robot to the ground, relative to which
            the base moves.
    """
    bodies = _bodies(tree, constraint)
    on_robot = [body for body in bodies if body in tree.carriers]
    ground = [body for body in bodies if _is_ground(tree, body)]
    if not on_robot:
        return False
    if len(on_robot) + len(ground) < 2:
        return True
    # If the file fixes the base, the ground is the base, whose motion moves both ends of a loop.
    if not ground or tree.root is None or tree.carriers[on_robot[0]].joint == 0:
        return False
    names = " and ".join(f"'{tree.world.body_names[body] or 'world'}'" for body in bodies)
    raise ModelError(
        "closed loops through the world are not supported if the base has joints, because they "
        f"break its symmetry: equality {constraint.kind} '{constraint.name}' ties {names}, but "
        f"the base moves by joint '{tree.root.name}'; remove it or set active=\"false\", lock the "
        f"joints between them (lock=), or {HEAVY_GROUND}"
    )


def _closes_loop(tree: Tree, constraint: Constraint) -> bool:
    """Return whether a constraint ties two bodies that move relative to each other."""
    carriers = [tree.carrier(body) for body in _bodies(tree, constraint)]
    on_robot = any(body in tree.carriers for body in _bodies(tree, constraint))
    return on_robot and carriers[0].joint != carriers[1].joint


def _loop(tree: Tree, constraint: Constraint) -> Loop:
    """Return the loop that a connect or weld closes, and add its two frames to the model."""
    model, numbers = tree.world.model, np.array(constraint.numbers)
    if constraint.on_sites:
        placements = [
            frame(model.site_pos[site], model.site_quat[site]) for site in constraint.objects
        ]
    elif constraint.kind == "connect":
        placements = [pin.SE3(np.eye(3), anchor) for anchor in (numbers[:3], numbers[3:6])]
    else:
        placements = [frame(numbers[3:6], numbers[6:10]), pin.SE3(np.eye(3), numbers[:3])]
    names = []
    for number, (body, placement) in enumerate(
        zip(_bodies(tree, constraint), placements, strict=True), start=1
    ):
        carrier, name = tree.carrier(body), f"{constraint.name} {number}"
        frame_type = pin.FrameType.OP_FRAME
        tree.model.addFrame(
            pin.Frame(name, carrier.joint, 0, carrier.at * placement, frame_type), False
        )
        names.append(name)
    first, second = names
    kind: LoopKind = "3d" if constraint.kind == "connect" else "6d"
    return Loop(first, second, kind, constraint.name)


def _is_ground(tree: Tree, body: int) -> bool:
    """Return whether a body is fixed: it cannot move and is not a mocap body."""
    model = tree.world.model
    while body:
        if body in tree.carriers or model.body_jntnum[body] or model.body_mocapid[body] >= 0:
            return False
        body = int(model.body_parentid[body])
    return True


def _laws(tree: Tree, constraint: Constraint) -> Sequence[Coupling | JointPolynomial]:
    """Return the law between joints of a constraint, if the follower is not locked.

    MuJoCo's polynomial applies to displacements from the reference configuration (qpos0).

    Raises:
        ModelError: The leader is locked, and the follower is not.
    """
    world, free = tree.world, tree.free_joints
    first, second = constraint.objects
    if first not in free and second not in free:
        return ()
    follower = joint_of(world, first)
    if first not in free:  # The follower is locked, so the constraint would fix its leader.
        return ()
    leader = joint_of(world, second)
    if second not in free:
        raise ModelError(
            f"joint '{leader.name}' is the leader of joint '{follower.name}' by equality joint "
            f"'{constraint.name}', but it is locked; lock the follower as well "
            f"(lock=['{follower.name}']), or remove the constraint"
        )
    if not any(constraint.coefficients[2:]):
        return (proportional(follower, leader, constraint),)
    name, coefficients = constraint.name, tuple(constraint.coefficients)
    return (
        JointPolynomial(follower.name, leader.name, coefficients, follower.q0, leader.q0, name),
    )


def held_joints(world: World) -> dict[str, float]:
    """Return the joints that active equality constraints hold, with their values."""
    constant = {
        name: value
        for name, (value, _) in tendon_laws(world, proportional_couplings(world)).held.items()
    }
    for constraint in active_constraints(world):
        first, second = (*constraint.objects, -1)[:2]
        if constraint.kind == "joint" and second < 0 and first in world.all_joints:
            joint = joint_of(world, first)
            constant[joint.name] = joint.q0 + constraint.coefficients[0]
    return constant


def locked_with_followers(
    world: World, lock: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, Tie], tuple[str, ...]]:
    """Return locks that include the followers of locked joints, and the ties of these followers.

    The third value has the locked joints in couplings with several leaders.  Followers of locked
    joints may use any polynomial.

    Raises:
        InputError: A proportional follower is locked without its leader.
    """
    couplings = proportional_couplings(world)
    couplings += tendon_laws(world, couplings).couplings
    nonlinear: list[tuple[str, Tie]] = []
    for constraint in active_constraints(world):
        if couples_joints(world, constraint) and any(constraint.coefficients[2:]):
            follower, leader = (joint_of(world, joint) for joint in constraint.objects)
            c0, *higher = constraint.coefficients
            law = (follower.q0 + c0, *higher)
            nonlinear.append((follower.name, Tie(leader.name, law, at=leader.q0)))
    names = [world.joint_names[joint] for joint in world.all_joints]
    values, _ = with_followers(lock, couplings, names)
    ties: dict[str, Tie] = {}
    for name, tie in nonlinear:
        if tie.leader in values and name not in values:
            ties[name] = tie
            values[name], _ = tie.follow(values[tie.leader])
            values, _ = with_followers(values, couplings, names)
    linear_ties, shared = ties_of(values, couplings, names)
    return values, ties | linear_ties, shared
