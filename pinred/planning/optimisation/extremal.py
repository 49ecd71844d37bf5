"""extremal(): polish an optimised gait to an exact extremal of the isoholonomic problem."""

from __future__ import annotations

from ...common.argument_kinds import checks_arguments
from ...common.waiting import Wait
from .best_gait import BestGait
from .extremal_loop import Extremal, polish, refuse_extremal


@checks_arguments
@Wait("iterates a gait to an extremal")
def extremal(best: BestGait) -> Extremal:
    """Compute the extremal near an optimised gait: a loop that obeys Wong's equations.

    A loop of least length for its displacement, or of largest displacement per length, obeys
    ∇_ẋ ẋ = M⁻¹⟨μ, B(·, ẋ)⟩ with a charge μ that is constant in space. The boundary value problem of
    a closed loop is solved by multiple shooting and a Levenberg–Marquardt iteration that starts
    from the Fourier gait.

    Args:
        best: An optimum of `optimise_gait` with cost "length", within its limits.
    Returns:
        The extremal, with its charge and the residual of the boundary value problem.
    Raises:
        InputError: The cost is not the length, the gait is a polygon, or a limit is active.
        NoOptimum: No extremal was found near the gait, or it exceeds the limits.
    """
    refuse_extremal(best.task, best.gait, best.cost)
    return polish(best.task, best.gait, best.merit)
