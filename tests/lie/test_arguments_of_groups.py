"""Operations of groups accept lists of numbers, and name arguments that are not numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pinred
from pinred.lie import GROUPS, Group

OPERATIONS = {
    "compose": ("g", "h"), "inverse": ("g",), "exp": ("xi",), "log": ("g",), "Ad": ("g",),
    "ad": ("xi",), "rate": ("g", "xi"), "matrix": ("g",), "normalize": ("g",),
    "bracket": ("xi", "eta"), "coadjoint": ("xi", "mu"), "spatial_momentum": ("g", "mu"),
    "error": ("g", "h"),
}  # fmt: skip
WRONG: list[Any] = [
    "text", None, object(), {}, 1 + 2j, np.array(["a"]), np.array([b"a"] * 7),
    np.array([None] * 6), np.array([object()]), [np.array(["a"])], [[1.0], [1.0, 2.0]],
    np.zeros(9), np.zeros((2, 0)), [], 1.0, np.zeros(3, dtype="V8"), np.array(["2020"], "M8[D]"),
]  # fmt: skip


def numbers(group: Group, name: str) -> np.ndarray:
    """Return a value of an argument."""
    twist = np.linspace(0.1, 0.6, group.dim)
    return np.asarray(group.exp(twist)) if name in "gh" else twist


@pytest.mark.parametrize("group", GROUPS.values(), ids=str)
def test_lists_and_arrays_of_any_numbers_are_converted(group: Group) -> None:
    """The result is that for an array of floats."""
    for operation, names in OPERATIONS.items():
        arrays = [numbers(group, name) for name in names]
        call = getattr(group, operation)
        expected = call(*arrays)
        expected = vars(expected) if operation == "error" else {"": expected}
        forms = ([a.tolist() for a in arrays], [tuple(a) for a in arrays],
                 [a.astype(object) for a in arrays])  # fmt: skip
        for form in forms:
            result = call(**dict(zip(names, form, strict=True)))
            result = vars(result) if operation == "error" else {"": result}
            for key, value in expected.items():
                np.testing.assert_array_equal(result[key], value)


@pytest.mark.parametrize("group", GROUPS.values(), ids=str)
def test_other_arguments_are_named(group: Group) -> None:
    """Every operation of every group, with each value at each argument."""
    for operation, names in OPERATIONS.items():
        for wrong in names:
            for value in WRONG:
                given: dict[str, Any] = {name: numbers(group, name) for name in names}
                with pytest.raises(pinred.InputError, match=rf"^{wrong}\b"):
                    getattr(group, operation)(**given | {wrong: value})


@pytest.mark.parametrize("group", GROUPS.values(), ids=str)
@pytest.mark.parametrize("value", [*WRONG, np.zeros((2, 3)), range(3)])
def test_matrix_of_another_kind_or_shape_is_named(group: Group, value: Any) -> None:
    """A list of rows is converted."""
    matrix = group.matrix(group.identity())
    np.testing.assert_array_equal(group.from_matrix(matrix.tolist()), group.identity())
    with pytest.raises(pinred.InputError, match=r"^matrix\b"):
        group.from_matrix(value)
