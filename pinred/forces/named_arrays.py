"""Shape and rate as forces and controllers are given them: x["hinge"] is x[0].

Both are what they would be without names, a CasADi column or a NumPy vector, and what is
computed from them is plain: names are looked up only while an expression is written, or in a
controller of Python.
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
    """A column of CasADi expressions, (m,), with an entry for each joint of the shape.

    Joints that follow others have entries too, by name and by the numbers from m on, which are no
    part of the column itself.
    """

    def __init__(
        self, entries: ca.SX, joints: tuple[str, ...], what: str, followers: Sequence[ca.SX] = ()
    ) -> None:
        """Take the entries, the names of the joints, and what an error calls the column.

        followers: entries of those that follow others, whose names come after the others'.
        """
        super().__init__(entries)
        self._joints, self._what, self._followers = joints, what, tuple(followers)

    def __getitem__(self, key: Any) -> Any:
        """Return entries by name or as CasADi does.  Raises InputError for unknown names."""
        if isinstance(key, str):
            key = joint_index(key, self._joints, self._what)
        m = len(self._joints) - len(self._followers)
        if isinstance(key, int) and m <= key < len(self._joints):
            return self._followers[key - m]
        return super().__getitem__(key)


class Vector(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """Numbers, (m,), with an entry for each joint; what is made of them has no names."""

    _joints: tuple[str, ...] | None = None
    _what = ""

    @classmethod
    def of(cls, numbers: Array, joints: tuple[str, ...], what: str) -> Vector:
        """Return a copy of numbers with the names of the joints and what an error calls it."""
        vector = np.array(numbers, dtype=float).view(cls)
        vars(vector).update(_joints=joints, _what=what)
        return vector

    def __getitem__(self, key: Any) -> Any:
        """Return entries by name or as NumPy does.  Raises InputError for unknown names."""
        if isinstance(key, str):
            if self._joints is None:
                raise InputError(
                    f"only x and xdot as they are given know '{key}'; arrays made of them have "
                    "numbers"
                )
            key = joint_index(key, self._joints, self._what)
        return self.view(np.ndarray)[key]

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Return what a function of NumPy made of it as a plain array or number."""
        if array is self:  # as in x += 1
            return self
        return array[()] if return_scalar else np.asarray(array)
