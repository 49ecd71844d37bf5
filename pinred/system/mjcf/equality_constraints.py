"""Equality constraints of an MJCF file.

Constraints that couple joints linearly become couplings.  Other polynomials of joints, and
constraints between two links of the robot, become loops.

The length of a fixed tendon is Σ c q.  MuJoCo's constraint of two tendons is
L₁ − L₁⁰ = a₀ + a₁ (L₂ − L₂⁰), with the lengths L⁰ in the reference configuration (qpos0).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.errors import ModelError
from ..coupling import resolved, ties_of, with_constants, with_followers
from ..locked_joints import Tie
from ..loops.loop import HEAVY_GROUND, JointPolynomial, Loop, LoopKind
from ..loops.loop import Constraint as LoopConstraint
from ..robot_file_contents import Coupling
from .compile import mujoco_package
from .mujoco_forces import moving_tendons
from .tree import Tree
from .world import Joint, World, frame, joint_of

_ROUND_OFF = 1e-12  # coefficients and constants below this fraction of their terms are zero


@dataclass(frozen=True)
class Constraint:
    """An active equality constraint.

    Attributes:
        kind: Kind, such as "weld".
        name: Name in the file, or kind and number.
        objects: Ids of its two objects; the second is −1 if there is only one.
        coefficients: Coefficients of the constraint's polynomial, (5,).
        on_sites: Whether the objects are sites instead of bodies.
        numbers: All numbers of the constraint in MuJoCo's model (eq_data), (11,).
    """

    kind: str
    name: str
    objects: tuple[int, int]
    coefficients: list[float]
    on_sites: bool
    numbers: tuple[float, ...] = ()


def active_constraints(world: World) -> Iterator[Constraint]:
    """Return the active equality constraints of a model."""
    model, mj = world.model, mujoco_package()
    kinds = {
        int(kind): name.removeprefix("mjEQ_").lower() for name, kind in mj.mjtEq.__members__.items()
    }
    for k in [] if world.disabled("EQUALITY") else np.flatnonzero(model.eq_active0).tolist():
        yield Constraint(
            kind=kinds[int(model.eq_type[k])],
            name=world.name("EQUALITY", k),
            objects=(int(model.eq_obj1id[k]), int(model.eq_obj2id[k])),
            coefficients=[float(c) for c in model.eq_data[k, :5]],
            on_sites=int(model.eq_objtype[k]) == int(mj.mjtObj.mjOBJ_SITE),
            numbers=tuple(float(c) for c in model.eq_data[k]),
        )


def proportional(follower: Joint, leader: Joint, constraint: Constraint) -> Coupling:
    """Return the coupling of a joint constraint of degree one."""
    c0, c1, *_ = constraint.coefficients
    offset = follower.q0 + c0 - c1 * leader.q0
    return Coupling(follower.name, {leader.name: c1}, offset)


def couples_joints(world: World, constraint: Constraint) -> bool:
    """Return whether a constraint couples two joints of the robot."""
    return constraint.kind == "joint" and set(constraint.objects) <= set(world.all_joints)


def proportional_couplings(world: World) -> list[Coupling]:
    """Return the couplings that joint constraints of degree one define."""
    return [
        proportional(joint_of(world, follower), joint_of(world, leader), constraint)
        for constraint in active_constraints(world)
        if couples_joints(world, constraint) and not any(constraint.coefficients[2:])
        for follower, leader in [constraint.objects]
    ]


def joints_of(world: World, constraint: Constraint) -> dict[int, float]:
    """Return the joints of a constraint's fixed tendons, with their factors in L₁ − a₁ L₂."""
    first, second = constraint.objects
    joints: dict[int, float] = {}
    for tendon, factor in ((first, 1.0), (second, -constraint.coefficients[1])):
        for joint, coefficient in _fixed(world, tendon) if tendon >= 0 else ():
            joints[joint] = joints.get(joint, 0.0) + factor * coefficient
    return joints


def not_linear(world: World, constraint: Constraint) -> str:
    """Return why the constraint of tendons is not linear in joint values; "" if it is."""
    tendons = [tendon for tendon in constraint.objects if tendon >= 0]
    for tendon in tendons:
        if not _fixed(world, tendon):
            return f"tendon '{world.name('TENDON', tendon)}' is spatial"
    if len(tendons) > 1 and any(constraint.coefficients[2:]):
        return "the lengths of two tendons are not in proportion"
    return ""


def _fixed(world: World, tendon: int) -> list[tuple[int, float]]:
    """Return joints and coefficients of a fixed tendon; empty for a spatial tendon."""
    model, kind = world.model, int(mujoco_package().mjtWrap.mjWRAP_JOINT)
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    return [
        (int(model.wrap_objid[wrap]), float(model.wrap_prm[wrap]))
        for wrap in wraps
        if int(model.wrap_type[wrap]) == kind
    ]


def tendon_laws(
    world: World, couplings: Sequence[Coupling]
) -> tuple[list[Coupling], dict[str, float]]:
    """Solve the linear constraints of fixed tendons for one joint each.

    The follower is the joint with the largest coefficient, among equal ones the last joint.

    Args:
        world: The robot.
        couplings: Couplings of joint constraints.
    Returns:
        Couplings, each with one joint as the follower; and values of joints that constraints fix.
    Raises:
        ModelError: Two constraints contradict each other.
    """
    names = [world.joint_names[joint] for joint in world.all_joints]
    laws, constant_joints = list[Coupling](), dict[str, float]()
    for constraint in active_constraints(world):
        if constraint.kind != "tendon" or not_linear(world, constraint):
            continue
        joints = joints_of(world, constraint)
        if not set(joints) <= set(world.all_joints):
            continue
        constants = [Coupling(name, {}, value) for name, value in constant_joints.items()]
        independent = resolved([*couplings, *laws, *constants], names)
        row, constant, size = _substituted(world, constraint, joints, independent)
        if not row:
            if abs(constant) > _ROUND_OFF * size:
                raise ModelError(
                    f"equality tendon '{constraint.name}' contradicts other constraints by "
                    f'{constant:g}; remove it or set active="false"'
                )
            continue
        largest = max(map(abs, row.values())) * (1.0 - _ROUND_OFF)
        follower = [name for name in names if abs(row.get(name, 0.0)) >= largest][-1]
        pivot = row.pop(follower)
        law = Coupling(follower, {n: -c / pivot for n, c in row.items()}, -constant / pivot)
        if row:
            laws.append(law)
        else:
            constant_joints[follower] = law.offset
    return laws, constant_joints


def _substituted(
    world: World,
    constraint: Constraint,
    joints: Mapping[int, float],
    independent: Mapping[str, Coupling],
) -> tuple[dict[str, float], float, float]:
    """Express a tendon's constraint Σ c q + constant = 0 by independent joints.

    Returns:
        Coefficients by joint, the constant, and the size of the terms that it is a sum of.
    """
    row: dict[str, float] = {}
    constant = -constraint.coefficients[0]
    size, sizes = abs(constant), dict[str, float]()
    for number, factor in joints.items():
        joint = joint_of(world, number)
        law = independent.get(joint.name, Coupling(joint.name, {joint.name: 1.0}, 0.0))
        constant += factor * (law.offset - joint.q0)
        size += abs(factor) * (abs(law.offset) + abs(joint.q0))
        for name, ratio in law.ratios.items():
            row[name] = row.get(name, 0.0) + factor * ratio
            sizes[name] = sizes.get(name, 0.0) + abs(factor * ratio)
    row = {name: c for name, c in row.items() if abs(c) > _ROUND_OFF * sizes[name]}
    return row, constant, size


def constraints_of(
    tree: Tree,
) -> tuple[tuple[Coupling, ...], tuple[str, ...], tuple[LoopConstraint, ...]]:
    """Return the active constraints of a robot, and add the frames of loops to its model.

    Returns:
        Couplings of followers in proportion to their leaders; names of constraints that tie the
        robot to other bodies, or act on tendons or flexible bodies; and constraints that close
        kinematic loops, and polynomials of joints.
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
    return (*couplings, *_tendon_couplings(tree)), tuple(outside), tuple(loops)


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
    laws, _ = tendon_laws(world, proportional_couplings(world))
    free = [coupling for coupling in laws if coupling.follower not in values]
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
    _, constant = tendon_laws(world, proportional_couplings(world))
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
    couplings += tendon_laws(world, couplings)[0]
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
