"""A flow as a CasADi Callback with derivatives, for optimal control with IPOPT and others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ...common.arrays import Array
from .flow_columns import Columns

_Evaluation = Callable[[Sequence[Array]], Sequence[Array]]
_Shapes = Sequence[tuple[int, int]]


class FlowCallback(ca.Callback):
    """A flow as a CasADi Function with derivatives of first order.

    Its inputs are those of the flow by name, as columns, and its output is the column `y`.  It has
    a Jacobian and forward and reverse derivatives.  Keep the object alive as long as expressions
    use it, for CasADi does not.

    Attributes:
        columns: The flow between vectors, with the order of inputs and outputs.
    """

    def __init__(self, columns: Columns, name: str) -> None:
        """Build the Function.

        Args:
            columns: The flow between vectors.
            name: Name of the Function.
        """
        ca.Callback.__init__(self)
        self.columns = columns
        self._derivatives: list[Any] = []  # CasADi does not keep derivatives alive.
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return len(self.columns.names)

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_name_in(self, i: int) -> str:
        """Return the name of input i, with underscores for the dots that CasADi rejects."""
        return str(self.columns.names[i]).replace(".", "_")

    def get_name_out(self, _i: int) -> str:
        """Return the name of the output."""
        return "y"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of input i, a dense column."""
        return ca.Sparsity.dense(self.columns.sizes[i], 1)

    def get_sparsity_out(self, _i: int) -> ca.Sparsity:
        """Return the shape of the output, a dense column."""
        return ca.Sparsity.dense(self.columns.size, 1)

    def eval(self, arguments: Any) -> list[Any]:
        """Compute the output."""
        return [ca.DM(self.columns.value(*map(np.array, arguments)))]

    def has_jacobian(self) -> bool:
        """Return True: there is a Jacobian."""
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, _options: Any) -> ca.Function:
        """Return the Jacobian as a Function of the inputs and the output.

        Args:
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
        Returns:
            Function that does not read the output.
        """
        columns = self.columns
        inputs = [(size, 1) for size in columns.sizes]
        outputs = [(columns.size, size) for size in columns.sizes]

        def evaluate(arguments: Sequence[Array]) -> Sequence[Array]:
            return columns.jacobian(*arguments)

        return self._derivative(name, inames, onames, [inputs, []], outputs, evaluate)

    def has_forward(self, _count: int) -> bool:
        """Return True: there are forward derivatives."""
        return True

    def get_forward(
        self, count: int, name: str, inames: Any, onames: Any, _options: Any
    ) -> ca.Function:
        """Return the derivatives along `count` directions, one in each column.

        Args:
            count: Number of directions.
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
        Returns:
            Function of the inputs, the output and the directions.
        """
        columns = self.columns
        inputs = [(size, 1) for size in columns.sizes]
        directions = [(size, count) for size in columns.sizes]

        def evaluate(arguments: Sequence[Array]) -> Sequence[Array]:
            values, along = arguments[: len(inputs)], arguments[len(inputs) :]
            return [columns.jvp(values, [direction.T for direction in along]).T]

        shapes = [inputs, directions]
        return self._derivative(name, inames, onames, shapes, [(columns.size, count)], evaluate)

    def has_reverse(self, _count: int) -> bool:
        """Return True: there are reverse derivatives."""
        return True

    def get_reverse(
        self, count: int, name: str, inames: Any, onames: Any, _options: Any
    ) -> ca.Function:
        """Return the derivatives of `count` products covector · output, one in each column.

        Args:
            count: Number of covectors.
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
        Returns:
            Function of the inputs, the output and the covectors.
        """
        columns = self.columns
        inputs = [(size, 1) for size in columns.sizes]
        outputs = [(size, count) for size in columns.sizes]

        def evaluate(arguments: Sequence[Array]) -> Sequence[Array]:
            values, covectors = arguments[: len(inputs)], arguments[len(inputs)]
            return [derivative.T for derivative in columns.vjp(values, covectors.T)]

        shapes = [inputs, [(columns.size, count)]]
        return self._derivative(name, inames, onames, shapes, outputs, evaluate)

    def _derivative(
        self,
        name: str,
        inames: Any,
        onames: Any,
        inputs: Sequence[_Shapes],
        outputs: _Shapes,
        evaluate: _Evaluation,
    ) -> ca.Function:
        """Build a derivative and keep it alive.

        inputs: shapes of the arguments before and after the output.
        """
        sparsities = [
            *(ca.Sparsity.dense(*shape) for shape in inputs[0]),
            ca.Sparsity(self.columns.size, 1),  # The output, which no derivative reads.
            *(ca.Sparsity.dense(*shape) for shape in inputs[1]),
        ]
        unread = len(inputs[0])

        def call(arguments: Any) -> list[Any]:
            arrays = [np.array(argument) for argument in arguments]
            results = evaluate(arrays[:unread] + arrays[unread + 1 :])
            return [ca.DM(result) for result in results]

        derivative: ca.Function = _Derivative(
            name, [*inames], [*onames], sparsities,
            [ca.Sparsity.dense(*shape) for shape in outputs], call,
        )  # fmt: skip
        self._derivatives.append(derivative)
        return derivative


class _Derivative(ca.Callback):
    """A derivative of a FlowCallback, with the names that CasADi asks for."""

    def __init__(
        self,
        name: str,
        inames: list[str],
        onames: list[str],
        inputs: list[ca.Sparsity],
        outputs: list[ca.Sparsity],
        call: Callable[..., Any],
    ) -> None:
        ca.Callback.__init__(self)
        self._inames, self._onames, self._inputs, self._outputs = inames, onames, inputs, outputs
        self._call = call
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        return str(self._inames[i])

    def get_name_out(self, i: int) -> str:
        return str(self._onames[i])

    def get_sparsity_in(self, i: int) -> Any:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> Any:
        return self._outputs[i]

    def eval(self, arguments: Any) -> list[Any]:
        return list(self._call(arguments))
