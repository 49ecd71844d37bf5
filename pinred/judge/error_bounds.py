"""The bounds of compare: largest values with which a comparison passes.

Units are documented at each constant. `compute_error_bounds` gives the bound on the errors of the
motion at each time. docs/comparison.md derives all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..simulation.trajectory import Trajectory
from .distances import Distance, Size
from .step_defects import Defects

EQUATION_BOUND = 1e-12  # relative; round-off between two ways to the same accelerations
DEFECT_BOUND = 3.0  # tolerances; defect of a step, as in the stress suite
DENSE_BOUND = 50.0  # tolerances; defect of a subinterval: step control does not see dense output
DRIFT_BOUND = 100.0  # tolerances, at least; accumulated effect of many steps on energy
REFERENCE_BOUND = 100.0  # tolerances per growth; the reference is unreliable above it
FIELD_BOUND = 1e-9  # relative; pose, twist, momenta and energy are functions of q and v
RESOLUTION = 1e-13  # relative; accuracy of the reference solution and its energies
_SAFETY = 10.0  # growth is measured by one perturbation, and defects on a sample of steps
_ROUND_OFF = 1e-15  # relative; of one step


@dataclass(frozen=True)
class ErrorBounds:
    """Bounds on the errors of a motion over time.

    Attributes:
        relative: Bounds in units of the motion's size, (T,).
        distance: The same bounds in the units of each error, (T, …).
        mean_defect: Mean defect of a step, limited to the largest that passes.
    """

    relative: Array
    distance: Distance
    mean_defect: float


def compute_error_bounds(
    traj: Trajectory,
    times: Array,
    growth: Array,
    defects: Defects,
    reference_difference: Array,
    size: Size,
    tolerance: float,
) -> ErrorBounds:
    """Bound the errors at each time by the accumulated defects times the growth of perturbations.

    Args:
        traj: The trajectory.
        times: Times of the comparison, (T,) [s].
        growth: Factors by which a small perturbation has grown, (T,).
        defects: Defects of the trajectory.
        reference_difference: Distance between the two reference solutions, (T,), relative.
        size: Units of errors.
        tolerance: Sum of relative and absolute tolerance.
    Returns:
        Bounds at all times.
    """
    steps = np.searchsorted(traj.motion.knots, times, side="left")
    # A failing defect must not loosen the bound on errors, so defects are limited to what passes.
    mean, worst = float(defects.steps.mean()), float(defects.subintervals.max())
    largest_mean, largest = DEFECT_BOUND * tolerance, DENSE_BOUND * tolerance
    mean_share, share = largest_mean / max(mean, largest_mean), largest / max(worst, largest)
    per_step = mean_share * float(defects.motion_steps.mean())
    # Times lie inside steps, where dense output has an error of lower order.
    dense = share * float(defects.motion_subintervals.max())
    local = steps * per_step + np.where(steps > 0, dense, 0.0) + _ROUND_OFF * (steps + 1)
    local += defects.round_off_rate * times  # round-off of ABA affects the references, too
    floor = RESOLUTION + np.maximum.accumulate(reference_difference)
    relative = _SAFETY * (growth * local + floor)
    bounds = Distance(
        joints=relative[:, None] * size.joints,
        rotation=relative,
        # Positions far from the origin have the round-off of their distance on both sides.
        position=relative * size.position + _SAFETY * _ROUND_OFF * size.away,
    )
    return ErrorBounds(relative, bounds, mean_share * mean)
