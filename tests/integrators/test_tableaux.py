"""Tableaux of explicit methods, by Butcher's conditions on rooted trees; what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement
from math import prod
from typing import Any, TypeAlias

import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.common.errors import InputError
from pinred.integrators.explicit.tableau import Tableau
from pinred.integrators.methods import DOP853, METHODS, Explicit, Tsit5

EXPLICIT = [kind for kind in METHODS.values() if issubclass(kind, Explicit)]
Tree: TypeAlias = tuple[Any, ...]  # of its branches


@cache
def forests(nodes: int, largest: int) -> list[Tree]:
    """Multisets of rooted trees with so many nodes in all, none with more than `largest`."""
    if nodes == 0:
        return [()]
    found = []
    for size in range(min(nodes, largest), 0, -1):
        for count in range(nodes // size, 0, -1):
            for some in combinations_with_replacement(trees(size), count):
                found += [some + rest for rest in forests(nodes - size * count, size - 1)]
    return found


@cache
def trees(order: int) -> list[Tree]:
    """Rooted trees with so many nodes."""
    return forests(order - 1, order - 1)


def size(tree: Tree) -> int:
    """How many nodes a tree has."""
    return 1 + sum(map(size, tree))


def density(tree: Tree) -> int:
    """γ of a tree."""
    return size(tree) * prod(map(density, tree))


def weights(A: Array, tree: Tree) -> Array:
    """Φ of a tree, for each stage."""
    out = np.ones(len(A))
    for branch in tree:
        out *= A @ weights(A, branch)
    return out


def misses(A: Array, b: Array, order: int, part: float = 1.0) -> float:
    """By how much the conditions of an order are missed at most, at a part of the step."""
    goal = {tree: part**order / density(tree) for tree in trees(order)}
    return max(abs(float(b @ weights(A, tree)) - value) for tree, value in goal.items())


def at_end(tableau: Tableau) -> Array:
    """Weights of the rates at the end of a step."""
    return np.asarray(tableau.A[tableau.stages])


def at_part(tableau: Tableau, x: float) -> Array:
    """Weights of the rates at a part of a step."""
    first, last = np.zeros((2, len(tableau.A)))
    first[0] = last[tableau.stages] = 1.0
    b, y = at_end(tableau), 1.0 - x
    rows = [b, first - b, 2.0 * b - first - last, *tableau.dense]
    total = np.zeros(len(b))
    for k in reversed(range(len(rows))):
        total = rows[k] + (x if k % 2 else y) * total
    return np.asarray(x * total)


def test_trees() -> None:
    """As many as Cayley counted; densities of the four with four nodes."""
    assert [len(trees(order)) for order in range(1, 10)] == [1, 1, 2, 4, 9, 20, 48, 115, 286]
    assert sorted(map(density, trees(4))) == [4, 8, 12, 24]


@pytest.mark.parametrize("kind", EXPLICIT)
def test_order_conditions(kind: type[Explicit]) -> None:
    """Met to the order that is claimed, and not beyond it."""
    tableau, claimed = kind.tableau(), kind(1e-3, 1e-3)
    A, b = tableau.A, at_end(tableau)
    for order in range(1, claimed.order + 1):
        assert misses(A, b, order) < 1e-13
    assert misses(A, b, claimed.order + 1) > 1e-6


@pytest.mark.parametrize("kind", EXPLICIT)
def test_order_conditions_of_the_dense_output(kind: type[Explicit]) -> None:
    """Met to the order that is claimed, at any part of a step, and not beyond it."""
    tableau, claimed = kind.tableau(), kind(1e-3, 1e-3)
    for x in (0.0, 0.1, 0.37, 0.5, 0.81, 1.0):
        b = at_part(tableau, x)
        for order in range(1, claimed.dense_order + 1):
            assert misses(tableau.A, b, order, x) < 1e-13
    assert misses(tableau.A, at_part(tableau, 0.5), claimed.dense_order + 1, 0.5) > 1e-6


@pytest.mark.parametrize(("kind", "orders"), [(DOP853, (5, 3)), (Tsit5, (4,))])
def test_order_conditions_of_the_errors(kind: type[Explicit], orders: tuple[int, ...]) -> None:
    """Errors are differences to methods of these orders."""
    tableau = kind.tableau()
    assert len(tableau.errors) == len(orders)
    for row, order in zip(tableau.errors, orders, strict=True):
        error = np.zeros(len(tableau.A))
        error[: len(row)] = row
        for lower in range(1, order + 1):
            assert misses(tableau.A, at_end(tableau) - error, lower) < 1e-13
        assert misses(tableau.A, at_end(tableau) - error, order + 1) > 1e-6


def test_the_interpolant_of_tsitouras() -> None:
    """As the paper has it: the weights of the first, second and last rate are polynomials."""
    for x in (0.2, 0.5, 0.9):
        b = at_part(Tsit5.tableau(), x)
        paper = {
            0: x + x * x * (-2.763706197274826 + x * (2.9132554618219126 - 1.0530884977290216 * x)),
            1: x * x * (0.1317 + x * (-0.2234 + x * 0.1017)),
            6: x * x * (1.5 + x * (-4.0 + 2.5 * x)),
        }  # fmt: skip
        for k, weight in paper.items():
            assert b[k] == pytest.approx(weight, abs=1e-14)


def test_no_stage_is_evaluated_for_a_zero() -> None:
    """SciPy's copy and ours: as many stages as the methods are known for."""
    assert (DOP853.tableau().stages, len(DOP853.tableau().A)) == (12, 16)
    assert (Tsit5.tableau().stages, len(Tsit5.tableau().A)) == (6, 7)
    assert DOP853.tableau() is DOP853.tableau()
    with pytest.raises(ValueError, match="read-only"):
        Tsit5.tableau().A[1, 0] = 0.0


def test_what_is_no_tableau() -> None:
    """Sums of weights, shapes, weights that are not there yet."""
    right = Tsit5.tableau()
    A, errors, dense = right.A, right.errors, right.dense
    later, longer, shifted = A.copy(), A.copy(), errors.copy()
    later[2, 2], longer[6, 1], shifted[0, 3] = 0.1, 0.011, errors[0, 3] + 1e-6
    for changes, message in (
        ({"A": later}, "zero from its diagonal on"),
        ({"A": A[:6]}, "A must be square"),
        ({"A": longer}, "the end must add up to 1"),
        ({"errors": shifted}, "errors must add up to 0"),
        ({"errors": errors[0]}, "errors must have shape"),
        ({"errors": np.vstack([errors] * 3)}, "errors must have shape"),
        ({"errors": 0.0 * errors}, "not zero"),
        ({"dense": dense[:, :-1]}, "dense must have shape"),
        ({"dense": dense + 1e-6}, "dense must add up to 0"),
    ):
        with pytest.raises(InputError, match=message):
            replace(right, **changes)
