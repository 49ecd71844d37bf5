"""The table of all checks, and functions that run them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from ...common.errors import InputError, PinredError
from . import motion_checks as motion
from . import parameter_checks as parameters
from .check import Case, Check, Outcome, Trial

# All checks by name, in the order of the table.
CHECKS: dict[str, Check] = {
    check.name: check
    for check in (
        *(motion.tolerances, motion.between, motion.periods, motion.reversal),
        *(motion.energy, motion.casimirs),
        *(parameters.mass_ratios, parameters.spins, parameters.flat_bodies),
        *(parameters.straight_chains, parameters.singular_shapes, parameters.stiff_springs),
        *(parameters.long_chains, parameters.zero_momentum, parameters.time_scales),
        *(parameters.chaos, motion.frames, motion.units),
    )
}


def select_checks(names: Sequence[str]) -> list[Check]:
    """Return the named checks, or all if `names` is empty; raise InputError for an unknown name."""
    unknown = [name for name in names if name not in CHECKS]
    if unknown:
        raise InputError(f"no check '{unknown[0]}'; the checks are {', '.join(CHECKS)}")
    return [CHECKS[name] for name in names or CHECKS]


def run_checks(
    checks: Iterable[Check], trial: Trial, *, on_case: Callable[[Check, int], None] | None = None
) -> Iterator[Outcome]:
    """Run checks in order.  on_case: called with a check and the number of its finished cases."""
    for check in checks:
        yield run_check(check, trial, on_case)


def run_check(
    check: Check, trial: Trial, on_case: Callable[[Check, int], None] | None = None
) -> Outcome:
    """Run a check; errors of pinred count as failures of the check."""
    began = time.perf_counter()
    cases: list[Case] = []
    stopped = ""
    try:
        # A result that overflows exceeds its bound, so numpy's warnings are redundant.
        with np.errstate(all="ignore"):
            for case in check.cases(trial):
                cases.append(case)
                if on_case is not None:
                    on_case(check, len(cases))
    except PinredError as error:
        stopped = " ".join(f"{type(error).__name__}: {error}".split())
    return Outcome(check.name, check.what, tuple(cases), time.perf_counter() - began, stopped)


def table(outcomes: Sequence[Outcome]) -> str:
    """Format a table with the worst case of each check, followed by all failed cases."""
    rows = [
        f"{'check':<16} {'cases':>5} {'measured':>9} {'bound':>9}        {'wall':>6} s  worst case"
    ]
    rows += [
        f"{outcome.name:<16} {len(outcome.cases):>5} {outcome.measured:>9.1e} "
        f"{outcome.bound:>9.1e} {'ok' if outcome.passed else 'FAILED':>6} {outcome.wall:>8.1f}  "
        f"{'' if outcome.worst is None else outcome.worst.name}"
        for outcome in outcomes
    ]
    for outcome in outcomes:
        rows += [f"{outcome.name}: {case}" for case in outcome.cases if not case.passed]
        if outcome.stopped:
            rows.append(
                f"{outcome.name}: stopped after {len(outcome.cases)} cases: {outcome.stopped}"
            )
    passed = sum(outcome.passed for outcome in outcomes)
    rows.append(f"{passed} of {len(outcomes)} checks passed")
    return "\n".join(rows)
