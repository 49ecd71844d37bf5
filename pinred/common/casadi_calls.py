"""Calls of CasADi Functions with NumPy arrays, without CasADi's type conversions."""

from __future__ import annotations

from threading import local
from typing import Any

import casadi as ca
import numpy as np

from .arrays import Array


class Numeric:
    """A CasADi Function of dense inputs and outputs, callable from any thread."""

    def __init__(self, function: ca.Function) -> None:
        """Store the Function; work arrays are allocated at the first call of each thread."""
        self._function = function
        self._local = local()

    def __call__(self, *arguments: Array | float) -> list[Array]:
        """Evaluate the Function; return new arrays, (rows, columns) each."""
        if not hasattr(self._local, "run"):
            self._prepare()
        for array, argument in zip(self._local.inputs, arguments, strict=True):
            array[:] = argument
        self._local.run()
        return [array.copy() for array in self._local.outputs]

    def _prepare(self) -> None:
        """Allocate work arrays of this thread, which CasADi reads and writes in place."""
        f, work = self._function, self._local
        buffer: Any
        buffer, run = f.buffer()
        work.buffer, work.run = buffer, run
        work.inputs = [np.zeros(f.nnz_in(k)) for k in range(f.n_in())]
        work.outputs = [np.zeros(f.size_out(k), order="F") for k in range(f.n_out())]
        arrays: list[Any] = [*work.inputs, *work.outputs]
        for k, array in enumerate(arrays):
            if array.size:
                view = memoryview(array.ravel(order="K"))
                is_input = k < f.n_in()
                set_view = buffer.set_arg if is_input else buffer.set_res
                set_view(k if is_input else k - f.n_in(), view)
