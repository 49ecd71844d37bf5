"""Kernels: one robot and one kind of scene, compiled, judged against Pinocchio, kept on disk."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ..common.arrays import Array
from ..forces.force_model import ForceModel
from ..reduction.tree.free_bodies import free_numbers
from ..system.system import System
from .layout import Layout, Outputs, Structure, outputs_of
from .machine.native import NativeCode

_POINTER = ctypes.POINTER(ctypes.c_double)
_SIGNATURE = ctypes.CFUNCTYPE(None, _POINTER, _POINTER, _POINTER)


class KernelStore(Protocol):
    """A store of kernels: an ObjectCache, or something like it."""

    def get(self, key: str) -> bytes | None:
        """Return the code of `key`, if it is there."""

    def put(self, key: str, code: bytes) -> None:
        """Keep the code of `key`."""


@dataclass(frozen=True)
class Kernel:
    """Machine code of a reduced vector field and of its outputs.

    layout: the places of things in y and in the parameters.  rate: (y, parameters) → dy/dt.
    outputs: ((y, t), (parameters, c0, v0, g)) → everything of Outputs.  instructions:
    arithmetic operations of `rate`.
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
        """Return parameters (p,) with which code made of this kernel is compared with it."""
        layout = self.layout
        parameters = rng.normal(size=layout.parameters)
        bodies = free_numbers(self.system, layout.freed)
        parameters[layout.bodies_at : layout.bodies_at + len(bodies)] = bodies
        if self.forces is not None:
            first = self.layout.parameters - self.layout.numbers
            parameters[first:] = self.forces.random_numbers(rng)
        return parameters

    def evaluate_rate(self, y: Array, parameters: Array) -> Array:
        """Return dy/dt, (size,)."""
        return self._call(self._rate, y, parameters, self.layout.size)

    def evaluate_outputs(self, t: float, y: Array, parameters: Array, line: Array) -> Array:
        """Return everything of Outputs, (where.size,), at a time.

        line: (3k,) start, velocity and fall of the centre of mass.
        """
        y = y if self.layout.clock else np.append(y, t)
        return self._call(self._outputs, y, np.append(parameters, line), self.where.size)

    @cached_property
    def where(self) -> Outputs:
        """The places of things in the outputs."""
        return outputs_of(self.system, self.layout)

    @staticmethod
    def _call(function: Callable[..., None], y: Array, parameters: Array, size: int) -> Array:
        y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
        out = np.empty(size)
        function(*(array.ctypes.data_as(_POINTER) for array in (y, parameters, out)))
        return out
