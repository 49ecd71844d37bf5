"""The adjoint of a kernel's outputs: from covectors of full states to those of reduced states."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ...common.arrays import Array
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.kernel_call import call, call_adjoint
from ...kernels.flow_functions import Row, outcome_of, reference_in, reference_size
from ...kernels.kernel import Kernel
from ...system.coordinates import Indices

# Covectors of rows of the outputs at T times of a segment, and their derivatives: start of the
# segment [s]; times after the start, (T,) [s]; reduced states at these times, (T, n), read-only;
# constants of the kernel, (p,); covectors of the rows, (T, rows); derivatives with respect to the
# states, (T, n), overwritten, and to the constants, (p,), to which the result is added.
OutputCovectors: TypeAlias = tuple[float, Array, Array, Array, Array, Array, Array]


class OutcomeAdjoint:
    """The adjoint of a kernel's outputs at all times of a segment, in one call."""

    def __init__(self, kernel: Kernel, rows: tuple[Row, ...]) -> None:
        """Prepare the adjoint of the given rows of the outputs."""
        layout, system, size = kernel.layout, kernel.system, kernel.where.size
        self._outputs, self._outcome = kernel.outputs, outcome_of(kernel, rows)
        self._size, self._output_size = layout.size, size
        self._argument_size = layout.size + 1 + reference_size(system)
        # Numbers from one on, because entries of the reference that the outputs lack are zero.
        places = reference_in(kernel, np.arange(1.0, size + 1.0)).astype(np.int64) - 1
        is_relative = "pose" in rows or ("x" in rows and len(system.space.balls) > 0)
        self._reference = places if is_relative else places[:0]

    def __call__(self, back: OutputCovectors) -> None:
        """Compute the derivatives of Σ covectors · rows."""
        argument, reference = np.zeros(self._argument_size), self._reference
        slopes = np.empty(len(argument) + len(back[3]))
        addresses = (self._outputs.address, self._outcome.adjoint.address)
        out = np.empty(self._output_size)
        _propagate_covectors(addresses, self._size, reference, back, argument, out, slopes)


@compiled
def _propagate_covectors(
    addresses: tuple[int, int],
    size: int,
    reference: Indices,
    back: OutputCovectors,
    argument: Array,
    out: Array,
    slopes: Array,
) -> None:
    """Propagate the covectors of OutcomeAdjoint backwards, time by time.

    addresses: addresses of the kernel's output function and of its adjoint.
    size: length of y.
    reference: index in the outputs of each entry of the reference, −1 for entries that remain zero;
        empty if no covector needs the reference.
    argument: work space for (y, t, reference); the output function reads only y and t.
    out, slopes: work space for the outputs and for the derivatives at one time.
    """
    begin, times, y, constants, covectors, at_times, by_constants = back
    argument_size = argument.shape[0]
    for j in range(times.shape[0]):
        for k in range(size):
            argument[k] = y[j, k]
        argument[size] = begin + times[j]
        if reference.shape[0] > 0:
            call(addresses[0], argument, constants, out)
            for k in range(reference.shape[0]):
                if reference[k] >= 0:
                    argument[size + 1 + k] = out[reference[k]]
        call_adjoint(addresses[1], argument, constants, covectors[j], slopes)
        for k in range(size):
            at_times[j, k] = slopes[k]
        for k in range(constants.shape[0]):
            by_constants[k] += slopes[argument_size + k]
