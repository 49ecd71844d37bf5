"""Arrays with named entries, for forces and controllers: x["hinge"] is an entry, like x[0].

Shape and rate have joint names; pose, twist and momenta have the names of their components.

A Column behaves like a CasADi column, a Vector like a NumPy vector. Arrays computed from them have
no names and are indexed by number. Names are resolved while an expression is built, so they cost
nothing in the compiled kernel. A Python controller resolves them at each call.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.names import component_index, joint_index


class Column(ca.SX):
    """A CasADi column (n,) whose entries have names.

    Follower joints have entries, too, which are indexed by name or by numbers from n on. These
    entries are not part of the column itself.
    """

    def __init__(
        self,
        entries: ca.SX,
        names: Sequence[str] | Mapping[str, int],
        what: str,
        followers: Sequence[ca.SX] = (),
    ) -> None:
        """Store the entries and their names.

        Args:
            entries: The entries, (n,).
            names: Names of the shape joints, then of the followers; or the index of each component
                of a pose, twist or momentum by all its names.
            what: Name of the column in messages.
            followers: Entries of the follower joints.
        """
        super().__init__(entries)
        self.names, self._what, self._followers = names, what, tuple(followers)

    def __getitem__(self, key: Any) -> Any:
        """Return an entry by joint name, or any selection that CasADi supports.

        Args:
            key: Name, index or slice.
        Returns:
            The entry or entries.
        Raises:
            InputError: The name is unknown.
        """
        if isinstance(key, str):
            key = _index(key, self.names, self._what)
        if self._followers:
            n = len(self.names) - len(self._followers)
            if isinstance(key, int) and n <= key < len(self.names):
                return self._followers[key - n]
        return super().__getitem__(key)


class Vector(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """A NumPy vector (n,) whose entries have names; arrays computed from it have none."""

    _names: Sequence[str] | Mapping[str, int] | None = None
    _what = ""

    @classmethod
    def of(cls, numbers: Array, names: Sequence[str] | Mapping[str, int], what: str) -> Vector:
        """Return a copy of an array whose entries have names.

        Args:
            numbers: Values, (n,).
            names: Names of the joints; or the index of each component by all its names.
            what: Name of the vector in messages.
        Returns:
            The copy.
        """
        vector = np.array(numbers, dtype=float).view(cls)
        vars(vector).update(_names=names, _what=what)
        return vector

    def __getitem__(self, key: Any) -> Any:
        """Return an entry by joint name, or any selection that NumPy supports.

        Args:
            key: Name, index or slice.
        Returns:
            The entry or entries.
        Raises:
            InputError: The name is unknown, or this array was computed from others and has no
                names.
        """
        if isinstance(key, str):
            if self._names is None:
                raise InputError(
                    f"only the arguments x and xdot, and fields of a state, accept names such as "
                    f"'{key}'; arrays computed from them accept only indices"
                )
            key = _index(key, self._names, self._what)
        return self.view(np.ndarray)[key]

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Return results of NumPy functions as plain arrays or numbers.

        Args:
            array: Result of the NumPy function.
            context: Unused; part of NumPy's interface.
            return_scalar: Whether NumPy expects a scalar.
        Returns:
            The result as a plain array or number.
        """
        if array is self:  # as in x += 1
            return self
        return array[()] if return_scalar else np.asarray(array)


def _index(key: str, names: Sequence[str] | Mapping[str, int], what: str) -> int:
    """Return the index of an entry by its name.  Raises InputError."""
    if isinstance(names, Mapping):
        return component_index(key, names, what)
    return joint_index(key, names, what)
