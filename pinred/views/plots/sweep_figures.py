"""Figures of sweeps: histograms, scatter plots, maps over two numbers, and quantiles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed, nearest, quoted
from .style import BLACK, BLUE, FIELD, PANEL, RED, STEADY, WIDTH, figure, legend, styled

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
