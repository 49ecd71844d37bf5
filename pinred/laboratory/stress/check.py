"""The stress suite: checks, their cases, options and outcomes; common bounds; the table.

The decorator `check` adds a check to the suite.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from ...common.errors import PinredError
from ...integrators.methods import DOP853, RKMK4, AdaptiveGauss, Gauss, Method
from ...simulation.members.trajectories import Trajectories
from ...simulation.simulate import simulate
from ...simulation.simulate_many import simulate_many
from ...simulation.trajectory import Trajectory

T = TypeVar("T")
_TIGHT = 1e-8  # largest relative tolerance for the `adaptive` methods
_ANY = 10**12  # limit on trial steps, too large to be reached
Effort: TypeAlias = Literal["short", "usual", "full"]


@dataclass(frozen=True)
class Trial:
    """Options of a check: its effort, and the functions under test.

    Attributes:
        effort: Number and length of cases.
        simulate: Function under test, with the signature of pinred's simulate.
        simulate_many: Function under test, with the signature of pinred's simulate_many.
        fixed: Functions that create a method with fixed steps from a step length [s].
        adaptive: Functions that create methods for tight tolerances, in addition to DOP853.
    """

    effort: Effort = "usual"
    simulate: Callable[..., Trajectory] = simulate
    simulate_many: Callable[..., Trajectories] = simulate_many
    fixed: tuple[Callable[[float], Method], ...] = (RKMK4, Gauss)
    adaptive: tuple[Callable[[], Method], ...] = (AdaptiveGauss,)

    def methods(self, rtol: float) -> list[Method]:
        """Return the methods with step control that are tested at a relative tolerance."""
        further = self.adaptive if rtol <= _TIGHT else ()
        return [DOP853(max_steps=_ANY), *(make() for make in further)]

    def pick(self, short: T, usual: T, full: T | None = None) -> T:
        """Return the value for this effort; `full` defaults to `usual`."""
        if self.effort == "short":
            return short
        return usual if full is None or self.effort == "usual" else full


@dataclass(frozen=True)
class Case:
    """One measured number of a check and the largest value that passes."""

    name: str
    measured: float
    bound: float

    @property
    def passed(self) -> bool:
        """Whether the number is within its bound; NaN never is."""
        return self.measured <= self.bound

    @property
    def ratio(self) -> float:
        """Ratio of the number to its bound; infinite for NaN."""
        ratio = self.measured / self.bound
        return ratio if ratio == ratio else inf

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "FAILED"
        return f"{self.name:<58} {self.measured:10.2e}   bound {self.bound:8.1e}   {verdict}"


Cases: TypeAlias = Iterator[Case]


@dataclass(frozen=True)
class Check:
    """A check of the stress suite.

    Attributes:
        name: Name of the check.
        what: Measured quantity and its unit.
        cases: Generator of its cases.
    """

    name: str
    what: str
    cases: Callable[[Trial], Cases]


@dataclass(frozen=True)
class Outcome:
    """The result of a check.

    Attributes:
        check: The check.
        cases: Its cases.
        wall: Wall time [s].
        stopped: Message of the error that stopped it; "" if complete.
    """

    check: Check
    cases: tuple[Case, ...]
    wall: float
    stopped: str = ""

    @property
    def worst(self) -> Case:
        """Case with the largest ratio of number to bound."""
        return max(self.cases, key=lambda case: case.ratio, default=Case("", inf, 0.0))

    @property
    def passed(self) -> bool:
        """Whether the check is complete, has cases, and all of them pass."""
        return bool(self.cases) and not self.stopped and all(case.passed for case in self.cases)


CHECKS: dict[str, Check] = {}  # all checks by name, in the order of the table


def check(what: str) -> Callable[[Callable[[Trial], Cases]], Check]:
    """Return a decorator that makes a check of a generator of cases, with its name; see Check."""

    def decorate(cases: Callable[[Trial], Cases]) -> Check:
        name = cases.__name__
        CHECKS[name] = Check(name, what, cases)
        return CHECKS[name]

    return decorate


def tolerance(rtol: float) -> dict[str, float]:
    """Return scene options for a relative tolerance, with a smaller absolute tolerance."""
    return {"rtol": rtol, "atol": 1e-2 * rtol}


def dop853(rtol: float, atol: float) -> DOP853:
    """Return DOP853 without a practical limit on steps."""
    return DOP853(rtol=rtol, atol=atol, max_steps=_ANY)


# Bounds in units of the tolerance; docs/stress.md derives them.
DEFECT = 3.0  # largest defect of one step
PER_RADIAN = 3.0  # largest error per radian of rotation
PER_GROWTH = 100.0  # largest ratio of the final error to the growth of a small perturbation
EPS = 2.220446049250313e-16


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
    return Outcome(check, tuple(cases), time.perf_counter() - began, stopped)


def table(outcomes: Sequence[Outcome]) -> str:
    """Format a table with the worst case of each check, followed by all failed cases."""
    lines = [
        f"{'check':<16} {'cases':>5} {'measured':>9} {'bound':>9}        {'wall':>6} s  worst case"
    ]
    lines += [
        f"{outcome.check.name:<16} {len(outcome.cases):>5} {outcome.worst.measured:>9.1e} "
        f"{outcome.worst.bound:>9.1e} {'ok' if outcome.passed else 'FAILED':>6} "
        f"{outcome.wall:>8.1f}  {outcome.worst.name}"
        for outcome in outcomes
    ]
    for outcome in outcomes:
        name = outcome.check.name
        lines += [f"{name}: {case}" for case in outcome.cases if not case.passed]
        if outcome.stopped:
            lines.append(f"{name}: stopped after {len(outcome.cases)} cases: {outcome.stopped}")
    passed = sum(outcome.passed for outcome in outcomes)
    lines.append(f"{passed} of {len(outcomes)} checks passed")
    return "\n".join(lines)
