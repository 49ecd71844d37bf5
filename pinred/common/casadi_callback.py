"""CasADi Functions that call Python functions of arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from .arrays import Array

_Evaluation: TypeAlias = Callable[[Sequence[Array]], Sequence[Array]]
_Arguments: TypeAlias = Sequence[tuple[str, ca.Sparsity]]


class ArrayCallback(ca.Callback):
    """A CasADi Function that calls a Python function from arrays to arrays."""

    def __init__(
        self, name: str, inputs: _Arguments, outputs: _Arguments, evaluate: _Evaluation
    ) -> None:
        """Build the Function.

        Args:
            name: Name of the Function.
            inputs: Name and sparsity of each input.
            outputs: Name and sparsity of each output.
            evaluate: Function from the inputs to the outputs.
        """
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._evaluate = inputs, outputs, evaluate
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return len(self._inputs)

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        """Return the name of input i."""
        return self._inputs[i][0]

    def get_name_out(self, i: int) -> str:
        """Return the name of output i."""
        return self._outputs[i][0]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of input i."""
        return self._inputs[i][1]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """Return the shape of output i."""
        return self._outputs[i][1]

    def eval(self, arguments: Any) -> list[Any]:
        """Compute the outputs."""
        arrays = [np.array(argument) for argument in arguments]
        return [ca.DM(result) for result in self._evaluate(arrays)]


def dense(name: str, rows: int, columns: int = 1) -> tuple[str, ca.Sparsity]:
    """Return the name and the sparsity of a dense argument."""
    return name, ca.Sparsity.dense(rows, columns)
