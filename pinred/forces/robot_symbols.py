"""The robot as expressions of forces see it: numbers of it that may vary are symbols there.

A wrench on a link needs the way to it, inverse dynamics all inertias, the weight besides.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from ..common.arrays import Array, read_only
from ..reduction.potential import acting_gravity
from ..reduction.tree.body_frames import Body, bodies_of
from ..reduction.tree.free_bodies import (
    LINK,
    NOTHING,
    Freed,
    free_numbers,
    link_numbers,
    of_bodies,
    total_mass,
    with_free,
)
from ..reduction.tree.scalars import Scalar, Vec
from ..system.system import System


class RobotSymbols:
    """The robot with symbols for numbers that may vary, among them always gravity.

    freed: what is a symbol, with the links that were asked for so far.  weighed: whether gravity
    was.
    """

    def __init__(
        self, system: System, freed: Freed = NOTHING, movable: Collection[int] = ()
    ) -> None:
        """Take the bodies that may vary.  movable: frames of links whose places on these may."""
        self._system, self.freed, self._movable = system, freed, movable
        self._symbols = [ca.SX.sym(f"Y{k}") for k in range(freed.size)]
        self._gravity = [ca.SX.sym(f"g{axis}") for axis in "xyz"]
        self.weighed = False

    @cached_property
    def bodies(self) -> list[Body]:
        """The bodies, in the frames of the sweep."""
        return with_free(bodies_of(self._system), replace(self.freed, links=()), self._symbols)

    @property
    def gravity(self) -> Vec:
        """Gravity that acts on the shape, (3,) in the root joint's fixed frame [m/s²]."""
        self.weighed = True
        return list(self._gravity)

    @property
    def mass(self) -> Scalar:
        """The mass of all bodies [kg]."""
        return total_mass(self.bodies) if self.freed.inertias else self._system.mass

    def place(self, frame: int) -> tuple[list[Vec], Vec]:
        """Return the axes of a link in its body's frame, row by row, and its origin."""
        found = self._system.model.frames[frame]
        numbers: list[Scalar]
        if frame not in self._movable:
            body = self.bodies[found.parentJoint - 1]
            numbers = link_numbers(body, found.placement).tolist()
        else:
            if frame not in self.freed.links:
                self.freed = replace(self.freed, links=(*self.freed.links, frame))
                self._symbols += [ca.SX.sym(f"link{frame}_{k}") for k in range(LINK)]
            numbers = self._symbols[self.freed.of_link(frame)]
        return [numbers[3 * k : 3 * k + 3] for k in range(3)], numbers[9:]

    @property
    def column(self) -> ca.SX:
        """All symbols, (freed.size + 3,): of `freed`, then gravity."""
        return ca.vertcat(*self._symbols, *self._gravity)


def numbers_of(system: System, freed: Freed, *, weighed: bool) -> Array:
    """Return what a system has for the symbols; gravity is left out unless it counts.

    Raises SymmetryError if gravity counts and breaks the symmetry.
    """
    gravity = acting_gravity(system) if weighed else np.zeros(3)
    return read_only(np.concatenate([free_numbers(system, freed), gravity]))


def numbers_in(
    bodies: Sequence[Body], system: System, freed: Freed, links: Mapping[int, Sequence[Scalar]]
) -> list[Scalar]:
    """Return what other bodies have for the symbols of `freed`, be it numbers or symbols.

    links: of links that vary; the others' places are the system's.
    """
    out, frames = of_bodies(bodies, freed), system.model.frames
    for frame in freed.links:
        known = links.get(frame)
        if known is None:
            body = bodies[frames[frame].parentJoint - 1]
            known = link_numbers(body, frames[frame].placement).tolist()
        out += known
    return out
