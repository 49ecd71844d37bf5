"""A flow as a CasADi Callback with derivatives, for optimal control by IPOPT and others."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from .columns import Columns


class FlowCallback(ca.Callback):
    """A flow as a Function: its inputs by name as columns, one output `y`; with its Jacobian.

    columns: what stands where.  The Callback has to live as long as what is made of it.
    """

    def __init__(self, columns: Columns, name: str) -> None:
        """Take a flow between columns and the name of the Function."""
        ca.Callback.__init__(self)
        self.columns = columns
        self._slopes: list[Any] = []  # CasADi does not keep them alive
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
        return [ca.DM(self.columns.value(*(np.array(a) for a in arguments)))]

    def has_jacobian(self) -> bool:
        """Return that there is a Jacobian."""
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, _options: Any) -> ca.Function:
        """Return the Jacobian as a Function of the inputs, and of outputs that it does not read."""
        slopes: ca.Function = _Slopes(self.columns, name, inames, onames)
        self._slopes.append(slopes)
        return slopes


class _Slopes(ca.Callback):
    """The Jacobian of a FlowCallback."""

    def __init__(self, columns: Columns, name: str, inames: Any, onames: Any) -> None:
        ca.Callback.__init__(self)
        self._columns, self._inames, self._onames = columns, list(inames), list(onames)
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inames)

    def get_n_out(self) -> int:
        return len(self._onames)

    def get_name_in(self, i: int) -> str:
        return str(self._inames[i])

    def get_name_out(self, i: int) -> str:
        return str(self._onames[i])

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        sizes = self._columns.sizes
        return (
            ca.Sparsity.dense(sizes[i], 1) if i < len(sizes) else ca.Sparsity(self._columns.size, 1)
        )

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._columns.size, self._columns.sizes[i])

    def eval(self, arguments: Any) -> list[Any]:
        count = len(self._columns.sizes)
        found = self._columns.jacobian(*(np.array(a) for a in arguments[:count]))
        return [ca.DM(part) for part in found]
