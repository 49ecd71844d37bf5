"""The plan of a scene: everything that follows from it before anything is integrated.

It is made once, and everybody takes it: both routes, `simulate_many`, the balances, and what
is told of a scene.  The one thing it leaves open is whether the angular momentum of the base
is zero, which depends on the initial state: `kind` has both answers, for of many members some
may have momentum and others none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..common.arrays import Array, read_only
from ..common.memo import once
from ..forces.force_model import ForceModel, touched_by
from ..integrators.methods import Method
from ..kernels.layout import Layout, Structure, layout_of
from ..reduction.cyclic_joints import cyclic_of
from ..reduction.potential import pivot_weight, shape_gravity
from ..scene.scene import Scene
from ..system.system import System
from .choose_method import Choice, choose
from .stops import stops_of

_NONE = read_only(np.empty(0))


@dataclass(frozen=True, eq=False)
class Kind:
    """The terms of a plan with angular momentum of the base, or without any.

    structure: which terms there are.
    """

    system: System
    forces: ForceModel | None
    structure: Structure

    @cached_property
    def layout(self) -> Layout:
        """Numbers that are integrated, and where they stand; made when first looked at."""
        return layout_of(self.system, self.structure, self.forces)


@dataclass(frozen=True, eq=False)
class Plan:
    """All that follows from a scene before it is integrated; arrays are read-only.

    weight: (3,) m g in the root joint's fixed frame where it turns a pivoted base, else zero
    [N].  gravity: (3,) what of it acts on the shape or turns the base, in that frame [m/s²], or
    None.  momentum_changes: whether something acts on the angular momentum of the base.
    cyclic, driven, free: indices of the joints whose momentum is constant, of those that are
    prescribed, and of all others than these last.  stops: (S,) times at which integration
    stops, the end last [s].  numbers: (p,) those in the forces at the start.
    """

    scene: Scene
    weight: Array
    gravity: tuple[float, float, float] | None
    momentum_changes: bool
    cyclic: tuple[int, ...]
    driven: tuple[int, ...]
    free: tuple[int, ...]
    stops: Array
    numbers: Array

    @property
    def system(self) -> System:
        """The system of the scene."""
        return self.scene.system

    @property
    def forces(self) -> ForceModel | None:
        """All that acts besides gravity, and the prescribed joints; None if there is nothing."""
        return self.scene.force_model

    @property
    def wanted(self) -> bool:
        """Whether somebody asks for the base."""
        return self.scene.outputs == "all"

    @property
    def wrench(self) -> bool:
        """Whether a force acts on the base itself."""
        return self.forces is not None and self.forces.has_wrench

    @property
    def turned(self) -> bool:
        """Whether gravity turns a pivoted base."""
        return bool(self.weight.any())

    @cached_property
    def choice(self) -> Choice:
        """The integrator of the compiled route, and why it is this one."""
        return choose(self.scene, self.stops)

    @property
    def method(self) -> Method:
        """The integrator of the compiled route."""
        return self.choice.method

    def kind(self, *, zero_momentum: bool) -> Kind:
        """Return the terms there are if the angular momentum is exactly zero, or if it is not."""
        zero = zero_momentum and not self.momentum_changes
        return once(self, (Kind, zero), lambda: self._kind(zero))

    def _kind(self, zero: bool) -> Kind:
        # A constant angular momentum that turns in the body is a quaternion to symplectic methods.
        constant = self.system.group.turns == 3 and not (zero or self.momentum_changes)
        structure = Structure(
            zero_momentum=zero,
            cyclic=self.cyclic,
            gravity=self.gravity,
            base=self.wanted,
            lifted=self.method.symplectic and constant,
        )
        return Kind(self.system, self.forces, structure)


def plan_of(scene: Scene) -> Plan:
    """Return the plan of a scene, made once.

    Raises SymmetryError if gravity breaks the symmetry.
    """
    return once(scene, Plan, lambda: _plan(scene))


def _plan(scene: Scene) -> Plan:
    system, forces = scene.system, scene.force_model
    weight = pivot_weight(system)
    gravity = shape_gravity(system).direction
    if weight.any():
        x, y, z = (weight / system.mass).tolist()
        gravity = (x, y, z)
    driven = forces.joints if forces is not None else ()
    return Plan(
        scene=scene,
        weight=weight,
        gravity=gravity,
        momentum_changes=bool(weight.any()) or (forces is not None and forces.has_wrench),
        cyclic=cyclic_of(system, touched_by(forces)),
        driven=driven,
        free=tuple(k for k in range(system.m) if k not in driven),
        stops=read_only(stops_of(scene)),
        numbers=_NONE if forces is None else read_only(forces.numbers_from(0.0, scene.end)),
    )
