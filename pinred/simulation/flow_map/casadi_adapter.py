"""A flow as a CasADi Callback with derivatives, for optimal control by IPOPT and others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ...common.arrays import Array
from .flow_columns import Columns

_Evaluation = Callable[[Sequence[Array]], Sequence[Array]]
_Sizes = Sequence[tuple[int, int]]


class FlowCallback(ca.Callback):
    """A flow as a Function: its inputs by name as columns, one output `y`; with derivatives.

    These are its Jacobian, and its derivatives along directions and back, of first order.
    columns: what stands where.  The Callback has to live as long as what is made of it.
    """

    def __init__(self, columns: Columns, name: str) -> None:
        """Take a flow between columns and the name of the Function."""
        ca.Callback.__init__(self)
        self.columns = columns
        self._derivatives: list[Any] = []  # CasADi does not keep them alive
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return len(self.columns.names)

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_name_in(self, i: int) -> str:
        """Return the name of an input, as CasADi allows it."""
        return str(self.columns.names[i]).replace(".", "_")

    def get_name_out(self, _i: int) -> str:
        """Return the name of the output."""
        return "y"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return a dense column."""
        return ca.Sparsity.dense(self.columns.sizes[i], 1)

    def get_sparsity_out(self, _i: int) -> ca.Sparsity:
        """Return a dense column."""
        return ca.Sparsity.dense(self.columns.size, 1)

    def eval(self, arguments: Any) -> list[Any]:
        """Return the output."""
        return [ca.DM(self.columns.value(*map(np.array, arguments)))]

    def has_jacobian(self) -> bool:
        """Return that there is a Jacobian."""
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, _options: Any) -> ca.Function:
        """Return the Jacobian as a Function of the inputs, and of outputs that it does not read."""
        columns = self.columns
        given = [(size, 1) for size in columns.sizes]
        out = [(columns.size, size) for size in columns.sizes]

        def call(arguments: Sequence[Array]) -> Sequence[Array]:
            return columns.jacobian(*arguments)

        return self._made(name, inames, onames, [given, []], out, call)

    def has_forward(self, _count: int) -> bool:
        """Return that there are derivatives along directions."""
        return True

    def get_forward(
        self, count: int, name: str, inames: Any, onames: Any, _options: Any
    ) -> ca.Function:
        """Return the derivatives along so many directions, which stand side by side."""
        columns = self.columns
        given = [(size, 1) for size in columns.sizes]
        along = [(size, count) for size in columns.sizes]

        def call(arguments: Sequence[Array]) -> Sequence[Array]:
            own, directions = arguments[: len(given)], arguments[len(given) :]
            return [columns.jvp(own, [each.T for each in directions]).T]

        return self._made(name, inames, onames, [given, along], [(columns.size, count)], call)

    def has_reverse(self, _count: int) -> bool:
        """Return that there are derivatives back."""
        return True

    def get_reverse(
        self, count: int, name: str, inames: Any, onames: Any, _options: Any
    ) -> ca.Function:
        """Return the derivatives of so many covectors · output, which stand side by side."""
        columns = self.columns
        given = [(size, 1) for size in columns.sizes]
        out = [(size, count) for size in columns.sizes]

        def call(arguments: Sequence[Array]) -> Sequence[Array]:
            own, covectors = arguments[: len(given)], arguments[len(given)]
            return [each.T for each in columns.vjp(own, covectors.T)]

        return self._made(name, inames, onames, [given, [(columns.size, count)]], out, call)

    def _made(
        self,
        name: str,
        inames: Any,
        onames: Any,
        given: Sequence[_Sizes],
        out: _Sizes,
        call: _Evaluation,
    ) -> ca.Function:
        """Return a derivative, kept alive; given: the sizes before and after the output."""
        places = [
            *(ca.Sparsity.dense(*size) for size in given[0]),
            ca.Sparsity(self.columns.size, 1),  # the output, which it does not read
            *(ca.Sparsity.dense(*size) for size in given[1]),
        ]
        unread = len(given[0])

        def read(arguments: Any) -> list[Any]:
            arrays = [np.array(each) for each in arguments]
            return [ca.DM(part) for part in call(arrays[:unread] + arrays[unread + 1 :])]

        made: ca.Function = _Derivative(
            name, [*inames], [*onames], places, [ca.Sparsity.dense(*size) for size in out], read
        )
        self._derivatives.append(made)
        return made


class _Derivative(ca.Callback):
    """A derivative of a FlowCallback, by the names that CasADi has for its inputs and outputs."""

    def __init__(
        self,
        name: str,
        inames: list[str],
        onames: list[str],
        given: list[ca.Sparsity],
        out: list[ca.Sparsity],
        call: Callable[..., Any],
    ) -> None:
        ca.Callback.__init__(self)
        self._inames, self._onames, self._given, self._out = inames, onames, given, out
        self._call = call
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._given)

    def get_n_out(self) -> int:
        return len(self._out)

    def get_name_in(self, i: int) -> str:
        return str(self._inames[i])

    def get_name_out(self, i: int) -> str:
        return str(self._onames[i])

    def get_sparsity_in(self, i: int) -> Any:
        return self._given[i]

    def get_sparsity_out(self, i: int) -> Any:
        return self._out[i]

    def eval(self, arguments: Any) -> list[Any]:
        return list(self._call(arguments))
