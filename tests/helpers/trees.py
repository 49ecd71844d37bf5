"""Random multibody trees: any group, branched, with all kinds of shape joints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from pinred.common.arrays import Array
from pinred.lie import GROUPS

Rng = np.random.Generator


def unit(rng: Rng) -> Array:
    """Return a random direction, (3,)."""
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def placement(rng: Rng) -> pin.SE3:
    """Return a random rigid transform."""
    return pin.SE3(pin.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-0.5, 0.5, 3))


def inertia(rng: Rng) -> pin.Inertia:
    """Return a random physical inertia: that of four point masses plus a small isotropic term."""
    points = rng.uniform(-0.3, 0.3, (4, 3))
    masses = rng.uniform(0.2, 1.0, 4)
    com = masses @ points / masses.sum()
    arms = points - com
    moment = sum(
        m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(masses, arms, strict=True)
    )
    return pin.Inertia(float(masses.sum()), com, moment + 1e-3 * np.eye(3))


def continuous(rng: Rng) -> pin.JointModel:
    """Return a continuous joint about a random axis.

    Pinocchio's Python interface cannot construct this joint, so it is read from a URDF.
    """
    x, y, z = unit(rng)
    return pin.buildModelFromXML(
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia '
        'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j" type="continuous"><parent link="a"/><child link="b"/>'
        f'<axis xyz="{x:.17g} {y:.17g} {z:.17g}"/></joint></robot>'
    ).joints[1]


def climbing_joint() -> pin.JointModel:
    """Return a prismatic joint along z followed by a planar joint, as one joint."""
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


def random_model(
    group: str, joints: int, seed: int, *, armature: bool = True, balls: float = 0.0
) -> pin.Model:
    """Return a branched tree with `joints` shape joints on a root of `group`, without gravity.

    Args:
        group: Name of the symmetry group.
        joints: Number of shape joints.
        seed: Seed of the tree.
        armature: Whether the joints have armature; only without balls.
        balls: Share of balls among the joints.
    """
    assert group in GROUPS
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"tree-{group}-{joints}-{seed}"
    model.gravity.setZero()
    for k in range(joints + 1):
        joint_types = JOINTS if k else ROOTS[group]
        joint_type = joint_types[rng.integers(len(joint_types))](rng)
        if k and balls and rng.random() < balls:
            joint_type = pin.JointModelSpherical()
        # Branch only off the path to the newest joint, because Pinocchio needs depth-first order.
        path = list(model.supports[k])[1:] if k else [0]
        parent = int(path[rng.integers(len(path))])
        i = model.addJoint(parent, joint_type, placement(rng), f"joint{k}")
        model.appendBodyToJoint(i, inertia(rng), pin.SE3.Identity())
    if armature:
        values = np.zeros(model.nv)
        values[model.joints[1].nv :] = rng.uniform(0.0, 0.1, joints)
        model.armature = values
    return model


def limbed_model(group: str, limbs: int, joints: int, seed: int) -> pin.Model:
    """Return a tree with identical branches on the root or on a trunk joint.

    The branches have the same random topology. Their constants agree, differ or vanish at random,
    so that every combination of common and different constants occurs.

    Args:
        group: Name of the symmetry group.
        limbs: Number of branches.
        joints: Number of joints per branch.
        seed: Seed of the tree.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"limbs-{group}-{limbs}-{joints}-{seed}"
    model.gravity.setZero()
    joint_types = [JOINTS[k] for k in rng.integers(len(JOINTS), size=joints)]
    path, parents = [0], [0]
    for k in range(1, joints):
        parents.append(path[rng.integers(len(path))])
        path = [*path[: path.index(parents[k]) + 1], k]
    common = [(placement(rng), inertia(rng)) for _ in range(joints)]
    root = model.addJoint(0, ROOTS[group][0](rng), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, inertia(rng), pin.SE3.Identity())
    trunk = model.addJoint(root, pin.JointModelRX(), placement(rng), "trunk")
    model.appendBodyToJoint(trunk, inertia(rng), pin.SE3.Identity())
    base_joint = trunk if rng.random() < 0.5 else root
    for limb in range(limbs):
        joint_ids: list[int] = []
        for k in range(joints):
            place, body = common[k] if rng.random() < 0.5 else (placement(rng), inertia(rng))
            if rng.random() < 0.3:
                place = pin.SE3.Identity()
            parent = joint_ids[parents[k]] if k else base_joint
            joint_ids.append(model.addJoint(parent, joint_types[k](rng), place, f"limb{limb}.{k}"))
            model.appendBodyToJoint(joint_ids[-1], body, pin.SE3.Identity())
    values = np.zeros(model.nv)
    values[model.joints[1].nv :] = rng.choice([0.0, 0.05], model.nv - model.joints[1].nv)
    model.armature = values
    return model


def unequal_limbs_model(group: str, limbs: int, joints: int, seed: int) -> pin.Model:
    """Return a trunk of three bodies with limbs of different lengths on any of them.

    Joints at one depth are of the same type, with exceptions. Some limbs fork.

    Args:
        group: Name of the symmetry group.
        limbs: Number of limbs.
        joints: Largest number of joints per limb.
        seed: Seed of the tree.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"unequal-{group}-{limbs}-{joints}-{seed}"
    model.gravity.setZero()
    types = [JOINTS[k] for k in rng.integers(len(JOINTS), size=joints)]

    def add(parent: int, joint: pin.JointModel, name: str) -> int:
        place = pin.SE3.Identity() if rng.random() < 0.2 else placement(rng)
        i: int = model.addJoint(parent, joint, place, name)
        model.appendBodyToJoint(i, inertia(rng), pin.SE3.Identity())
        return i

    trunk = [model.addJoint(0, ROOTS[group][0](rng), pin.SE3.Identity(), "root")]
    model.appendBodyToJoint(trunk[0], inertia(rng), pin.SE3.Identity())
    for k in range(2):
        trunk.append(add(trunk[-1], pin.JointModelRX(), f"trunk{k}"))
    for limb in range(limbs):
        above = trunk[int(rng.integers(3))]
        for k in range(int(rng.integers(1, joints + 1))):
            kind = types[k] if rng.random() < 0.9 else JOINTS[int(rng.integers(len(JOINTS)))]
            tip = add(above, kind(rng), f"limb{limb}.{k}")
            if rng.random() < 0.15:
                add(above, kind(rng), f"fork{limb}.{k}")
            above = tip
    values = np.zeros(model.nv)
    values[model.joints[1].nv :] = rng.choice([0.0, 0.05], model.nv - model.joints[1].nv)
    model.armature = values
    return model


def varied(value: Array, rng: Rng, *, may_vanish: bool = True) -> Array:
    """Return numbers that are kept, negated, replaced or set to zero, independently per entry.

    A replacement is at most as large as the original number.
    """
    choices = rng.integers(4 if may_vanish else 3, size=value.shape)
    replacement = value * rng.uniform(-1.0, 1.0, value.shape)
    return np.asarray(
        np.choose(choices, [value, -value, replacement, np.zeros_like(value)][: choices.max() + 1])
    )


def mirrored_model(group: str, limbs: int, joints: int, seed: int) -> pin.Model:
    """Return identical branches whose constants agree, differ, vanish or differ by sign.

    Real robots have such branches: a left knee rotates in the opposite direction, or about an axis
    that is rotated by half a turn.

    Args:
        group: Name of the symmetry group.
        limbs: Number of branches.
        joints: Number of joints per branch.
        seed: Seed of the tree.
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


def shuffled(model: pin.Model, seed: int) -> pin.Model:
    """Return the same tree with its joints in a random order, parents before children."""
    rng = np.random.default_rng(seed)
    other = pin.Model()
    other.name, other.gravity = model.name, model.gravity
    place, waiting = {0: 0}, list(range(1, model.njoints))
    while waiting:
        i = int(rng.choice([k for k in waiting if model.parents[k] in place]))
        waiting.remove(i)
        at, joint = model.jointPlacements[i], model.joints[i]
        place[i] = other.addJoint(place[model.parents[i]], joint, at, model.names[i])
        other.appendBodyToJoint(place[i], model.inertias[i], pin.SE3.Identity())
    for i, k in place.items():
        old, new = model.joints[i], other.joints[k]
        for name in ("lowerPositionLimit", "upperPositionLimit") if i else ():
            values = getattr(model, name)[old.idx_q : old.idx_q + old.nq]
            getattr(other, name)[new.idx_q : new.idx_q + new.nq] = values
        for name in ("armature", "damping") if i else ():
            values = getattr(model, name)[old.idx_v : old.idx_v + old.nv]
            getattr(other, name)[new.idx_v : new.idx_v + new.nv] = values
    for frame in list(model.frames)[1:]:
        parent = place[frame.parentJoint]
        other.addFrame(pin.Frame(frame.name, parent, 0, frame.placement, frame.type), False)
    return other


def model_in_random_order(group: str, seed: int) -> pin.Model:
    """Return a random tree with hinges, slides, balls and rotors, in a random joint order.

    The rotors are symmetric about their hinges, so they are cyclic joints.
    """
    rng = np.random.default_rng(seed)
    model = random_model(group, int(rng.integers(2, 6)), seed)
    rotors = np.array(model.armature)
    for k in range(int(rng.integers(2, 5))):
        is_rotor = rng.random() < 0.5
        joint = pin.JointModelRZ() if is_rotor else pin.JointModelSpherical()
        parent = int(rng.integers(1, model.njoints))
        i = model.addJoint(parent, joint, placement(rng), f"{'rotor' if is_rotor else 'ball'}{k}")
        body = inertia(rng)
        if is_rotor:
            body = pin.Inertia(body.mass, np.array([0.0, 0.0, 0.1]), np.diag([0.2, 0.2, 0.3]))
        model.appendBodyToJoint(i, body, pin.SE3.Identity())
        rotors = np.append(rotors, np.full(joint.nv, rng.uniform(0.0, 0.1)))
    model.armature = rotors
    return shuffled(model, seed)
