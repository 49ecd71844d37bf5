"""The state of a run: its registers and work rows, and the operations of the step loop on them.

Compiled code uses a `Run` and its fields by name. Python stores it in an array (1,) of LAYOUT, from
which an interrupted run continues. The first work rows contain the states at both ends of a step.

Steps with fixed lengths are repeated with tangents and covectors: `Replay` and what follows it.
"""

from __future__ import annotations

from math import sqrt
from struct import Struct
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from .compiling import compiled, inlined

Y, NEW = 0, 1  # rows of `work`: the state at the start of a step, and at its end
WIDTH = 4  # number of floats in a vector; rows are padded with zeros to a multiple of it

# The quaternions (x, y, z, w) of a state: index in y of the first entry of the first quaternion,
# and number of consecutive quaternions; (0, 0) for none. This is a plain tuple, because numba takes
# microseconds to find the type of a named tuple.
Quaternions: TypeAlias = tuple[int, int]

# Scale of the errors of a quaternion's entries. A rotation by an angle changes the quaternion by
# half the angle, and the root mean square over four entries halves it again. With this scale, the
# tolerance applies to the angle.
TURN = 0.25


def padded_rows(count: int, n: int) -> Array:
    """Return `count` rows of zeros for n numbers each, padded to whole vectors."""
    return np.zeros((count, -(-n // WIDTH) * WIDTH))


@inlined
def in_quaternion(i: int, quaternions: Quaternions) -> bool:
    """Return whether entry i is an entry of a quaternion."""
    first, count = quaternions
    return first <= i < first + 4 * count


@inlined
def first_entries(quaternions: Quaternions) -> range:
    """Return the index of the first entry of each quaternion."""
    first, count = quaternions
    return range(first, first + 4 * count, 4)


@inlined
def entry_size(y: Array, i: int, quaternions: Quaternions) -> float:
    """Return the scale of entry i with which its error is compared."""
    size: float = abs(y[i])
    if in_quaternion(i, quaternions):
        size = TURN
    return size


@inlined
def inverse_length(y: Array, first: int) -> float:
    """Return the reciprocal of the length of the quaternion whose first entry is y[first]."""
    square = 0.0
    for i in range(first, first + 4):
        square += y[i] * y[i]
    return 1.0 / sqrt(square)


@compiled
def unit_alone(y: Array, quaternions: Quaternions) -> None:
    """Normalise the quaternions of y."""
    for first in first_entries(quaternions):
        factor = inverse_length(y, first)
        for i in range(first, first + 4):
            y[i] *= factor


@compiled
def unit(y: Array, rate: Array, quaternions: Quaternions) -> None:
    """Normalise the quaternions of y, and scale the rate of each by the same factor.

    A kernel uses only the directions of the quaternions. Therefore the rate of a quaternion is
    proportional to its length, and the other rates do not change.
    """
    for first in first_entries(quaternions):
        factor = inverse_length(y, first)
        for i in range(first, first + 4):
            y[i] *= factor
            rate[i] *= factor


@compiled
def first_not_finite(row: Array, n: int) -> int:
    """Return the index of the first of n entries that is not finite, −1 if all are finite."""
    total = 0.0
    for i in range(n):
        total += row[i] - row[i]  # NaN for infinities and NaN, else zero
    if total == 0.0:
        return -1
    for i in range(n):
        if row[i] - row[i] != 0.0:
            return i
    return -1


@compiled
def copy_row(source: Array, out: Array) -> None:
    """Copy a row."""
    for k in range(out.shape[0]):
        out[k] = source[k]


@compiled
def add_row(source: Array, out: Array) -> None:
    """Add a row to another."""
    for k in range(out.shape[0]):
        out[k] += source[k]


# These values are plain tuples: numba takes microseconds to find the type of a named tuple.

# The steps of a run: address of the kernel; quaternions; parameters, (p,); times of the step ends,
# (K,) [s]; sorted report times, (T,) [s].
Replay: TypeAlias = tuple[int, Quaternions, Array, Array, Array]

# A state and tangent directions, and their reports. N rows contain one direction each, or SEEDS
# directions with consecutive values for each entry: state, (n,), and directions of the state,
# (N, n …), both changed in place; directions of the parameters, (N, p …); states at the report
# times, (T, n), and their tangents, (T, N, n …), both output.
Tangents: TypeAlias = tuple[Array, Array, Array, Array, Array]

# A covector that is propagated back over stored steps: states at the step ends, (K, n), or
# (K, n + …) with the stages of each step; covector (n,) at the last step end, changed to the
# covector at the first; covectors of the states at the report times, (T, n), overwritten;
# derivative with respect to the parameters, (p,), to which the result is added; workspace for the
# output of the adjoint kernel, (n + p,) per state.
Cotangents: TypeAlias = tuple[Array, Array, Array, Array, Array]


@compiled
def across(y: Array, quaternions: Quaternions, v: Array, width: int) -> None:
    """Apply the derivative of `unit_alone` at y, a symmetric matrix, to tangents or covectors v.

    Args:
        y: State before normalisation.
        quaternions: Quaternions of the state.
        v: Tangents or covectors, (n width,), changed in place.
        width: Number of consecutive values in v for each entry of the state.
    """
    for first in first_entries(quaternions):
        factor = inverse_length(y, first)
        for lane in range(width):
            radial = 0.0
            for k in range(first, first + 4):
                radial += y[k] * factor * v[k * width + lane]
            for k in range(first, first + 4):
                across_unit = v[k * width + lane] - y[k] * factor * radial
                v[k * width + lane] = across_unit * factor


@compiled
def normalise_with(y: Array, quaternions: Quaternions, along: Array, width: int) -> None:
    """Normalise the quaternions of y and, with the derivative, all rows of tangents in `along`."""
    for row in range(along.shape[0]):
        across(y, quaternions, along[row], width)
    unit_alone(y, quaternions)


@compiled
def report(tangents: Tangents, r: int, quaternions: Quaternions, width: int) -> None:
    """Write the state and its tangents as report r, with normalised quaternions."""
    y, along, _, out, out_along = tangents
    copy_row(y, out[r])
    for row in range(along.shape[0]):
        copy_row(along[row], out_along[r, row])
    normalise_with(out[r], quaternions, out_along[r], width)


# Return values of `advance`. WANTED: the run needs the derivative of the kernel to continue.
DONE, PAUSED, FULL, WANTED, UNDERFLOW, NOT_FINITE, TOO_MANY, DIVERGED = range(8)
AGAIN = 8  # return value of an attempted step that was rejected

# Solvers of implicit steps.
AUTO, FIXED_POINT, NEWTON = 1, 2, 3

MOST_STAGES = 8  # of Gauss's methods


def lanes_of(stages: int) -> int:
    """Return the number of SIMD lanes for a number of stages, including idle lanes."""
    return 4 if stages <= 4 else 8


# Contents of the work rows: the states at the ends of a step, also its stages, or also the terms of
# its dense output.
ENDS, STEP, DENSE = range(3)


# Stored data of steps: nothing, the states at step ends, or also the stage rates.
NOTHING_KEPT, ENDS_KEPT, STAGES_KEPT = range(3)

# Number of kernel evaluations between pauses. They take at most some milliseconds, so Ctrl-C and
# progress reports stay responsive.
EVALUATIONS_BETWEEN_PAUSES = 4096


class Run:
    """The registers of a run: all scalars that the step loop needs to continue."""

    t: float  # time [s]
    h: float  # length of the next step [s]
    t_end: float
    max_step: float
    rtol: float
    atol: float
    before: float  # length of the previous step [s], 0 if no step can be extrapolated
    error: float  # estimated error of the current step, in units of the tolerance
    error_before: float  # estimated error of the previous step, in units of the tolerance
    growth: float  # factor by which the next step may be longer
    quotient: float  # factor by which the next step must be shorter
    factored: float  # step length of the current factorisation in Newton's method [s]
    contraction: float  # ratio of successive changes in Newton's method
    convergence: float  # ratio of the remaining error to the last change
    cut: float  # factor by which a failed step is shortened

    address: int  # address of the kernel
    tangent: int  # address of the tangent kernel, or 0
    closing: int  # address of the kernel that closes loops at step ends, or 0
    n: int  # number of entries of the state
    quaternions_at: int  # index of the first entry of the first quaternion
    quaternion_count: int  # number of consecutive quaternions
    pairs: int  # number of positions in y, followed by as many momenta
    spin: int  # number of parameters that are components of a constant momentum
    stages: int  # number of stages per evaluation
    lanes: int  # number of SIMD lanes, idle lanes included
    solver: int  # code of the solver of implicit steps
    total: int  # number of steps of a method with equal steps
    max_steps: int  # limit on the number of trial steps
    budget: int  # number of evaluations between pauses
    keep: int  # code of the data stored at step ends

    begun: int  # whether the first step was prepared
    pause: int  # number of evaluations at which the run pauses next
    steps: int  # number of accepted steps
    rejected: int
    evaluations: int
    next: int  # index of the next report time
    known: int  # code of the contents of the work rows
    again: int  # whether the last trial was rejected
    entry: int  # index of the entry that was not finite, or −1
    fresh: int  # whether the Jacobian belongs to the current state
    remaining: int  # number of Newton steps before fixed-point iteration is tried again
    member: int  # index of the member in a batch, or −1


class Canonical(NamedTuple):
    """Properties of a kernel in canonical form that only Variational uses.

    Attributes:
        pairs: Number of positions in y, which are followed by as many momenta.
        spin: Number of parameters that are components of the constant spatial momentum J, which
            enters the equations as q̄ J q.
        closing: Address of the kernel that closes loops at step ends, or 0 (see
            implicit/lagrange_poincare.py).
    """

    pairs: int = 0
    spin: int = 0
    closing: int = 0


NOT_CANONICAL = Canonical()


Runs: TypeAlias = NDArray[np.void]  # (1,) of LAYOUT

_KINDS = {"float": "d", "int": "q"}
_PACKED = Struct("".join(_KINDS[kind] for kind in Run.__annotations__.values()))
LAYOUT = np.dtype([(name, _KINDS[kind]) for name, kind in Run.__annotations__.items()], align=True)
_FIRST: dict[str, Any] = {
    **dict.fromkeys(Run.__annotations__, 0),
    "entry": -1,
    "member": -1,
}


def new_run(**numbers: float) -> Runs:
    """Return the registers of a run before its first step; `numbers` sets registers by name."""
    first = {**_FIRST, "budget": EVALUATIONS_BETWEEN_PAUSES, **numbers}
    # Assigning the fields is twice as fast as building the array from a tuple.
    return np.frombuffer(bytearray(_PACKED.pack(*first.values())), LAYOUT)


def copied(runs: Runs) -> Runs:
    """Return an independent copy of the registers."""
    return np.frombuffer(bytearray(runs.tobytes()), LAYOUT)


@inlined
def quaternions_of(run: Run) -> Quaternions:
    """Return the quaternions of the state, see Quaternions."""
    return run.quaternions_at, run.quaternion_count


@inlined
def keep_state(run: Run, work: Array, t: float, end_times: Array, end_states: Array) -> None:
    """Store step end number run.steps: the time, and the state before normalisation.

    Args:
        run: Registers of the run.
        work: Rows of the stepper.
        t: Time [s].
        end_times: Times of the step ends, (K,) [s].
        end_states: States at the step ends, (K, n …).
    """
    if run.keep:
        k, row = run.steps, NEW if run.begun else Y
        end_times[k] = t
        for i in range(run.n):
            end_states[k, i] = work[row, i]


@inlined
def copy_an_end(run: Run, work: Array, time: float, t_new: float, out: Array) -> bool:
    """Copy the state to `out` if a time is the start or the end of the current step.

    Args:
        run: Registers of the run.
        work: Rows of the stepper.
        time: Time of the requested state [s].
        t_new: End of the step [s].
        out: State, (n,).
    Returns:
        Whether the state was copied.
    """
    if run.t < time < t_new:
        return False
    row = Y if time <= run.t else NEW
    for i in range(run.n):
        out[i] = work[row, i]
    return True


@inlined
def reject_step(run: Run, h: float) -> int:
    """Reject a trial step and plan a shorter one, of length h, with new Newton factors."""
    run.rejected += 1
    run.again = 1
    run.h, run.factored = h, 0.0
    return AGAIN


@compiled
def first_step_by_rate(run: Run, y: Array, rate: Array, lanes: int, fraction: float) -> float:
    """Return a first step: a fraction of the time in which the state changes by its size.

    Args:
        run: Registers of the run.
        y: Initial state, (n,).
        rate: Rates of the initial state; entry i is at index i·lanes.
        lanes: Distance between the rates of successive entries.
        fraction: Fraction of this time that the step takes.
    Returns:
        Length of the first step [s].
    """
    square = 0.0
    for i in range(run.n):
        scale = run.atol / run.rtol + entry_size(y, i, quaternions_of(run))
        square += (rate[i * lanes] / scale) ** 2
    longest: float = min(run.t_end, run.max_step)
    return min(longest, fraction * sqrt(run.n / square)) if square > 0.0 else longest
