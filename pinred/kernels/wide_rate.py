"""The vector field at several states at once, for methods whose stages are lanes.

The stages take up the lanes here, so limbs of one build are not lanes as well.
"""

from __future__ import annotations

import numpy as np

from ..common.errors import KernelMismatch
from .derived import derived_code
from .evaluate import evaluate
from .judge import agree
from .kernel import Kernel
from .machine.native import NativeCode, compile_object

_TRIALS, _MOST = 3, 80


def wide_rate(kernel: Kernel, lanes: int) -> NativeCode:
    """Return machine code of a kernel's vector field at `lanes` states at once, built once.

    Entry i of state j stands at i lanes + j, of y and of dy/dt.  Raises
    KernelMismatch if it disagrees with the kernel, which Pinocchio has judged.
    """
    return derived_code(
        kernel,
        "rate",
        {"lanes": lanes},
        lambda graph: compile_object(graph.rate(), "rate", wide=lanes),
        lambda native: _judge(kernel, native, lanes),
    )


def _judge(kernel: Kernel, native: NativeCode, lanes: int) -> None:
    """Compare every lane with the kernel at random states."""
    rng, size = np.random.default_rng(0), kernel.layout.size
    parameters = kernel.random_parameters(rng)
    who = f"the kernel of '{kernel.system.name}' at {lanes} states at once"
    judged = np.zeros(lanes)
    for trial in range(_MOST):
        # Where a force is not defined everywhere, as a barrier is, smaller states are tried.
        y = rng.normal(size=(lanes, size)) * 0.9 ** max(0, trial - _TRIALS)
        expected = evaluate(kernel.rate.address, parameters, y, size)
        found = evaluate(native.address, parameters, y.T.reshape(1, -1), size * lanes)
        for lane, one in enumerate(expected):
            if np.isfinite(one).all():
                agree(who, "the rate", found.reshape(size, lanes)[:, lane], one, abs(one))
                judged[lane] += 1
        if judged.min() >= _TRIALS:
            return
    raise KernelMismatch(f"{who} is finite at too few of {_MOST} random states to be judged")
