"""CasADi Functions called with NumPy arrays, without CasADi's own conversions."""

from __future__ import annotations

from threading import local
from typing import Any

import casadi as ca
import numpy as np

from .arrays import Array


class Numeric:
    """A Function of dense inputs and outputs, which any thread may call."""

    def __init__(self, function: ca.Function) -> None:
        """Take the Function."""
        self._function = function
        self._local = local()

    def __call__(self, *arguments: Array | float) -> list[Array]:
        """Return the outputs, (rows, columns) each; they are never overwritten."""
        if not hasattr(self._local, "run"):
            self._prepare()
        for place, argument in zip(self._local.inputs, arguments, strict=True):
            place[:] = argument
        self._local.run()
        return [place.copy() for place in self._local.outputs]

    def _prepare(self) -> None:
        """Give this thread its own memory, which CasADi reads and writes in place."""
        f, mine = self._function, self._local
        buffer: Any
        buffer, run = f.buffer()
        mine.buffer, mine.run = buffer, run
        mine.inputs = [np.zeros(f.nnz_in(k)) for k in range(f.n_in())]
        mine.outputs = [np.zeros(f.size_out(k), order="F") for k in range(f.n_out())]
        places: list[Any] = [*mine.inputs, *mine.outputs]
        for k, place in enumerate(places):
            if place.size:
                view = memoryview(place.ravel(order="K"))
                given = k < f.n_in()
                (buffer.set_arg if given else buffer.set_res)(k if given else k - f.n_in(), view)
