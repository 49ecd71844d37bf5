"""First roots of polynomials in Bernstein form, whose coefficients can exclude roots."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import comb

import numpy as np

from ..common.arrays import Array

_NEWTON = 0.6  # Largest part of a step in which a single root is polished.
_MOST_NEWTON, _SAME = 100, 4e-16  # Steps for a root, and the change at which it is found.


@cache
def bernstein(degree: int) -> tuple[Array, Array]:
    """Return nodes in [0, 1] and the matrix from values there to Bernstein coefficients.

    Args:
        degree: Degree of the polynomials.
    Returns:
        Nodes, (degree + 1,), and the matrix, (degree + 1, degree + 1).
    """
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
    basis = [comb(degree, k) * nodes**k * (1.0 - nodes) ** (degree - k) for k in range(degree + 1)]
    return nodes, np.asarray(np.linalg.inv(np.array(basis).T))


def first_root(coefficients: Array) -> float | None:
    """Return the first point of [0, 1] where a polynomial falls to zero, or None.

    The polynomial is divided by de Casteljau's algorithm until one part has a single change of
    sign. Bernstein coefficients of one sign exclude a root.

    Args:
        coefficients: Bernstein coefficients, (degree + 1,); the first one is positive.
    Returns:
        The root, or None.
    """
    parts = [(0.0, 1.0, coefficients)]
    while parts:
        a, b, c = parts.pop()
        if (c > 0.0).all():
            continue
        middle = 0.5 * (a + b)
        if not a < middle < b:
            return a
        changes = np.count_nonzero(np.diff(np.signbit(c)))
        if changes == 1 and c[0] > 0.0 and c[-1] < 0.0 and b - a < _NEWTON:
            return a + (b - a) * _polish(c)
        left, right = _halves(c)
        parts += [(middle, b, right), (a, middle, left)]
    return None


def _halves(c: Array) -> tuple[Array, Array]:
    """Return the Bernstein coefficients of a polynomial on both halves of its interval."""
    rows = [c]
    while len(rows[-1]) > 1:
        rows.append(0.5 * (rows[-1][:-1] + rows[-1][1:]))
    return np.array([row[0] for row in rows]), np.array([row[-1] for row in rows[::-1]])


def _polish(c: Array) -> float:
    """Return the only root of a polynomial in [0, 1] by Newton's method with bisection.

    Args:
        c: Bernstein coefficients; the first one is positive, the last one negative.
    """
    values, degree = c.tolist(), len(c) - 1
    low, high, s = 0.0, 1.0, float(c[0] / (c[0] - c[-1]))
    for _ in range(_MOST_NEWTON):
        value, slope = _at(values, s, degree)
        low, high = (s, high) if value > 0.0 else (low, s)
        new = s - value / slope if slope < 0.0 else np.inf
        if abs(new - s) <= _SAME:
            return new
        if not low < new < high:
            new = 0.5 * (low + high)
        s = new
    return s


def _at(coefficients: list[float], s: float, degree: int) -> tuple[float, float]:
    """Evaluate a polynomial and its derivative at s from its Bernstein coefficients."""
    row, r = coefficients, 1.0 - s
    for _ in range(degree - 1):
        row = [r * a + s * b for a, b in pairwise(row)]
    first, last = row
    return r * first + s * last, degree * (last - first)
