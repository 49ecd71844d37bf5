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
from ..reduction.potential import acting_gravity, pivot_weight
from ..scene.scene import Scene
from ..system.body_parameters import Bodies
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
class Acting:
    """What a system and the forces on it say of every scene with both; arrays are read-only.

    forces: all that acts besides gravity, and the prescribed joints; None if there is nothing.
    weight: (3,) m g in the root joint's fixed frame where it turns a pivoted base, else zero
    [N].  gravity: (3,) what of it acts on the shape or turns the base, in that frame [m/s²].
    momentum_changes: whether something acts on the angular momentum of the base.
    cyclic, driven, free: indices of the joints whose momentum is constant, of those that are
    prescribed, and of all others than these last.
    """

    system: System
    forces: ForceModel | None
    weight: Array
    gravity: Array
    momentum_changes: bool
    cyclic: tuple[int, ...]
    driven: tuple[int, ...]
    free: tuple[int, ...]

    @property
    def wrench(self) -> bool:
        """Whether a force acts on the base itself."""
        return self.forces is not None and self.forces.has_wrench

    @property
    def turned(self) -> bool:
        """Whether gravity turns a pivoted base."""
        return bool(self.weight.any())

    def kind(
        self, *, zero_momentum: bool, base: bool, symplectic: bool, free: tuple[int, ...] = ()
    ) -> Kind:
        """Return the terms there are, made once.

        zero_momentum: whether the angular momentum is exactly zero.  base: whether somebody asks
        for the base.  symplectic: whether the integrator is.  free: bodies whose inertias vary.
        """
        zero = zero_momentum and not self.momentum_changes
        # A constant angular momentum that turns in the body is a quaternion to symplectic methods.
        constant = self.system.group.turns == 3 and not (zero or self.momentum_changes)
        lifted = symplectic and constant
        key = (zero, base, lifted, free)
        return once(self, key, lambda: self._kind(*key))

    def _kind(self, zero: bool, base: bool, lifted: bool, free: tuple[int, ...]) -> Kind:
        axes = tuple(np.flatnonzero(self.gravity).tolist())
        structure = Structure(
            zero_momentum=zero,
            cyclic=self.cyclic,
            gravity=axes,
            base=base,
            lifted=lifted,
            free=free,
        )
        return Kind(self.system, self.forces, structure)


@dataclass(frozen=True, eq=False)
class Plan:
    """All that follows from a scene before it is integrated; arrays are read-only.

    acting: what it shares with other scenes.  stops: (S,) times at which integration stops, the
    end last [s].  numbers: (p,) those in the forces at the start.
    """

    scene: Scene
    acting: Acting
    stops: Array
    numbers: Array

    @property
    def system(self) -> System:
        """The system of the scene."""
        return self.scene.system

    @property
    def forces(self) -> ForceModel | None:
        """All that acts besides gravity, and the prescribed joints; None if there is nothing."""
        return self.acting.forces

    @property
    def wanted(self) -> bool:
        """Whether somebody asks for the base."""
        return self.scene.outputs == "all"

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
        return self.acting.kind(
            zero_momentum=zero_momentum,
            base=self.wanted,
            symplectic=self.method.symplectic,
            free=self.scene.free_bodies,
        )


def plan_of(scene: Scene) -> Plan:
    """Return the plan of a scene, made once.

    Raises SymmetryError if gravity breaks the symmetry.
    """
    return once(scene, Plan, lambda: _plan(scene))


def _plan(scene: Scene) -> Plan:
    system, forces = scene.system, scene.force_model
    # A force model belongs to one system.
    bodies = scene.varied_bodies
    key = (Acting, *(bodies.parameters if bodies is not None else ()))
    owner = system if forces is None else forces
    acting = once(owner, key, lambda: _acting(system, forces, bodies))
    numbers = _NONE if forces is None else read_only(forces.numbers_from(0.0, scene.end))
    return Plan(scene, acting, read_only(stops_of(scene)), numbers)


def _acting(system: System, forces: ForceModel | None, bodies: Bodies | None) -> Acting:
    weight = pivot_weight(system)
    driven = forces.joints if forces is not None else ()
    pushed = forces is not None and forces.has_wrench
    cyclic = cyclic_of(system, touched_by(forces), pushed=pushed)
    if bodies is not None:  # a joint that another value would not leave cyclic is none
        other = bodies.system(bodies.perturbed(np.random.default_rng(0)))
        always = cyclic_of(other, touched_by(forces), pushed=pushed)
        cyclic = tuple(k for k in cyclic if k in always)
    return Acting(
        system=system,
        forces=forces,
        weight=weight,
        gravity=acting_gravity(system),
        momentum_changes=bool(weight.any()) or pushed,
        cyclic=cyclic,
        driven=driven,
        free=tuple(k for k in range(system.m) if k not in driven),
    )
