"""plot(): draw a figure selected by the name of its kind, with the options of that kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from inspect import unwrap
from typing import TYPE_CHECKING, Any, Literal, overload

from ...common.argument_kinds import checks_arguments, shows_overloads
from ...common.errors import InputError
from .. import plots

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike
    from xarray import Dataset

    from ...analysis.connections.connection import ConnectionSource
    from ...analysis.equilibria.branches import Branches
    from ...analysis.phases.gait import Gait
    from ...analysis.phases.phase import Phase
    from ...judge.verdict import Report
    from ...planning.optimisation.optimise import BestGait
    from ...planning.reorientation.turning_loop import TurnPlan
    from ...simulation.trajectory import Trajectory
    from ..motion_source import MotionSource
    from .connection_field import Limits, Part, Source
    from .figures_of_many_runs import MeasuredWork
    from .time_series import Attitudes

DEFAULT_KIND = "shape"


@overload
def plot(
    source: MotionSource,
    kind: Literal["shape", "rates", "limits"] = "shape",
    *,
    joints: Sequence[str | int] | None = None,
) -> Figure: ...


@overload
def plot(
    source: Trajectory, kind: Literal["torques"], *, joints: Sequence[str | int] | None = None
) -> Figure: ...


@overload
def plot(
    source: MotionSource, kind: Literal["base"], *, attitude: Attitudes = "quaternion"
) -> Figure: ...


@overload
def plot(source: MotionSource, kind: Literal["momentum", "energy"]) -> Figure: ...


@overload
def plot(source: Report | Trajectory, kind: Literal["error"]) -> Figure: ...


@overload
def plot(
    source: MotionSource,
    kind: Literal["phase"],
    *,
    joints: Sequence[str | int] | None = None,
    limits: Limits | None = None,
    when: float = 0.0,
) -> Figure: ...


@overload
def plot(source: MotionSource, kind: Literal["sphere"], *, when: float = 0.0) -> Figure: ...


@overload
def plot(
    source: Source,
    kind: Literal["curvature"],
    *,
    joints: Sequence[str | int] | None = None,
    component: str | int | None = None,
    limits: Limits | None = None,
    at: ArrayLike | None = None,
    path: ArrayLike | None = None,
) -> Figure: ...


@overload
def plot(
    source: MotionSource | Sequence[MotionSource],
    kind: Literal["poincare"],
    *,
    joints: Sequence[str | int] | None = None,
    value: float | None = None,
    direction: int = 1,
) -> Figure: ...


@overload
def plot(
    source: MeasuredWork | Sequence[MeasuredWork],
    kind: Literal["work_precision"],
    *,
    against: Literal["wall", "evaluations"] = "wall",
) -> Figure: ...


@overload
def plot(
    source: ConnectionSource,
    kind: Literal["field"],
    *,
    joints: Sequence[str | int] | None = None,
    component: str | int | None = None,
    part: Part = "curvature",
    limits: Limits | None = None,
    at: ArrayLike | None = None,
    gait: Gait | None = None,
) -> Figure: ...


@overload
def plot(
    source: Branches, kind: Literal["branches"], *, joint: str | int | None = None
) -> Figure: ...


@overload
def plot(source: Phase, kind: Literal["cycles"], *, count: int = 5) -> Figure: ...


@overload
def plot(source: BestGait | TurnPlan, kind: Literal["loop"]) -> Figure: ...


@overload
def plot(source: Dataset, kind: Literal["histogram"], *, output: str | None = None) -> Figure: ...


@overload
def plot(
    source: Dataset,
    kind: Literal["scatter", "heatmap", "quantiles"],
    *,
    output: str | None = None,
    numbers: Sequence[str] | None = None,
) -> Figure: ...


@overload
def plot(source: Any, kind: str) -> Figure: ...


@checks_arguments
@shows_overloads
def plot(source: Any, kind: str = DEFAULT_KIND, **options: Any) -> Figure:
    """Draw a figure by the function of pinred.plots with the name `kind`.

    Each kind accepts only some of the options; see the functions of pinred.plots.

    Args:
        source: Argument of the function: a Connection or System for field, a Phase for cycles, a
            BestGait or TurnPlan for loop, Branches for branches, results of `bench_accuracy` for
            work_precision, results of `sweep` for histogram, scatter, heatmap and quantiles, and a
            Trajectory for all other kinds.
        kind: Name of the function, such as "shape", "energy" or "phase".
        joints: Names or indices of joints.
        limits: (low, high) of each joint on an axis [rad | m].
        when: Time at which the momentum and the joints that are not on an axis are evaluated [s].
        component: Name or index of a component of the body twist.
        at: Shape of the joints that are not on an axis, (m,) [rad | m].
        path: Shapes to draw over the figure, (T, m) [rad | m].
        value: Value of the joint at which it crosses the section [rad | m].
        direction: Direction of the crossing: 1, −1, or 0 for both.
        against: "wall" or "evaluations".
        attitude: "quaternion", or in degrees "vector" or "rpy" (roll, pitch, yaw).
        part: "curvature", "exterior", "bracket" or "connection".
        gait: Gait to draw over the field.
        joint: Name or index of the joint on the vertical axis.
        count: Number of cycles.
        output: Name of an output of a sweep.
        numbers: Names of varied numbers of a sweep.
        **options: The options listed above that the kind takes.
    Returns:
        The figure.
    Raises:
        InputError: The kind or an option is unknown; the message lists the valid names.
        MissingPackageError: matplotlib is not installed.
    """
    return draw(source, kind, options)


def draw(source: Any, kind: str, options: Mapping[str, Any]) -> Figure:
    """Draw a figure like `plot`, with the options in a mapping."""
    valid = options_of(kind)
    for option in options:
        if option not in valid:
            listed = f"its options are {', '.join(valid)}" if valid else "it has none"
            raise InputError(f"plot '{kind}' has no option '{option}'; {listed}")
    figure: Figure = getattr(plots, kind)(source, **options)
    return figure


@checks_arguments
def options_of(kind: str) -> tuple[str, ...]:
    """Return the names of the options of a kind of plot.

    Args:
        kind: Name of the kind.
    Returns:
        Names of its options.
    Raises:
        InputError: Unknown kind.
    """
    if kind not in plots.KINDS:
        raise InputError(f"no plot of kind {kind!r}; the kinds are {', '.join(plots.KINDS)}")
    return tuple(unwrap(getattr(plots, kind)).__kwdefaults__ or ())
