"""A discrete Lagrange–Poincaré integrator of order 2 for shape, momentum and attitude.

The discrete Lagrangian of a step uses the trapezoidal rule and Cayley's map on SO(3): with
u = cay⁻¹(R₀ᵀ R₁) and stage velocities whose means are (x₁ − x₀)/h and u/h,

    L_d = h/2 [ℓ(x₀, v₀, Ω₀) + ℓ(x₁, v₁, Ω₁)],

made stationary with respect to the difference of the stages. Both stages then have the same
momenta, p of the shape and m of the attitude. With Hamilton's function H(x, p, m), the discrete
Euler–Lagrange and Euler–Poincaré equations are

    p = π₀ − h/2 ∂H/∂x(x₀),   x₁ = x₀ + h/2 (∂H/∂p(x₀) + ∂H/∂p(x₁)),   π₁ = p − h/2 ∂H/∂x(x₁),
    u = h/2 (∂H/∂m(x₀) + ∂H/∂m(x₁)),   (dcay⁻¹_u)* m = R₀ᵀ J,   R₁ = R₀ cay u.

The method preserves J, is symplectic and self-adjoint. Without an attitude it is the method of
Störmer and Verlet. J. E. Marsden, S. Pekarsky, S. Shkoller, Discrete Euler–Poincaré and Lie–Poisson
equations, Nonlinearity 12 (1999) 1647–1662; N. Bou-Rabee, J. E. Marsden, Hamilton–Pontryagin
integrators on Lie groups I, Found. Comput. Math. 9 (2009) 197–219.

With closed loops φ(x) = 0, the points of the discrete action are closed shapes. Its equations are
those of the open tree with multipliers λ of the constraints at step ends,

    p = π₀ − h/2 ∂H/∂x(x₀) + J(x₀)ᵀ λ,   φ(x₁) = 0,

so that φ = 0 holds at step ends to round-off. This is RATTLE for Hamiltonians that are not
separable; its projection of π₁ on J v = 0 changes π₁ by Jᵀν only, which the next λ absorbs, so the
outputs project instead. Each iteration changes λ by a Newton step with the matrix J H⁻¹ Jᵀ at x₀.
L. Jay, Symplectic partitioned Runge–Kutta methods for constrained Hamiltonian systems, SIAM J.
Numer. Anal. 33 (1996) 368–387; S. Reich, Symplectic integration of constrained Hamiltonian systems
by composition methods, SIAM J. Numer. Anal. 33 (1996) 475–491.

Forces without a potential act in both stages, by the principle of Lagrange and d'Alembert. A state
inside a step is the end of a shorter step.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from ...common.arrays import Array
from ..stepping.compiling import compiled, inlined
from ..stepping.intrinsics import call, call_closing
from ..stepping.run_state import (
    DIVERGED,
    DONE,
    NEW,
    NOT_FINITE,
    Run,
    Y,
    copy_an_end,
    first_not_finite,
    in_quaternion,
    keep_state,
    padded_rows,
    quaternions_of,
    unit_alone,
)
from ..stepping.step_loop import Hooks, Stepper, equal_steps, loops

# Rows of `work` after the state: eight rows for the step (MAIN), and eight for a shorter step to a
# report time (SUB). They contain the end of the step, its two stages (with p as momenta and m as a
# quaternion), the rates of both stages, u followed by h Ω₁ / 2, and the pull of the loops before
# and after an iteration: the largest gap, then h Jᵀλ for each momentum, then h λ.
MAIN, SUB = NEW, NEW + 8
END, BEGIN, STOP, BEGIN_RATE, STOP_RATE, TURN, PULL, NEXT_PULL = range(8)
ROWS, LEAST = SUB + 8, 6  # number of rows; smallest row length, for the six entries of row TURN

_MOST = 100  # largest number of fixed-point iterations per step
# Ratios of successive changes above which the iteration has stalled: near round-off, and elsewhere.
_STALLED, _SLOWEST = 0.5, 0.95
# Changes relative to the largest absolute value: the change that counts as near round-off, and the
# largest accepted change of a stalled iteration.
_SMALL, _SLACK = 1e-14, 1e-11
# Negligible size of the predicted next change, relative to the largest absolute value.
_NOTHING = 1e-17
_CLOSED = 1e-14  # gap of closed loops that counts as round-off, relative to their size


@inlined
def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:
    """Normalise the quaternion and evaluate the initial rates (hook of the step loop)."""
    unit_alone(work[Y], quaternions_of(run))
    keep_state(run, work, 0.0, end_times, end_states)
    _begin(run, params, work, MAIN, run.h)
    run.entry = first_not_finite(work[MAIN + BEGIN_RATE], run.n)
    return NOT_FINITE if run.entry >= 0 else DONE


@inlined
def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:  # noqa: ARG001
    """Solve the equations of a step of fixed length (hook)."""
    status = _step(run, params, work, MAIN, run.h)
    if status == NOT_FINITE:
        run.entry = first_not_finite(work[MAIN + BEGIN_RATE], run.n)
        if run.entry < 0:
            run.entry = first_not_finite(work[MAIN + STOP_RATE], run.n)
    return status


@inlined
def accept_step(run: Run, work: Array, t_new: float) -> None:  # noqa: ARG001
    """Start the next step at the end of this step (hook)."""
    for i in range(run.n):
        work[Y, i] = work[NEW, i]


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write a state inside the step, computed as the end of a shorter step (hook)."""
    if copy_an_end(run, work, time, t_new, out):
        return DONE
    _begin(run, params, work, SUB, time - run.t)
    solved = _step(run, params, work, SUB, time - run.t) == DONE
    for i in range(run.n):
        out[i] = work[SUB + END, i] if solved else np.nan
    return DONE if solved else DIVERGED


@compiled
def _begin(run: Run, params: Array, work: Array, first: int, h: float) -> None:
    """Set stage rates and rotation of a step to the values at its start, as a first guess."""
    n, address = run.n, run.address
    call(address, work[Y], params, work[first + BEGIN_RATE])
    run.evaluations += 1
    for i in range(n):
        work[first + STOP_RATE, i] = work[first + BEGIN_RATE, i]
    if run.closing:
        for i in range(n + 1):
            work[first + PULL, i] = 0.0
    if run.quaternion_count:
        _body_rate(work[Y], work[first + BEGIN_RATE], run.quaternions_at, h, work[first + TURN])


@compiled
def _step(run: Run, params: Array, work: Array, first: int, h: float) -> int:
    """Compute a step from row Y to row END; return DONE or the reason of a failure."""
    n, pairs, half = run.n, run.pairs, 0.5 * h
    quaternion, has_quaternion = run.quaternions_at, run.quaternion_count > 0
    address, spin = run.address, run.spin
    y, end, u = work[Y], work[first + END], work[first + TURN]
    begin, stop = work[first + BEGIN], work[first + STOP]
    rate, last = work[first + BEGIN_RATE], work[first + STOP_RATE]
    pull, next_pull = work[first + PULL], work[first + NEXT_PULL]
    for i in range(n):
        begin[i], stop[i] = y[i], y[i]
    if run.closing:  # the multipliers of the previous step act along J at the start of this one
        call_closing(run.closing, y, params, y, pull, next_pull)
        for i in range(n + 1):
            pull[i] = next_pull[i]
    for i in range(pairs):
        begin[pairs + i] = stop[pairs + i] = y[pairs + i] + half * last[pairs + i]
        stop[i] = y[i] + h * (1.5 * last[i] - 0.5 * rate[i])
    previous, stalls = np.inf, 0
    for iteration in range(_MOST):
        largest = size = 0.0
        if has_quaternion and spin:
            _write_stage_quaternion(y, u, params, begin, quaternion)
        call(address, begin, params, rate)
        for i in range(pairs, 2 * pairs):
            new = y[i] + half * rate[i]
            if run.closing:
                new += pull[1 + i - pairs] / h
            size = max(size, abs(new - begin[i]))
            largest = max(largest, abs(new), abs(y[i]))
            begin[i] = stop[i] = new
        for i in range(2 * pairs, n):
            # An entry that only counts time is exact at the end of the step. The rates depend on no
            # other entry except the quaternion.
            is_rotated = in_quaternion(i, quaternions_of(run))
            stop[i] = begin[i] if is_rotated else y[i] + h * rate[i]
        call(address, stop, params, last)
        run.evaluations += 2
        for i in range(pairs):
            new = y[i] + half * (rate[i] + last[i])
            size = max(size, abs(new - stop[i]))
            largest = max(largest, abs(new))
            stop[i] = new
        if run.closing:
            call_closing(run.closing, y, params, stop, pull, next_pull)
            if not next_pull[0] <= _CLOSED:
                for i in range(pairs):
                    # The next rates of both stages must contain the change, or the gap oscillates.
                    change = (next_pull[1 + i] - pull[1 + i]) / h
                    begin[pairs + i] += change
                    stop[pairs + i] += change
                    size = max(size, abs(change))
                for i in range(n + 1):
                    pull[i] = next_pull[i]
        if has_quaternion:
            _body_rate(begin, rate, quaternion, half, end)
            _body_rate(stop, last, quaternion, half, u[3:])
            for i in range(3):
                new = end[i] + u[3 + i]
                size = max(size, abs(new - u[i]))
                u[i] = new
            largest = max(largest, 1.0)
        if not size < np.inf or first_not_finite(last, n) >= 0:
            # An iteration that starts with finite values becomes non-finite only if it diverges.
            return NOT_FINITE if iteration == 0 else DIVERGED
        if iteration > 0 and size > 10.0 * previous and size > _SLACK * largest:
            return DIVERGED
        stalls += size >= _SLOWEST * previous
        if size == 0.0 or (size <= _SMALL * largest and size >= _STALLED * previous):
            break
        if iteration > 0 and size * size <= _NOTHING * largest * previous:
            break
        if stalls > 2 and size <= _SLACK * largest:
            break
        previous = size
    else:
        return DIVERGED
    for i in range(pairs):
        end[i], end[pairs + i] = stop[i], begin[pairs + i] + half * last[pairs + i]
    for i in range(2 * pairs, n):
        end[i] = y[i] + half * (rate[i] + last[i])
    if has_quaternion:
        _multiply(y, 0.5 * u[0], 0.5 * u[1], 0.5 * u[2], 1.0, end, quaternion)
        unit_alone(end, quaternions_of(run))
        for i in range(3):
            u[i] = 4.0 * u[3 + i] - u[i]  # first guess of the next step
    return DONE


@compiled
def _body_rate(y: Array, rate: Array, quaternion: int, h: float, out: Array) -> None:
    """Write h times the body angular velocity ω, (3,), from a quaternion q and its rate ½ q ω."""
    a, b, c, w = y[quaternion], y[quaternion + 1], y[quaternion + 2], y[quaternion + 3]
    p, q, r, s = (
        rate[quaternion], rate[quaternion + 1], rate[quaternion + 2], rate[quaternion + 3],
    )  # fmt: skip
    factor = 2.0 * h / (a * a + b * b + c * c + w * w)
    out[0] = factor * (w * p - s * a - b * r + c * q)
    out[1] = factor * (w * q - s * b - c * p + a * r)
    out[2] = factor * (w * r - s * c - a * q + b * p)


@compiled
def _multiply(
    y: Array, a: float, b: float, c: float, w: float, out: Array, quaternion: int
) -> None:
    """Write the product of the quaternion of y and the quaternion (a, b, c, w)."""
    p, q, r, s = y[quaternion], y[quaternion + 1], y[quaternion + 2], y[quaternion + 3]
    out[quaternion] = s * a + w * p + q * c - r * b
    out[quaternion + 1] = s * b + w * q + r * a - p * c
    out[quaternion + 2] = s * c + w * r + p * b - q * a
    out[quaternion + 3] = s * w - p * a - q * b - r * c


@compiled
def _write_stage_quaternion(y: Array, u: Array, params: Array, out: Array, quaternion: int) -> None:
    """Write a quaternion whose lift q̄ J q is m, with (dcay⁻¹_u)* m = Rᵀ J.

    With μ = Rᵀ J, m = (μ − ½ u × μ) / (1 + ¼ |u|²). Among all such quaternions this is the one
    whose rotation from m to μ is shortest. J is the first three parameters.
    """
    x, s, z, w = y[quaternion], y[quaternion + 1], y[quaternion + 2], y[quaternion + 3]
    a, b, c = params[0], params[1], params[2]
    # Rᵀ J for a quaternion of length one.
    p, q, r = 2.0 * (b * z - c * s), 2.0 * (c * x - a * z), 2.0 * (a * s - b * x)
    a, b, c = a + w * p + q * z - r * s, b + w * q + r * x - p * z, c + w * r + p * s - q * x
    factor = 1.0 / (1.0 + 0.25 * (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]))
    p = factor * (a - 0.5 * (u[1] * c - u[2] * b))
    q = factor * (b - 0.5 * (u[2] * a - u[0] * c))
    r = factor * (c - 0.5 * (u[0] * b - u[1] * a))
    norm_mu, norm_m = sqrt(a * a + b * b + c * c), sqrt(p * p + q * q + r * r)
    # The quaternion (m × μ, |m| |μ| + m · μ), at a length whose square is |m| / |μ|.
    d = norm_mu * norm_m + p * a + q * b + r * c
    scale = sqrt(norm_m / norm_mu) / sqrt(2.0 * norm_mu * norm_m * d)
    _multiply(
        y, scale * (q * c - r * b), scale * (r * a - p * c), scale * (p * b - q * a), scale * d,
        out, quaternion,
    )  # fmt: skip


STEPPER = Stepper(
    loops(
        "Variational",
        Hooks(begin_run, equal_steps, attempt_step, accept_step, write_state),
    ),
    lambda n: padded_rows(ROWS, max(n + 1, LEAST)),
)
