"""Random multibody trees: any group, branched, every kind of shape joint."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from pinred.common.arrays import Array
from pinred.lie import GROUPS

Rng = np.random.Generator


def unit(rng: Rng) -> Array:
    """A random direction, (3,)."""
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def placement(rng: Rng) -> pin.SE3:
    """A random rigid transform."""
    return pin.SE3(pin.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-0.5, 0.5, 3))


def inertia(rng: Rng) -> pin.Inertia:
    """A random physical inertia: that of a slightly blown-up cloud of four points."""
    points = rng.uniform(-0.3, 0.3, (4, 3))
    masses = rng.uniform(0.2, 1.0, 4)
    com = masses @ points / masses.sum()
    arms = points - com
    moment = sum(
        m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(masses, arms, strict=True)
    )
    return pin.Inertia(float(masses.sum()), com, moment + 1e-3 * np.eye(3))


def continuous(rng: Rng) -> pin.JointModel:
    """A slanted continuous joint; only Pinocchio's URDF reader can make one from Python."""
    x, y, z = unit(rng)
    return pin.buildModelFromXML(
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia '
        'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j" type="continuous"><parent link="a"/><child link="b"/>'
        f'<axis xyz="{x:.17g} {y:.17g} {z:.17g}"/></joint></robot>'
    ).joints[1]


def climbing_joint() -> pin.JointModel:
    """A slide along z and a plane across it, in one joint."""
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelPZ())
    joint.addJoint(pin.JointModelPlanar())
    return joint


ROOTS: dict[str, list[Callable[[Rng], pin.JointModel]]] = {
    "R": [lambda _: pin.JointModelPX(), lambda rng: pin.JointModelPrismaticUnaligned(unit(rng))],
    "SO2": [
        lambda _: pin.JointModelRZ(),
        lambda _: pin.JointModelRUBY(),
        lambda rng: pin.JointModelRevoluteUnaligned(unit(rng)),
    ],
    "SE2": [lambda _: pin.JointModelPlanar()],
    "SO3": [lambda _: pin.JointModelSpherical()],
    "SE3": [lambda _: pin.JointModelFreeFlyer()],
    "RxSE2": [lambda _: climbing_joint()],
}
JOINTS: list[Callable[[Rng], pin.JointModel]] = [
    lambda _: pin.JointModelRX(),
    lambda _: pin.JointModelRY(),
    lambda _: pin.JointModelRZ(),
    lambda _: pin.JointModelRUBX(),
    lambda _: pin.JointModelRUBZ(),
    lambda _: pin.JointModelPX(),
    lambda _: pin.JointModelPY(),
    lambda rng: pin.JointModelRevoluteUnaligned(unit(rng)),
    continuous,
    lambda rng: pin.JointModelPrismaticUnaligned(unit(rng)),
]


def random_model(group: str, joints: int, seed: int, *, armature: bool = True) -> pin.Model:
    """A branched tree with `joints` shape joints on a root of `group`, without gravity."""
    assert group in GROUPS
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"tree-{group}-{joints}-{seed}"
    model.gravity.setZero()
    for k in range(joints + 1):
        kinds = JOINTS if k else ROOTS[group]
        kind = kinds[rng.integers(len(kinds))](rng)
        # Branch off the path to the newest joint only: Pinocchio needs depth-first order.
        path = list(model.supports[k])[1:] if k else [0]
        parent = int(path[rng.integers(len(path))])
        i = model.addJoint(parent, kind, placement(rng), f"joint{k}")
        model.appendBodyToJoint(i, inertia(rng), pin.SE3.Identity())
    if armature:
        values = np.zeros(model.nv)
        values[model.joints[1].nv :] = rng.uniform(0.0, 0.1, joints)
        model.armature = values
    return model


def limbed_model(group: str, limbs: int, joints: int, seed: int) -> pin.Model:
    """A root with a trunk joint and `limbs` limbs of one build, on either of the two.

    Limbs branch at random, but alike.  Their constants differ, agree, or vanish, and the
    armature of some joints does, so that all that limbs may have in common occurs.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"limbs-{group}-{limbs}-{joints}-{seed}"
    model.gravity.setZero()
    kinds = [JOINTS[k] for k in rng.integers(len(JOINTS), size=joints)]
    path, parents = [0], [0]
    for k in range(1, joints):
        parents.append(path[rng.integers(len(path))])
        path = [*path[: path.index(parents[k]) + 1], k]
    same = [(placement(rng), inertia(rng)) for _ in range(joints)]
    root = model.addJoint(0, ROOTS[group][0](rng), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, inertia(rng), pin.SE3.Identity())
    trunk = model.addJoint(root, pin.JointModelRX(), placement(rng), "trunk")
    model.appendBodyToJoint(trunk, inertia(rng), pin.SE3.Identity())
    hangs_on = trunk if rng.random() < 0.5 else root
    for limb in range(limbs):
        made: list[int] = []
        for k in range(joints):
            where, body = same[k] if rng.random() < 0.5 else (placement(rng), inertia(rng))
            if rng.random() < 0.3:
                where = pin.SE3.Identity()
            parent = made[parents[k]] if k else hangs_on
            made.append(model.addJoint(parent, kinds[k](rng), where, f"limb{limb}.{k}"))
            model.appendBodyToJoint(made[-1], body, pin.SE3.Identity())
    values = np.zeros(model.nv)
    values[model.joints[1].nv :] = rng.choice([0.0, 0.05], model.nv - model.joints[1].nv)
    model.armature = values
    return model


def varied(value: Array, rng: Rng, *, may_vanish: bool = True) -> Array:
    """The same numbers, others, none, or the same with other signs: each entry by itself.

    Other numbers are as large as the old ones at most.
    """
    kinds = rng.integers(4 if may_vanish else 3, size=value.shape)
    other = value * rng.uniform(-1.0, 1.0, value.shape)
    return np.asarray(
        np.choose(kinds, [value, -value, other, np.zeros_like(value)][: kinds.max() + 1])
    )


def mirrored_model(group: str, limbs: int, joints: int, seed: int) -> pin.Model:
    """Limbs of one build whose constants agree, differ, vanish, or differ by sign, each by itself.

    So do the limbs of robots from elsewhere: a left knee turns the other way, or about an
    axis that is turned by half a turn.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"mirrored-{group}-{limbs}-{joints}-{seed}"
    model.gravity.setZero()
    root = model.addJoint(0, ROOTS[group][0](rng), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, inertia(rng), pin.SE3.Identity())
    axes = [rng.choice([*np.eye(3), unit(rng)]) for _ in range(joints)]
    slides = rng.random(joints) < 0.3
    angles = rng.choice([np.pi, np.pi / 2, 0.7], (joints, 3))
    shifts = rng.uniform(-0.5, 0.5, (joints, 3))
    levers = rng.uniform(-0.3, 0.3, (joints, 3))
    products = rng.uniform(-0.05, 0.05, (joints, 3))
    masses = rng.uniform(0.5, 2.0, joints)
    rotors = rng.uniform(0.01, 0.1, joints)
    values = [np.zeros(model.nv)]
    for limb in range(limbs):
        parent = root
        for k in range(joints):
            axis = axes[k] * rng.choice([-1.0, 1.0])
            kind = (
                pin.JointModelPrismaticUnaligned if slides[k] else pin.JointModelRevoluteUnaligned
            )
            turn = pin.rpy.rpyToMatrix(varied(angles[k], rng))
            place = pin.SE3(turn, varied(shifts[k], rng))
            parent = model.addJoint(parent, kind(axis), place, f"limb{limb}.{k}")
            xy, xz, yz = varied(products[k], rng)
            moments = np.array([[0.3, xy, xz], [xy, 0.4, yz], [xz, yz, 0.5]])
            mass = float(np.abs(varied(masses[k : k + 1], rng, may_vanish=False))[0]) + 0.1
            model.appendBodyToJoint(
                parent, pin.Inertia(mass, varied(levers[k], rng), moments), pin.SE3.Identity()
            )
            values.append(np.abs(varied(rotors[k : k + 1], rng)))
    model.armature = np.concatenate(values)
    return model
