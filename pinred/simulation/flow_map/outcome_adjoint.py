"""The adjoint of a kernel's outputs: from covectors of full states to those of reduced states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...common.arrays import Array
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.kernel_call import call, call_adjoint
from ...kernels.flow_functions import Row, outcome_of
from ...kernels.kernel import Kernel


class OutputCovectors(NamedTuple):
    """Covectors of rows of the outputs at T times of a segment, and their derivatives.

    Attributes:
        times: Times, (T,) [s].
        y: Reduced states at these times, (T, n), read-only.
        constants: Constants of the kernel, (p,).
        covectors: Covectors of the rows, (T, rows).
        at_times: Derivatives with respect to y, (T, n), which are overwritten.
        by_constants: Derivatives with respect to the constants, (p,), which are added to.
    """

    times: Array
    y: Array
    constants: Array
    covectors: Array
    at_times: Array
    by_constants: Array


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
        slopes = np.empty(len(argument) + len(back.constants))
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
    argument_size, constants = argument.shape[0], back.constants
    for j in range(back.times.shape[0]):
        for k in range(size):
            argument[k] = back.y[j, k]
        argument[size] = back.times[j]
        if pose >= 0:
            call(addresses[0], argument, constants, out)
            for k in range(size + 1, argument_size):
                argument[k] = out[pose + k - size - 1]
        call_adjoint(addresses[1], argument, constants, back.covectors[j], slopes)
        for k in range(size):
            back.at_times[j, k] = slopes[k]
        for k in range(constants.shape[0]):
            back.by_constants[k] += slopes[argument_size + k]
