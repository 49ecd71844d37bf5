"""The compiled kernel, its structure, and the layout of its state, parameters and outputs."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, starmap

import numpy as np

from ..common.arrays import Array
from ..forces.force_model import ForceModel
from ..reduction.base_parts import BaseParts, base_parts
from ..reduction.tree.free_bodies import NOTHING, Freed, free_numbers
from ..system.state_fields import FIELDS, axis_lengths
from ..system.system import System
from .machine.native import NativeCode


@dataclass(frozen=True)
class Structure:
    """The structure of a kernel; together with the forces, it determines which terms exist.

    With `lifted`, a quaternion q of any norm represents the angular momentum: μ = q̄ J q for the
    constant angular momentum J in the fixed frame, so μ is quadratic in q.  Under this map of
    Cayley and Klein from ℝ⁴ to so(3)*, the canonical bracket becomes the Lie–Poisson bracket.
    A symplectic method for (x, π, q) is then a Poisson map of (x, π, μ).

    Attributes:
        zero_momentum: Whether the momentum of the base is exactly zero.
        cyclic: Indices of the cyclic joints.
        gravity: Indices of the axes of the root joint's fixed frame along which gravity acts on the
            shape or rotates a pivoted base.
        base: Whether the outputs contain the state of the base.
        lifted: Whether a quaternion of any norm represents the angular momentum.
        freed: Variable body parameters: inertias, joint placements and link placements.
    """

    zero_momentum: bool = True
    cyclic: tuple[int, ...] = ()
    gravity: tuple[int, ...] = ()
    base: bool = True
    lifted: bool = False
    freed: Freed = NOTHING


@dataclass(frozen=True)
class Layout:
    """The order of the entries in the reduced state y and in the parameters.

    Attributes:
        active: Indices of the shape joints whose positions and momenta are integrated.
        cyclic: Indices of the cyclic joints.
        prescribed: Indices of the prescribed joints.
        base: Numbers of integrated and constant entries of the base.
        base_requested: Whether the outputs contain the state of the base.
        gravity_on_base: Whether gravity rotates a pivoted base.
        clock: 1 if the time is the last entry of y, else 0.
        gravity: Indices of the axes along which the gravity component is a parameter.
        freed: Variable body parameters.
        com_path: Number of parameters for the centre-of-mass path: 3k if forces depend on the
            path, else 0.
        numbers: Number of force parameters.
    """

    active: tuple[int, ...]
    cyclic: tuple[int, ...]
    prescribed: tuple[int, ...]
    base: BaseParts
    base_requested: bool
    gravity_on_base: bool
    clock: int
    gravity: tuple[int, ...]
    freed: Freed
    com_path: int
    numbers: int

    @cached_property
    def base_at(self) -> int:
        """Index in y of the first base entry."""
        return 2 * len(self.active) + len(self.cyclic)

    @cached_property
    def size(self) -> int:
        """Length of y."""
        return self.base_at + self.base.size + self.clock

    @cached_property
    def parameters(self) -> int:
        """Number of parameters."""
        return self.com_path_at + self.com_path + self.numbers

    @property
    def bodies_at(self) -> int:
        """Index in the parameters of the first body parameter."""
        return self.gravity_at + len(self.gravity)

    @property
    def gravity_at(self) -> int:
        """Index in the parameters of the first gravity component."""
        return self.base.spin + len(self.cyclic)

    @property
    def com_path_at(self) -> int:
        """Index in the parameters of the first centre-of-mass path entry."""
        return self.bodies_at + self.freed.size

    @property
    def quaternions(self) -> tuple[int, int]:
        """Index in y of the first quaternion entry, and number of quaternions; (0, 0) for none."""
        return (self.base_at, 1) if self.base.attitude == 4 else (0, 0)

    @property
    def canonical(self) -> tuple[int, int]:
        """Number of positions with conjugate momenta, and number of constant angular momenta."""
        return len(self.active), self.base.spin


@dataclass(frozen=True)
class Outputs:
    """Slices of the outputs of a kernel.

    Attributes:
        xi: Body twist relative to the centre of mass, (r,).
        xdot: Shape rate, (m,).
        com: Centre of mass in the frame of the root body, (3,).
        mu: Body momentum about the centre of mass, (r,).
        weight: Gravity force that rotates a pivoted base, in the body frame, (3,) or empty.
        driven_x: Positions of the prescribed joints, (k,).
        driven_pi: Canonical momenta of the prescribed joints, (k,).
        fields: All fields of State except the time; of ShapeState if the base is not requested.
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
        """Extract a field of State, with joints in the order of the robot's original model.

        Args:
            name: Name of the field, except "t".
            outputs: Outputs of the kernel, (…, size).
            system: The system of the kernel.
        Returns:
            The field: (…,) for scalars, else (…, length of the field's axis).
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
    """Return the fields of State that have separate entries in the outputs, in order.

    The shape rate is always an output, and the body twist is the first part of the field v, so
    neither is among the separate fields.
    """
    shared = ("t", "xdot", "xi")
    return [f.name for f in FIELDS.values() if f.name not in shared and (base or not f.needs_base)]


def outputs_of(system: System, layout: Layout) -> Outputs:
    """Compute the slices of a kernel's outputs.

    Args:
        system: The system.
        layout: Layout of the kernel.
    Returns:
        The slices.
    """
    m, r, k = system.m, system.r, len(layout.prescribed)
    names, lengths = separate_fields(base=layout.base_requested), axis_lengths(system)
    relative = [r, m, 3, r, 3 * layout.gravity_on_base, k, k]
    ends = list(accumulate([*relative, *(lengths[FIELDS[name].axis] for name in names)], initial=0))
    xi, xdot, com, mu, weight, driven_x, driven_pi, *slices = starmap(slice, pairwise(ends))
    fields = {**dict(zip(names, slices, strict=True)), "xdot": xdot}
    if layout.base_requested:
        fields["xi"] = slice(fields["v"].start, fields["v"].start + r)
    return Outputs(xi, xdot, com, mu, weight, driven_x, driven_pi, fields, ends[-1])


def layout_of(system: System, structure: Structure, forces: ForceModel | None) -> Layout:
    """Compute the layout of the reduced state and of the parameters.

    Args:
        system: The system.
        structure: Structure of the kernel.
        forces: Forces on the system, or None.
    Returns:
        The layout.
    """
    prescribed = forces.joints if forces is not None else ()
    heavy = system.group.is_pivot and bool(structure.gravity)
    base_observed = forces is not None and (forces.sees_attitude or forces.sees_place)
    base = base_parts(
        system.group,
        wanted=structure.base or structure.lifted or base_observed,
        heavy=heavy,
        wrench=forces is not None and forces.has_wrench,
        zero_momentum=structure.zero_momentum,
    )
    return Layout(
        active=tuple(k for k in range(system.m) if k not in {*structure.cyclic, *prescribed}),
        cyclic=structure.cyclic,
        prescribed=prescribed,
        base=base,
        base_requested=structure.base,
        gravity_on_base=heavy,
        clock=int(forces is not None and forces.needs_time),
        gravity=structure.gravity,
        freed=structure.freed,
        com_path=3 * system.group.linear if forces is not None and forces.sees_place else 0,
        numbers=len(forces.numbers) if forces is not None else 0,
    )


_POINTER = ctypes.POINTER(ctypes.c_double)
_SIGNATURE = ctypes.CFUNCTYPE(None, _POINTER, _POINTER, _POINTER)


@dataclass(frozen=True)
class Kernel:
    """Machine code of a reduced vector field and of its outputs.

    Attributes:
        system: The system.
        structure: Structure of the reduced equations.
        forces: Forces on the system, or None.
        layout: Layout of the reduced state y and of the parameters.
        rate: Machine code (y, parameters) → dy/dt.
        outputs: Machine code ((y, t), (parameters, c0, v0, g)) → all fields of Outputs.
        instructions: Number of arithmetic operations of `rate`.
    """

    system: System
    structure: Structure
    forces: ForceModel | None
    layout: Layout
    rate: NativeCode
    outputs: NativeCode
    instructions: int

    @cached_property
    def _rate(self) -> Callable[..., None]:
        return _SIGNATURE(self.rate.address)

    @cached_property
    def _outputs(self) -> Callable[..., None]:
        return _SIGNATURE(self.outputs.address)

    def random_parameters(self, rng: np.random.Generator) -> Array:
        """Draw random parameters for the comparison of derived code with this kernel.

        Args:
            rng: Random number generator.
        Returns:
            (p,): random spin, gravity and force parameters, with the body parameters of the robot.
        """
        layout = self.layout
        parameters = rng.normal(size=layout.parameters)
        bodies = free_numbers(self.system, layout.freed)
        parameters[layout.bodies_at : layout.bodies_at + len(bodies)] = bodies
        if self.forces is not None:
            parameters[layout.parameters - layout.numbers :] = self.forces.random_numbers(rng)
        return parameters

    def evaluate_rate(self, y: Array, parameters: Array) -> Array:
        """Evaluate the reduced vector field.

        Args:
            y: Reduced state, (size,).
            parameters: Parameters, (p,).
        Returns:
            (size,): dy/dt.
        """
        return self._call(self._rate, y, parameters, self.layout.size)

    def evaluate_outputs(self, t: float, y: Array, parameters: Array, com_path: Array) -> Array:
        """Evaluate the outputs at a time.

        Args:
            t: Time [s].
            y: Reduced state, (size,).
            parameters: Parameters, (p,).
            com_path: Centre-of-mass path (c0, v0, g), (3k,) [m, m/s, m/s²].
        Returns:
            (where.size,): all fields of Outputs.
        """
        y = y if self.layout.clock else np.append(y, t)
        return self._call(self._outputs, y, np.append(parameters, com_path), self.where.size)

    @cached_property
    def where(self) -> Outputs:
        """Slices of the kernel's outputs."""
        return outputs_of(self.system, self.layout)

    @staticmethod
    def _call(function: Callable[..., None], y: Array, parameters: Array, size: int) -> Array:
        y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
        values = np.empty(size)
        function(*(array.ctypes.data_as(_POINTER) for array in (y, parameters, values)))
        return values
