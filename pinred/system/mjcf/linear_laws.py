"""Linear laws between joints that equality constraints of joints and fixed tendons define.

The length of a fixed tendon is Σ c q.  MuJoCo's constraint of two tendons is
L₁ − L₁⁰ = a₀ + a₁ (L₂ − L₂⁰), with the lengths L⁰ in the reference configuration (qpos0).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...common.errors import ModelError
from ..coupling import resolved
from ..robot_file_contents import Coupling
from .compile import mujoco_package
from .mujoco_joints import Joint, joint_of
from .world import World

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


@dataclass(frozen=True)
class TendonLaws:
    """The linear laws of fixed tendons.

    Attributes:
        couplings: Couplings, each with one joint as the follower.
        held: Values of joints that constraints fix, and names of these constraints, by joint.
    """

    couplings: list[Coupling]
    held: dict[str, tuple[float, str]]


def tendon_laws(world: World, couplings: Sequence[Coupling]) -> TendonLaws:
    """Solve the linear constraints of fixed tendons for one joint each.

    The follower is the joint with the largest coefficient, among equal ones the last joint.

    Args:
        world: The robot.
        couplings: Couplings of joint constraints.
    Returns:
        The laws.
    Raises:
        ModelError: Two constraints contradict each other.
    """
    names = [world.joint_names[joint] for joint in world.all_joints]
    laws = TendonLaws([], {})
    for constraint in active_constraints(world):
        if constraint.kind != "tendon" or not_linear(world, constraint):
            continue
        joints = joints_of(world, constraint)
        if not set(joints) <= set(world.all_joints):
            continue
        all_couplings = [*couplings, *laws.couplings]
        constants = [Coupling(name, {}, value) for name, (value, _) in laws.held.items()]
        independent = resolved([*all_couplings, *constants], names)
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
            laws.couplings.append(law)
        else:
            laws.held[follower] = (law.offset, constraint.name)
    return laws


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
