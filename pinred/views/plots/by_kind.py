"""A figure by the name of its kind: the function of that name, with the options it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, overload

from ...common.errors import InputError
from ...common.signatures import shows_overloads
from .. import plots

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from ...analysis.branches.follow import Branches
    from ...analysis.connections.connection import Connection
    from ...analysis.gaits.gait import Gait
    from ...analysis.phases.phase import Phase
    from ...judge.report import Report
    from ...planning.optimisation.best_gait import BestGait
    from ...planning.reorientation.turn_plan import TurnPlan
    from ...simulation.trajectory import Trajectory
    from ..motion_source import MotionSource
    from .connection_field import Part
    from .curvature_field import Source
    from .shape_plane import Limits
    from .work_against_error import MeasuredWork


@overload
def plot(
    source: MotionSource,
    kind: Literal["shape"] = "shape",
    *,
    joints: Sequence[str | int] | None = None,
) -> Figure: ...


@overload
def plot(source: MotionSource, kind: Literal["base", "momentum", "energy"]) -> Figure: ...


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
    source: Connection,
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
def plot(source: Any, kind: str) -> Figure: ...


@shows_overloads
def plot(source: Any, kind: str = "shape", **options: Any) -> Figure:
    """Return the figure of a kind: the function of that name in pinred.plots.

    source: what the function takes: a Connection for field, a Phase for cycles, a BestGait or
    TurnPlan for loop, Branches for branches, a Trajectory for all others but work_precision.
    options: those of the function; no kind takes all that are shown here.
    Raises InputError for a kind or option that there is not, listing those there are;
    MissingPackageError if matplotlib is not installed.
    """
    return draw(source, kind, options)


def draw(source: Any, kind: str, options: Mapping[str, Any]) -> Figure:
    """Return what `plot` does, of options under any names."""
    known = options_of(kind)
    for option in options:
        if option not in known:
            has = f"its options are {', '.join(known)}" if known else "it has none"
            raise InputError(f"plot '{kind}' has no option '{option}'; {has}")
    figure: Figure = getattr(plots, kind)(source, **options)
    return figure


def options_of(kind: str) -> tuple[str, ...]:
    """Return the names of the options that a kind of plot takes.  Raises as `plot`."""
    if kind not in plots.KINDS:
        raise InputError(f"no plot of kind {kind!r}; the kinds are {', '.join(plots.KINDS)}")
    return tuple(getattr(plots, kind).__wrapped__.__kwdefaults__ or ())
