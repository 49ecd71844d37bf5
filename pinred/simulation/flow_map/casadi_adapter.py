"""A flow as a CasADi Callback with derivatives, for optimal control with IPOPT and others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from ...common.arrays import Array
from ...common.casadi_callback import ArrayCallback, dense
from .flow_columns import Columns


class FlowCallback(ArrayCallback):
    """A flow as a CasADi Function with derivatives of first order.

    Its inputs are the inputs of the flow, as columns with their names; its output is the column
    `y`.  The Function has a Jacobian and forward and reverse derivatives.  Keep the object alive
    as long as expressions use it, because CasADi does not keep it alive.

    Attributes:
        columns: The flow between vectors, with the order of inputs and outputs.
    """

    def __init__(self, columns: Columns, name: str) -> None:
        """Build the Function.

        Args:
            columns: The flow between vectors.
            name: Name of the Function.
        """
        self.columns = columns
        self._derivatives: list[Any] = []  # CasADi does not keep derivatives alive.
        # CasADi rejects dots in names.
        names = [name.replace(".", "_") for name in columns.names]
        inputs = [dense(name, size, 1) for name, size in zip(names, columns.sizes, strict=True)]
        outputs = [dense("y", columns.size, 1)]
        super().__init__(name, inputs, outputs, lambda values: [columns.value(*values)])

    def has_jacobian(self) -> bool:
        """Return True, because `get_jacobian` provides a Jacobian."""
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, _options: Any) -> ca.Function:
        """Return the Jacobian as a Function of the inputs and the output.

        Args:
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
        Returns:
            The Jacobian; it takes the output as an argument, but does not read it.
        """
        columns = self.columns

        def evaluate(values: Sequence[Array], _: Sequence[Array]) -> Sequence[Array]:
            return columns.jacobian(*values)

        shapes = [(columns.size, size) for size in columns.sizes]
        return self._derivative(name, inames, onames, [], shapes, evaluate)

    def has_forward(self, _count: int) -> bool:
        """Return True, because `get_forward` provides forward derivatives."""
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

        def evaluate(values: Sequence[Array], directions: Sequence[Array]) -> Sequence[Array]:
            return [columns.jvp(values, [direction.T for direction in directions]).T]

        directions = [(size, count) for size in columns.sizes]
        shapes = [(columns.size, count)]
        return self._derivative(name, inames, onames, directions, shapes, evaluate)

    def has_reverse(self, _count: int) -> bool:
        """Return True, because `get_reverse` provides reverse derivatives."""
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

        def evaluate(values: Sequence[Array], covectors: Sequence[Array]) -> Sequence[Array]:
            return [derivative.T for derivative in columns.vjp(values, covectors[0].T)]

        covectors = [(columns.size, count)]
        shapes = [(size, count) for size in columns.sizes]
        return self._derivative(name, inames, onames, covectors, shapes, evaluate)

    def _derivative(
        self,
        name: str,
        inames: Sequence[str],
        onames: Sequence[str],
        seeds: Sequence[tuple[int, int]],
        shapes: Sequence[tuple[int, int]],
        evaluate: Callable[[Sequence[Array], Sequence[Array]], Sequence[Array]],
    ) -> ca.Function:
        """Build a derivative Function and store it, because CasADi does not keep it alive.

        Args:
            name: Name of the Function.
            inames: Names of its inputs.
            onames: Names of its outputs.
            seeds: Shapes of the arguments after the inputs and the output of the flow.
            shapes: Shapes of the results.
            evaluate: Function of the inputs and the seeds.
        Returns:
            Function of the inputs, the output and the seeds.
        """
        count = len(self.columns.sizes)
        sparsities = [
            *(ca.Sparsity.dense(size, 1) for size in self.columns.sizes),
            ca.Sparsity(self.columns.size, 1),  # The output, which no derivative reads.
            *(ca.Sparsity.dense(*shape) for shape in seeds),
        ]
        outputs = [dense(name, *shape) for name, shape in zip(onames, shapes, strict=True)]
        derivative: ca.Function = ArrayCallback(
            name, list(zip(inames, sparsities, strict=True)), outputs,
            lambda arguments: evaluate(arguments[:count], arguments[count + 1 :]),
        )  # fmt: skip
        self._derivatives.append(derivative)
        return derivative
