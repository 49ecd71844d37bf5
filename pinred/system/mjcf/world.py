"""The robot among the bodies of a compiled MuJoCo model, and the names of its bodies.

A massless body that is fixed to the world and carries several moving bodies is part of the world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from ...common.errors import ChoiceError, InputError, LoadError
from ...common.names import quoted
from ..robot_file_contents import shortened
from .compile import mujoco_package

_KINDS = ("free", "ball", "slide", "hinge")  # names of MuJoCo's mjtJoint
# Disable flags of MuJoCo that mjDSBL_CONSTRAINT implies.
_OF_CONSTRAINTS = ("EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT")


@dataclass(frozen=True)
class World:
    """A compiled model, and the body attached to the world that carries the robot.

    Attributes:
        model: The MjModel.
        top: Id of the body that carries the robot.
        bodies: Ids of that body and of its descendants, depth first.
        others: Names of other bodies attached to the world that can move.
        body_names: Unique names of all bodies by id; unnamed bodies get a generated name.
        joint_names: Unique names of all joints by id; unnamed joints get a generated name.
    """

    model: Any
    top: int
    bodies: tuple[int, ...]
    others: tuple[str, ...]
    body_names: tuple[str, ...]
    joint_names: tuple[str, ...]

    def joints(self, body: int) -> range:
        """Return the ids of a body's joints, in order."""
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    @property
    def all_joints(self) -> list[int]:
        """Ids of all joints of the robot."""
        return [joint for body in self.bodies for joint in self.joints(body)]

    def kind(self, joint: int) -> str:
        """Return the kind of a joint: "free", "ball", "slide" or "hinge"."""
        return _KINDS[self.model.jnt_type[joint]]

    def disabled(self, what: str) -> bool:
        """Return whether a flag of the file disables a kind of force.

        Args:
            what: Name of the flag in mujoco.mjtDisableBit, such as "LIMIT".
        """
        bits, flags = mujoco_package().mjtDisableBit, int(self.model.opt.disableflags)
        mask = int(getattr(bits, f"mjDSBL_{what}"))
        if what in _OF_CONSTRAINTS:
            mask |= int(bits.mjDSBL_CONSTRAINT)
        return bool(flags & mask)

    @property
    def no_passive_forces(self) -> bool:
        """Whether springs and dampers are disabled, which disables all passive forces."""
        return self.disabled("SPRING") and self.disabled("DAMPER")

    def name(self, kind: str, number: int) -> str:
        """Return the name of an element in the file, or its kind and number.

        Args:
            kind: Kind as in mujoco.mjtObj, such as "ACTUATOR".
            number: Id of the element.
        """
        return name_of(self.model, kind, number) or f"{kind.lower()} {number}"


def name_of(model: Any, kind: str, number: int) -> str:
    """Return the name of an element in the file, or "".

    Args:
        model: The MjModel.
        kind: Kind as in mujoco.mjtObj, such as "ACTUATOR".
        number: Id of the element.
    """
    mj = mujoco_package()
    name: str | None = mj.mj_id2name(model, getattr(mj.mjtObj, f"mjOBJ_{kind}"), number)
    return name or ""


def robot_in(model: Any, root: str | None = None, what: str = "the model") -> World:
    """Return the robot in a model: the body attached to the world that can move, with its tree.

    Args:
        model: The MjModel.
        root: Name of that body, if several bodies can move.
        what: Source of the model, for messages.
    Returns:
        The robot.
    Raises:
        LoadError: No body has a joint or a mass.
        ChoiceError: Several bodies can move and root is None; the message lists them.
        InputError: The root is not one of the bodies; the message lists them.
    """
    children = _children(model)
    body_names = _names(model, "BODY", model.nbody, lambda i: f"body{i}")
    joint_names = _names(model, "JOINT", model.njnt, lambda i: _joint_name(model, body_names, i))
    trees = {body: tuple(_below(children, body)) for body in _in_the_world(model, children)}
    moving = [body for body, tree in trees.items() if _moves(model, tree)]
    # Without joints, a body with mass is a rigid body that can float.
    heavy = [body for body, tree in trees.items() if sum(model.body_mass[i] for i in tree) > 0]
    candidates = moving or heavy
    names = tuple(body_names[body] for body in candidates)
    if root is None:
        if not candidates:
            raise LoadError(f"no body in {what} has a joint or a mass")
        if len(candidates) > 1:
            joints = {body: sum(model.body_jntnum[i] for i in trees[body]) for body in candidates}
            largest = sorted(candidates, key=lambda body: -joints[body])
            raise ChoiceError(
                f"several bodies in the world can move: {shortened(names, 20)}; "
                "choose the one that carries the robot with root=",
                "root",
                tuple(body_names[body] for body in largest),
            )
        top = candidates[0]
    else:
        # The user can also choose a body that is part of the world; its whole tree then floats.
        trees = {body: tuple(_below(children, body)) for body in children[0]} | trees
        at_top = {body_names[body]: body for body in trees}
        if root not in at_top:
            raise InputError(
                f"root: no body {quoted(root)} in the world; the bodies are {shortened(names, 20)}"
            )
        top = at_top[root]
    other_bodies = tuple(body_names[body] for body in moving if body not in trees[top])
    return World(model, top, trees[top], other_bodies, body_names, joint_names)


def _children(model: Any) -> list[list[int]]:
    children: list[list[int]] = [[] for _ in range(model.nbody)]
    for body in range(1, model.nbody):
        children[model.body_parentid[body]].append(body)
    return children


def _in_the_world(model: Any, children: list[list[int]]) -> list[int]:
    """Return the bodies that are attached to the world, or to a body that is part of it."""

    def under(body: int) -> list[int]:
        if model.body_jntnum[body] or model.body_mass[body] > 0.0:
            return [body]
        inner = [top for child in children[body] for top in under(child)]
        several = sum(_moves(model, _below(children, top)) for top in inner) > 1
        return inner if several else [body]

    return [top for body in children[0] for top in under(body)]


def _moves(model: Any, bodies: Iterable[int]) -> bool:
    return any(model.body_jntnum[body] for body in bodies)


def _below(children: list[list[int]], body: int) -> Iterator[int]:
    """Yield a body and its descendants, depth first, which is Pinocchio's order."""
    stack = [body]
    while stack:
        top = stack.pop()
        yield top
        stack.extend(reversed(children[top]))


def _joint_name(model: Any, body_names: tuple[str, ...], joint: int) -> str:
    """Return a name for an unnamed joint: its body and kind, numbered from the second joint on."""
    body = int(model.jnt_bodyid[joint])
    number = joint - int(model.body_jntadr[body]) + 1
    name = f"{body_names[body]}_{_KINDS[model.jnt_type[joint]]}"
    return name if number == 1 else f"{name}{number}"


def _names(model: Any, kind: str, count: int, name_for: Callable[[int], str]) -> tuple[str, ...]:
    """Return unique names of bodies or joints; generated names avoid those in the file."""
    file_names = [name_of(model, kind, i) for i in range(count)]
    used = {*file_names, "universe"}  # Pinocchio calls the world "universe".
    names = []
    for i, file_name in enumerate(file_names):
        name = file_name
        if not name or name == "universe":
            name = name or name_for(i)
            while name in used:
                name += "_"
            used.add(name)
        names.append(name)
    return tuple(names)
