"""Shape and rate with joint names, for forces and controllers: x["hinge"] is an entry, like x[0].

A Column behaves like a CasADi column, a Vector like a NumPy vector. Arrays computed from them have
no names and are indexed by number. Names are resolved while an expression is built, so they cost
nothing in the compiled kernel. A Python controller resolves them at each call.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.names import joint_index


class Column(ca.SX):
    """A CasADi column (m,) with an entry for each joint of the shape.

    Follower joints have entries, too, which are indexed by name or by numbers from m on. These
    entries are not part of the column itself.
    """

    def __init__(
        self, entries: ca.SX, joints: tuple[str, ...], what: str, followers: Sequence[ca.SX] = ()
    ) -> None:
        """Store the entries and their names.

        Args:
            entries: Entries of the shape joints, (m,).
            joints: Names of the shape joints, then of the followers.
            what: Name of the column in messages.
            followers: Entries of the follower joints.
        """
        super().__init__(entries)
        self._joints, self._what, self._followers = joints, what, tuple(followers)

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
            key = joint_index(key, self._joints, self._what)
        m = len(self._joints) - len(self._followers)
        if isinstance(key, int) and m <= key < len(self._joints):
            return self._followers[key - m]
        return super().__getitem__(key)


class Vector(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """A NumPy vector (m,) with an entry for each joint; arrays computed from it have no names."""

    _joints: tuple[str, ...] | None = None
    _what = ""

    @classmethod
    def of(cls, numbers: Array, joints: tuple[str, ...], what: str) -> Vector:
        """Return a copy of an array whose entries have joint names.

        Args:
            numbers: Values, (m,).
            joints: Names of the joints.
            what: Name of the vector in messages.
        Returns:
            The copy.
        """
        vector = np.array(numbers, dtype=float).view(cls)
        vars(vector).update(_joints=joints, _what=what)
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
            if self._joints is None:
                raise InputError(
                    f"only the arguments x and xdot accept names such as '{key}'; arrays computed "
                    "from them accept only indices"
                )
            key = joint_index(key, self._joints, self._what)
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
