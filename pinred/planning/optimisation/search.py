"""The search for a Fourier gait: from a first loop to an optimum that keeps its limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...analysis.gaits.coefficients import coefficients_of
from ...analysis.gaits.gait import Gait
from ...common.arrays import Array
from .ipopt import Minimum, minimum
from .margins import tightened, worst_times
from .transcription import Path, Task, fourier_path, problem_of

_PIECES = 2  # of order 16, a harmonic and three more
_CHECKS = 4  # a harmonic and four more, at which limits are imposed
_ROUNDS = 6  # of keeping limits between the nodes
_EXCHANGED = 2  # of these by imposing them where they are overshot


class Lost(Exception):  # noqa: N818
    """A start that led to no optimum, and why."""


@dataclass(frozen=True)
class Search:
    """A task for paths of one kind."""

    task: Task
    path: Path

    def from_gait(self, gait: Gait, *, most: int = 500) -> Minimum:
        """Return the optimum near a Fourier gait of as many harmonics, or less."""
        y = self.path.unknowns(coefficients_of(gait, (len(self.path.shift) - 1) // 2))
        z = np.append(y, gait.period) if self.task.period_is_free else y
        return minimum(problem_of(self.task, self.path), z, most=most)

    def coefficients(self, z: Array) -> Array:
        """Return the coefficients (K, m) at unknowns z."""
        return self.path.coefficients(z[: self.path.size])

    def gait(self, z: Array) -> Gait:
        """Return the Fourier gait at unknowns z."""
        c = self.coefficients(z)
        h = (len(c) - 1) // 2
        T = float(z[-1]) if self.task.period_is_free else self.task.period
        return Gait.fourier(c[0], c[1 : 1 + h], c[1 + h :], period=T)


def fourier_path_of(
    task: Task, harmonics: int, more: Array | None = None, start: Array | None = None
) -> Path:
    """Return Fourier paths, whose limits are imposed at even times and at more, s (C,).

    start: (m,) a shape in which all of them begin, or None.
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


def within(
    search: Search, best: Minimum, harmonics: int, start: Array | None = None
) -> tuple[Search, Minimum]:
    """Return the optimum within limits that hold between the nodes, too.

    They are imposed where the loop goes beyond them; what then is left, they are made tighter by.
    start: as of fourier_path_of.  Raises Lost.
    """
    task, more = search.task, np.zeros(0)
    for k in range(_ROUNDS):
        gait = search.gait(best.z)
        worst = worst_times(task.connection, gait, task.limits)
        if not len(worst):
            return replace(search, task=task), best
        more = np.union1d(more, worst) if k < _EXCHANGED else more
        imposed = search.task.limits
        if k >= _EXCHANGED:
            imposed = tightened(imposed, task.connection, gait, task.limits)
        search = Search(
            replace(task, limits=imposed), fourier_path_of(task, harmonics, more, start)
        )
        best = search.from_gait(gait)
    raise Lost("between the nodes the loop stays beyond its limits")
