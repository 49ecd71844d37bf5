"""The derivative of the vector field along several directions at once, for Newton's method.

Forward mode at one state, with the directions as lanes: the whole Jacobian of a state of n
numbers takes n/8 evaluations, and is exact to round-off.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..integrators.stepping.kernel_call import SEEDS
from ..integrators.stepping.linear_systems import jacobian
from .derived_code import derived_code
from .evaluate import evaluate
from .kernel import Kernel
from .machine.native import NativeCode, compile_object
from .reduced_graph import ReducedGraph
from .validation import ROUND_OFF, require_agreement

_TRIALS, _NEEDED = 40, 2
_STEP = 2e-3  # of the differences, for states of size one
_TOLERANCE = 1e-7  # of the largest entry in a column
_NOISE = 1e-13  # of the largest rate; what its round-off is to differences
_SAFELY = 10.0  # times the round-off that is seen


def tangent_of(kernel: Kernel) -> NativeCode:
    """Return machine code (y, parameters, directions) → ∂ẏ/∂y directions, built once.

    Entry i of direction j stands at 8 i + j, of the directions and of the output.  Raises
    KernelMismatch if it disagrees with differences of the kernel, which Pinocchio has judged.
    """
    return derived_code(
        kernel,
        "tangent",
        {"tangent": SEEDS},
        lambda graph: compile_object(
            _graph(graph, kernel), "tangent", wide=SEEDS, wide_inputs=(2,)
        ),
        lambda native: _judge(kernel, native),
    )


def _graph(graph: ReducedGraph, kernel: Kernel) -> ca.Function:
    y, parameters = ca.SX.sym("y", kernel.layout.size), ca.SX.sym("p", kernel.layout.parameters)
    along = ca.SX.sym("v", kernel.layout.size)
    slope = ca.jtimes(graph.rate()(y, parameters), y, along)
    return ca.Function("tangent", [y, parameters, along], [ca.densify(slope)], {"cse": True})


def jacobian_of(kernel: Kernel, y: Array, parameters: Array) -> Array:
    """Return ∂ẏ/∂y, (size, size)."""
    return _jacobian(tangent_of(kernel), y, parameters)


def _jacobian(native: NativeCode, y: Array, parameters: Array) -> Array:
    n = len(y)
    seeds, slopes = np.zeros((2, n * SEEDS))
    rows = np.zeros((n, -(-n // SEEDS) * SEEDS))
    jacobian(native.address, y, parameters, seeds, slopes, rows, 0, n)
    return rows[:, :n].copy()


def _judge(kernel: Kernel, native: NativeCode) -> None:
    """Compare with differences of the kernel's rates, where these agree among each other."""
    rng, size, judged = np.random.default_rng(0), kernel.layout.size, 0
    who = f"the derivative of the kernel of '{kernel.system.name}'"
    for trial in range(_TRIALS):
        reach = 0.9 ** max(0, trial - _NEEDED)
        y = reach * rng.normal(size=size)
        parameters = kernel.random_parameters(rng)
        found = _jacobian(native, y, parameters)
        rough, expected = (_differences(kernel, y, parameters, h) for h in (2.0 * _STEP, _STEP))
        rate = kernel.evaluate_rate(y, parameters)
        # Where a force has a kink or is not defined, differences say nothing.
        with np.errstate(invalid="ignore"):
            noise = max(_NOISE * np.abs(rate).max(initial=0.0), _round_off(kernel, y, parameters))
            noise /= _STEP
            most = _TOLERANCE * np.abs(expected).max(axis=0, initial=0.0) + noise
            smooth = np.abs(rough - expected).max(axis=0, initial=0.0) <= most
        smooth &= np.isfinite(found).all(axis=0)
        for j in np.flatnonzero(smooth):
            terms = noise / ROUND_OFF
            require_agreement(
                who, f"column {j}", found[:, j], expected[:, j], terms, 10.0 * _TOLERANCE
            )
        judged += bool(2 * smooth.sum() >= size)
        if judged == _NEEDED:
            return
    raise InputError(
        f"the forces on '{kernel.system.name}' have no derivatives at {_TRIALS - judged} of "
        f"{_TRIALS} random states; an implicit method needs them"
    )


def _round_off(kernel: Kernel, y: Array, parameters: Array) -> float:
    """Return how far rates a few last digits beside y are apart; where all cancels, all of them."""
    beside = y * (1.0 + np.finfo(float).eps * np.arange(-4.0, 5.0)[:, None])
    rates = evaluate(kernel.rate.address, parameters, beside, len(y))
    return _SAFELY * float(np.ptp(rates, axis=0).max(initial=0.0))


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
