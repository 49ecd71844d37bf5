"""The vector field at several states at once, for methods whose stages are lanes.

Lanes are taken by the stages here, so that limbs of one build are not lanes as well.
"""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np

from ..errors import KernelMismatch
from .cache import ObjectCache, cache_key
from .evaluate import evaluate
from .identity import model_bytes
from .judge import agree
from .kernel import Kernel, KernelStore
from .native import NativeCode, compile_object, load_object
from .symbolic import ReducedGraph

_TRIALS, _MOST = 3, 80


def wide_rate(kernel: Kernel, lanes: int, cache: KernelStore | None = None) -> NativeCode:
    """Return machine code of a kernel's vector field at `lanes` states at once, built once.

    Of y and dy/dt it takes and gives entry i of state j at i lanes + j.  Raises
    KernelMismatch if it disagrees with the kernel, which Pinocchio has judged.
    """
    ready: dict[int, NativeCode] = kernel.__dict__.setdefault("_wide", {})
    if lanes not in ready:
        cache = ObjectCache() if cache is None else cache
        kind = asdict(kernel.structure) | {
            "forces": None if kernel.forces is None else kernel.forces.key,
            "lanes": lanes,
        }
        key = cache_key(model_bytes(kernel.system), json.dumps(kind))
        code = cache.get(key)
        if code is None:
            graph = ReducedGraph(kernel.system, kernel.structure, kernel.forces)
            code = compile_object(graph.rate(), "rate", wide=lanes)
            cache.put(key, code)
        native = load_object(code, "rate")
        _judge(kernel, native, lanes)
        # Another thread may have been faster, and its address may be in use.
        return ready.setdefault(lanes, native)
    return ready[lanes]


def _judge(kernel: Kernel, native: NativeCode, lanes: int) -> None:
    """Compare every lane with the kernel at random states."""
    rng, size = np.random.default_rng(0), kernel.layout.size
    parameters = rng.normal(size=kernel.layout.parameters)
    who = f"the kernel of '{kernel.system.name}' at {lanes} states at once"
    judged = np.zeros(lanes)
    for trial in range(_MOST):
        # Where a force is not defined everywhere, as a barrier is, smaller states are tried.
        y = rng.normal(size=(lanes, size)) * 0.9 ** max(0, trial - _TRIALS)
        expected = evaluate(kernel.rate.address, parameters, y, size)
        found = evaluate(native.address, parameters, y.T.reshape(1, -1), size * lanes)
        for lane, one in enumerate(expected):
            if np.isfinite(one).all():
                agree(who, "the rate", found.reshape(size, lanes)[:, lane], one)
                judged[lane] += 1
        if judged.min() >= _TRIALS:
            return
    raise KernelMismatch(f"{who} is finite at too few of {_MOST} random states to be judged")
