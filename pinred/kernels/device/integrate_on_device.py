"""integrate_on_device(): integrate one kernel from many initial states on a CUDA device."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...common.errors import InputError
from ...integrators.integrate import begun_by
from ...integrators.integrate_many import Solutions, checked_batch, solutions
from ...integrators.methods.method import Explicit, Method
from ...integrators.stepping.codes import PAUSED
from ...integrators.stepping.run_state import NOT_CANONICAL
from ..kernel import Kernel
from .cuda_driver import opened_device, run_on_device
from .device_code import ENTRY, ptx_of

_NO_PAUSE = 2**62  # number of evaluations before a run pauses


def integrate_on_device(
    method: Method,
    kernel: Kernel,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: ArrayLike,
    times: ArrayLike,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for all members i, one member per thread.

    The step loop and its numbers are those of `integrate`. A device may round the kernel and its
    sines differently, so the results agree up to round-off and its growth.

    Args:
        method: Explicit method, such as DOP853.
        kernel: Kernel of f.
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        t_end: End time, or one for each member, (N,) [s].
        times: Sorted report times, (T,) or (N, T), as for `integrate_many` [s].
    Returns:
        The solutions, member first.
    Raises:
        InputError: An argument is invalid.
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `cuda.bindings` is not installed.
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    if not isinstance(method, Explicit):
        raise InputError(
            f"method: expected DOP853 or Tsit5 on a device, got {method.name}. Choose one of them"
        )
    opened_device()  # report a missing device before its code is generated
    quaternions = kernel.layout.quaternions
    asked = checked_batch(kernel.rate.address, params, y0, t_end, times, quaternions, 1)
    batch = asked.batch
    (size, n), (rows, columns) = batch.y0.shape, batch.times.shape
    first = begun_by(method, kernel.rate.address, n, asked.end, quaternions, NOT_CANONICAL)
    runs = np.repeat(first, size)
    runs["t_end"], runs["budget"] = batch.ends, _NO_PAUSE
    status = np.full(size, PAUSED)
    arrays = (runs, batch.params, batch.y0, batch.times, batch.y, status)
    run_on_device(ptx_of(kernel, method), ENTRY, size, (size, columns, rows, *arrays))
    batch.outcomes["status"] = status
    for name in ("t", "entry", "steps", "rejected", "evaluations"):
        batch.outcomes[name] = runs[name]
    return solutions(method, batch)
