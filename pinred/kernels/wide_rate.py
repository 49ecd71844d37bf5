"""The vector field at several states at once.

For methods whose stages are lanes, with the parameters of one run; and for runs in lanes, each
with parameters of its own.  States take up the lanes here, so limbs of one build are not lanes as
well.
"""

from __future__ import annotations

import numpy as np

from ..common.errors import KernelMismatch
from .derived_code import derived_code
from .evaluate import evaluate
from .kernel import Kernel
from .machine.native import NativeCode, compile_object
from .validation import require_agreement

_TRIALS, _MOST = 3, 80


def wide_rate(kernel: Kernel, lanes: int, *, own_parameters: bool = False) -> NativeCode:
    """Return machine code of a kernel's vector field at `lanes` states at once, built once.

    Entry i of state j stands at i lanes + j, of y and of dy/dt; and of the parameters, if every
    state has its own.  Raises KernelMismatch if it disagrees with the kernel, which Pinocchio has
    judged.
    """
    wide_inputs = (0, 1) if own_parameters else (0,)
    return derived_code(
        kernel,
        "rate",
        {"lanes": lanes} | ({"own_parameters": 1} if own_parameters else {}),
        lambda graph: compile_object(graph.rate(), "rate", wide=lanes, wide_inputs=wide_inputs),
        lambda native: _judge(kernel, native, lanes, own_parameters=own_parameters),
    )


def _judge(kernel: Kernel, native: NativeCode, lanes: int, *, own_parameters: bool) -> None:
    """Compare every lane with the kernel at random states."""
    rng, size = np.random.default_rng(0), kernel.layout.size
    several = range(lanes if own_parameters else 1)
    parameters = np.array([kernel.random_parameters(rng) for _ in several])
    who = f"the kernel of '{kernel.system.name}' at {lanes} states at once"
    judged = np.zeros(lanes)
    for trial in range(_MOST):
        # Where a force is not defined everywhere, as a barrier is, smaller states are tried.
        y = rng.normal(size=(lanes, size)) * 0.9 ** max(0, trial - _TRIALS)
        found = evaluate(native.address, parameters.T.ravel(), y.T.reshape(1, -1), size * lanes)
        for lane in range(lanes):
            own = parameters[lane % len(parameters)]
            (one,) = evaluate(kernel.rate.address, own, y[lane : lane + 1], size)
            if np.isfinite(one).all():
                require_agreement(
                    who, "the rate", found.reshape(size, lanes)[:, lane], one, abs(one)
                )
                judged[lane] += 1
        if judged.min() >= _TRIALS:
            return
    raise KernelMismatch(f"{who} is finite at too few of {_MOST} random states to be judged")
