"""The robot among the bodies of a compiled MuJoCo model, and the names of its bodies.

A body without mass that is fixed to the world, and carries several that move, is part of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from ...common.errors import ChoiceError, InputError, LoadError
from ...common.plain_names import quoted
from ..contents import shortened
from .package import mujoco_package

_KINDS = ("free", "ball", "slide", "hinge")  # MuJoCo's mjtJoint
_OF_CONSTRAINTS = ("EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT")


@dataclass(frozen=True)
class World:
    """A compiled model and one body of its world, which carries the robot.

    model: the MjModel.  top: the body's id.  bodies: ids of it and all that hangs on it,
    depth first.  others: names of other bodies in the world that can move.
    body_names, joint_names: by id, unique; those without a name in the file get one.
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

    def kind(self, joint: int) -> str:
        """Return what kind a joint is: free, ball, slide or hinge."""
        return _KINDS[self.model.jnt_type[joint]]

    def disabled(self, what: str) -> bool:
        """Return whether a flag of the file switches a kind of force off.

        what: as in mujoco.mjtDisableBit, such as "LIMIT".
        """
        bits, flags = mujoco_package().mjtDisableBit, int(self.model.opt.disableflags)
        off = int(getattr(bits, f"mjDSBL_{what}"))
        if what in _OF_CONSTRAINTS:
            off |= int(bits.mjDSBL_CONSTRAINT)
        return bool(flags & off)

    @property
    def no_passive_forces(self) -> bool:
        """Whether the flags of springs and dampers are off, and with them all passive forces."""
        return self.disabled("SPRING") and self.disabled("DAMPER")

    def name(self, kind: str, number: int) -> str:
        """Return what something is called in the file, or its number.

        kind: as in mujoco.mjtObj, such as "ACTUATOR".
        """
        return name_of(self.model, kind, number) or f"{kind.lower()} {number}"


def name_of(model: Any, kind: str, number: int) -> str:
    """Return the name of something in the file, or an empty text."""
    mj = mujoco_package()
    found: str | None = mj.mj_id2name(model, getattr(mj.mjtObj, f"mjOBJ_{kind}"), number)
    return found or ""


def robot_in(model: Any, root: str | None = None, what: str = "the model") -> World:
    """Return the robot in a model: what hangs on the one body of the world that can move.

    root: the name of that body, where there are several.  what: where the model comes from.
    Raises LoadError if there is none, ChoiceError if there are several and root is None,
    InputError for a root that is none of them; both list them.
    """
    children = _children(model)
    body_names = _names(model, "BODY", model.nbody, lambda i: f"body{i}")
    joint_names = _names(model, "JOINT", model.njnt, lambda i: _joint_name(model, body_names, i))
    trees = {body: tuple(_below(children, body)) for body in _in_the_world(model, children)}
    moving = [body for body, tree in trees.items() if _moves(model, tree)]
    # Where nothing moves, a body by itself is a rigid one that can be set free.
    heavy = [body for body, tree in trees.items() if sum(model.body_mass[i] for i in tree) > 0]
    candidates = moving or heavy
    names = tuple(body_names[body] for body in candidates)
    if root is None:
        if not candidates:
            raise LoadError(f"no body in {what} has a joint or a mass; there is nothing to move")
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
        # What is part of the world may be chosen too, and floats with all that hangs on it.
        trees = {body: tuple(_below(children, body)) for body in children[0]} | trees
        at_top = {body_names[body]: body for body in trees}
        if root not in at_top:
            raise InputError(
                f"root: no body {quoted(root)} in the world; the bodies are {shortened(names, 20)}"
            )
        top = at_top[root]
    others = tuple(body_names[body] for body in moving if body not in trees[top])
    return World(model, top, trees[top], others, body_names, joint_names)


def _children(model: Any) -> list[list[int]]:
    children: list[list[int]] = [[] for _ in range(model.nbody)]
    for body in range(1, model.nbody):
        children[model.body_parentid[body]].append(body)
    return children


def _in_the_world(model: Any, children: list[list[int]]) -> list[int]:
    """Return the bodies that hang on the world, or on what is part of it."""

    def under(body: int) -> list[int]:
        if model.body_jntnum[body] or model.body_mass[body] > 0.0:
            return [body]
        inner = [each for child in children[body] for each in under(child)]
        several = sum(_moves(model, _below(children, each)) for each in inner) > 1
        return inner if several else [body]

    return [each for body in children[0] for each in under(body)]


def _moves(model: Any, bodies: Iterable[int]) -> bool:
    return any(model.body_jntnum[body] for body in bodies)


def _below(children: list[list[int]], body: int) -> Iterator[int]:
    """Yield a body and all that hangs on it, depth first: the order that Pinocchio needs."""
    stack = [body]
    while stack:
        at = stack.pop()
        yield at
        stack.extend(reversed(children[at]))


def _joint_name(model: Any, body_names: tuple[str, ...], joint: int) -> str:
    """Return a name for a joint that has none: of its body and kind, numbered from the second."""
    body = int(model.jnt_bodyid[joint])
    number = joint - int(model.body_jntadr[body]) + 1
    name = f"{body_names[body]}_{_KINDS[model.jnt_type[joint]]}"
    return name if number == 1 else f"{name}{number}"


def _names(model: Any, kind: str, count: int, make: Any) -> tuple[str, ...]:
    """Return the names of bodies or joints; one that is made gives way to those in the file."""
    given = [name_of(model, kind, i) for i in range(count)]
    taken = {*given, "universe"}  # Pinocchio's name of the world
    out = []
    for i, name in enumerate(given):
        if not name or name == "universe":
            name = name or make(i)
            while name in taken:
                name += "_"
            taken.add(name)
        out.append(name)
    return tuple(out)
