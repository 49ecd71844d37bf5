"""The structure of a kernel, and the places of things in its state, parameters and outputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

from ..forces.force_model import ForceModel
from ..reduction.base_parts import BaseParts, base_parts
from ..reduction.tree.free_bodies import NOTHING, Freed
from ..system.system import System


@dataclass(frozen=True)
class Structure:
    """The structure of a kernel: it decides, with the forces, which terms there are.

    zero_momentum: of the base.  cyclic: indices of the cyclic joints.  gravity: which axes of the
    root joint's fixed frame the part of it has that acts on the shape or turns a pivoted base.
    base: whether the base is asked for.  freed: bodies whose inertias, and whose steps from their
    parents, are parameters.  lifted: whether a quaternion of any length
    stands for the angular momentum, μ = q̄ J q, which grows as the square of that length.
    Under this map (Cayley and Klein's) of ℝ⁴ to so(3)* the canonical bracket becomes that of
    Lie and Poisson, so that a symplectic method for (x, π, q) is a Poisson map of (x, π, μ).
    """

    zero_momentum: bool = True
    cyclic: tuple[int, ...] = ()
    gravity: tuple[int, ...] = ()
    base: bool = True
    lifted: bool = False
    freed: Freed = NOTHING


@dataclass(frozen=True)
class Layout:
    """The places of things in y and in the parameters.

    active, cyclic, prescribed: indices of shape joints.  base: the parts of the base that
    are integrated, and its constants.  clock: 1 if the time is the last number of y, else 0.
    gravity: axes along which gravity is a parameter.  freed: bodies whose numbers are.  line: how
    many numbers say where the centre of mass begins, how fast, and how it falls, where forces see
    that.  numbers: how many numbers the forces have.
    """

    active: tuple[int, ...]
    cyclic: tuple[int, ...]
    prescribed: tuple[int, ...]
    base: BaseParts
    wanted: bool
    heavy: bool
    clock: int
    gravity: tuple[int, ...]
    freed: Freed
    line: int
    numbers: int

    @cached_property
    def base_at(self) -> int:
        """Index in y of the first number of the base."""
        return 2 * len(self.active) + len(self.cyclic)

    @cached_property
    def size(self) -> int:
        """Length of y."""
        return self.base_at + self.base.size + self.clock

    @cached_property
    def parameters(self) -> int:
        """Number of parameters."""
        return self.line_at + self.line + self.numbers

    @property
    def bodies_at(self) -> int:
        """Index in the parameters of the first number of a body."""
        return self.gravity_at + len(self.gravity)

    @property
    def gravity_at(self) -> int:
        """Index in the parameters of the first number of gravity."""
        return self.base.spin + len(self.cyclic)

    @property
    def line_at(self) -> int:
        """Index in the parameters of the first number of the centre of mass's path."""
        return self.bodies_at + self.freed.size

    @property
    def quaternion(self) -> int:
        """Index of the first of four quaternion entries in y, or −1."""
        return self.base_at if self.base.attitude == 4 else -1

    @property
    def canonical(self) -> tuple[int, int]:
        """Number of positions with momenta behind them, and of constant angular momenta."""
        return len(self.active), self.base.spin


@dataclass(frozen=True)
class Outputs:
    """The places of things in the outputs, as slices.

    xi, xdot, com, mu, weight, driven_x, driven_pi: as seen from the centre of mass; com in
    the root body's frame, (3,); the weight that turns a pivoted base, (3,) in its frame, or
    none; x and π of the prescribed joints.  The rest are fields of State, or of
    ShapeState, whose energy is the last.
    """

    xi: slice
    xdot: slice
    com: slice
    mu: slice
    weight: slice
    driven_x: slice
    driven_pi: slice
    x: slice
    pose: slice
    q: slice
    v: slice
    body_momentum: slice
    spatial_momentum: slice
    size: int


def outputs_of(system: System, layout: Layout) -> Outputs:
    """Return where things stand in the outputs of a kernel."""
    m, r, k = system.m, system.r, len(layout.prescribed)
    full = [system.group.size, system.model.nq, system.model.nv, r, r]
    sizes = [r, m, 3, r, 3 * layout.heavy, k, k, m, *(full if layout.wanted else [0] * len(full))]
    ends = [sum(sizes[:i]) for i in range(len(sizes) + 1)]
    places: list[Any] = [*(slice(a, b) for a, b in pairwise(ends)), ends[-1] + 1]
    return Outputs(*places)


def layout_of(system: System, structure: Structure, forces: ForceModel | None) -> Layout:
    """Return where things stand in y and in the parameters of a kernel of this structure."""
    prescribed = forces.joints if forces is not None else ()
    heavy = system.group.is_pivot and bool(structure.gravity)
    sees = forces is not None and (forces.sees_attitude or forces.sees_place)
    parts = base_parts(
        system.group,
        wanted=structure.base or structure.lifted or sees,
        heavy=heavy,
        wrench=forces is not None and forces.has_wrench,
        zero_momentum=structure.zero_momentum,
    )
    return Layout(
        active=tuple(k for k in range(system.m) if k not in {*structure.cyclic, *prescribed}),
        cyclic=structure.cyclic,
        prescribed=prescribed,
        base=parts,
        wanted=structure.base,
        heavy=heavy,
        clock=int(forces is not None and forces.needs_time),
        gravity=structure.gravity,
        freed=structure.freed,
        line=3 * system.group.linear if forces is not None and forces.sees_place else 0,
        numbers=len(forces.numbers) if forces is not None else 0,
    )
