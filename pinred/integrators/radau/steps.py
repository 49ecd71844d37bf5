"""Radau IIA of order 5 over a kernel and its derivative: for hard springs and strong dampers.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., Springer 1996,
section IV.8, and Hairer's code radau5.f, whose step control and constants are used here.  The
coefficients are SciPy's copy.  The Jacobian is exact and cheap beside its factors, so that it
is new whenever these are.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from scipy.integrate._ivp import radau as tableau

from ...common.arrays import Array
from ..dop853 import TURN
from ..machine.kernel_call import SEEDS, call, compiled
from ..machine.newton import factor, factor_complex, jacobian, solve, solve_complex
from ..machine.registers import (
    AGAIN,
    ATOL,
    BEFORE,
    BEGUN,
    BUDGET,
    CONTRACTION,
    CONVERGENCE,
    CUT,
    DONE,
    ENTRY,
    ERROR,
    EVALUATIONS,
    FACTORED,
    FRESH,
    FULL,
    KEEP,
    MAX_STEP,
    MAX_STEPS,
    NOT_FINITE,
    PAUSED,
    QUATERNION,
    REJECTED,
    RTOL,
    STEPS,
    T_END,
    TANGENT,
    TOO_MANY,
    UNDERFLOW,
    WANTED,
    Counts,
    H,
    N,
    T,
    first_not_finite,
    unit,
)
from .dense import (
    ALONG,
    END_RATE,
    GAMMA,
    MATRIX,
    NEW,
    PIVOTS,
    RATE,
    SLOPES,
    Y,
    Z,
    between,
    keep,
    report,
)

# Rows of `work` besides those of radau_dense.py.  W: stages in the coordinates in which the
# matrix of the method is diagonal; F: rates at the stages, then what is solved; OLD: Z of the
# step before.
SCALE, STAGE, W, F, OLD, MISS = 3, END_RATE, 8, 11, 14, 17

_C1, _C2 = float(tableau.C[0]), float(tableau.C[1])
_T, _TI = tableau.T, tableau.TI
_E1, _E2, _E3 = (float(e) for e in tableau.E)
_ALPHA, _BETA = float(tableau.MU_COMPLEX.real), float(tableau.MU_COMPLEX.imag)
_EPS = float(np.finfo(float).eps)

_MOST = 7  # turns of Newton's method
_SAFETY, _SHRINK, _GROW, _CRASH, _HALF = 0.9, 0.2, 8.0, 0.1, 0.5
_FAST = 1e-2  # contraction that lets the factors serve for the next step, too
_SAME = 1.2  # a step that might be so much longer keeps its length, and the factors


@compiled
def advance(
    address: int,
    params: Array,
    real: Array,
    count: Counts,
    work: Array,
    times: Array,
    out: Array,
    knots_t: Array,
    knots_y: Array,
) -> int:
    """Integrate until the end, a pause, a full store of knots or a failure; return which.

    Arguments as in dop853.advance; knots_y: (K, KEPT n).  WANTED if there is no derivative yet.
    """
    n, quaternion = count[N], count[QUATERNION]
    if count[TANGENT] == 0:
        return WANTED
    if not count[BEGUN]:
        keep(count, work, 0.0, knots_t, knots_y)
        call(address, work[Y], params, work[RATE])
        count[EVALUATIONS] += 1
        unit(work[Y], work[RATE], quaternion)
        count[ENTRY] = first_not_finite(work[RATE], n)
        if count[ENTRY] >= 0:
            return NOT_FINITE
        real[H], real[CONVERGENCE] = _first_step(real, count, work), 1.0
        count[BEGUN] = 1
        report(params, real, count, work, times, out, 0.0)
    pause = count[EVALUATIONS] + count[BUDGET]
    while real[T] < real[T_END]:
        if count[EVALUATIONS] >= pause:
            return PAUSED
        if count[KEEP] and count[STEPS] + 1 >= knots_t.shape[0]:
            return FULL
        if count[STEPS] + count[REJECTED] >= count[MAX_STEPS]:
            return TOO_MANY
        t, h = real[T], real[H]
        if 0.1 * h <= _EPS * t:
            return NOT_FINITE if count[ENTRY] >= 0 else UNDERFLOW
        t_new = real[T_END] if t + 1.0001 * h >= real[T_END] else t + h
        h = t_new - t
        if abs(h - real[FACTORED]) > 1e-9 * h:
            pause -= n * n // 8  # of evaluations, which factors cost
            if not _prepare(params, real, count, work, h):
                _reject(real, count, h * _HALF)
                continue
        turns = _newton(address, params, real, count, work, h)
        if turns == 0:
            _reject(real, count, h * (_CRASH if count[ENTRY] >= 0 else real[CUT]))
            continue
        error = _error(address, params, count, work, h)
        # Fewer turns of Newton's method: more trust in the error.
        trust = min(_SAFETY, _SAFETY * (1 + 2 * _MOST) / (turns + 2 * _MOST))
        quotient = min(1.0 / _SHRINK, max(1.0 / _GROW, sqrt(sqrt(error)) / trust))
        accepted = error < 1.0
        if accepted:
            call(address, work[NEW], params, work[STAGE])
            count[EVALUATIONS] += 1
            entry = first_not_finite(work[STAGE], n)
            if entry >= 0:
                count[ENTRY] = entry
                _reject(real, count, h * _CRASH)
                continue
            report(params, real, count, work, times, out, t_new)
            count[STEPS] += 1
            keep(count, work, t_new, knots_t, knots_y)
            for i in range(n):
                work[Y, i] = work[NEW, i]
                work[RATE, i] = work[STAGE, i]
                for k in range(3):
                    work[OLD + k, i] = work[Z + k, i]
            unit(work[Y], work[RATE], quaternion)
            if real[BEFORE] > 0.0:  # Gustafsson's predictive control
                root = sqrt(sqrt(error * error / real[ERROR]))
                predicted = h / real[BEFORE] * root / _SAFETY
                quotient = max(quotient, min(1.0 / _SHRINK, max(1.0 / _GROW, predicted)))
            real[BEFORE], real[ERROR], real[T] = h, max(1e-2, error), t_new
            new = min(h / quotient, real[MAX_STEP])
            if count[AGAIN]:
                new = min(new, h)
            else:
                count[ENTRY] = -1  # clear of what was not finite
            count[AGAIN], count[FRESH] = 0, 0
            if real[CONTRACTION] <= _FAST and h <= new <= _SAME * h:
                new = h
            else:
                real[FACTORED] = 0.0
            real[H] = new
        elif error < np.inf:
            _reject(real, count, h * _CRASH if count[STEPS] == 0 else h / quotient)
        else:
            _reject(real, count, h * _CRASH)
    return DONE


@compiled
def _reject(real: Array, count: Counts, h: float) -> None:
    """Try again with a shorter step."""
    count[REJECTED] += 1
    count[AGAIN] = 1
    real[H], real[FACTORED] = h, 0.0


@compiled
def _prepare(params: Array, real: Array, count: Counts, work: Array, h: float) -> bool:
    """Factor the two systems of a step h; return whether that was possible."""
    n = count[N]
    parts, imag, one = MATRIX + 2 * n, MATRIX + 3 * n, MATRIX + n
    if not count[FRESH]:
        seeds, slopes = work[ALONG:SLOPES], work[SLOPES:MATRIX]
        jacobian(count[TANGENT], work[Y], params, seeds, slopes, work, MATRIX, n)
        count[EVALUATIONS] += (n + SEEDS - 1) // SEEDS
        count[FRESH] = 1
    for i in range(n):
        for j in range(n):
            slope = -h * work[MATRIX + i, j]
            work[one + i, j], work[parts + i, j], work[imag + i, j] = slope, slope, 0.0
        work[one + i, i] += GAMMA
        work[parts + i, i] += _ALPHA
        work[imag + i, i] = _BETA
    real[FACTORED] = h
    return factor(work, one, n, work[PIVOTS]) and factor_complex(
        work, parts, imag, n, work[PIVOTS + 1]
    )


@compiled
def _tolerances(real: Array) -> tuple[float, float]:
    """Return what the error estimate, of order 3, has to keep for an error of the tolerance."""
    relative = 0.1 * real[RTOL] ** (2.0 / 3.0)
    return relative, relative * real[ATOL] / real[RTOL]


@compiled
def _measure(real: Array, count: Counts, work: Array) -> None:
    """Fill row SCALE with what an entry is divided by, inverse."""
    n, quaternion = count[N], count[QUATERNION]
    rtol, atol = _tolerances(real)
    for i in range(n):
        size = abs(work[Y, i])
        if 0 <= i - quaternion < 4 and quaternion >= 0:
            size = TURN
        work[SCALE, i] = 1.0 / (atol + rtol * size)


@compiled
def _newton(address: int, params: Array, real: Array, count: Counts, work: Array, h: float) -> int:
    """Find the stages; return the turns, or 0, with what the step is to be cut by in CUT."""
    n = count[N]
    one, parts, imag = MATRIX + n, MATRIX + 2 * n, MATRIX + 3 * n
    _measure(real, count, work)
    _guess(work, n, h / real[BEFORE] if real[BEFORE] > 0.0 else 0.0)
    rtol, _ = _tolerances(real)
    enough = max(10.0 * _EPS / rtol, min(0.03, sqrt(rtol)))
    left = max(real[CONVERGENCE], _EPS) ** 0.8
    contraction, before, part_before = _FAST, 0.0, 0.0
    count[ENTRY] = count[ENTRY] if count[AGAIN] else -1
    real[CUT] = _HALF
    for turn in range(1, _MOST + 1):
        for k in range(3):
            for i in range(n):
                work[STAGE, i] = work[Y, i] + work[Z + k, i]
            call(address, work[STAGE], params, work[F + k])
            entry = first_not_finite(work[F + k], n)
            if entry >= 0:
                count[ENTRY] = entry
                return 0
        count[EVALUATIONS] += 3
        _residual(work, n, h)
        solve(work, one, n, work[PIVOTS], work[F])
        solve_complex(work, parts, imag, n, work[PIVOTS + 1], work[F + 1], work[F + 2])
        total = 0.0
        for k in range(3):
            for i in range(n):
                total += (work[F + k, i] * work[SCALE, i]) ** 2
        size = sqrt(total / (3 * n))
        if not size < np.inf:
            return 0
        if turn > 1:
            part = size / before
            contraction = part if turn == 2 else sqrt(part * part_before)
            part_before = part
            if contraction >= 0.99:
                return 0
            left = contraction / (1.0 - contraction)
            still = left * size * contraction ** (_MOST - 1 - turn) / enough
            if still >= 1.0:
                much = max(1e-4, min(20.0, still))
                real[CUT] = 0.8 * much ** (-1.0 / (4 + _MOST - 1 - turn))
                return 0
        before = max(size, _EPS)
        _move(work, n)
        if left * size <= enough:
            real[CONTRACTION], real[CONVERGENCE] = contraction, left
            for i in range(n):
                work[NEW, i] = work[Y, i] + work[Z + 2, i]
            return turn
    return 0


@compiled
def _residual(work: Array, n: int, h: float) -> None:
    """Turn rates at the stages, F, into right-hand sides."""
    for i in range(n):
        a, b, c = h * work[F, i], h * work[F + 1, i], h * work[F + 2, i]
        u, v, w = work[W, i], work[W + 1, i], work[W + 2, i]
        work[F, i] = _TI[0, 0] * a + _TI[0, 1] * b + _TI[0, 2] * c - GAMMA * u
        work[F + 1, i] = _TI[1, 0] * a + _TI[1, 1] * b + _TI[1, 2] * c - _ALPHA * v + _BETA * w
        work[F + 2, i] = _TI[2, 0] * a + _TI[2, 1] * b + _TI[2, 2] * c - _BETA * v - _ALPHA * w


@compiled
def _move(work: Array, n: int) -> None:
    """Add the solutions in F to W, and renew Z."""
    for i in range(n):
        for k in range(3):
            work[W + k, i] += work[F + k, i]
        u, v, w = work[W, i], work[W + 1, i], work[W + 2, i]
        for k in range(3):
            work[Z + k, i] = _T[k, 0] * u + _T[k, 1] * v + _T[k, 2] * w


@compiled
def _guess(work: Array, n: int, ratio: float) -> None:
    """Fill Z and W by the polynomial of the step before; ratio: of the lengths, 0 for none."""
    for i in range(n):
        a, b, c = work[OLD, i], work[OLD + 1, i], work[OLD + 2, i]
        if ratio == 0.0:
            a, b, c = 0.0, 0.0, 0.0
        u = between(a, b, c, 1.0 + ratio * _C1) - c
        v = between(a, b, c, 1.0 + ratio * _C2) - c
        w = between(a, b, c, 1.0 + ratio) - c
        work[Z, i], work[Z + 1, i], work[Z + 2, i] = u, v, w
        for k in range(3):
            work[W + k, i] = _TI[k, 0] * u + _TI[k, 1] * v + _TI[k, 2] * w


@compiled
def _error(address: int, params: Array, count: Counts, work: Array, h: float) -> float:
    """Return the estimated error of a step in units of the tolerance (IV.8.19 and 8.20)."""
    n = count[N]
    for i in range(n):
        stages = _E1 * work[Z, i] + _E2 * work[Z + 1, i] + _E3 * work[Z + 2, i]
        work[F, i] = stages
        work[MISS, i] = stages + h * work[RATE, i]
    solve(work, MATRIX + n, n, work[PIVOTS], work[MISS])
    error = _size(work, n)
    if error >= 1.0 and (count[STEPS] == 0 or count[AGAIN]):
        for i in range(n):
            work[STAGE, i] = work[Y, i] + work[MISS, i]
        call(address, work[STAGE], params, work[MISS])
        count[EVALUATIONS] += 1
        for i in range(n):
            work[MISS, i] = work[F, i] + h * work[MISS, i]
        solve(work, MATRIX + n, n, work[PIVOTS], work[MISS])
        error = _size(work, n)
    return max(error, 1e-10) if error < np.inf else np.inf


@compiled
def _size(work: Array, n: int) -> float:
    """Return the size of row MISS in tolerances, in the mean."""
    total = 0.0
    for i in range(n):
        total += (work[MISS, i] * work[SCALE, i]) ** 2
    return sqrt(total / n)


@compiled
def _first_step(real: Array, count: Counts, work: Array) -> float:
    """Return the first step: a part of the time in which the state changes by its size."""
    n, quaternion, least = count[N], count[QUATERNION], real[ATOL] / real[RTOL]
    rate = 0.0
    for i in range(n):
        scale = least + (TURN if 0 <= i - quaternion < 4 and quaternion >= 0 else abs(work[Y, i]))
        rate += (work[RATE, i] / scale) ** 2
    longest: float = min(real[T_END], real[MAX_STEP])
    return min(longest, 0.01 * sqrt(n / rate)) if rate > 0.0 else longest
