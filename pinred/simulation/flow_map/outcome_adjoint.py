"""The adjoint of a kernel's outputs: from covectors of full states to those of reduced states."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ...common.arrays import Array
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.kernel_call import call, call_adjoint
from ...kernels.flow_functions import Row, outcome_of
from ...kernels.kernel import Kernel

# Covectors of rows of the outputs at T times of a segment, and their derivatives: start of the
# segment [s]; times after the start, (T,) [s]; reduced states at these times, (T, n), read-only;
# constants of the kernel, (p,); covectors of the rows, (T, rows); derivatives with respect to the
# states, (T, n), overwritten, and to the constants, (p,), to which the result is added.
OutputCovectors: TypeAlias = tuple[float, Array, Array, Array, Array, Array, Array]


class OutcomeAdjoint:
    """The adjoint of a kernel's outputs at all times of a segment, in one call."""

    def __init__(self, kernel: Kernel, rows: tuple[Row, ...]) -> None:
        """Prepare the adjoint of the given rows of the outputs."""
        layout, where = kernel.layout, kernel.where
        self._outputs, self._outcome = kernel.outputs, outcome_of(kernel, rows)
        self._size, self._output_size = layout.size, where.size
        self._pose = where.fields["pose"].start if "pose" in rows else -1
        self._argument_size = layout.size + 1 + kernel.system.group.size

    def __call__(self, back: OutputCovectors) -> None:
        """Compute the derivatives of Σ covectors · rows."""
        argument = np.zeros(self._argument_size)
        slopes = np.empty(len(argument) + len(back[3]))
        addresses = (self._outputs.address, self._outcome.adjoint.address)
        out = np.empty(self._output_size)
        _propagate_covectors(addresses, self._size, self._pose, back, argument, out, slopes)


@compiled
def _propagate_covectors(
    addresses: tuple[int, int],
    size: int,
    pose: int,
    back: OutputCovectors,
    argument: Array,
    out: Array,
    slopes: Array,
) -> None:
    """Propagate the covectors of OutcomeAdjoint backwards, time by time.

    addresses: addresses of the kernel's output function and of its adjoint.
    size: length of y.
    pose: index of the pose in the outputs, or −1 if no covector needs the pose.
    argument: work space for (y, t, pose); the output function reads only y and t.
    out, slopes: work space for the outputs and for the derivatives at one time.
    """
    begin, times, y, constants, covectors, at_times, by_constants = back
    argument_size = argument.shape[0]
    for j in range(times.shape[0]):
        for k in range(size):
            argument[k] = y[j, k]
        argument[size] = begin + times[j]
        if pose >= 0:
            call(addresses[0], argument, constants, out)
            for k in range(size + 1, argument_size):
                argument[k] = out[pose + k - size - 1]
        call_adjoint(addresses[1], argument, constants, covectors[j], slopes)
        for k in range(size):
            at_times[j, k] = slopes[k]
        for k in range(constants.shape[0]):
            by_constants[k] += slopes[argument_size + k]
