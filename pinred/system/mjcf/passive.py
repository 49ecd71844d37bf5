"""Springs, dampers and dry friction at the joints of a MuJoCo model.

MuJoCo's force at a hinge or slide, y from its springref and at rate v, is
−(k₁ y + k₂ y² + k₃ y³) − v (d₁ + d₂ |v| + d₃ v²), and dry friction of at most `frictionloss`.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..force import Force
from ..passive import BASE, Damper, Friction, Spring
from .tree import Tree

PLASTIC = "plastic springs"


def passive_forces(tree: Tree) -> tuple[Force, ...]:
    """Return the springs, dampers and dry friction of the shape, joint by joint."""
    return tuple(force for joint in _of_shape(tree) for force in _at(tree, joint))


def passive_left_out(tree: Tree) -> dict[str, list[str]]:
    """Return the joints at which something of the kind acts that is no force of the shape.

    At the base it would not leave the momentum as it is, nor speak of the shape alone; a plastic
    spring remembers how far it was bent.
    """
    world, shape = tree.world, _of_shape(tree)
    base = [joint for joint in tree.free_joints if joint not in shape]
    return {
        BASE: [world.joint_names[joint] for joint in base if _acts(tree, joint)],
        PLASTIC: [world.joint_names[joint] for joint in shape if _plastic(tree, joint)],
    }


def _of_shape(tree: Tree) -> list[int]:
    ids = {name: joint for joint, name in enumerate(tree.world.joint_names)}
    return [ids[joint.name] for joint in tree.shape]


def _at(tree: Tree, joint: int) -> Iterator[Force]:
    world, model = tree.world, tree.world.model
    name, v = world.joint_names[joint], int(model.jnt_dofadr[joint])
    k, higher = float(model.jnt_stiffness[joint]), _without_zeros(model.jnt_stiffnesspoly[joint])
    if (k or higher) and not world.disabled("SPRING") and not _plastic(tree, joint):
        rest = float(model.qpos_spring[model.jnt_qposadr[joint]])
        yield Spring(name, k, rest, polynomial=higher)
    d, higher = float(model.dof_damping[v]), _without_zeros(model.dof_dampingpoly[v])
    if (d or higher) and not world.disabled("DAMPER"):
        yield Damper(name, d, polynomial=higher)
    most = float(model.dof_frictionloss[v])
    if most > 0.0 and not world.disabled("FRICTIONLOSS"):
        yield Friction(name, most)


def _plastic(tree: Tree, joint: int) -> bool:
    world, model = tree.world, tree.world.model
    stiff = model.jnt_stiffness[joint] or model.jnt_stiffnesspoly[joint].any()
    return bool(stiff and model.jnt_springyield[joint]) and not world.disabled("SPRING")


def _acts(tree: Tree, joint: int) -> bool:
    """Return whether any spring, damper or friction acts at a joint."""
    world, model = tree.world, tree.world.model
    v = int(model.jnt_dofadr[joint])
    acting = {
        "SPRING": (model.jnt_stiffness[joint], *model.jnt_stiffnesspoly[joint]),
        "DAMPER": (model.dof_damping[v], *model.dof_dampingpoly[v]),
        "FRICTIONLOSS": (model.dof_frictionloss[v],),
    }
    return any(any(numbers) and not world.disabled(what) for what, numbers in acting.items())


def _without_zeros(coefficients: Iterator[float]) -> tuple[float, ...]:
    """Return coefficients without zeros at their end."""
    found = [float(value) for value in coefficients]
    while found and found[-1] == 0.0:
        found.pop()
    return tuple(found)
