"""Errors of the reference solution, from its residuals in the equations of motion.

Gauss's quadrature shares nothing with Hairer's codes. It integrates the residual of the dense
output over each step that contains a time of the comparison. The defects of steps accumulate, and
grow like perturbations of the motion.
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .quadrature import integrate_residuals, propagate_residuals
from .reference_solution import FullState, Solution


def reference_errors(
    full: FullState, solution: Solution, times: Array, growth: Array, units: Array
) -> Array:
    """Bound the errors of a solution by its accumulated defects times the growth of perturbations.

    Args:
        full: Full simulation of the scene.
        solution: Solution at `times`.
        times: Increasing times, (T,) [s].
        growth: Factors by which a small perturbation has grown, (T,).
        units: Units of the numbers in a state, (n,).
    Returns:
        (T,) errors relative to the units; zero at the start.
    """
    steps = solution.steps
    if steps is None:
        return np.zeros(len(times))

    def numbers(t: Array) -> list[Array]:
        return [solution.parameters[k] for k in np.searchsorted(steps.ends, t)]

    count = len(steps.ends)
    residuals = integrate_residuals(full, steps.starts, steps.ends, steps, numbers)
    propagated = propagate_residuals(full, residuals, np.arange(count), units)
    defects = np.maximum(np.abs(residuals.defects), np.abs(propagated))
    step = np.minimum(np.searchsorted(steps.ends, times), count - 1)
    # Steps without times of the comparison count like the others.
    skipped = (np.searchsorted(solution.step_ends, times) + 1) / (step + 1)
    accumulated = skipped * np.cumsum((defects / units).max(axis=1))[step]
    # Times lie within steps, where dense output has an error of lower order.
    within = np.maximum.accumulate((residuals.largest_defects / units).max(axis=1))[step]
    return np.where(times > 0.0, growth * accumulated + within, 0.0)
