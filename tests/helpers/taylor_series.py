"""Taylor series with 30 digits: products of series, and two free bodies joined at their centres."""

from __future__ import annotations

from decimal import Decimal, localcontext
from typing import Any

import numpy as np

ORDER, DIGITS = 26, 30
Series = list[list[Decimal]]  # Taylor coefficients of several entries, [entry][power]


def decimals(values: Any) -> list[Decimal]:
    """Return the exact values of floats."""
    return [Decimal(float(value)) for value in values]


def dot(a: list[Decimal], b: list[Decimal]) -> Decimal:
    """Return the inner product."""
    return sum((p * q for p, q in zip(a, b, strict=True)), Decimal(0))


def product(a: list[Decimal], b: list[Decimal], n: int) -> Decimal:
    """Return Taylor coefficient n of a product."""
    return sum((a[k] * b[n - k] for k in range(n + 1)), Decimal(0))


def cross(a: Series, b: Series, n: int) -> list[Decimal]:
    """Return Taylor coefficient n of a cross product."""
    pairs = ((1, 2), (2, 0), (0, 1))
    return [product(a[j], b[k], n) - product(a[k], b[j], n) for j, k in pairs]


def half_product(q: Series, v: Series, n: int, *, after: bool) -> list[Decimal]:
    """Return coefficient n of ½ q ∘ v, or of ½ v ∘ q, for a quaternion q (x, y, z, w)."""
    turn = cross(q[:3], v, n) if after else cross(v, q[:3], n)
    along = [product(q[3], c, n) + t for c, t in zip(v, turn, strict=True)]
    real = -sum((product(c, e, n) for c, e in zip(q[:3], v, strict=True)), Decimal(0))
    return [c / 2 for c in (*along, real)]


def sum_at(series: Series, h: Decimal) -> list[Decimal]:
    """Return the values of series at a time."""
    return [sum((c * h**k for k, c in enumerate(column)), Decimal(0)) for column in series]


def two_bodies(
    moments: Any, omegas: Any, attitudes: Any, stiffness: float, times: Any, step: float = 0.06
) -> np.ndarray:
    """Integrate two free bodies, joined at their centres of mass by a ball with a cosine spring.

    With the attitude q of the second body relative to the first, of vector part u and real part w,
    the spring of potential k (1 − cos θ) acts on the second body with the moment −2 k w u, and on
    the first with 2 k w u, each in the axes of the body.

    Args:
        moments: Principal moments of inertia, (2, 3) [kg m²].
        omegas: Angular velocities in the axes of the bodies, (2, 3) [rad/s].
        attitudes: Unit quaternions in space, (2, 4).
        stiffness: Stiffness k [N m/rad].
        times: Sorted times, (T,), starting at 0 [s].
        step: Longest step [s].
    Returns:
        Attitudes in space, (T, 2, 4).
    """
    with localcontext() as context:
        context.prec = DIGITS
        I, k = [decimals(row) for row in moments], Decimal(stiffness)
        state: list[Decimal] = []
        for row, omega in zip(I, omegas, strict=True):
            state += [a * b for a, b in zip(row, decimals(omega), strict=True)]
        for attitude in attitudes:
            q = decimals(attitude)
            state += [c / dot(q, q).sqrt() for c in q]
        rows = [state[6:]]
        for duration in np.diff(times).tolist():
            count = int(np.ceil(duration / step))
            for _ in range(count):
                state = _step_of_bodies(state, I, k, Decimal(duration) / count)
            rows.append(state[6:])
        return np.array(rows, dtype=float).reshape(-1, 2, 4)


def _step_of_bodies(
    state: list[Decimal], I: list[list[Decimal]], k: Decimal, h: Decimal
) -> list[Decimal]:
    y: Series = [[c] for c in state]
    w: Series = [[] for _ in range(6)]
    q: Series = [[] for _ in range(4)]  # of the second body relative to the first
    for n in range(ORDER):
        for j in range(6):
            w[j].append(y[j][n] / I[j // 3][j % 3])
        p, r = y[6:10], y[10:]
        between = cross(r[:3], p[:3], n)
        for j in range(3):
            across = product(p[3], r[j], n) - product(r[3], p[j], n)
            q[j].append(across + between[j])
        q[3].append(sum((product(a, b, n) for a, b in zip(p, r, strict=True)), Decimal(0)))
        moment = [2 * k * product(q[3], q[j], n) for j in range(3)]
        rates = [a + b for a, b in zip(cross(y[:3], w[:3], n), moment, strict=True)]
        rates += [a - b for a, b in zip(cross(y[3:6], w[3:], n), moment, strict=True)]
        rates += half_product(p, w[:3], n, after=True) + half_product(r, w[3:], n, after=True)
        for column, rate in zip(y, rates, strict=True):
            column.append(rate / (n + 1))
    return sum_at(y, h)
