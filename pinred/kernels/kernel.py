"""Kernels: compiled reduced equations of one robot and structure."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..common.arrays import Array
from ..forces.force_model import ForceModel
from ..reduction.tree.free_bodies import free_numbers
from ..system.system import System
from .layout import Layout, Outputs, Structure, outputs_of
from .machine.native import NativeCode

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
            (p,): spin, gravity and force parameters are random; body parameters are those of the
            robot.
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
        """Slices of the outputs."""
        return outputs_of(self.system, self.layout)

    @staticmethod
    def _call(function: Callable[..., None], y: Array, parameters: Array, size: int) -> Array:
        y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
        values = np.empty(size)
        function(*(array.ctypes.data_as(_POINTER) for array in (y, parameters, values)))
        return values
