"""Radau IIA of order 5 over a kernel and its derivative, for hard springs and strong dampers.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., Springer 1996,
section IV.8, and Hairer's code radau5.f, with its step control and constants. Evaluating the
exact Jacobian is cheap compared with factorising the systems, so the Jacobian is recomputed before
every factorisation.

The inverse of the method's matrix is T Λ T⁻¹ with a real eigenvalue and a conjugate pair. The
coefficients are those of SciPy, whose module takes long to import.

A step end is stored as the state before its quaternions are normalised, followed by the stages of
the step. Dense output from stored steps thus equals the dense output during the run bit for bit.

The polynomial through the stages has order 3 only. Corrections from ẏ and ÿ at the ends, computed
with the exact Jacobian, raise it to order 5. In stiff directions ẏ and ÿ amplify errors by hλ and
(hλ)². Filters remove these directions and are 1 − O(h³) in others: 1 − (1 − F)³ with
F = (1 − hJ/γ)⁻¹, which decreases as 1/(hλ), for ẏ, and its square for ÿ.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import compiled, inlined
from ..stepping.intrinsics import SEEDS, call, call_tangent
from ..stepping.linear_systems import factor, factor_complex, finite_jacobian, solve, solve_complex
from ..stepping.run_state import (
    DENSE,
    DONE,
    NEW,
    NOT_FINITE,
    Run,
    Y,
    copy_an_end,
    entry_size,
    first_not_finite,
    first_step_by_rate,
    quaternions_of,
    reject_step,
    unit,
    unit_alone,
)
from ..stepping.step_loop import Hooks, Stepper, loops

_S6 = 6**0.5

C1, C2 = (4 - _S6) / 10, (4 + _S6) / 10  # times of the stages; the last stage is the end
E1, E2, E3 = (float(e) for e in np.array([-13 - 7 * _S6, -13 + 7 * _S6, -1]) / 3)  # error weights
# The C library computes powers, whose last digit may differ between platforms, and with it the key
# of the shipped bitcode.
_CUBE_ROOT, _CUBE_ROOT_SQUARED = 1.4422495703074083, 2.080083823051904  # of 3
GAMMA = 3 + _CUBE_ROOT_SQUARED - _CUBE_ROOT  # real eigenvalue
# Real and imaginary part of an eigenvalue of the pair.
ALPHA = 3 + 0.5 * (_CUBE_ROOT - _CUBE_ROOT_SQUARED)
BETA = -0.5 * (2.498049532966813 + 3.6028108655280087)  # of 3^(5/6) and 3^(7/6)
T = np.array(
    [
        [0.09443876248897524, -0.14125529502095421, 0.03002919410514742],
        [0.25021312296533332, 0.20412935229379994, -0.38294211275726192],
        [1.0, 1.0, 0.0],
    ]
)
T_INVERSE = np.array(
    [
        [4.17871859155190428, 0.32768282076106237, 0.52337644549944951],
        [-4.17871859155190428, -0.32768282076106237, 0.47662355450055044],
        [0.50287263494578682, -2.57192694985560522, 0.59603920482822492],
    ]
)

# Rows of `work`: rates at both ends of a step; stages minus the state; corrections at the ends;
# free rows; rows of Newton's method and of the Jacobian.
RATE, END_RATE, Z, CORRECTION, FREE, PIVOTS, ALONG = 2, 4, 5, 8, 11, 18, 21
SLOPES = ALONG + SEEDS
MATRIX = SLOPES + SEEDS  # the Jacobian, three systems of a step, and one of the corrections
KEPT = 4  # number of floats stored at a step end per entry of the state
# Rows of attempted steps. W: stages in the coordinates that diagonalise the matrix of the method.
# F: stage rates, then right-hand sides and solutions. OLD: stages Z of the previous step, relative
# to its initial state. MISS: error estimate.
SCALE, STAGE, W, F, OLD, MISS = 3, END_RATE, 8, 11, 14, 17
_EPS = float(np.finfo(float).eps)

_MOST = 7  # largest number of Newton iterations per stage solve
_SAFETY, _SHRINK, _GROW, _CRASH, _HALF = 0.9, 0.2, 8.0, 0.1, 0.5
_FAST = 1e-2  # contraction of Newton's method below which the next step reuses the factorisation
_SAME = 1.2  # growth of the step length below which the length is kept, to reuse the factorisation


@inlined
def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:
    """Evaluate the initial rates and choose the first step (hook of the step loop)."""
    store_end(run, work, 0.0, end_times, end_states)
    call(run.address, work[Y], params, work[RATE])
    run.evaluations += 1
    unit(work[Y], work[RATE], quaternions_of(run))
    run.entry = first_not_finite(work[RATE], run.n)
    if run.entry >= 0:
        return NOT_FINITE
    run.h, run.convergence = first_step_by_rate(run, work[Y], work[RATE], 1, 0.01), 1.0
    return DONE


@inlined
def next_end_time(run: Run) -> float:
    """Return t + h, or the end time if it is almost reached (hook)."""
    return run.t_end if run.t + 1.0001 * run.h >= run.t_end else run.t + run.h


@inlined
def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:
    """Solve the stages by Newton's method and estimate the error (hook)."""
    n, h = run.n, t_new - run.t
    if abs(h - run.factored) > 1e-9 * h:
        run.pause -= n * n // 8  # number of evaluations that cost as much as the factorisation
        if not _prepare(run, params, work, h):
            return reject_step(run, h * _HALF)
    iterations = _newton(run, params, work, h)
    if iterations == 0:
        return reject_step(run, h * (_CRASH if run.entry >= 0 else run.cut))
    run.error = _error(run, params, work, h)
    # The safety factor is larger if Newton's method converged quickly.
    safety = min(_SAFETY, _SAFETY * (1 + 2 * _MOST) / (iterations + 2 * _MOST))
    run.quotient = min(1.0 / _SHRINK, max(1.0 / _GROW, sqrt(sqrt(run.error)) / safety))
    if run.error < 1.0:
        call(run.address, work[NEW], params, work[STAGE])
        run.evaluations += 1
        entry = first_not_finite(work[STAGE], n)
        if entry < 0:
            return DONE
        run.entry = entry
        return reject_step(run, h * _CRASH)
    if run.error < np.inf and run.steps > 0:
        return reject_step(run, h / run.quotient)
    return reject_step(run, h * _CRASH)


@inlined
def accept_step(run: Run, work: Array, t_new: float) -> None:
    """Continue from the end of the step, and choose the next length (hook)."""
    h, quotient = t_new - run.t, run.quotient
    for i in range(run.n):
        work[Y, i] = work[NEW, i]
        work[RATE, i] = work[STAGE, i]
        for k in range(3):
            work[OLD + k, i] = work[Z + k, i]
    unit(work[Y], work[RATE], quaternions_of(run))
    if run.before > 0.0:  # Gustafsson's predictive control
        root = sqrt(sqrt(run.error * run.error / run.error_before))
        predicted = h / run.before * root / _SAFETY
        quotient = max(quotient, min(1.0 / _SHRINK, max(1.0 / _GROW, predicted)))
    run.before, run.error_before = h, max(1e-2, run.error)
    new = min(h / quotient, run.max_step)
    if run.again:
        new = min(new, h)
    else:
        run.entry = -1  # the accepted step is finite, so an earlier non-finite entry is obsolete
    run.again, run.fresh = 0, 0
    if run.contraction <= _FAST and h <= new <= _SAME * h:
        new = h
    else:
        run.factored = 0.0
    run.h = new


@compiled
def _prepare(run: Run, params: Array, work: Array, h: float) -> bool:
    """Factorise the two linear systems of a step of length h; return whether both are regular."""
    n = run.n
    real, imag, first = MATRIX + 2 * n, MATRIX + 3 * n, MATRIX + n
    if not run.fresh:
        seeds, slopes = work[ALONG:SLOPES], work[SLOPES:MATRIX]
        finite_jacobian(run, work[Y], params, seeds, slopes, work, MATRIX, n)
        run.evaluations += (n + SEEDS - 1) // SEEDS
        run.fresh = 1
    for i in range(n):
        for j in range(n):
            slope = -h * work[MATRIX + i, j]
            work[first + i, j], work[real + i, j], work[imag + i, j] = slope, slope, 0.0
        work[first + i, i] += GAMMA
        work[real + i, i] += ALPHA
        work[imag + i, i] = BETA
    run.factored = h
    return factor(work, first, n, work[PIVOTS]) and factor_complex(
        work, real, imag, n, work[PIVOTS + 1]
    )


@compiled
def _tolerances(run: Run) -> tuple[float, float]:
    """Return rtol and atol for the error estimate.

    The estimate is of order 3, the method of order 5. The returned tolerances are converted so that
    the error of the method meets the tolerances of the run.
    """
    relative = 0.1 * run.rtol ** (2.0 / 3.0)
    return relative, relative * run.atol / run.rtol


@compiled
def _measure(run: Run, work: Array) -> None:
    """Set row SCALE to the reciprocal of each entry's tolerance."""
    n, quaternions = run.n, quaternions_of(run)
    rtol, atol = _tolerances(run)
    for i in range(n):
        work[SCALE, i] = 1.0 / (atol + rtol * entry_size(work[Y], i, quaternions))


@compiled
def _newton(run: Run, params: Array, work: Array, h: float) -> int:
    """Return the number of Newton iterations that solve the stages, 0 for failure.

    After a failure, run.cut contains the factor that shortens the step.
    """
    n = run.n
    first, real, imag = MATRIX + n, MATRIX + 2 * n, MATRIX + 3 * n
    _measure(run, work)
    _guess(work, n, h / run.before if run.before > 0.0 else 0.0)
    rtol, _ = _tolerances(run)
    enough = max(10.0 * _EPS / rtol, min(0.03, sqrt(rtol)))
    error_factor = max(run.convergence, _EPS) ** 0.8
    contraction, previous, last_ratio = _FAST, 0.0, 0.0
    run.entry = run.entry if run.again else -1
    run.cut = _HALF
    for iteration in range(1, _MOST + 1):
        for k in range(3):
            for i in range(n):
                work[STAGE, i] = work[Y, i] + work[Z + k, i]
            call(run.address, work[STAGE], params, work[F + k])
            run.evaluations += 1
            entry = first_not_finite(work[F + k], n)
            if entry >= 0:
                run.entry = entry
                return 0
        _residual(work, n, h)
        solve(work, first, n, work[PIVOTS], work[F])
        solve_complex(work, real, imag, n, work[PIVOTS + 1], work[F + 1], work[F + 2])
        total = 0.0
        for k in range(3):
            for i in range(n):
                total += (work[F + k, i] * work[SCALE, i]) ** 2
        size = sqrt(total / (3 * n))
        if not size < np.inf:
            return 0
        if iteration > 1:
            ratio = size / previous
            contraction = ratio if iteration == 2 else sqrt(ratio * last_ratio)
            last_ratio = ratio
            if contraction >= 0.99:
                return 0
            error_factor = contraction / (1.0 - contraction)
            predicted = error_factor * size * contraction ** (_MOST - 1 - iteration) / enough
            if predicted >= 1.0:
                excess = max(1e-4, min(20.0, predicted))
                run.cut = 0.8 * excess ** (-1.0 / (4 + _MOST - 1 - iteration))
                return 0
        previous = max(size, _EPS)
        _move(work, n)
        if error_factor * size <= enough:
            run.contraction, run.convergence = contraction, error_factor
            for i in range(n):
                work[NEW, i] = work[Y, i] + work[Z + 2, i]
            return iteration
    return 0


@compiled
def _residual(work: Array, n: int, h: float) -> None:
    """Convert the stage rates in F to the right-hand sides of Newton's method, in place."""
    for i in range(n):
        a, b, c = h * work[F, i], h * work[F + 1, i], h * work[F + 2, i]
        u, v, w = work[W, i], work[W + 1, i], work[W + 2, i]
        work[F, i] = T_INVERSE[0, 0] * a + T_INVERSE[0, 1] * b + T_INVERSE[0, 2] * c - GAMMA * u
        work[F + 1, i] = (
            T_INVERSE[1, 0] * a + T_INVERSE[1, 1] * b + T_INVERSE[1, 2] * c - ALPHA * v + BETA * w
        )
        work[F + 2, i] = (
            T_INVERSE[2, 0] * a + T_INVERSE[2, 1] * b + T_INVERSE[2, 2] * c - BETA * v - ALPHA * w
        )


@compiled
def _move(work: Array, n: int) -> None:
    """Add the Newton corrections in F to the transformed stages W, and update the stages Z."""
    for i in range(n):
        for k in range(3):
            work[W + k, i] += work[F + k, i]
        u, v, w = work[W, i], work[W + 1, i], work[W + 2, i]
        for k in range(3):
            work[Z + k, i] = T[k, 0] * u + T[k, 1] * v + T[k, 2] * w


@compiled
def _guess(work: Array, n: int, ratio: float) -> None:
    """Extrapolate the stages Z and W from the previous step.

    `ratio` is the length of this step divided by that of the previous step, or 0 for a first step.
    """
    for i in range(n):
        a, b, c = work[OLD, i], work[OLD + 1, i], work[OLD + 2, i]
        if ratio == 0.0:
            a, b, c = 0.0, 0.0, 0.0
        u = stage_polynomial(a, b, c, 1.0 + ratio * C1) - c
        v = stage_polynomial(a, b, c, 1.0 + ratio * C2) - c
        w = stage_polynomial(a, b, c, 1.0 + ratio) - c
        work[Z, i], work[Z + 1, i], work[Z + 2, i] = u, v, w
        for k in range(3):
            work[W + k, i] = T_INVERSE[k, 0] * u + T_INVERSE[k, 1] * v + T_INVERSE[k, 2] * w


@compiled
def _error(run: Run, params: Array, work: Array, h: float) -> float:
    """Return the estimated error of a step in units of the tolerance (IV.8.19 and 8.20)."""
    n = run.n
    for i in range(n):
        stages = E1 * work[Z, i] + E2 * work[Z + 1, i] + E3 * work[Z + 2, i]
        work[F, i] = stages
        work[MISS, i] = stages + h * work[RATE, i]
    solve(work, MATRIX + n, n, work[PIVOTS], work[MISS])
    error = _size(work, n)
    if error >= 1.0 and (run.steps == 0 or run.again):
        for i in range(n):
            work[STAGE, i] = work[Y, i] + work[MISS, i]
        call(run.address, work[STAGE], params, work[MISS])
        run.evaluations += 1
        for i in range(n):
            work[MISS, i] = work[F, i] + h * work[MISS, i]
        solve(work, MATRIX + n, n, work[PIVOTS], work[MISS])
        error = _size(work, n)
    return max(error, 1e-10) if error < np.inf else np.inf


@compiled
def _size(work: Array, n: int) -> float:
    """Return the root mean square of row MISS in units of the tolerance."""
    total = 0.0
    for i in range(n):
        total += (work[MISS, i] * work[SCALE, i]) ** 2
    return sqrt(total / n)


# --- dense output -------------------------------------------------------------------------------


def _polynomial(c: float, a: float, b: float) -> tuple[float, float, float]:
    """Return the coefficients of u, u² and u³ of the polynomial that is 1 at c, and 0 at 0, a, b.

    NumPy's inverse of a Vandermonde matrix would depend on the processor in the last digit, and
    with it the key of the shipped bitcode.
    """
    scale = c * (c - a) * (c - b)
    return a * b / scale, -(a + b) / scale, 1.0 / scale


# End derivatives of the Lagrange polynomials of the stages, which vanish at 0.  The rows are
# contiguous, because numba compiles the addresses of other arrays instead of their values.
_POWERS = np.ascontiguousarray(
    np.transpose([_polynomial(C1, C2, 1.0), _polynomial(C2, C1, 1.0), _polynomial(1.0, C1, C2)])
)
_SLOPE, _BEND, _LAST_BEND = _POWERS[0], 2.0 * _POWERS[1], 2.0 * _POWERS[1] + 6.0 * _POWERS[2]


@inlined
def store_end(run: Run, work: Array, t: float, end_times: Array, end_states: Array) -> None:
    """Store time, state and stages of a step (hook of the step loop)."""
    if run.keep:
        n, k = run.n, run.steps
        row = NEW if run.begun else Y
        end_times[k] = t
        for i in range(n):
            end_states[k, i] = work[row, i]
            for j in range(3):
                end_states[k, (j + 1) * n + i] = work[Z + j, i]


@inlined
def load_step(run: Run, params: Array, work: Array, t_new: float, stored: Array) -> None:  # noqa: ARG001
    """Restore the stages of a stored step, and evaluate the rates at its ends (hook)."""
    for i in range(run.n):
        for row in range(3):
            work[Z + row, i] = stored[(row + 1) * run.n + i]
    call(run.address, work[Y], params, work[RATE])
    call(run.address, work[NEW], params, work[END_RATE])
    unit(work[Y], work[RATE], quaternions_of(run))


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write a state inside the step, computed with the corrected stage polynomial (hook)."""
    if not copy_an_end(run, work, time, t_new, out):
        if run.known < DENSE:
            run.known = DENSE
            _fill_corrections(run, params, work, t_new - run.t)
        x = (time - run.t) / (t_new - run.t)
        y = 1.0 - x
        by_slope, by_bend, by_last = (
            x * y**3 * (1.0 + 3.0 * x),
            0.5 * x * x * y**3,
            0.5 * x**3 * y * y,
        )
        for i in range(run.n):
            correction = (
                by_slope * work[CORRECTION, i]
                + by_bend * work[CORRECTION + 1, i]
                + by_last * work[CORRECTION + 2, i]
            )
            polynomial = stage_polynomial(work[Z, i], work[Z + 1, i], work[Z + 2, i], x)
            out[i] = work[Y, i] + (polynomial + correction)
    unit_alone(out, quaternions_of(run))
    return DONE


@compiled
def _fill_corrections(run: Run, params: Array, work: Array, h: float) -> None:
    """Compute the corrections of the stage polynomial: hẏ at the start, h²ÿ at both ends."""
    n, system, pivots = run.n, MATRIX + 4 * run.n, work[PIVOTS + 2]
    seeds, slopes = work[ALONG:SLOPES], work[SLOPES:MATRIX]
    directions, second_derivatives = seeds.reshape(-1), slopes.reshape(-1)
    directions[: n * SEEDS] = 0.0
    for i in range(n):
        directions[i * SEEDS] = work[END_RATE, i]
    call_tangent(run.tangent, work[NEW], params, directions, second_derivatives)
    is_finite = True
    for i in range(n):
        work[CORRECTION + 2, i] = h * h * second_derivatives[i * SEEDS]
        is_finite = is_finite and abs(work[CORRECTION + 2, i]) < np.inf
    if not is_finite:
        finite_jacobian(run, work[NEW], params, seeds, slopes, work, MATRIX, n)
        for i in range(n):
            second_derivative = 0.0
            for j in range(n):
                second_derivative += work[MATRIX + i, j] * work[END_RATE, j]
            work[CORRECTION + 2, i] = h * h * second_derivative
    finite_jacobian(run, work[Y], params, seeds, slopes, work, MATRIX, n)
    run.evaluations += 1 + (n + SEEDS - 1) // SEEDS
    for i in range(n):
        second_derivative = 0.0
        for j in range(n):
            second_derivative += work[MATRIX + i, j] * work[RATE, j]
            work[system + i, j] = -h / GAMMA * work[MATRIX + i, j]
        work[system + i, i] += 1.0
        a, b, c = work[Z, i], work[Z + 1, i], work[Z + 2, i]
        work[CORRECTION, i] = h * work[RATE, i] - (_SLOPE[0] * a + _SLOPE[1] * b + _SLOPE[2] * c)
        work[CORRECTION + 1, i] = h * h * second_derivative - (
            _BEND[0] * a + _BEND[1] * b + _BEND[2] * c
        )
        work[CORRECTION + 2, i] -= _LAST_BEND[0] * a + _LAST_BEND[1] * b + _LAST_BEND[2] * c
    if factor(work, system, n, pivots):
        for row in range(3):
            _filter(work, system, n, pivots, work[CORRECTION + row])
            if row > 0:
                _filter(work, system, n, pivots, work[CORRECTION + row])
    else:
        work[CORRECTION : CORRECTION + 3, :n] = 0.0


@compiled
def _filter(work: Array, system: int, n: int, pivots: Array, v: Array) -> None:
    """Replace v by (1 − (1 − F)³) v = 3 F v − 3 F² v + F³ v.

    Args:
        work: Work rows.
        system: First row of the factorised matrix F⁻¹ = 1 − hJ/γ.
        n: Number of entries of the state.
        pivots: Pivots of this factorisation.
        v: Vector, (n,), changed in place.
    """
    power, total = work[FREE], work[FREE + 1]
    for i in range(n):
        power[i], total[i] = v[i], 0.0
    for weight in (3.0, -3.0, 1.0):
        solve(work, system, n, pivots, power)
        for i in range(n):
            total[i] += weight * power[i]
    for i in range(n):
        v[i] = total[i]


@compiled
def stage_polynomial(a: float, b: float, c: float, x: float) -> float:
    """Return the stage polynomial, which is 0 at the start, at fraction x of a step.

    a, b and c are its values at the three stages.
    """
    first = a * (x - C2) * (x - 1.0) / (C1 * (C1 - C2) * (C1 - 1.0))
    second = b * (x - C1) * (x - 1.0) / (C2 * (C2 - C1) * (C2 - 1.0))
    return x * (first + second + c * (x - C1) * (x - C2) / ((1.0 - C1) * (1.0 - C2)))


STEPPER = Stepper(
    loops(
        "Radau",
        Hooks(
            begin_run, next_end_time, attempt_step, accept_step, write_state, load_step, store_end
        ),
    ),
    lambda n: np.zeros((MATRIX + 5 * n, -(-n // SEEDS) * SEEDS)),
    kept=KEPT,
    needs_tangent=True,
)
