"""Covectors of the states that a flow gives, back to the reduced states and what is constant."""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.kernel_call import call, call_adjoint
from ...kernels.flow_functions import Row, outcome_of
from ...kernels.kernel import Kernel


class OutcomesBack:
    """The adjoint of a kernel's outcome at all times of a stretch, in one call."""

    def __init__(self, kernel: Kernel, rows: tuple[Row, ...]) -> None:
        """Take the rows of which covectors are given."""
        layout, where = kernel.layout, kernel.where
        self._outputs, self._outcome = kernel.outputs, outcome_of(kernel, rows)
        self._size, self._room = layout.size, where.size
        self._pose = where.fields["pose"].start if "pose" in rows else -1
        self._whole = layout.size + 1 + kernel.system.group.size

    def __call__(
        self,
        begin: float,
        times: Array,
        y: Array,
        constants: Array,
        covectors: Array,
        at_times: Array,
        by_constants: Array,
    ) -> None:
        """Fill at_times (T, n) with the slopes by y, and add up those by the constants.

        begin: the time from which times (T,) count [s].  y: (T, n), read-only.
        covectors: (T, rows).
        """
        whole = np.zeros(self._whole)
        _from_outcomes(
            self._outputs.address, self._outcome.adjoint.address, self._size, self._pose, begin,
            times, y, constants, covectors, at_times, by_constants, whole, np.empty(self._room),
            np.empty(self._whole + len(constants)),
        )  # fmt: skip


@compiled
def _from_outcomes(
    outputs: int,
    adjoint: int,
    size: int,
    pose: int,
    begin: float,
    times: Array,
    y: Array,
    constants: Array,
    covectors: Array,
    at_times: Array,
    by_constants: Array,
    whole: Array,
    out: Array,
    slopes: Array,
) -> None:
    """Do as OutcomesBack.  pose: where it stands in the outputs, −1 if nobody asks for it.

    whole: (y, t, pose), of which the outputs read no more than t.
    """
    head = whole.shape[0]
    for j in range(times.shape[0]):
        for k in range(size):
            whole[k] = y[j, k]
        whole[size] = begin + times[j]
        if pose >= 0:
            call(outputs, whole, constants, out)
            for k in range(size + 1, head):
                whole[k] = out[pose + k - size - 1]
        call_adjoint(adjoint, whole, constants, covectors[j], slopes)
        for k in range(size):
            at_times[j, k] = slopes[k]
        for k in range(constants.shape[0]):
            by_constants[k] += slopes[head + k]
