"""A solver: a way to solve a problem, with its cost and where it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...common.arrays import Array
from .problems import Problem

ATOL = 0.01  # absolute tolerance, in parts of the relative one, where a method takes both
UNKNOWN = float("nan")


@dataclass(frozen=True)
class End:
    """The end of a motion.

    x: (m,) shape, unwrapped.  q: (nq,) and v: (n,), Pinocchio's.  evaluations: see Solver.
    """

    x: Array
    q: Array
    v: Array
    evaluations: float


@dataclass(frozen=True)
class PreparedRun:
    """A method ready to run a problem at a tolerance.

    run: what is timed, from the initial values to the end; raises IntegrationError if it
    does not get there.  end: takes what `run` returns; not timed.  build: s before, once.
    """

    run: Callable[[], Any]
    end: Callable[[Any], End]
    build: float = 0.0


@dataclass(frozen=True)
class Solver:
    """A way to solve a problem.

    about: what is timed.  tolerances: those at which it is measured, from coarse to fine:
    relative tolerances, or with fixed=True the step in parts of the whole time.  missing:
    says of a problem why the method is not run, "" if it is.  Its evaluations are of the
    vector field, or steps if it is Taylor's; NaN where it does not tell.
    """

    name: str
    about: str
    tolerances: tuple[float, ...]
    prepare: Callable[[Problem, float], PreparedRun]
    missing: Callable[[Problem], str] = lambda _: ""
    fixed: bool = False


def decades(first: int, last: int, by: int = 1) -> tuple[float, ...]:
    """Return the tolerances 10⁻ᵏ for k from first to last."""
    return tuple(float(f"1e-{k}") for k in range(first, last + 1, by))


def halvings(first: int, count: int) -> tuple[float, ...]:
    """Return steps in parts of the whole time: 1/first, and each half of the one before."""
    return tuple(1.0 / (first * 2**k) for k in range(count))


def steps_of(part: float) -> int:
    """Return how many steps of this part of the whole time there are."""
    return round(1.0 / part)
