"""The derivative of the vector field along several directions at once, for Newton's method.

Forward mode: the state is one, the directions are lanes.  n numbers in the state take n/8
evaluations for the whole Jacobian, exact to round-off.
"""

from __future__ import annotations

import json
from dataclasses import asdict

import casadi as ca
import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..integrators.kernel import SEEDS, call_tangent, compiled
from .cache import ObjectCache, cache_key
from .evaluate import evaluate
from .identity import model_bytes
from .judge import agree
from .kernel import Kernel, KernelStore
from .native import NativeCode, compile_object, load_object
from .symbolic import ReducedGraph

_TRIALS, _NEEDED = 40, 2
_STEP = 2e-3  # of the differences, for states of size one
_TOLERANCE = 1e-7  # of the largest entry in a column


def tangent_of(kernel: Kernel, cache: KernelStore | None = None) -> NativeCode:
    """Return machine code (y, parameters, directions) → ∂ẏ/∂y directions, built once.

    Of directions and output it takes and gives entry i of direction j at 8 i + j.  Raises
    KernelMismatch if it disagrees with differences of the kernel, which Pinocchio has judged.
    """
    ready: dict[str, NativeCode] = kernel.__dict__.setdefault("_tangent", {})
    if "tangent" not in ready:
        cache = ObjectCache() if cache is None else cache
        kind = asdict(kernel.structure) | {
            "forces": None if kernel.forces is None else kernel.forces.key,
            "tangent": SEEDS,
        }
        key = cache_key(model_bytes(kernel.system), json.dumps(kind))
        code = cache.get(key)
        if code is None:
            code = compile_object(_graph(kernel), "tangent", wide=SEEDS, wide_inputs=(2,))
            cache.put(key, code)
        native = load_object(code, "tangent")
        _judge(kernel, native)
        # Another thread may have been faster, and its address may be in use.
        return ready.setdefault("tangent", native)
    return ready["tangent"]


def _graph(kernel: Kernel) -> ca.Function:
    graph = ReducedGraph(kernel.system, kernel.structure, kernel.forces)
    y, parameters = ca.SX.sym("y", kernel.layout.size), ca.SX.sym("p", kernel.layout.parameters)
    along = ca.SX.sym("v", kernel.layout.size)
    slope = ca.jtimes(graph.rate()(y, parameters), y, along)
    return ca.Function("tangent", [y, parameters, along], [ca.densify(slope)], {"cse": True})


def jacobian_of(kernel: Kernel, y: Array, parameters: Array) -> Array:
    """Return ∂ẏ/∂y, (size, size)."""
    out = np.zeros((len(y), len(y)))
    _fill(tangent_of(kernel).address, y, parameters, out)
    return out


@compiled
def _fill(address: int, y: Array, parameters: Array, out: Array) -> None:
    n = len(y)
    directions, slopes = np.zeros((n, SEEDS)), np.zeros((n, SEEDS))
    for first in range(0, n, SEEDS):
        directions[:] = 0.0
        for j in range(min(SEEDS, n - first)):
            directions[first + j, j] = 1.0
        call_tangent(address, y, parameters, directions, slopes)
        for j in range(min(SEEDS, n - first)):
            out[:, first + j] = slopes[:, j]


def _judge(kernel: Kernel, native: NativeCode) -> None:
    """Compare with differences of the kernel's rates, where these agree among each other."""
    rng, size, judged = np.random.default_rng(0), kernel.layout.size, 0
    who = f"the derivative of the kernel of '{kernel.system.name}'"
    for trial in range(_TRIALS):
        reach = 0.9 ** max(0, trial - _NEEDED)
        y = reach * rng.normal(size=size)
        parameters = reach * rng.normal(size=kernel.layout.parameters)
        found = np.zeros((size, size))
        _fill(native.address, y, parameters, found)
        rough, expected = (_differences(kernel, y, parameters, h) for h in (2.0 * _STEP, _STEP))
        # Where a force has a kink or is not defined, differences say nothing.
        with np.errstate(invalid="ignore"):
            scale = np.maximum(1e-3, np.abs(expected).max(axis=0, initial=0.0))
            smooth = np.abs(rough - expected).max(axis=0, initial=0.0) <= _TOLERANCE * scale
        smooth &= np.isfinite(found).all(axis=0)
        for j in np.flatnonzero(smooth):
            agree(who, f"column {j}", found[:, j], expected[:, j], 10.0 * _TOLERANCE)
        judged += bool(2 * smooth.sum() >= size)
        if judged == _NEEDED:
            return
    raise InputError(
        f"the forces on '{kernel.system.name}' have no derivatives at {_TRIALS - judged} of "
        f"{_TRIALS} random states; an implicit method needs them"
    )


def _differences(kernel: Kernel, y: Array, parameters: Array, h: float) -> Array:
    """Return ∂ẏ/∂y by central differences of order 6."""
    out = np.zeros((len(y), len(y)))
    steps = h * np.arange(1, 4)
    for j in range(len(y)):
        moved = np.tile(y, (6, 1))
        moved[:3, j] += steps
        moved[3:, j] -= steps
        rates = evaluate(kernel.rate.address, parameters, moved, len(y))
        out[:, j] = np.array([45.0, -9.0, 1.0]) / (60.0 * h) @ (rates[:3] - rates[3:])
    return out
