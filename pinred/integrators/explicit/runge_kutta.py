"""Explicit Runge–Kutta methods over a kernel: tableaus, steps, step control and dense output.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
Springer 1993, sections II.4 (step control, first step), II.5 and II.6 (dense output), and
Hairer's code dop853.f, whose constants all methods of this module use. DOP853 is Dormand and
Prince's method of order 8(5,3) in Hairer's form. Tsit5 is from Ch. Tsitouras, Runge–Kutta pairs of
order 5(4) satisfying only the first column simplifying assumption, Comput. Math. Appl. 62 (2011)
770–775, which contains the pair of methods and an interpolant of order 4 without further stages.

The state stored at a step end is the result of the step before its quaternions are normalised,
so that repeating a step from this state reproduces it bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import scipy

from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ...common.memo import once_for_all
from ..stepping.compiling import Bindings, unbound
from ..stepping.intrinsics import call
from ..stepping.run_state import (
    DENSE,
    DONE,
    ENDS,
    NEW,
    NOT_FINITE,
    STAGES_KEPT,
    STEP,
    Run,
    Y,
    copy_an_end,
    first_not_finite,
    keep_state,
    padded_rows,
    quaternions_of,
    reject_step,
    unit,
    unit_alone,
)
from ..stepping.step_loop import Hooks, Stepper, loops
from .row_programs import Rate, Sum, Terms, row_program
from .step_formulas import (
    BEGIN_RATE,
    END_RATE,
    ERROR,
    ERROR3,
    RATES,
    SCALAR,
    STAGE,
    add_formulas,
    dense_value,
    fill_hermite,
    first_step,
    next_step,
)

_ROUND_OFF = 1e-12  # largest relative error of a sum of weights


@dataclass(frozen=True, eq=False)
class Tableau:
    """Coefficients of an explicit method with s stages.

    The rate at the end of a step is the first stage rate of the next step.

    The dense output at fraction x of a step, with y = 1 − x, is

        y₀ + x (F₀ + y (F₁ + x (F₂ + y (F₃ + x (F₄ + …))))).

    F₀, F₁ and F₂ define Hermite's cubic polynomial. F₃ and later terms are weighted sums of rates.

    Attributes:
        A: Weights of the rates in the state of each stage, (s + 1 + e, s + 1 + e), strictly lower
            triangular: rows for the s stages (the first is the start of the step), for the step
                end, and for e additional stages of the dense output.
        errors: Weights of the error estimate. (1, s + 1): difference to a method of lower order.
            (2, s + 1): two differences, which are combined as in Hairer's DOP853.
        dense: Weights of F₃, F₄, …, (d, s + 1 + e).
    Raises:
        InputError: Shapes, or sums of weights, are inconsistent.
    """

    A: Array
    errors: Array
    dense: Array

    def __post_init__(self) -> None:
        freeze(self)
        A, errors, dense, size = self.A, self.errors, self.dense, len(self.A)
        if A.ndim != 2 or A.shape != (size, size) or A[np.triu_indices(size)].any():
            raise InputError(f"A must be square and zero from its diagonal on, got {A.shape}")
        if errors.ndim != 2 or len(errors) not in (1, 2) or not 2 <= errors.shape[1] <= size:
            raise InputError(f"errors must have shape (1 or 2, s + 1), got {errors.shape}")
        if dense.ndim != 2 or dense.shape[1] != size:
            raise InputError(f"dense must have shape (d, {size}), got {dense.shape}")
        for name, weights, total in (
            ("the end", A[self.stages], 1.0), ("errors", errors, 0.0), ("dense", dense, 0.0),
        ):  # fmt: skip
            sums = np.atleast_2d(weights).sum(axis=1)
            if not np.allclose(
                sums, total, rtol=0.0, atol=_ROUND_OFF * max(1.0, abs(weights).sum())
            ):
                raise InputError(f"weights of {name} must add up to {total:g}, got {sums}")
        if not np.atleast_2d(errors).any(axis=1).all():
            raise InputError("errors must have weights that are not zero")

    @property
    def stages(self) -> int:
        """Number of stages, not counting the end of the step."""
        return int(self.errors.shape[1]) - 1


_TSIT5_A = (
    (),
    (0.161,),
    (-0.008480655492356989, 0.335480655492357),
    (2.8971530571054935, -6.359448489975075, 4.3622954328695815),
    (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525),
    (
        5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401,
        -0.028269050394068383,
    ),
    (
        0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081,
        2.324710524099774,
    ),
)  # fmt: skip
_TSIT5_ERRORS = (
    -0.00178001105222577714, -0.0008164344596567469, 0.007880878010261995, -0.1447110071732629,
    0.5823571654525552, -0.45808210592918697, 1 / 66,
)  # fmt: skip
# Coefficients of θ⁴ in the interpolant. Values and derivatives at both ends determine the lower
# terms.
_TSIT5_DENSE = (
    -1.0530884977290216, 0.1017, 2.490627285651253, -16.548102889244902, 47.37952196281928,
    -34.87065786149661, 2.5,
)  # fmt: skip


@once_for_all
def dop853_tableau() -> Tableau:
    """Return the coefficients of DOP853, which are taken from SciPy."""
    # The file is run alone, because importing its package, scipy.integrate, takes long.
    file = Path(scipy.__file__).with_name("integrate") / "_ivp" / "dop853_coefficients.py"
    found = run_path(str(file))
    return Tableau(found["A"], np.array([found["E5"], found["E3"]]), found["D"])


@once_for_all
def tsit5_tableau() -> Tableau:
    """Return the coefficients of Tsit5."""
    A = np.zeros((7, 7))
    for i, row in enumerate(_TSIT5_A):
        A[i, :i] = row
    return Tableau(A, np.array([_TSIT5_ERRORS]), np.array([_TSIT5_DENSE]))


# --- names that a tableau binds -----------------------------------------------------------------


STAGES = 1

# Row programs, each (address, params, work, h) -> number of evaluations: fill_step computes the
# stage rates of a step of length h from row Y, and the state in row NEW; fill_end the rate at the
# end of the step; fill_errors the error rows; fill_dense the rates and terms of the dense output.
# estimate(run, work, h) returns the error of the step, relative to its tolerance.
fill_step = fill_end = fill_errors = fill_dense = estimate = unbound


# --- hooks of the step loop ---------------------------------------------------------------------


def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:
    """Evaluate the initial rates and choose the first step (hook of the step loop)."""
    keep_state(run, work, 0.0, end_times, end_states)
    call(run.address, work[Y], params, work[BEGIN_RATE])
    run.evaluations += 1
    unit(work[Y], work[BEGIN_RATE], quaternions_of(run))
    run.entry = first_not_finite(work[BEGIN_RATE], run.n)
    if run.entry >= 0:
        return NOT_FINITE
    run.h = first_step(run, params, work)
    run.evaluations += 1
    return DONE


def next_end_time(run: Run) -> float:
    """Return t + h, or the end time if it is almost reached (hook)."""
    return run.t_end if run.t + 1.01 * run.h >= run.t_end else run.t + run.h


def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:
    """Compute a step and its error; return DONE, or AGAIN with a shorter step (hook)."""
    h = t_new - run.t  # includes the round-off of t, so that the state belongs to the stored time
    run.evaluations += fill_step(run.address, params, work, h)
    fill_errors(run.address, params, work, 1.0)
    run.error = estimate(run, work, h)
    if run.error <= 1.0:
        run.evaluations += fill_end(run.address, params, work, h)
        if first_not_finite(work[END_RATE], run.n) < 0:
            return DONE
    if not 1.0 < run.error < np.inf:  # an entry is not finite
        run.entry = non_finite_entry(work, run.n)
    return reject_step(run, next_step(run.error, h, False, False, run.max_step))


def accept_step(run: Run, work: Array, t_new: float) -> None:
    """Continue from the end of the step, and choose the next length from the error (hook)."""
    for i in range(run.n):
        work[Y, i] = work[NEW, i]
        work[BEGIN_RATE, i] = work[END_RATE, i]
    unit(work[Y], work[BEGIN_RATE], quaternions_of(run))
    run.h = next_step(run.error, t_new - run.t, True, run.again != 0, run.max_step)
    if not run.again:
        run.entry = -1  # the accepted step is finite, so an earlier non-finite entry is obsolete
    run.again = 0


def store_end(run: Run, work: Array, t: float, end_times: Array, end_states: Array) -> None:
    """Store a step end, followed by the stage rates of the step if stages are requested."""
    keep_state(run, work, t, end_times, end_states)
    if run.keep == STAGES_KEPT:
        n, k = run.n, run.steps
        for i in range(n):
            end_states[k, n + i] = work[BEGIN_RATE, i]
        for stage in range(STAGES - 1):
            for i in range(n):
                end_states[k, (stage + 2) * n + i] = work[RATES + stage, i]


def load_step(run: Run, params: Array, work: Array, t_new: float, stored: Array) -> None:  # noqa: ARG001
    """Evaluate the rate at the start of a stored step; other rates follow when needed (hook)."""
    call(run.address, work[Y], params, work[BEGIN_RATE])
    unit(work[Y], work[BEGIN_RATE], quaternions_of(run))


def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write a state inside the step, computed with the dense output of section II.6 (hook)."""
    if not copy_an_end(run, work, time, t_new, out):
        h = t_new - run.t
        if run.known == ENDS:
            fill_step(run.address, params, work, h)
            fill_end(run.address, params, work, h)
            run.known = STEP
        if run.known == STEP:
            run.known = DENSE
            fill_dense_rows(run, params, work, h)
        x = (time - run.t) / h
        for i in range(run.n):
            out[i] = dense_value(work, i, x)
    unit_alone(out, quaternions_of(run))
    return DONE


def fill_dense_rows(run: Run, params: Array, work: Array, h: float) -> None:
    """Compute all rows of the dense output."""
    run.evaluations += fill_dense(run.address, params, work, h)
    fill_hermite(run, work, h)


def non_finite_entry(work: Array, n: int) -> int:
    """Return the entry that first became non-finite in a trial step, −1 for none."""
    entry = first_not_finite(work[BEGIN_RATE], n)
    for row in range(RATES, RATES + STAGES - 1):
        if entry < 0:
            entry = first_not_finite(work[row], n)
    if entry < 0:
        entry = first_not_finite(work[NEW], n)
    if entry < 0:
        entry = first_not_finite(work[END_RATE], n)
    return entry


# --- steppers from tableaux ---------------------------------------------------------------------


@dataclass(frozen=True)
class Steps:
    """The operations of a tableau: linear combinations and kernel calls on rows of `work`.

    Attributes:
        to_end: Steps that compute row NEW from row Y and its rate.
        at_end: Steps that compute the rate at NEW; empty if `to_end` computes this rate because the
            error estimate needs it.
        errors: Steps that compute the error rows.
        dense: Steps that compute the dense-output terms beyond the cubic, in rows from `first` + 3.
        first: First row of dense output.
        rows: Number of work rows.
    """

    to_end: list[Sum | Rate]
    at_end: list[Sum | Rate]
    errors: list[Sum | Rate]
    dense: list[Sum | Rate]
    first: int
    rows: int


def steps_of(tableau: Tableau) -> Steps:
    """Convert a tableau to linear combinations and evaluations."""
    s, extra = tableau.stages, len(tableau.A) - tableau.stages - 1
    row_of = [BEGIN_RATE, *range(RATES, RATES + s - 1), END_RATE]
    first = RATES + s - 1 + extra
    row_of += range(first - extra, first)

    def weighted(weights: Array) -> Terms:
        rates = zip(row_of, weights.tolist(), strict=False)
        return [(row, weight) for row, weight in rates if weight != 0.0]

    def stages(indices: range) -> list[Sum | Rate]:
        pairs = [(Sum(STAGE, Y, weighted(tableau.A[i])), Rate(STAGE, row_of[i])) for i in indices]
        return [step for pair in pairs for step in pair]

    at_end: list[Sum | Rate] = [Rate(NEW, END_RATE)]
    errors_need_end = bool(tableau.errors[:, s].any())
    to_end = [*stages(range(1, s)), Sum(NEW, Y, weighted(tableau.A[s]))]
    errors = zip((ERROR, ERROR3), tableau.errors, strict=False)
    return Steps(
        to_end=to_end + at_end if errors_need_end else to_end,
        at_end=[] if errors_need_end else at_end,
        errors=[Sum(row, None, weighted(weights)) for row, weights in errors],
        dense=[
            *stages(range(s + 1, s + 1 + extra)),
            *(Sum(first + 3 + k, None, weighted(w)) for k, w in enumerate(tableau.dense)),
        ],
        first=first,
        rows=first + 3 + len(tableau.dense),
    )


def bind_formulas(
    prefix: str, order: int, tableau: Tableau, numbers: dict[str, Any], **programs: Any
) -> Bindings:
    """Bind the step formulas to a tableau and a number type (scalars or SIMD vectors).

    Args:
        prefix: Unique start of the names of the compiled functions.
        order: Order of the method.
        tableau: Coefficients of the method.
        numbers: Functions of the number type, by name, like SCALAR.
        **programs: Keyword arguments of `row_program`, for vectors that differ from those of a
            single run.
    Returns:
        The bindings, with row programs, formulas and error estimate.
    """
    steps = steps_of(tableau)
    bindings = Bindings(
        prefix,
        STAGES=tableau.stages,
        HALVINGS=(order & -order).bit_length() - 1,
        REST=order // (order & -order),
        FIRST=steps.first,
        TERMS=steps.rows - steps.first,
        fill_step=row_program(steps.to_end, **programs),
        fill_end=row_program(steps.at_end, **programs),
        fill_errors=row_program(steps.errors, **programs),
        fill_dense=row_program(steps.dense, **programs),
        **numbers,
    )
    add_formulas(bindings, len(tableau.errors))
    return bindings


@once_for_all
def make_stepper(name: str, order: int, tableau: Tableau) -> Stepper:
    """Return the stepper of a method, given its name, order and coefficients."""
    prefix = f"{name}_{digest(order, tableau)}"
    bindings = bind_formulas(prefix, order, tableau, SCALAR)
    bindings.add(non_finite_entry)
    bindings.add(fill_dense_rows)
    rows = steps_of(tableau).rows
    hooks = (
        begin_run, next_end_time, attempt_step, accept_step, write_state, load_step, store_end,
    )  # fmt: skip
    return Stepper(
        loops(prefix, Hooks(*map(bindings.add, hooks))),
        partial(padded_rows, rows),
        stages=tableau.stages,
    )


def digest(order: int, tableau: Tableau) -> str:
    """Return a digest that distinguishes methods in the names of their machine code."""
    numbers = (np.array([order]), tableau.A, tableau.errors, tableau.dense)
    return sha256(b"".join(array.tobytes() for array in numbers)).hexdigest()[:12]
