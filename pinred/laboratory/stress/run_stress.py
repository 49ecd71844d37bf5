"""All checks by name, and how they are run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from ...common.errors import InputError, PinredError
from . import (
    chaos,
    dense_output,
    energy_drift,
    error_per_tolerance,
    fast_spins,
    flat_bodies,
    frame_invariance,
    long_chains,
    mass_ratios,
    periods,
    round_off_drift,
    singular_arms,
    stiff_springs,
    straight_chains,
    time_reversal,
    time_scales,
    unit_invariance,
    zero_momentum,
)
from .check import Case, Check, Outcome, Trial

# All checks by name, in the order of the table.
CHECKS: dict[str, Check] = {
    module.CHECK.name: module.CHECK
    for module in (
        error_per_tolerance,
        dense_output,
        periods,
        time_reversal,
        energy_drift,
        round_off_drift,
        mass_ratios,
        fast_spins,
        flat_bodies,
        straight_chains,
        singular_arms,
        stiff_springs,
        long_chains,
        zero_momentum,
        time_scales,
        chaos,
        frame_invariance,
        unit_invariance,
    )
}


def chosen(names: Sequence[str]) -> list[Check]:
    """Return the checks of these names, all if there are none.  Raises InputError."""
    unknown = [name for name in names if name not in CHECKS]
    if unknown:
        raise InputError(f"no check '{unknown[0]}'; the checks are {', '.join(CHECKS)}")
    return [CHECKS[name] for name in names or CHECKS]


def run_checks(
    checks: Iterable[Check], trial: Trial, *, begun: Callable[[Check, int], None] | None = None
) -> Iterator[Outcome]:
    """Run checks one after the other.  begun: called with a check and the cases done so far."""
    for check in checks:
        yield run_check(check, trial, begun)


def run_check(
    check: Check, trial: Trial, begun: Callable[[Check, int], None] | None = None
) -> Outcome:
    """Run a check; what cannot be integrated or compiled is a failure, not an error."""
    began = time.perf_counter()
    cases: list[Case] = []
    stopped = ""
    try:
        # What overflows or is not finite fails its bound; numpy need not say so too.
        with np.errstate(all="ignore"):
            for case in check.cases(trial):
                cases.append(case)
                if begun is not None:
                    begun(check, len(cases))
    except PinredError as error:
        stopped = " ".join(f"{type(error).__name__}: {error}".split())
    return Outcome(check.name, check.what, tuple(cases), time.perf_counter() - began, stopped)


def table(outcomes: Sequence[Outcome]) -> str:
    """Return outcomes as a table: of each check its worst case, and below all that failed."""
    rows = [
        f"{'check':<16} {'cases':>5} {'measured':>9} {'bound':>9}        {'wall':>6} s  worst case"
    ]
    rows += [
        f"{each.name:<16} {len(each.cases):>5} {each.measured:>9.1e} {each.bound:>9.1e} "
        f"{'ok' if each.passed else 'FAILED':>6} {each.wall:>8.1f}  "
        f"{'' if each.worst is None else each.worst.name}"
        for each in outcomes
    ]
    for each in outcomes:
        rows += [f"{each.name}: {case}" for case in each.cases if not case.passed]
        if each.stopped:
            rows.append(f"{each.name}: stopped after {len(each.cases)} cases: {each.stopped}")
    passed = sum(each.passed for each in outcomes)
    rows.append(f"{passed} of {len(outcomes)} checks passed")
    return "\n".join(rows)
