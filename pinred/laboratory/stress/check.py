"""A check of the stress suite, its trial, and its outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf
from typing import Literal, TypeAlias, TypeVar

from ...integrators.methods import DOP853, RKMK4, AdaptiveGauss, Gauss, Method
from ...simulation.members.trajectories import Trajectories
from ...simulation.simulate import simulate
from ...simulation.simulate_many import simulate_many
from ...simulation.trajectory import Trajectory

T = TypeVar("T")
_TIGHT = 1e-8  # relative tolerances for which there are special methods
_ANY = 10**12  # steps
Effort: TypeAlias = Literal["short", "usual", "full"]


@dataclass(frozen=True)
class Trial:
    """The task of a check: how much to do, and what is under trial.

    simulate, simulate_many: take what those of pinred take.  fixed: from a step [s] to
    methods of fixed step.  adaptive: give methods for tight tolerances, beside DOP853.
    """

    effort: Effort = "usual"
    simulate: Callable[..., Trajectory] = simulate
    simulate_many: Callable[..., Trajectories] = simulate_many
    fixed: tuple[Callable[[float], Method], ...] = (RKMK4, Gauss)
    adaptive: tuple[Callable[[], Method], ...] = (AdaptiveGauss,)

    def methods(self, rtol: float) -> list[Method]:
        """Return the adaptive methods for scenes of a tolerance, which they take."""
        others = self.adaptive if rtol <= _TIGHT else ()
        return [DOP853(max_steps=_ANY), *(make() for make in others)]

    def pick(self, short: T, usual: T, full: T | None = None) -> T:
        """Return the value for this effort; the usual one where `full` has none of its own."""
        if self.effort == "short":
            return short
        return usual if full is None or self.effort == "usual" else full


@dataclass(frozen=True)
class Case:
    """One number of a check, and the largest with which it passes."""

    name: str
    measured: float
    bound: float

    @property
    def passed(self) -> bool:
        """Whether the number is within its bound; one that is not a number never is."""
        return self.measured <= self.bound

    @property
    def ratio(self) -> float:
        """The part of the bound that is used up; infinite for what is not a number."""
        ratio = self.measured / self.bound
        return ratio if ratio == ratio else inf

    def __str__(self) -> str:
        verdict = "ok" if self.passed else "FAILED"
        return f"{self.name:<58} {self.measured:10.2e}   bound {self.bound:8.1e}   {verdict}"


Cases: TypeAlias = Iterator[Case]


@dataclass(frozen=True)
class Check:
    """A check.  what: that is measured, with its unit.  cases: yields them one by one."""

    name: str
    what: str
    cases: Callable[[Trial], Cases]


@dataclass(frozen=True)
class Outcome:
    """The result of a check.  wall: s.  stopped: why it could not be done, if so."""

    name: str
    what: str
    cases: tuple[Case, ...]
    wall: float
    stopped: str = ""

    @property
    def worst(self) -> Case | None:
        """The case that uses up most of its bound."""
        return max(self.cases, key=lambda case: case.ratio, default=None)

    @property
    def measured(self) -> float:
        """The number of the worst case."""
        return inf if self.worst is None else self.worst.measured

    @property
    def bound(self) -> float:
        """The bound of the worst case."""
        return 0.0 if self.worst is None else self.worst.bound

    @property
    def passed(self) -> bool:
        """Whether there are cases, and all pass."""
        return bool(self.cases) and not self.stopped and all(case.passed for case in self.cases)


def tolerance(rtol: float) -> dict[str, float]:
    """Return the options of a scene for a relative tolerance that is all there is."""
    return {"rtol": rtol, "atol": 1e-2 * rtol}


def dop853(rtol: float, atol: float) -> DOP853:
    """Return DOP853 for runs of any length."""
    return DOP853(rtol=rtol, atol=atol, max_steps=_ANY)


# What passes, in units of the tolerance; docs/stress.md says why.
DEFECT = 3.0  # of one step
PER_RADIAN = 3.0  # an error that grows with the angle that has been turned
PER_GROWTH = 100.0  # an error at the end, over the growth of a small kick
EPS = 2.220446049250313e-16
