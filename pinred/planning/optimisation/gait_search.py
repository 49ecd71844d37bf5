"""The search for a Fourier gait: from an initial loop to an optimum within its limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...analysis.gaits.gait import Gait
from ...common.arrays import Array
from .ipopt import Minimum, minimum
from .limits import tighten_limits, violation_times
from .transcription import Path, Task, fourier_path, problem_of

_PIECES = 2  # number of quadrature segments of order 16 per (harmonics + 3)
_CHECKS = 4  # number of times at which limits are imposed per (harmonics + 1)
_ROUNDS = 6  # largest number of repeated optimisations that enforce limits between check times
_EXCHANGED = 2  # number of first repetitions that add times instead of tightening limits


class StartFailed(Exception):  # noqa: N818
    """An initial loop did not converge to an optimum; the message states the reason."""


@dataclass(frozen=True)
class Search:
    """An optimisation task, restricted to one family of paths.

    Attributes:
        task: The task.
        path: The family of paths over which the task is optimised.
    """

    task: Task
    path: Path

    def optimise_from(self, gait: Gait, *, most: int = 500) -> Minimum:
        """Find the optimum near a Fourier gait.

        Args:
            gait: A gait with at most as many harmonics as the paths.
            most: Maximum number of iterations.
        Returns:
            The result of IPOPT.
        """
        y = self.path.unknowns(gait.series.coefficients((len(self.path.shift) - 1) // 2))
        z = np.append(y, gait.period) if self.task.period_is_free else y
        return minimum(problem_of(self.task, self.path), z, most=most)

    def coefficients(self, z: Array) -> Array:
        """Return the path coefficients, (K, m), for the unknowns z of the optimisation."""
        return self.path.coefficients(z[: self.path.size])

    def gait(self, z: Array) -> Gait:
        """Return the Fourier gait for the unknowns z of the optimisation."""
        c = self.coefficients(z)
        h = (len(c) - 1) // 2
        T = float(z[-1]) if self.task.period_is_free else self.task.period
        return Gait.fourier(c[0], c[1 : 1 + h], c[1 + h :], period=T)


def fourier_path_of(
    task: Task, harmonics: int, more: Array | None = None, start: Array | None = None
) -> Path:
    """Return the family of Fourier paths for a task; limits are imposed at sample times.

    Args:
        task: The task.
        harmonics: Number of harmonics.
        more: Additional times s = t/T in [0, 1], (C,), at which limits are imposed.
        start: Common initial shape of all paths, (m,), or None.
    Returns:
        The family of paths.
    """
    count = _CHECKS * (harmonics + 1)
    even = np.arange(count) / count
    checks = even if more is None else np.union1d(even, more)
    pieces = _PIECES * (harmonics + 3)
    power = 2 if task.cost in ("torque", "power", "acceleration") else 1
    return fourier_path(
        harmonics, task.connection.m, pieces=pieces, checks=checks, power=power, start=start,
        passage=task.passage,
    )  # fmt: skip


def enforce_limits(
    search: Search, best: Minimum, harmonics: int, start: Array | None = None
) -> tuple[Search, Minimum]:
    """Repeat an optimisation until its limits also hold between the sample times.

    The limits are imposed where the loop exceeds them.  Remaining violations tighten the limits.

    Args:
        search: The search of the first optimum.
        best: The first optimum.
        harmonics: Number of harmonics.
        start: See `fourier_path_of`.
    Returns:
        The last search and its optimum.
    Raises:
        StartFailed: The loop still exceeds its limits.
    """
    task, more = search.task, np.zeros(0)
    for k in range(_ROUNDS):
        gait = search.gait(best.z)
        worst = violation_times(task.connection, gait, task.limits)
        if not len(worst):
            return replace(search, task=task), best
        more = np.union1d(more, worst) if k < _EXCHANGED else more
        imposed = search.task.limits
        if k >= _EXCHANGED:
            imposed = tighten_limits(imposed, task.connection, gait, task.limits)
        search = Search(
            replace(task, limits=imposed), fourier_path_of(task, harmonics, more, start)
        )
        best = search.optimise_from(gait)
    raise StartFailed("the loop still exceeds its limits between the sample times")
