"""Work–precision diagrams: run time against error for each method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import isotonic_regression

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from .style import WIDTH, dots, figure, line, shown, styled

_LineEnd = tuple[str, float, float, str]  # name, largest error, work there, colour
_LABEL_HEIGHT = 0.16  # of a line's name [in]
_AGAINST = {
    "wall": ("wall time [ms]", 1e3),
    "evaluations": ("evaluations, or Taylor steps [1]", 1.0),
}


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

    def of(self, method: str) -> Sequence[Any]:
        """Return the measured points of one method.

        A point has `tolerance`, the largest `error` at the end [rad | m], the `wall` time of a run
        [s], and its `evaluations` of the vector field.
        """


@checks_arguments
@styled
def work_precision(
    results: MeasuredWork | Sequence[MeasuredWork],
    *,
    against: Literal["wall", "evaluations"] = "wall",
) -> Figure:
    """Draw run time against error, one panel per problem and one line per method.

    Both axes are logarithmic. The name of each method stands at its line. Errors inside the grey
    band are smaller than the uncertainty of the reference.

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
    # Make each panel as high as the names of its lines [in].
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
    ends: list[_LineEnd] = []
    for k, name in enumerate(names):
        if name not in result.about:
            continue
        points = sorted(result.of(name), key=lambda point: point.tolerance)
        series = [(p.error, factor * getattr(p, against)) for p in points if 0.0 < p.error < np.inf]
        if series:
            x, y = zip(*series, strict=True)
            axes.plot(x, y, label=shown(name), **{**line(k), **dots(k)}, markerfacecolor="white")
            ends.append((shown(name), x[-1], y[-1], str(line(k)["color"])))
            errors += x
    axes.set(xscale="log", yscale="log", xlabel="error [rad | m]", ylabel=label)
    if errors and result.reference_error > 0.0:
        low = min(result.reference_error, *errors) / 3.0
        axes.axvspan(
            low, result.reference_error, color="#E4E4E4", linewidth=0.0, zorder=0.5,
            label="not known",
        )  # fmt: skip
        axes.text(
            1.2 * low, 0.03, "not known", rotation=90.0, fontsize=8.0, color="#777777",
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
        axes.set_xlim(low, max(errors) * 3.0)
    if not errors:
        axes.text(0.5, 0.5, "no method finished", transform=axes.transAxes, ha="center")
    axes.set_title(result.problem, loc="left", parse_math=False)
    _label_lines(axes, ends)


def _label_lines(axes: Axes, ends: list[_LineEnd]) -> None:
    """Write the name of each line to the right of the axes, at the height of its end.

    Names that would overlap are moved apart as little as possible, in the order of the ends.
    """
    if not ends:
        return
    axes.set_ylim(axes.get_ylim())  # the heights below refer to the final limits
    ends = sorted(ends, key=lambda end: end[2])
    low, high = np.log(axes.get_ylim())
    heights = (np.log([end[2] for end in ends]) - low) / (high - low)
    figure_height = axes.get_figure(root=True).get_size_inches()[1]  # type: ignore[union-attr]
    gap = _LABEL_HEIGHT / (figure_height * axes.get_position().height)
    steps = gap * np.arange(len(ends))
    placed = isotonic_regression(heights - steps).x + steps
    for (name, error, work, colour), height in zip(ends, placed, strict=True):
        axes.annotate(
            name, (error, work), (1.03, float(height)), textcoords="axes fraction", color=colour,
            fontsize=8.0, va="center", annotation_clip=False, parse_math=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "alpha": 0.5},
        )  # fmt: skip
