"""Numbers that may be known: they fold away where nothing is to be computed, and nowhere else."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable
from typing import Any

import casadi as ca
import pytest

from pinred.reduction.tree.scalars import add, mul, sub

NUMBERS = [0.0, 1.0, -1.0, 10.0, 0.1, -2.5]


@pytest.mark.parametrize(
    ("ours", "true"), [(add, operator.add), (sub, operator.sub), (mul, operator.mul)]
)
@pytest.mark.parametrize("known", list(itertools.product([True, False], repeat=2)))
def test_operations_equal_plain_arithmetic(
    ours: Callable[[Any, Any], Any], true: Callable[[Any, Any], Any], known: tuple[bool, bool]
) -> None:
    """Of any two, each known or not; what is known of both is a number."""
    symbols = ca.SX.sym("a"), ca.SX.sym("b")
    for numbers in itertools.product(NUMBERS, repeat=2):
        given = [n if k else s for n, k, s in zip(numbers, known, symbols, strict=True)]
        found = ours(*given)
        value = ca.Function("f", symbols, [ca.SX(found)])
        assert float(value(*numbers)) == true(*numbers)
        if all(known):
            assert isinstance(found, float)


def test_operations_with_zero_and_one_are_simplified() -> None:
    """They return an operand or a float."""
    s = ca.SX.sym("s")
    assert add(0.0, s) is add(s, 0.0) is sub(s, 0.0) is mul(1.0, s) is mul(s, 1.0) is s
    for nothing in (mul(0.0, s), mul(s, 0.0)):
        assert isinstance(nothing, float)
        assert nothing == 0.0
