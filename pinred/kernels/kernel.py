"""The compiled kernel, and the layout of its outputs."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, starmap

import numpy as np

from ..common.arrays import Array
from ..common.machine_code import NativeCode
from ..forces.force_model import ForceModel
from ..integrators.stepping.run_state import Canonical
from ..reduction.tree.free_bodies import free_numbers
from ..system.state_fields import FIELDS, axis_lengths
from ..system.system import System
from .state_layout import Layout, Structure


@dataclass(frozen=True)
class Outputs:
    """Slices of the outputs of a kernel.

    Attributes:
        xi: Body twist relative to the centre of mass, (r,).
        xdot: Shape rate, (m,).
        com: Centre of mass in the frame of the root body, (3,).
        mu: Body momentum about the centre of mass, (r,).
        weight: Gravity force that rotates a pivoted base, in the body frame, (3,) or empty.
        driven_x: Coordinates of the prescribed joints, (kx,).
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


def in_given_order(name: str, values: Array, system: System) -> Array:
    """Convert entries of the outputs to a field of State, with joints in the robot's order.

    Args:
        name: Name of the field, except "t".
        values: Its entries, (…, length of the field's axis), or (…, 1) for scalars.
        system: The system of the kernel.
    Returns:
        The field.
    """
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
    m, r, driven = system.m, system.r, (len(layout.prescribed_x), len(layout.prescribed))
    names, lengths = separate_fields(base=layout.base_requested), axis_lengths(system)
    relative = [r, m, 3, r, 3 * layout.gravity_on_base, *driven]
    ends = list(accumulate([*relative, *(lengths[FIELDS[name].axis] for name in names)], initial=0))
    xi, xdot, com, mu, weight, driven_x, driven_pi, *slices = starmap(slice, pairwise(ends))
    fields = {**dict(zip(names, slices, strict=True)), "xdot": xdot}
    if layout.base_requested:
        fields["xi"] = slice(fields["v"].start, fields["v"].start + r)
    return Outputs(xi, xdot, com, mu, weight, driven_x, driven_pi, fields, ends[-1])


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
        closing: Machine code that closes loops at step ends, for methods with multipliers; the
            rates are then those of the open tree (see closing_code.py).
    """

    system: System
    structure: Structure
    forces: ForceModel | None
    layout: Layout
    rate: NativeCode
    outputs: NativeCode
    instructions: int
    closing: NativeCode | None = None

    @property
    def canonical(self) -> Canonical:
        """Pairs of positions and momenta, constant angular momenta, and the closing of loops."""
        closing = 0 if self.closing is None else self.closing.address
        return Canonical(self.layout.pairs, self.layout.base.spin, closing)

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
