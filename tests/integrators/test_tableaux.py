"""Tableaux of explicit methods, by Butcher's order conditions on rooted trees."""

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
from pinred.integrators.explicit.runge_kutta import Tableau
from pinred.integrators.methods import DOP853, METHODS, Explicit, Tsit5

EXPLICIT = [kind for kind in METHODS.values() if issubclass(kind, Explicit)]
Tree: TypeAlias = tuple[Any, ...]  # of its branches


@cache
def forests(nodes: int, largest: int) -> list[Tree]:
    """Return multisets of rooted trees with `nodes` nodes in all, each at most `largest`."""
    if nodes == 0:
        return [()]
    multisets = []
    for size in range(min(nodes, largest), 0, -1):
        for count in range(nodes // size, 0, -1):
            for chosen in combinations_with_replacement(trees(size), count):
                multisets += [
                    chosen + remaining for remaining in forests(nodes - size * count, size - 1)
                ]
    return multisets


@cache
def trees(order: int) -> list[Tree]:
    """Return the rooted trees with a number of nodes."""
    return forests(order - 1, order - 1)


def size(tree: Tree) -> int:
    """Return the number of nodes of a tree."""
    return 1 + sum(map(size, tree))


def density(tree: Tree) -> int:
    """Return γ of a tree."""
    return size(tree) * prod(map(density, tree))


def weights(A: Array, tree: Tree) -> Array:
    """Return Φ of a tree, for each stage."""
    product = np.ones(len(A))
    for branch in tree:
        product *= A @ weights(A, branch)
    return product


def residual(A: Array, b: Array, order: int, part: float = 1.0) -> float:
    """Return the largest residual of the conditions of an order, at a fraction of the step."""
    goal = {tree: part**order / density(tree) for tree in trees(order)}
    return max(abs(float(b @ weights(A, tree)) - value) for tree, value in goal.items())


def at_end(tableau: Tableau) -> Array:
    """Return the weights of the rates at the end of a step."""
    return np.asarray(tableau.A[tableau.stages])


def at_fraction(tableau: Tableau, x: float) -> Array:
    """Return the weights of the rates at a fraction of a step."""
    first, last = np.zeros((2, len(tableau.A)))
    first[0] = last[tableau.stages] = 1.0
    b, y = at_end(tableau), 1.0 - x
    terms = [b, first - b, 2.0 * b - first - last, *tableau.dense]
    total = np.zeros(len(b))
    for k in reversed(range(len(terms))):
        total = terms[k] + (x if k % 2 else y) * total
    return np.asarray(x * total)


def test_number_and_densities_of_trees() -> None:
    """Cayley's numbers, and the densities of the four trees with four nodes."""
    assert [len(trees(order)) for order in range(1, 10)] == [1, 1, 2, 4, 9, 20, 48, 115, 286]
    assert sorted(map(density, trees(4))) == [4, 8, 12, 24]


@pytest.mark.parametrize("kind", EXPLICIT)
def test_methods_satisfy_exactly_their_order_conditions(kind: type[Explicit]) -> None:
    """Up to the stated order, and not beyond it."""
    tableau, claimed = kind.tableau(), kind(1e-3, 1e-3)
    A, b = tableau.A, at_end(tableau)
    for order in range(1, claimed.order + 1):
        assert residual(A, b, order) < 1e-13
    assert residual(A, b, claimed.order + 1) > 1e-6


@pytest.mark.parametrize("kind", EXPLICIT)
def test_dense_output_satisfies_exactly_its_order_conditions(kind: type[Explicit]) -> None:
    """At any fraction of a step, and not beyond its order."""
    tableau, claimed = kind.tableau(), kind(1e-3, 1e-3)
    for x in (0.0, 0.1, 0.37, 0.5, 0.81, 1.0):
        b = at_fraction(tableau, x)
        for order in range(1, claimed.dense_order + 1):
            assert residual(tableau.A, b, order, x) < 1e-13
    assert residual(tableau.A, at_fraction(tableau, 0.5), claimed.dense_order + 1, 0.5) > 1e-6


@pytest.mark.parametrize(("kind", "orders"), [(DOP853, (5, 3)), (Tsit5, (4,))])
def test_error_estimates_have_their_orders(kind: type[Explicit], orders: tuple[int, ...]) -> None:
    """Errors are differences to methods of these orders."""
    tableau = kind.tableau()
    assert len(tableau.errors) == len(orders)
    for error_weights, order in zip(tableau.errors, orders, strict=True):
        error = np.zeros(len(tableau.A))
        error[: len(error_weights)] = error_weights
        for lower in range(1, order + 1):
            assert residual(tableau.A, at_end(tableau) - error, lower) < 1e-13
        assert residual(tableau.A, at_end(tableau) - error, order + 1) > 1e-6


def test_interpolant_of_tsitouras_equals_paper() -> None:
    """The weights of the first, second and last rate are polynomials."""
    for x in (0.2, 0.5, 0.9):
        b = at_fraction(Tsit5.tableau(), x)
        paper = {
            0: x + x * x * (-2.763706197274826 + x * (2.9132554618219126 - 1.0530884977290216 * x)),
            1: x * x * (0.1317 + x * (-0.2234 + x * 0.1017)),
            6: x * x * (1.5 + x * (-4.0 + 2.5 * x)),
        }  # fmt: skip
        for k, weight in paper.items():
            assert b[k] == pytest.approx(weight, abs=1e-14)


def test_tableaus_have_known_numbers_of_stages() -> None:
    """Zeros of a tableau cost no evaluation; stages are as in the literature."""
    assert (DOP853.tableau().stages, len(DOP853.tableau().A)) == (12, 16)
    assert (Tsit5.tableau().stages, len(Tsit5.tableau().A)) == (6, 7)
    assert DOP853.tableau() is DOP853.tableau()
    with pytest.raises(ValueError, match="read-only"):
        Tsit5.tableau().A[1, 0] = 0.0


def test_invalid_tableaus_are_rejected() -> None:
    """Wrong sums, wrong shapes, and weights of later rates."""
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
