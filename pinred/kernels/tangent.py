"""The derivative of the vector field along several directions at once, for Newton's method.

Forward mode at one state with the directions in SIMD lanes: the Jacobian of a state of size n
needs n/8 evaluations and is exact to round-off.
"""

from __future__ import annotations

from functools import partial

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.differences import central_differences
from ..common.errors import InputError
from ..integrators.stepping.kernel_call import SEEDS
from ..integrators.stepping.linear_systems import jacobian
from .derived_code import derived_code
from .evaluate import evaluate
from .kernel import Kernel
from .machine.native import NativeCode, compile_object
from .reduced_graph import ReducedGraph
from .validation import ROUND_OFF, require_agreement

_TRIALS, _REQUIRED = 40, 2  # random states, and comparisons that must succeed
_STEP = 2e-3  # step of the differences, for states of size one
_TOLERANCE = 1e-7  # relative to the largest entry of a column
_NOISE = 1e-13  # round-off of rates, relative to the largest rate
_SAFETY = 10.0  # factor on the observed round-off of rates


def tangent_of(kernel: Kernel) -> NativeCode:
    """Return machine code (y, parameters, directions) → ∂ẏ/∂y · directions, compiled once.

    Entry i of direction j has index 8 i + j, in the directions and in the result.

    Args:
        kernel: The kernel, already validated against Pinocchio.
    Returns:
        The machine code.
    Raises:
        KernelMismatch: The code disagrees with differences of the kernel.
        InputError: The forces are not differentiable at most random states.
    """
    return derived_code(
        kernel,
        "tangent",
        {"tangent": SEEDS},
        lambda graph: compile_object(
            _graph(graph, kernel), "tangent", wide=SEEDS, wide_inputs=(2,)
        ),
        lambda native: _validate(kernel, native),
    )


def _graph(graph: ReducedGraph, kernel: Kernel) -> ca.Function:
    y, parameters = ca.SX.sym("y", kernel.layout.size), ca.SX.sym("p", kernel.layout.parameters)
    direction = ca.SX.sym("v", kernel.layout.size)
    derivative = ca.jtimes(graph.rate()(y, parameters), y, direction)
    return ca.Function(
        "tangent", [y, parameters, direction], [ca.densify(derivative)], {"cse": True}
    )


def jacobian_of(kernel: Kernel, y: Array, parameters: Array) -> Array:
    """Compute the Jacobian of the vector field.

    Args:
        kernel: The kernel.
        y: Reduced state, (size,).
        parameters: Parameters, (p,).
    Returns:
        (size, size): ∂ẏ/∂y.
    """
    return _jacobian(tangent_of(kernel), y, parameters)


def _jacobian(native: NativeCode, y: Array, parameters: Array) -> Array:
    n = len(y)
    seeds, derivatives = np.zeros((2, n * SEEDS))
    padded = np.zeros((n, -(-n // SEEDS) * SEEDS))
    jacobian(native.address, y, parameters, seeds, derivatives, padded, 0, n)
    return padded[:, :n].copy()


def _validate(kernel: Kernel, native: NativeCode) -> None:
    """Compare the derivative with differences of the rates, where these are accurate."""
    rng, size, compared = np.random.default_rng(0), kernel.layout.size, 0
    who = f"the derivative of the kernel of '{kernel.system.name}'"
    for trial in range(_TRIALS):
        reach = 0.9 ** max(0, trial - _REQUIRED)
        y = reach * rng.normal(size=size)
        parameters = kernel.random_parameters(rng)
        values = _jacobian(native, y, parameters)
        rate_at = partial(kernel.evaluate_rate, parameters=parameters)
        rough, expected = (central_differences(rate_at, y, h) for h in (2.0 * _STEP, _STEP))
        rate = rate_at(y)
        # Differences are inaccurate where a force has a kink or is undefined.
        with np.errstate(invalid="ignore"):
            noise = max(_NOISE * np.abs(rate).max(initial=0.0), _round_off(kernel, y, parameters))
            noise /= _STEP
            bound = _TOLERANCE * np.abs(expected).max(axis=0, initial=0.0) + noise
            smooth = np.abs(rough - expected).max(axis=0, initial=0.0) <= bound
        smooth &= np.isfinite(values).all(axis=0)
        for j in np.flatnonzero(smooth):
            terms = noise / ROUND_OFF
            require_agreement(
                who, f"column {j}", values[:, j], expected[:, j], terms, 10.0 * _TOLERANCE
            )
        compared += bool(2 * smooth.sum() >= size)
        if compared == _REQUIRED:
            return
    raise InputError(
        f"the forces on '{kernel.system.name}' have no derivatives at {_TRIALS - compared} of "
        f"{_TRIALS} random states; an implicit method needs them"
    )


def _round_off(kernel: Kernel, y: Array, parameters: Array) -> float:
    """Estimate the round-off of rates at y from states that differ in their last digits."""
    neighbours = y * (1.0 + np.finfo(float).eps * np.arange(-4.0, 5.0)[:, None])
    rates = evaluate(kernel.rate.address, parameters, neighbours, len(y))
    return _SAFETY * float(np.ptp(rates, axis=0).max(initial=0.0))
