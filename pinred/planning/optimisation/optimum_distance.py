"""Distance of an optimised gait from the optimum over all loops."""

from __future__ import annotations

from dataclasses import dataclass

from ...analysis.gaits.gait import Gait
from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, NoOptimum
from .extremal_loop import polish, refuse_extremal
from .gait_search import Search, StartFailed, finish, fourier_path_of, measure
from .transcription import Task


@checks_arguments
@dataclass(frozen=True)
class OptimumDistance:
    """The merit that an optimised gait lacks, by comparison with a better loop nearby.

    Attributes:
        value: Merit of the better loop minus merit of the gait; None if it is not known.
        route: The better loop: the "extremal" nearby, which is stationary among all loops, or the
            optimum with twice the "harmonics", which bounds the distance from below; or "none".
        reason: Why the extremal does not apply; empty if it does.
    """

    value: float | None
    route: str
    reason: str

    def __str__(self) -> str:
        if self.value is None:
            return f"not known: {self.reason}"
        if self.route == "extremal":
            return f"{self.value:.1e}, to the extremal nearby"
        return f"at least {self.value:.1e}, to the optimum with twice the harmonics"


def distance_of(task: Task, gait: Gait, merit: float, cost: float) -> OptimumDistance:
    """Compute the distance of an optimum from a better loop nearby.

    Args:
        task: The task.
        gait: Its optimum.
        merit: Merit of the optimum.
        cost: Cost of the optimum.
    Returns:
        The distance.
    """
    try:
        refuse_extremal(task, gait, cost)
        return OptimumDistance(polish(task, gait, merit).merit - merit, "extremal", "")
    except (InputError, NoOptimum) as error:
        reason = str(error)
    if not gait.is_smooth:
        return OptimumDistance(None, "none", reason)
    try:
        return OptimumDistance(_doubled(task, gait) - merit, "harmonics", reason)
    except StartFailed as error:
        return OptimumDistance(None, "none", f"with twice the harmonics, {error}")


def _doubled(task: Task, gait: Gait) -> float:
    """Return the merit of the optimum with twice the harmonics.  Raises StartFailed."""
    search = Search(task, fourier_path_of(task, 2 * len(gait.series.cos)))
    end = finish(search, gait)
    return measure(end.search, end.best, end.search.gait(end.best.z)).merit
