"""Numeric arguments of compiled forces at one state, and the resulting torques and wrenches.

CasADi Functions are evaluated in fixed arrays, which takes less time than their usual calls.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from threading import local
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array, FrozenArrays


@dataclass(frozen=True)
class BaseInSpace:
    """Pose, twist and momenta of the base in space, i.e. relative to the root joint's fixed frame.

    See SeenState for their definitions.

    Attributes:
        pose: Pose, (size,).
        xi: Body twist, (r,).
        mu: Body momentum, (r,).
        J: Spatial momentum, (r,).
    """

    pose: Array
    xi: Array
    mu: Array
    J: Array


@dataclass(frozen=True)
class ForceInputs:
    """The state that forces depend on, and the numbers in the forces: see Symbols.

    At T times, t has the shape (T,), and all others have a leading axis of length T.

    Attributes:
        t: Time [s].
        x: Shape, (m,).
        xdot: Shape rate, (m,).
        xi: Body twist relative to the centre of mass, (r,).
        mu: Body momentum about the centre of mass, (r,).
        numbers: Values of the numbers in the forces (see ForceModel.numbers), (p,).
        base: The base in space; required if forces depend on its pose or motion.
    """

    t: float | Array
    x: Array
    xdot: Array
    xi: Array
    mu: Array
    numbers: Array
    base: BaseInSpace | None = None


@dataclass(frozen=True)
class Acting:
    """The sum of all forces at one state, or at T states with a leading axis.

    Attributes:
        torque: Torques on the joints, −∂V/∂x included, (m,).
        wrench: Wrench on the base, (r,).
    """

    torque: Array
    wrench: Array


@dataclass(frozen=True)
class Prescribed(FrozenArrays):
    """Motion of k prescribed joints at one time, or at T times with a leading axis.

    Attributes:
        x: Positions, (k,).
        xdot: Rates, (k,).
        xddot: Accelerations, (k,).
    """

    x: Array
    xdot: Array
    xddot: Array


class FunctionBuffers:
    """Arrays that a CasADi Function of dense inputs and outputs reads and writes in place.

    Attributes:
        inputs: One array of numbers for each input, column by column.
        outputs: One array (rows, columns) for each output, which each run overwrites.
    """

    def __init__(self, function: ca.Function, shared: Mapping[int, Array] | None = None) -> None:
        """Allocate the arrays.

        Args:
            function: The Function.
            shared: Arrays to use for inputs by index, such as outputs of another Function.
        """
        f, values = function, shared or {}
        buffer: Any
        buffer, self._run = f.buffer()
        self._kept = function, buffer  # `_run` holds only pointers to them
        self.inputs = [values.get(k, np.zeros(f.nnz_in(k))) for k in range(f.n_in())]
        self.outputs = [np.zeros(f.size_out(k), order="F") for k in range(f.n_out())]
        for set_view, arrays in ((buffer.set_arg, self.inputs), (buffer.set_res, self.outputs)):
            for k, array in enumerate(arrays):
                if array.size:
                    entries: Any = array.ravel(order="K")  # a view
                    set_view(k, memoryview(entries))

    def run(self) -> None:
        """Evaluate the outputs."""
        self._run()


_AT_ONCE = 256  # number of evaluations that share a run


class Numeric:
    """A CasADi Function of dense inputs and outputs, callable from any thread."""

    def __init__(self, function: ca.Function) -> None:
        """Store the Function; work arrays are allocated at the first call of each thread."""
        self._function = function
        self._local = local()

    def __call__(self, *arguments: Array | float) -> list[Array]:
        """Evaluate the Function; return a new array (rows, columns) for each output."""
        work = self._local
        if not hasattr(work, "buffers"):
            work.buffers = FunctionBuffers(self._function)
        buffers: FunctionBuffers = work.buffers
        for array, argument in zip(buffers.inputs, arguments, strict=True):
            array[:] = argument
        buffers.run()
        return [array.copy() for array in buffers.outputs]

    def at_all(self, *arguments: Array) -> list[Array]:
        """Evaluate the Function at T arguments.

        Args:
            arguments: An array (T, rows) for each input, or (rows,) if all T share it.
        Returns:
            A new array (T, rows, columns) for each output.
        """
        count, f = max(len(a) for a in arguments if a.ndim == 2), self._function
        at_once = min(count, _AT_ONCE)
        buffers = FunctionBuffers(f.map(at_once))
        sizes = [f.size_out(k) for k in range(f.n_out())]
        outputs = [np.empty((count, columns, rows)) for rows, columns in sizes]
        for first in range(0, count, at_once):
            chunk = slice(first, min(first + at_once, count))
            for array, argument in zip(buffers.inputs, arguments, strict=True):
                rows = array.reshape(at_once, argument.shape[-1])
                rows[: chunk.stop - first] = argument[chunk] if argument.ndim == 2 else argument
            buffers.run()
            for output, column in zip(outputs, buffers.outputs, strict=True):
                results = column.T.reshape(at_once, *output.shape[1:])
                output[chunk] = results[: chunk.stop - first]
        return [output.swapaxes(1, 2) for output in outputs]
