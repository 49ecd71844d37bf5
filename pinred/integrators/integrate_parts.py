"""integrate_parts(): one run over successive parts of time, each with its own parameters.

The loop over the parts is compiled, because a run with many switches spends most of its time there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Array, read_only
from ..common.errors import IntegrationError
from .integrate import Progress, Tangent, begun_by, doubled, failure, give_tangent
from .methods.method import ErrorControl, stepper_of
from .solution import Solution
from .stepping.codes import DONE, FULL, UNDERFLOW, WANTED
from .stepping.run_state import ENDS_KEPT, LAYOUT, NOT_CANONICAL, Canonical, Runs
from .stepping.state_rows import Quaternions, Y

_NO_TIMES = read_only(np.empty(0))
_FIRST_KNOTS = 8  # initial number of step ends per part


@dataclass(frozen=True, eq=False)
class Parts:
    """The solutions of a run over S parts of time.

    Attributes:
        method: Integrator.
        params: Parameters of each part, (S, p).
        first: Index of the first step end of each part, and of the end of the last one, (S + 1,).
        knots: Times of all step ends, counted from the start of their part, (K,) [s].
    """

    method: ErrorControl
    params: Array
    first: NDArray[np.int64]
    knots: Array
    _runs: Runs
    _rows: Array

    @property
    def steps(self) -> int:
        """Number of accepted steps."""
        return int(self._runs["steps"].sum())

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the vector field."""
        return int(self._runs["evaluations"].sum())

    def __len__(self) -> int:
        return len(self._runs)

    def __getitem__(self, k: int) -> Solution:
        """Return the solution over part k, which has no report times."""
        rows = slice(self.first[k], self.first[k + 1])
        n = self._runs["n"][k]
        return Solution(
            self.method, _NO_TIMES, np.empty((0, n)), True, self.params[k],
            self._runs[k : k + 1], self.knots[rows], self._rows[rows],
        )  # fmt: skip


def integrate_parts(
    method: ErrorControl,
    address: int,
    params: Array,
    y0: Array,
    lengths: Array,
    quaternions: Quaternions = (0, 0),
    canonical: Canonical = NOT_CANONICAL,
    tangent: Tangent | None = None,
    progress: Progress | None = None,
    explain: Callable[[IntegrationError, int], IntegrationError] | None = None,
) -> Parts:
    """Integrate from y0 over successive parts of time; arguments are not validated.

    Args:
        method: Method with step control.
        address: Address of the kernel.
        params: Parameters of the S parts, (S, p), read-only.
        y0: Initial state, (n,).
        lengths: Lengths of the parts, (S,), read-only [s].
        quaternions: As for `integrate`. They are normalised between parts.
        canonical: As for `integrate`.
        tangent: As for `integrate`.
        progress: Called repeatedly with the finished fraction of the parts.
        explain: Returns the error to raise instead of a failure in a part, given by its index.
    Returns:
        The solutions.
    Raises:
        IntegrationError: The integration failed; see `integrate`.
    """
    n, count, stepper = len(y0), len(lengths), stepper_of(method)
    first_run = begun_by(method, address, n, float(lengths[0]), quaternions, canonical, ENDS_KEPT)
    if stepper.needs_tangent:
        give_tangent(tangent, method, first_run)
    runs, first = np.zeros(count, LAYOUT), np.zeros(count + 1, np.int64)
    work, place = stepper.work(n), np.zeros(1, np.int64)
    work[Y, :n] = y0
    capacity = _FIRST_KNOTS * count
    knots, rows = np.empty(capacity), np.empty((capacity, stepper.kept * n))
    reports = np.empty((0, n))
    while True:
        status = stepper.loops.through(
            runs, first_run, params, lengths, work, _NO_TIMES, reports, knots, rows, first, place
        )
        k = int(place[0])
        if progress is not None:
            progress(k / count)
        if status == DONE:
            return Parts(method, params, first, knots, runs, rows)
        if status == FULL:
            knots, rows = doubled(knots), doubled(rows)
        elif status == WANTED:
            for registers in (first_run, runs[k : k + 1]):
                give_tangent(tangent, method, registers)
            work = stepper.widened(n, work)
        elif status >= UNDERFLOW:
            stop = failure(status, runs[k : k + 1], work[Y, :n].copy())
            raise stop if explain is None else explain(stop, k) from None
