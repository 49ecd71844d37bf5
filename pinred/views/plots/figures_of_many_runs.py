"""Figures of many runs: results of sweeps, branches over the momentum, and work against error.

Sweeps have histograms, scatter plots, maps over two numbers, and quantiles. Branch diagrams draw
relative equilibria against momentum, with folds and pitchforks. Work–precision diagrams draw run
time against error for each method.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import isotonic_regression

from ...analysis.equilibria.branches import Branches, BranchPoint
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed, nearest, quoted
from ..motion_source import labels_of
from .style import (
    BLACK,
    BLUE,
    FIELD,
    PALETTE,
    PANEL,
    RED,
    STEADY,
    WIDTH,
    dots,
    figure,
    legend,
    line,
    shown,
    styled,
)

if TYPE_CHECKING:
    from xarray import Dataset

_BINS = 40  # bins of histograms and maps
_MOST_TICKS = 6  # more labels would touch each other
_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
_MOST_DOTS = 20_000  # points of a scatter plot; more would hide each other
_MOST_LISTED = 400  # largest number of different values that get a cell each


@checks_arguments
@styled
def histogram(source: Dataset, *, output: str | None = None) -> Figure:
    """Draw the distribution of an output of a sweep, with quantiles, mean and standard deviation.

    Args:
        source: Results of `pinred.sweep`, or the dataset of a store.
        output: Name of the output; unnecessary if there is only one.
    Returns:
        The figure.
    Raises:
        InputError: The output does not exist, or has more than one number for each point.
    """
    name, values, _, title = _chosen(source, output)
    drawing = figure(title, height=3.2)
    axes: Axes = drawing.subplots()
    low, high = float(values.min()), float(values.max())
    size = max(abs(low), abs(high))
    if high - low <= STEADY * size:  # Bins of constant values would be narrower than round-off.
        low, high = low - (0.1 * size or 1.0), high + (0.1 * size or 1.0)
    axes.hist(values, bins=_BINS, range=(low, high), color=BLUE)
    for level, style, words in ((0.05, ":", "5 %"), (0.5, "-", "median"), (0.95, ":", "95 %")):
        value = float(np.quantile(values, level))
        axes.axvline(value, color=RED, linestyle=style, label=f"{words}: {value:.4g}")
    mean, deviation = float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0
    axes.axvline(mean, color=BLACK, linestyle="--", label=f"mean: {mean:.4g} ± {deviation:.2g}")
    legend(axes)
    axes.set_xlabel(_label(source, name))
    axes.locator_params(axis="x", nbins=_MOST_TICKS)
    axes.set_ylabel(f"points of {len(values)}")
    return drawing


@checks_arguments
@styled
def scatter(
    source: Dataset, *, output: str | None = None, numbers: Sequence[str] | None = None
) -> Figure:
    """Draw an output of a sweep against each varied number, one panel for each.

    Args:
        source: Results of `pinred.sweep`, or the dataset of a store.
        output: Name of the output; unnecessary if there is only one.
        numbers: Names of the varied numbers; all if None.
    Returns:
        The figure.
    Raises:
        InputError: A name does not exist, or the output has several numbers for each point.
    """
    name, values, kept, title = _chosen(source, output)
    names = _numbers(source, numbers)
    drawing = figure(title, height=0.6 + PANEL * len(names))
    step = -(-len(values) // _MOST_DOTS)
    for axes, number in zip(drawing.subplots(len(names), squeeze=False).flat, names, strict=True):
        axes.plot(source[number].values[kept][::step], values[::step], ".", color=BLUE, ms=2.0)
        axes.set_xlabel(_label(source, number))
        axes.set_ylabel(_label(source, name))
    return drawing


@checks_arguments
@styled
def heatmap(
    source: Dataset, *, output: str | None = None, numbers: Sequence[str] | None = None
) -> Figure:
    """Draw the mean of an output of a sweep over two varied numbers.

    Args:
        source: Results of `pinred.sweep`, or the dataset of a store.
        output: Name of the output; unnecessary if there is only one.
        numbers: Names of two varied numbers; the first two if None.
    Returns:
        The figure.
    Raises:
        InputError: A name does not exist, there are not two numbers, or the output has several
            numbers for each point.
    """
    name, values, kept, title = _chosen(source, output)
    names = _numbers(source, numbers)[: None if numbers else 2]
    if len(names) != 2:
        raise InputError(f"numbers: expected two varied numbers, got {listed(names)}")
    columns = [source[number].values[kept] for number in names]
    edges = [_edges(column) for column in columns]
    bins: Any = edges
    sums, *_ = np.histogram2d(columns[0], columns[1], bins=bins, weights=values)
    counts, *_ = np.histogram2d(columns[0], columns[1], bins=bins)
    means = np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
    drawing = figure(title, height=0.75 * WIDTH)
    axes: Axes = drawing.subplots()
    mesh = axes.pcolormesh(*edges, means.T, cmap=FIELD)
    drawing.colorbar(mesh, ax=axes).set_label(f"mean of {_label(source, name)}", parse_math=False)
    axes.set_xlabel(_label(source, names[0]))
    axes.set_ylabel(_label(source, names[1]))
    return drawing


@checks_arguments
@styled
def quantiles(
    source: Dataset, *, output: str | None = None, numbers: Sequence[str] | None = None
) -> Figure:
    """Draw median and quantiles of an output of a sweep, over time or over a varied number.

    The bands are between the 5 and 95 %, and the 25 and 75 % quantiles.

    Args:
        source: Results of `pinred.sweep`, or the dataset of a store.
        output: Name of the output; unnecessary if there is only one.
        numbers: Name of one varied number, for outputs without time; the first one if None.
    Returns:
        The figure.
    Raises:
        InputError: A name does not exist, or the output has other dimensions.
    """
    name, values, kept, title = _chosen(source, output, over_time=True)
    drawing = figure(title, height=3.2)
    axes: Axes = drawing.subplots()
    if values.ndim == 2:
        x, levels = source["t"].values, np.quantile(values, _LEVELS, axis=0)
        axes.set_xlabel("time [s]")
    else:
        number = _numbers(source, numbers)[0]
        column = source[number].values[kept]
        bins = np.clip(np.searchsorted(edges := _edges(column), column, "right") - 1, 0, None)
        groups = [values[bins == k] for k in range(len(edges) - 1)]
        filled = [k for k, group in enumerate(groups) if group.size]
        x = (0.5 * (edges[1:] + edges[:-1]))[filled]
        levels = np.array([np.quantile(groups[k], _LEVELS) for k in filled]).T
        axes.set_xlabel(_label(source, number))
    axes.fill_between(x, levels[0], levels[4], color=BLUE, alpha=0.2, linewidth=0)
    axes.fill_between(x, levels[1], levels[3], color=BLUE, alpha=0.3, linewidth=0)
    axes.plot(x, levels[2], color=RED)
    axes.set_ylabel(_label(source, name))
    return drawing


def _chosen(
    source: Any, output: str | None, *, over_time: bool = False
) -> tuple[str, Array, Array, str]:
    """Return the name of an output, its finite values, the mask of their points, and a title."""
    admitted = [("point",), ("point", "t")] if over_time else [("point",)]
    if "status" not in getattr(source, "data_vars", ()):
        raise InputError(
            f"source: expected the results of pinred.sweep, got {type(source).__name__}"
        )
    names = [
        str(name)
        for name, values in source.data_vars.items()
        if values.dims in admitted and name != "status"
    ]
    if output is None and len(names) == 1:
        output = names[0]
    if output not in names:
        what = "" if output is None else f"there is no {quoted(output)}; {nearest(output, names)}"
        raise InputError(
            f"output: {what}choose one of the outputs with one number for each point: "
            f"{listed(names) or 'there are none; store an entry, such as pose.x'}"
        )
    values = source[output].values
    kept = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    if not kept.any():
        raise InputError(f"output: {quoted(output)} has no finite value")
    return output, values[kept], kept, f"{source.attrs.get('robot', 'sweep')}: {output}"


def _numbers(source: Any, names: Sequence[str] | None) -> list[str]:
    varied = [str(name) for name, values in source.coords.items() if values.dims == ("point",)]
    for name in names or ():
        if name not in varied:
            raise InputError(
                f"numbers: there is no {quoted(str(name))}; {nearest(str(name), varied)}the varied "
                f"numbers are {listed(varied)}"
            )
    return list(names or varied)


def _edges(column: Array) -> Array:
    """Return the edges of bins: around each value of a list, or of equal width."""
    values = np.unique(column)
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    if len(values) > min(_MOST_LISTED, len(column) // 2):
        return np.linspace(values[0], values[-1], _BINS + 1)
    middle = 0.5 * (values[1:] + values[:-1])
    first, last = 1.5 * values[0] - 0.5 * values[1], 1.5 * values[-1] - 0.5 * values[-2]
    return np.concatenate([[first], middle, [last]])


def _label(source: Any, name: str) -> str:
    unit = source[name].attrs.get("units", "")
    return f"{name} [{unit}]" if unit else name


GREY = "#555555"
_SAME = 2e-3  # largest distance between lines that coincide, relative to the size of the figure
# Line styles by the index of the amended potential: the number of directions in which it falls.
_STABLE, _EVEN, _ODD = "stable: a minimum", "undecided: index even", "unstable: index odd"
_LINES: dict[str, dict[str, Any]] = {
    _STABLE: {"linestyle": "-", "linewidth": 1.8},
    _EVEN: {"linestyle": (0, (5, 1.5)), "linewidth": 1.2},
    _ODD: {"linestyle": (0, (1.2, 1.2)), "linewidth": 1.2},
}
_MARKS = {"folds": "o", "pitchforks": "^", "crossings": "s"}
_MEANINGS = {"folds": "fold", "pitchforks": "pitchfork", "crossings": "crossing"}


@checks_arguments
@styled
def branches(found: Branches, *, joint: str | int | None = None) -> Figure:
    """Draw the branches of relative equilibria against the momentum.

    Solid lines are stable, dotted lines are unstable. The amended potential alone does not decide
    whether dashed lines are stable.

    Args:
        found: Result of `pinred.branches`.
        joint: Name or index of the joint on the vertical axis; the amended potential if None.
    Returns:
        The figure.
    Raises:
        InputError: `found` has another type, or the joint does not exist.
    """
    if not isinstance(found, Branches):
        raise InputError(
            f"a branch diagram takes the result of pinred.branches, got {type(found).__name__}"
        )
    system = found.system
    names = labels_of(system)
    k = None if joint is None else names.index(joint)
    is_linear = system.group.turns == 0
    momentum = "momentum" if is_linear else "angular momentum"
    drawing = figure(f"{system.name}: steady motions at each {momentum}", height=4.4)
    axes = drawing.subplots()

    def height(point: BranchPoint) -> float:
        if k is None:
            return point.amended_potential
        return float(system.space.chart(point.x[None])[0, k])

    low, high = found.momentum
    size = np.ptp([height(p) for p in found.points]) if found.points else 0.0
    near = _SAME * np.array([high - low, size])
    drawn: dict[str, list[Array]] = {}
    for number in range(found.count):
        color = PALETTE[number % len(PALETTE)]
        for segment, label in _segments(found.branch(number)):
            line = np.array([(p.momentum, height(p)) for p in segment])
            earlier = drawn.setdefault(label, [])
            # Overlapping dashed lines would look solid, so only one of two mirror images is drawn.
            if not any(_covers(other, line, near) for other in earlier):
                axes.plot(*line.T, color=color, **_LINES[label])
                earlier.append(line)
    for label in (label for label in _LINES if label in drawn):
        axes.plot([], [], color=GREY, label=label, **_LINES[label])
    for name, marker in _MARKS.items():
        points: tuple[BranchPoint, ...] = getattr(found, name)
        if points:
            axes.plot(
                [p.momentum for p in points], [height(p) for p in points],
                linestyle="", marker=marker, color="black", markerfacecolor="white",
                label=_MEANINGS[name], zorder=3,
            )  # fmt: skip
    axes.set_xlabel(f"{momentum} [{'N·s' if is_linear else 'N·m·s'}]")
    axes.set_ylabel("amended potential [J]" if k is None else names.with_unit(k))
    legend(axes)
    return drawing


def _segments(points: tuple[BranchPoint, ...]) -> list[tuple[list[BranchPoint], str]]:
    """Split a branch into segments of one stability and monotonic momentum, with shared ends."""
    segments: list[tuple[list[BranchPoint], str]] = []
    last_direction = 0.0
    for a, b in pairwise(points):
        label, direction = _stability(b), float(np.sign(b.momentum - a.momentum))
        if not segments or segments[-1][1] != label or direction * last_direction < 0.0:
            segments.append(([a], label))
        segments[-1][0].append(b)
        last_direction = direction or last_direction
    if not segments and points:
        segments.append(([points[0]], _stability(points[0])))
    return segments


def _covers(other: Array, line: Array, near: Array) -> bool:
    """Return whether one monotonic curve, (k, 2), visibly coincides with part of another curve."""
    if len(other) < 2:
        return False
    x, y = other[np.argsort(other[:, 0])].T
    within = x[0] - near[0] <= line[:, 0].min() and line[:, 0].max() <= x[-1] + near[0]
    return bool(within and (np.abs(np.interp(line[:, 0], x, y) - line[:, 1]) <= near[1]).all())


def _stability(point: BranchPoint) -> str:
    if point.index == 0:
        return _STABLE
    return _ODD if point.index % 2 else _EVEN


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
