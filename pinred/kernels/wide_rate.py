"""The vector field at several states at once, one state per SIMD lane.

Methods with parallel stages use one parameter vector for all lanes; batches of runs use one per
lane.  As states occupy the lanes, identical branches are not packed into lanes here.
"""

from __future__ import annotations

import numpy as np

from ..common.errors import KernelMismatch
from .derived_code import derived_code
from .evaluate import evaluate
from .kernel import Kernel
from .machine.native import NativeCode, compile_object
from .validation import require_agreement

_REQUIRED, _TRIALS = 3, 80  # successful comparisons per lane, and attempts


def wide_rate(kernel: Kernel, lanes: int, *, own_parameters: bool = False) -> NativeCode:
    """Return machine code of a kernel's vector field at several states at once.

    Entry i of state j has index i · lanes + j in y and dy/dt, and in the parameters with
    own_parameters.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        lanes: Number of states.
        own_parameters: Whether each state has separate parameters.
    Returns:
        The machine code, compiled once.
    Raises:
        KernelMismatch: The code disagrees with the kernel.
    """
    wide_inputs = (0, 1) if own_parameters else (0,)
    return derived_code(
        kernel,
        "rate",
        {"lanes": lanes} | ({"own_parameters": 1} if own_parameters else {}),
        lambda graph: compile_object(graph.rate(), "rate", wide=lanes, wide_inputs=wide_inputs),
        lambda native: _validate(kernel, native, lanes, own_parameters=own_parameters),
    )


def _validate(kernel: Kernel, native: NativeCode, lanes: int, *, own_parameters: bool) -> None:
    """Compare each lane with the kernel at random states."""
    rng, size = np.random.default_rng(0), kernel.layout.size
    count = lanes if own_parameters else 1
    parameters = np.array([kernel.random_parameters(rng) for _ in range(count)])
    who = f"the kernel of '{kernel.system.name}' at {lanes} states at once"
    compared = np.zeros(lanes)
    for trial in range(_TRIALS):
        # Some forces, such as barriers, are not defined everywhere, so states become smaller.
        y = rng.normal(size=(lanes, size)) * 0.9 ** max(0, trial - _REQUIRED)
        values = evaluate(native.address, parameters.T.ravel(), y.T.reshape(1, -1), size * lanes)
        for lane in range(lanes):
            lane_parameters = parameters[lane % len(parameters)]
            (expected,) = evaluate(kernel.rate.address, lane_parameters, y[lane : lane + 1], size)
            if np.isfinite(expected).all():
                require_agreement(
                    who, "the rate", values.reshape(size, lanes)[:, lane], expected, abs(expected)
                )
                compared[lane] += 1
        if compared.min() >= _REQUIRED:
            return
    raise KernelMismatch(f"{who} is finite at too few of {_TRIALS} random states to be validated")
