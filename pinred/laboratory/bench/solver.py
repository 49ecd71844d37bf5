"""Interface of the solvers that the benchmarks time: one motion, or a batch of members."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ...common.argument_kinds import checks_arguments
from .problems import End as End
from .problems import Problem

ATOL = 0.01  # ratio of absolute to relative tolerance, for methods with both
UNKNOWN = float("nan")


@checks_arguments
@dataclass(frozen=True)
class PreparedRun:
    """A method that is ready to solve a problem at a tolerance.

    Attributes:
        run: Timed function: integrates from the initial to the final state. Raises
            IntegrationError if it fails.
        end: Converts the result of `run` to the final state (not timed). For a batch, the second
            argument is the number of a member.
        build: Time of preparation, once [s].
    """

    run: Callable[[], Any]
    end: Callable[..., End]
    build: float = 0.0


@checks_arguments
@dataclass(frozen=True)
class Solver:
    """A method of the accuracy benchmark, or of batches.

    Attributes:
        name: Name of the method.
        about: Description of the timed work.
        tolerances: Relative tolerances from coarse to fine; if `fixed`, step lengths relative to
            the duration.
        prepare: Prepares a run of a problem, or of the members of a batch, at a tolerance.
        missing: Returns why the method cannot run a problem; "" if it can.
        fixed: Whether the method has fixed steps.
        most: Largest number of members that the method is timed with.
    """

    name: str
    about: str
    tolerances: tuple[float, ...]
    prepare: Callable[[Any, float], PreparedRun]
    missing: Callable[[Problem], str] = field(default_factory=lambda: lambda _: "")
    fixed: bool = False
    most: int = 10**9


def decades(first: int, last: int, by: int = 1) -> tuple[float, ...]:
    """Return the tolerances 10⁻ᵏ for k from first to last."""
    return tuple(float(f"1e-{k}") for k in range(first, last + 1, by))


def halvings(first: int, count: int) -> tuple[float, ...]:
    """Return step lengths relative to the duration: 1/first, then repeatedly halved."""
    return tuple(1.0 / (first * 2**k) for k in range(count))


def steps_of(fraction: float) -> int:
    """Return the number of steps whose length is this fraction of the duration."""
    return round(1.0 / fraction)
