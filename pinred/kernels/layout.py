"""The structure of a kernel, and the places of things in its state, parameters and outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, starmap

from ..common.arrays import Array
from ..forces.force_model import ForceModel
from ..reduction.base_parts import BaseParts, base_parts
from ..reduction.tree.free_bodies import NOTHING, Freed
from ..system.state_fields import FIELDS, axis_lengths
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
    """Slices of the outputs of a kernel.

    Attributes:
        xi: Body twist relative to the centre of mass, (r,).
        xdot: Shape rate, (m,).
        com: Centre of mass in the frame of the root body, (3,).
        mu: Body momentum about the centre of mass, (r,).
        weight: Gravity force that turns a pivoted base, in its frame, (3,) or empty.
        driven_x: Positions of the prescribed joints, (k,).
        driven_pi: Canonical momenta of the prescribed joints, (k,).
        fields: The fields of State, or of ShapeState without the base, except the time.
        size: Number of outputs.
    """

    xi: slice
    xdot: slice
    com: slice
    mu: slice
    weight: slice
    driven_x: slice
    driven_pi: slice
    fields: Mapping[str, slice]
    size: int

    def read_field(self, name: str, outputs: Array, system: System) -> Array:
        """Return a field of a state, with joints in the order of the robot's own model.

        Args:
            name: Name of the field, not "t".
            outputs: Outputs of the kernel, (…, size).
            system: The system of the kernel.

        Returns:
            (…,) or (…, length of the field's axis).
        """
        values = outputs[..., self.fields[name]]
        match FIELDS[name].axis:
            case "nq":
                return system.given_q(values)
            case "nv":
                return system.given_v(values)
            case None:
                return values[..., 0]
            case _:
                return values


def separate_fields(*, base: bool) -> list[str]:
    """Return the fields of State that have entries of their own among the outputs, in order.

    The shape rate is an output in any case, and the body twist is the first part of v.
    """
    shared = ("t", "xdot", "xi")
    return [f.name for f in FIELDS.values() if f.name not in shared and (base or not f.needs_base)]


def outputs_of(system: System, layout: Layout) -> Outputs:
    """Return the slices of the outputs of a kernel."""
    m, r, k = system.m, system.r, len(layout.prescribed)
    names, lengths = separate_fields(base=layout.wanted), axis_lengths(system)
    relative = [r, m, 3, r, 3 * layout.heavy, k, k]
    ends = list(accumulate([*relative, *(lengths[FIELDS[name].axis] for name in names)], initial=0))
    xi, xdot, com, mu, weight, driven_x, driven_pi, *slices = starmap(slice, pairwise(ends))
    fields = {**dict(zip(names, slices, strict=True)), "xdot": xdot}
    if layout.wanted:
        fields["xi"] = slice(fields["v"].start, fields["v"].start + r)
    return Outputs(xi, xdot, com, mu, weight, driven_x, driven_pi, fields, ends[-1])


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
