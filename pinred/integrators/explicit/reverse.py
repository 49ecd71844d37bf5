"""Adjoints of a run of an explicit method: back over the steps it took, at their lengths.

A run is a map of its initial state and parameters once the lengths of its steps are constants.
Of a step y₁ = y + h Σ b_i k_i with k_i = f(y + h Σ a_ij k_j), a covector λ₁ of y₁ goes back by

    g_i = h (b_i λ₁ + Σ a_ji z_j),    z_i = (∂f/∂y)ᵀ g_i,    λ = λ₁ + Σ z_i

from the last stage to the first (W. Hager, Numer. Math. 87 (2000) 247–282; A. Griewank,
A. Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, chapter 12).  The rates k_i are those that
the run has kept, or they are computed again from the state at the begin.  States between steps
are those of the dense output, which is linear in the rates of all stages.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import bound, compiled
from ..stepping.state_rows import padded_rows
from .derivatives import across, fill_weights, to_unit, weights_of
from .row_sums import Rate, Slopes, Sum, Terms, row_program, slope_program
from .runge_kutta import digest
from .tableau import Tableau

# Rows of `work`: the state at the begin of a step, the covector at its end, a state and a covector
# of a stage; then the rates of all stages, their z, and what reports give to each g.
BEGIN, COVECTOR, STAGE, SEED, RATES = range(5)


# --- what a tableau gives ------------------------------------------------------------------

STAGES = SIZE = 1  # stages of a step, and with those that only dense output takes


def fill_rates(address: int, params: Array, work: Array, h: float) -> int:
    """Fill the rates of the stages of a step h from row BEGIN."""
    raise NotImplementedError


def fill_more(address: int, params: Array, work: Array, h: float) -> int:
    """Fill the rates that dense output takes besides."""
    raise NotImplementedError


def go_back(
    adjoint: int, params: Array, work: Array, both: Array, by_params: Array, h: float
) -> None:
    """Fill z of the stages of a step."""
    raise NotImplementedError


def go_back_from_inside(
    adjoint: int, params: Array, work: Array, both: Array, by_params: Array, h: float
) -> None:
    """Fill z of all stages, with what reports within the step give to them."""
    raise NotImplementedError


# --- the sweep -----------------------------------------------------------------------------


def reverse(
    address: int,
    adjoint: int,
    params: Array,
    quaternion: int,
    dense: Array,
    knots: Array,
    stored: Array,
    times: Array,
    at_times: Array,
    covector: Array,
    by_params: Array,
    work: Array,
    both: Array,
    w: Array,
) -> None:
    """Bring a covector (n,) at the last knot back to the first, in place.

    stored: (steps + 1, n) states at the knots, as the integrator kept them, or (steps + 1,
    n + S n) with the rates of the stages that led there.  at_times: (T, n) covectors of the states
    at times, which are lost.  by_params: (p,), to which the slopes by parameters are added.
    both: (n + p,).  w: (S,).
    """
    n, first = covector.shape[0], times.shape[0]
    for step in range(knots.shape[0] - 2, -1, -1):
        h = knots[step + 1] - knots[step]
        last = first
        while first > 0 and times[first - 1] > knots[step]:
            first -= 1
        inside = last > first and times[first] < knots[step + 1]
        for r in range(first, last):
            if times[r] >= knots[step + 1]:
                for k in range(n):
                    covector[k] += at_times[r, k]
        for k in range(n):
            work[STAGE, k] = stored[step + 1, k]
            work[BEGIN, k] = stored[step, k]
        size = to_unit(work[STAGE], quaternion)
        across(work[STAGE], size, quaternion, covector, 1)
        to_unit(work[BEGIN], quaternion)
        for k in range(n):
            work[COVECTOR, k] = covector[k]
        if stored.shape[1] > n:
            for i in range(STAGES):
                for k in range(n):
                    work[RATES + i, k] = stored[step + 1, (i + 1) * n + k]
        else:
            fill_rates(address, params, work, h)
        if inside:
            fill_more(address, params, work, h)
            for i in range(SIZE):
                for k in range(n):
                    work[RATES + 2 * SIZE + i, k] = 0.0
            for r in range(first, last):
                if times[r] < knots[step + 1]:
                    fill_weights(dense, (times[r] - knots[step]) / h, w)
                    report_back(work, w, h, quaternion, at_times[r], covector)
            go_back_from_inside(adjoint, params, work, both, by_params, h)
        else:
            go_back(adjoint, params, work, both, by_params, h)
        for i in range(SIZE if inside else STAGES):
            for k in range(n):
                covector[k] += work[RATES + SIZE + i, k]
    for r in range(first):
        for k in range(n):
            covector[k] += at_times[r, k]


def report_back(
    work: Array, w: Array, h: float, quaternion: int, at_time: Array, covector: Array
) -> None:
    """Hand the covector of a state within a step on to its begin and to the rates.

    w: (S,) weights of the rates in that state.
    """
    n = at_time.shape[0]
    for k in range(n):
        work[STAGE, k] = work[BEGIN, k]
    for i in range(SIZE):
        for k in range(n):
            work[STAGE, k] += h * w[i] * work[RATES + i, k]
    size = to_unit(work[STAGE], quaternion)
    across(work[STAGE], size, quaternion, at_time, 1)
    for k in range(n):
        covector[k] += at_time[k]
    for i in range(SIZE):
        for k in range(n):
            work[RATES + 2 * SIZE + i, k] += h * w[i] * at_time[k]


# --- made of a tableau ---------------------------------------------------------------------


@dataclass(frozen=True)
class Reverse:
    """The sweep of a tableau: its function, and the rows that it works on for n numbers."""

    sweep: Callable[..., None]
    rows: Callable[[int], Array]


@once_for_all
def reverse_of(tableau: Tableau) -> Reverse:
    """Return the sweep of a tableau, compiled when it is first called."""
    A, s, size = weights_of(tableau).A, tableau.stages, len(tableau.A)
    told = f"reverse_{digest(0, tableau)}"

    def weighted(base: int, weights: Array) -> Terms:
        return [(base + j, a) for j, a in enumerate(weights.tolist()) if a != 0.0]

    def state(i: int) -> list[Sum]:
        terms = weighted(RATES, A[i, :i])
        return [Sum(STAGE, BEGIN, terms)] if terms else []

    def rates(some: range) -> list[Sum | Rate]:
        out: list[Sum | Rate] = []
        for i in some:
            out += [*state(i), Rate(STAGE if state(i) else BEGIN, RATES + i)]
        return out

    def back(count: int, *, inside: bool) -> list[Sum | Slopes]:
        out: list[Sum | Slopes] = []
        for i in range(count - 1, -1, -1):
            given = RATES + 2 * size + i
            terms = [*weighted(RATES + size + i + 1, A[i + 1 : count, i])]
            if A[s, i] != 0.0:
                terms = [(COVECTOR, float(A[s, i])), *terms]
            if terms:
                out.append(Sum(SEED, given if inside else None, terms))
            seed = SEED if terms else given
            out += [*state(i), Slopes(STAGE if state(i) else BEGIN, seed, RATES + size + i)]
        return out

    made: dict[str, Any] = {
        "STAGES": s,
        "SIZE": size,
        "fill_rates": row_program(rates(range(s))),
        "fill_more": row_program(rates(range(s, size))),
        "go_back": slope_program(back(s, inside=False)),
        "go_back_from_inside": slope_program(back(size, inside=True)),
    }
    made["report_back"] = compiled(bound(report_back, f"{told}_report_back", **made))
    sweep = compiled(bound(reverse, told, **made))
    return Reverse(sweep, lambda n: padded_rows(RATES + 3 * size, n))
