"""Work–precision diagrams: run time against error for each method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from .style import WIDTH, dots, figure, legend, line, shown, styled

_AGAINST = {
    "wall": ("wall time [ms]", 1e3),
    "evaluations": ("evaluations, or Taylor steps [1]", 1.0),
}


class MeasuredPoint(Protocol):
    """Measured error and run time of one method at one tolerance.

    Attributes:
        tolerance: Relative tolerance.
        error: Largest error at the end [rad | m].
        wall: Time of one run [s].
        evaluations: Number of evaluations of the vector field.
    """

    @property
    def tolerance(self) -> float: ...  # noqa: D102
    @property
    def error(self) -> float: ...  # noqa: D102
    @property
    def wall(self) -> float: ...  # noqa: D102
    @property
    def evaluations(self) -> float: ...  # noqa: D102


@runtime_checkable
class MeasuredWork(Protocol):
    """Run time against error on one problem, as `pinred bench accuracy` measures it.

    Attributes:
        problem: Name of the problem.
        about: Each method's name and a description of what is timed.
        reference_error: Uncertainty of the reference [rad | m].
    """

    @property
    def problem(self) -> str: ...  # noqa: D102
    @property
    def about(self) -> Mapping[str, str]: ...  # noqa: D102
    @property
    def reference_error(self) -> float: ...  # noqa: D102

    def of(self, method: str) -> Sequence[MeasuredPoint]:
        """Return the measured points of one method."""


@checks_arguments
@styled
def work_precision(
    results: MeasuredWork | Sequence[MeasuredWork],
    *,
    against: Literal["wall", "evaluations"] = "wall",
) -> Figure:
    """Draw run time against error, one panel per problem and one line per method.

    Both axes are logarithmic. Errors inside the grey band are smaller than the uncertainty of
    the reference.

    Args:
        results: One or several results of `bench_accuracy`.
        against: Quantity on the vertical axis.
    Returns:
        The figure.
    Raises:
        InputError: `results` is empty, or an argument has the wrong type.
    """
    problems = [results] if isinstance(results, MeasuredWork) else list(results)
    if not problems or not all(isinstance(problem, MeasuredWork) for problem in problems):
        raise InputError(
            "work_precision takes one or more results of pinred.laboratory.bench.bench_accuracy"
        )
    if against not in _AGAINST:
        raise InputError(f"against must be one of {', '.join(_AGAINST)}, got {against!r}")
    names = list(dict.fromkeys(name for problem in problems for name in problem.about))
    # Make each panel as high as its legend [in].
    panel_height = max(3.2, 0.2 * max(len(problem.about) for problem in problems))
    drawing = figure(
        "Work and precision", width=1.15 * WIDTH, height=0.5 + panel_height * len(problems)
    )
    panels = drawing.subplots(len(problems), 1, squeeze=False)[:, 0]
    for axes, problem in zip(panels, problems, strict=True):
        _draw_panel(axes, problem, names, against)
    return drawing


def _draw_panel(axes: Axes, result: MeasuredWork, names: list[str], against: str) -> None:
    label, factor = _AGAINST[against]
    errors: list[float] = []
    for k, name in enumerate(names):
        if name not in result.about:
            continue
        points = sorted(result.of(name), key=lambda point: point.tolerance)
        series = [(p.error, factor * getattr(p, against)) for p in points if 0.0 < p.error < np.inf]
        if series:
            x, y = zip(*series, strict=True)
            axes.plot(x, y, label=shown(name), **{**line(k), **dots(k)}, markerfacecolor="white")
            errors += x
    axes.set(xscale="log", yscale="log", xlabel="error [rad | m]", ylabel=label)
    if errors and result.reference_error > 0.0:
        low = min(result.reference_error, *errors) / 3.0
        axes.axvspan(
            low, result.reference_error, color="#E4E4E4", linewidth=0.0, zorder=0.5,
            label="not known",
        )  # fmt: skip
        axes.set_xlim(low, max(errors) * 3.0)
    if not errors:
        axes.text(0.5, 0.5, "no method finished", transform=axes.transAxes, ha="center")
    axes.set_title(result.problem, loc="left", parse_math=False)
    legend(axes)
